// SPDX-License-Identifier: AGPL-3.0-or-later
// Compressed functions: as near or as small as asked for, the same from a file, any voxel without the others.
#include "solvers/shell_texture/shell_texture_codec.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "solvers/shell_texture/vector_table.h"

namespace shellgrid {
namespace {

// Light that fades with depth, over a texture, with some noise; free space at a side.
ShellTexture smooth(const Vec3i& size, double noise) {
  ShellTexture t;
  t.size = size;
  t.voxel = 0.3;
  const int n = t.directions.count();
  const std::size_t voxels = static_cast<std::size_t>(size.x()) * size.y() * size.z();
  t.single.resize(voxels * n);
  t.multiple.resize(voxels * (n + 1));
  t.error.assign(voxels * (n + 1), 0.02f);
  t.matter.assign(voxels, 1.0f);
  for (std::size_t v = 0; v < voxels; ++v) {
    const double x = static_cast<double>(v % size.x()) / size.x(),
                 y = static_cast<double>(v / size.x() % size.y()) / size.y(),
                 z = static_cast<double>(v / (static_cast<std::size_t>(size.x()) * size.y()));
    t.matter[v] = z < 1 && x < 0.3 ? 0.0f : z < 2 && x < 0.35 ? 0.4f : 1.0f;
    const double vein = 1 + 0.5 * std::sin(12 * x + 3 * std::sin(9 * y)) * std::cos(7 * y);
    for (int l = 0; l <= n; ++l) {
      const Vec3 d = l < n ? t.directions.direction(l) : Vec3(0, 0, 1);
      for (int c = 0; c < 3; ++c) {
        const double chance = 1 + noise * (2 * to_unit(hash64(v, 100 * l + c)) - 1);
        const double single = d.z() * std::exp(-0.5 * z / d.z() * vein * (1 + 0.2 * c));
        const double multiple = d.z() * std::exp(-0.15 * z * (1 + 0.3 * c)) * (vein + 0.3 * d.x() * std::sin(15 * x));
        if (l < n) t.single[t.at(l, v)][c] = static_cast<float>(t.matter[v] > 0 ? single : 0.0);
        t.multiple[t.at(l, v)][c] = static_cast<float>(t.matter[v] > 0 ? std::max(0.0, multiple * chance) : 0.0);
      }
    }
  }
  for (int l = 0; l <= n; ++l)
    for (std::size_t k = 0; k < t.texel_count(); ++k)
      t.below.push_back(t.multiple[t.at(l, voxels - t.texel_count() + k)]);
  return t;
}

TEST(ShellTextureCodec, IsAsNearAsAskedFor) {
  const ShellTexture t = smooth({40, 36, 5}, 0.03);
  for (const ShellTextureCodec codec :
       {ShellTextureCodec::principal_components, ShellTextureCodec::vector_quantisation})
    for (const double psnr : {30.0, 38.0}) {
      CodecGoal goal;
      goal.psnr = psnr;
      CodecReport report;
      const auto lookup = compress_shell_texture(t, codec, goal, &report);
      std::printf("codec %d, %.0f dB asked for: %.2f dB, %.1f : 1, %d words\n", static_cast<int>(codec), psnr,
                  report.psnr, report.ratio, report.words);
      EXPECT_GT(report.psnr, psnr - 0.3);
      EXPECT_GT(report.ratio, 8);
      EXPECT_NEAR(report.psnr, psnr_of(t, *lookup), 1e-9);
      // What passes into the core, and the free space.
      const PreparedLight light = lookup->prepare_direction(t.directions.direction(5));
      for (int k = 0; k < 1440; k += 7) {
        const Vec3f below = lookup->below(static_cast<float>(k % 40) + 0.5f, static_cast<float>(k / 40) + 0.5f, light);
        EXPECT_LT((below - t.below[5 * 1440 + k]).cwiseAbs().maxCoeff(), 0.05f);
      }
      EXPECT_EQ(lookup->reader()->voxel_light(0, light).multiple.norm(), 0);
    }
}

TEST(ShellTextureCodec, IsAsSmallAsAskedFor) {
  const ShellTexture t = smooth({48, 40, 4}, 0.02);
  CodecGoal goal;
  goal.ratio = 20;
  CodecReport components, vectors;
  compress_shell_texture(t, ShellTextureCodec::principal_components, goal, &components);
  compress_shell_texture(t, ShellTextureCodec::vector_quantisation, goal, &vectors);
  EXPECT_GT(components.ratio, 19.9);
  EXPECT_GT(vectors.ratio, 18);
  std::printf("20 : 1: components %.2f dB, vectors %.2f dB\n", components.psnr, vectors.psnr);
  EXPECT_GT(components.psnr, vectors.psnr + 3);
}

TEST(ShellTextureCodec, ComesBackFromItsArchiveAndAnswersInAnyOrder) {
  ShellTexture t = smooth({21, 13, 3}, 0.02);
  t.kernels = {0.3, 2, {0, 1, 3}, std::vector<Vec3f>(6, Vec3f(1, 2, 3)), std::vector<std::uint8_t>(21 * 13, 0)};
  for (const ShellTextureCodec codec :
       {ShellTextureCodec::principal_components, ShellTextureCodec::vector_quantisation}) {
    CodecGoal goal;
    goal.psnr = 35;
    const auto lookup = compress_shell_texture(t, codec, goal);
    const NumberArchive archive = lookup->archive();
    const auto back = restore_compressed(archive, "file");
    EXPECT_EQ(back->size(), t.size);
    EXPECT_EQ(back->voxel(), 0.3);
    EXPECT_EQ(back->matter(), lookup->matter());
    EXPECT_TRUE(back->below() == lookup->below());
    EXPECT_TRUE(back->kernels().values == t.kernels.values);
    EXPECT_EQ(back->kernels().first_layer, t.kernels.first_layer);
    const auto one = lookup->reader(), other = back->reader();
    const PreparedLight light = lookup->prepare({{3, {1, 0.5f, 2}}, {70, {0, 1, 1}}}), same = back->prepare(light.list);
    for (std::size_t k = 0; k < t.voxel_count(); ++k) {
      const std::size_t v = k * 101 % t.voxel_count();
      const VoxelLight a = one->voxel_light(k, light), b = back->reader()->voxel_light(k, same);
      ASSERT_EQ(a.single, b.single);
      ASSERT_EQ(a.multiple, b.multiple);
      ASSERT_EQ(one->voxel_back(v), other->voxel_back(v));
    }
    for (const auto& [name, list] : archive.counts) {
      NumberArchive damaged = archive;
      damaged.counts.erase(name);
      EXPECT_THROW(restore_compressed(damaged, "file"), InputError) << name;
      if (list.empty()) continue;
      damaged = archive;
      damaged.counts[name].pop_back();
      EXPECT_THROW(restore_compressed(damaged, "file"), InputError) << name;
    }
    // Wrong bytes give wrong values, nothing worse.
    NumberArchive damaged = archive;
    for (std::size_t k = 0; k < damaged.counts["light stream"].size(); k += 3)
      damaged.counts["light stream"][k] ^= hash64(k);
    const auto wrong = restore_compressed(damaged, "file");
    const auto reader = wrong->reader();
    for (std::size_t v = 0; v < t.voxel_count(); ++v) (void)reader->voxel_light(v, light);
  }
  NumberArchive other;
  other.kind = "light paths";
  EXPECT_THROW(restore_compressed(other, "file"), InputError);
}

TEST(ShellTextureCodec, RefusesFreeSpaceAlone) {
  ShellTexture t = smooth({4, 4, 2}, 0);
  t.matter.assign(t.matter.size(), 0.0f);
  EXPECT_THROW(compress_shell_texture(t, ShellTextureCodec::principal_components, {}), InputError);
  EXPECT_THROW(compress_shell_texture(t, ShellTextureCodec::vector_quantisation, {}), InputError);
}

TEST(SymbolCoder, BringsBackWhatItWasGiven) {
  for (const std::size_t symbols : {1u, 2u, 77u, 4096u}) {
    std::vector<std::uint64_t> weights;
    for (std::size_t k = 0; k < symbols; ++k) weights.push_back(1'000'000 / (k * k + 1));
    const SymbolTable table = SymbolTable::from_weights(weights);
    std::vector<std::uint32_t> given;
    for (int k = 0; k < 5000; ++k)
      given.push_back(
          static_cast<std::uint32_t>(std::pow(to_unit(hash64(symbols, k)), 4) * static_cast<double>(symbols)));
    SymbolEncoder encoder;
    for (auto at = given.rbegin(); at != given.rend(); ++at) {
      encoder.put_bits(*at & 0xfff, 12);
      encoder.put(table, *at);
    }
    const std::vector<std::uint8_t> bytes = encoder.finish();
    SymbolDecoder decoder(bytes.data(), bytes.data() + bytes.size());
    for (const std::uint32_t symbol : given) {
      ASSERT_EQ(decoder.take(table), symbol);
      ASSERT_EQ(decoder.take_bits(12), symbol & 0xfff);
    }
  }
  EXPECT_THROW(SymbolTable::from_frequencies({4095}), InputError);
  EXPECT_THROW(SymbolTable::from_frequencies({4096, 0}), InputError);
}

}  // namespace
}  // namespace shellgrid
