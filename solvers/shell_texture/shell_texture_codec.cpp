// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_texture_codec.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/shell_texture/number_lists.h"
#include "solvers/shell_texture/vector_table.h"

namespace shellgrid {
namespace {

constexpr const char* kinds[] = {"shell texture function, vector quantisation",
                                 "shell texture function, principal components"};
constexpr double below_psnr = 48;         // of what passes into the core
constexpr std::size_t kept_blocks = 256;  // of a reader
constexpr int block_places = ComponentTable::block_places;

// Which of I_s, I_m by channel.
int kind_of(int dimension) { return dimension % 6; }

// Dimension 6 l + k: of direction l the channels of I_s, then of I_m; then `back` of them of I_m(ω_b).
VectorField field_of(const ShellTexture& t, bool light, bool back) {
  VectorField field;
  field.size = t.size;
  for (const float share : t.matter) field.filled.push_back(share > least_matter);
  const int of_light = light ? 6 * t.directions.count() : 0;
  for (int d = 0; d < of_light; ++d) field.kind.push_back(kind_of(d));
  for (int c = 0; c < (back ? 3 : 0); ++c) field.kind.push_back((light ? 6 : 0) + c);
  field.value = [&t, of_light](std::size_t v, int d) {
    if (d >= of_light) return t.multiple[t.at(t.directions.back(), v)][d - of_light];
    const std::size_t at = t.at(d / 6, v);
    return d % 6 < 3 ? t.single[at][d % 6] : t.multiple[at][d % 6 - 3];
  };
  return field;
}

// Dimension 3 l + c, the light from below last.
ComponentTable compress_below(const ShellTexture& t) {
  VectorField field;
  field.size = {t.size.x(), t.size.y(), 1};
  field.filled.assign(t.texel_count(), 1);
  for (int d = 0; d < 3 * (t.directions.count() + 1); ++d)
    field.kind.push_back(d % 3 + (d / 3 == t.directions.back() ? 3 : 0));
  field.value = [&t](std::size_t texel, int d) { return t.below[d / 3 * t.texel_count() + texel][d % 3]; };
  CodecGoal goal;
  goal.psnr = below_psnr;
  return ComponentTable::compress(field, goal);
}

// What a lookup holds beside I_s and I_m, as it comes back from its file.
ShellTexture frame_of(const Vec3i& size, double voxel, const LightDirections& directions,
                      const std::vector<std::uint8_t>& matter, const ComponentTable& below) {
  ShellTexture t;
  t.size = size;
  t.voxel = voxel;
  t.directions = directions;
  for (const std::uint8_t share : matter) t.matter.push_back(static_cast<float>(share) / 255);
  const std::size_t texels = t.texel_count();
  const int count = directions.count() + 1;
  t.below.assign(texels * count, Vec3f::Zero());
  std::vector<float> coefficients;
  int block = -1;
  for (std::size_t k = 0; k < texels; ++k) {
    if (below.block_of(k) != block) below.unpack(block = below.block_of(k), coefficients);
    const float* c = coefficients.data() + static_cast<std::size_t>(below.place_in_block(k)) * below.components();
    for (int d = 0; d < 3 * count; ++d) {
      float value = below.mean(d);
      for (int component = 0; component < below.components(); ++component)
        value += c[component] * below.basis(component, d);
      t.below[d / 3 * texels + k][d % 3] = std::max(0.0f, value);
    }
  }
  return t;
}

std::vector<std::uint8_t> in_bytes(const std::vector<float>& matter) {
  std::vector<std::uint8_t> bytes;
  for (const float share : matter)
    bytes.push_back(share > least_matter
                        ? static_cast<std::uint8_t>(std::clamp(static_cast<int>(std::lround(share * 255)), 1, 255))
                        : std::uint8_t{0});
  return bytes;
}

// The blocks unpacked last, each where its number falls.
template <class Value>
class BlockCache {
 public:
  template <class Unpack>
  const Value* get(int block, const Unpack& unpack) {
    Slot& slot = slots_[static_cast<std::size_t>(block) % kept_blocks];
    if (slot.block != block) {
      unpack(block, slot.values);
      slot.block = block;
    }
    return slot.values.data();
  }

 private:
  struct Slot {
    int block = -1;
    std::vector<Value> values;
  };
  std::vector<Slot> slots_ = std::vector<Slot>(kept_blocks);
};

// Everything that both codecs keep in the same way.
struct Frame {
  std::vector<std::uint8_t> matter;
  ComponentTable below;

  void save(const ShellTextureLookup& lookup, NumberArchive& archive) const {
    archive.numbers["voxel"] = {lookup.voxel()};
    archive.counts["directions"] = {static_cast<std::uint64_t>(lookup.directions().rings),
                                    static_cast<std::uint64_t>(lookup.directions().turns)};
    // Mostly whole: only what is not is written out.
    std::vector<char> whole;
    std::vector<std::uint8_t> others;
    for (const std::uint8_t share : matter) {
      whole.push_back(share == 255);
      if (share != 255) others.push_back(share);
    }
    archive.counts["matter sizes"] = {static_cast<std::uint64_t>(lookup.size().x()),
                                      static_cast<std::uint64_t>(lookup.size().y()),
                                      static_cast<std::uint64_t>(lookup.size().z()), others.size()};
    put_list(archive, "whole", packed_bits(whole));
    put_list(archive, "matter", others);
    below.save(archive, "below");
    const IrradianceKernels& kernels = lookup.kernels();
    if (kernels.empty()) return;
    archive.numbers["kernel ring"] = {kernels.ring};
    archive.counts["kernel sizes"] = {static_cast<std::uint64_t>(kernels.count()),
                                      static_cast<std::uint64_t>(kernels.bands()),
                                      static_cast<std::uint64_t>(kernels.rings)};
    put_list(archive, "kernel layers", kernels.first_layer);
    put_list(archive, "kernel values", kernels.values);
    put_list(archive, "kernel of texel", kernels.of_texel);
  }
};

IrradianceKernels restore_kernels(const NumberArchive& archive, const Vec3i& size, const std::string& path) {
  IrradianceKernels kernels;
  const auto ring = archive.numbers.find("kernel ring");
  if (ring == archive.numbers.end() || ring->second.size() != 1) return kernels;
  const std::vector<std::uint64_t> sizes = take_list<std::uint64_t>(archive, "kernel sizes", 3, path);
  if (sizes[0] > 256 || sizes[1] > 64 || sizes[2] > 4096) fail_lists(path);
  kernels.ring = ring->second[0];
  kernels.rings = static_cast<int>(sizes[2]);
  kernels.first_layer = take_list<int>(archive, "kernel layers", sizes[1], path);
  kernels.values = take_list<Vec3f>(archive, "kernel values", sizes[0] * sizes[1] * sizes[2], path);
  kernels.of_texel =
      take_list<std::uint8_t>(archive, "kernel of texel", static_cast<std::size_t>(size.x()) * size.y(), path);
  if (!kernels.is_sound(size)) fail_lists(path);
  return kernels;
}

struct RestoredFrame {
  Frame frame;
  ShellTexture texture;
};

RestoredFrame restore_frame(const NumberArchive& archive, const std::string& path) {
  RestoredFrame r;
  const auto voxel = archive.numbers.find("voxel");
  if (voxel == archive.numbers.end() || voxel->second.size() != 1 || !(voxel->second[0] > 0)) fail_lists(path);
  const std::vector<std::uint64_t> directions = take_list<std::uint64_t>(archive, "directions", 2, path);
  for (const std::uint64_t n : directions)
    if (n < 1 || n > 1000) fail_lists(path);
  const std::vector<std::uint64_t> sizes = take_list<std::uint64_t>(archive, "matter sizes", 4, path);
  const Vec3i size = [&] {
    const auto three = take_sizes(archive, "light sizes", 6, path);
    return Vec3i(static_cast<int>(three[0]), static_cast<int>(three[1]), static_cast<int>(three[2]));
  }();
  const std::size_t voxels = static_cast<std::size_t>(size.x()) * size.y() * size.z();
  for (int axis = 0; axis < 3; ++axis)
    if (sizes[axis] != static_cast<std::uint64_t>(size[axis])) fail_lists(path);
  if (sizes[3] > voxels) fail_lists(path);
  const std::vector<char> whole =
      unpacked_bits(take_list<std::uint8_t>(archive, "whole", (voxels + 7) / 8, path), voxels);
  const std::vector<std::uint8_t> others = take_list<std::uint8_t>(archive, "matter", sizes[3], path);
  if (static_cast<std::size_t>(std::count(whole.begin(), whole.end(), char{0})) != others.size()) fail_lists(path);
  std::size_t next = 0;
  for (const char w : whole) r.frame.matter.push_back(w ? std::uint8_t{255} : others[next++]);
  r.frame.below = ComponentTable::restore(archive, "below", path);
  LightDirections table;
  table.rings = static_cast<int>(directions[0]);
  table.turns = static_cast<int>(directions[1]);
  if (r.frame.below.size() != Vec3i(size.x(), size.y(), 1) || r.frame.below.dimensions() != 3 * (table.count() + 1))
    fail_lists(path);
  r.texture = frame_of(size, voxel->second[0], table, r.frame.matter, r.frame.below);
  r.texture.kernels = restore_kernels(archive, size, path);
  return r;
}

class ComponentLookup : public CompressedShellTexture {
 public:
  ComponentLookup(const ShellTexture& frame, Frame kept, ComponentTable light)
      : CompressedShellTexture(frame), kept_(std::move(kept)), light_(std::move(light)) {
    const int first = 6 * directions().count();
    for (int c = 0; c < 3; ++c) {
      back_.push_back(light_.mean(first + c));
      for (int k = 0; k < light_.components(); ++k) back_.push_back(light_.basis(k, first + c));
    }
  }

  std::unique_ptr<ShellTextureReader> reader() const override;
  std::size_t bytes() const override { return light_.bytes(); }
  const ComponentTable& light() const { return light_; }
  NumberArchive archive() const override {
    NumberArchive archive{kinds[1], "", {}, {}};
    light_.save(archive, "light");
    kept_.save(*this, archive);
    return archive;
  }

 protected:
  // Six numbers for the mean, then for each component: what a coefficient of one adds to I_s and I_m.
  void find_coefficients(PreparedLight& light) const override {
    light.coefficients.assign(6 * (static_cast<std::size_t>(light_.components()) + 1), 0.0f);
    for (const DirectionWeight& part : light.list)
      for (int d = 0; d < 6; ++d) {
        const int dimension = 6 * part.direction + d;
        const float weight = part.weight[d % 3];
        light.coefficients[d] += weight * light_.mean(dimension);
        for (int k = 0; k < light_.components(); ++k)
          light.coefficients[6 * (k + 1) + d] += weight * light_.basis(k, dimension);
      }
  }

 private:
  friend class ComponentReader;
  Frame kept_;
  ComponentTable light_;
  std::vector<float> back_;  // by channel: mean, then components
};

class ComponentReader : public ShellTextureReader {
 public:
  explicit ComponentReader(const ComponentLookup& lookup) : ShellTextureReader(lookup), lookup_(lookup) {}

  VoxelLight voxel_light(std::size_t voxel_index, const PreparedLight& light) override {
    const float* coefficients = coefficients_of(voxel_index);
    if (!coefficients) return {};
    const float* p = light.coefficients.data();
    float sum[6];
    std::copy(p, p + 6, sum);
    for (int k = 0; k < lookup_.light_.components(); ++k)
      for (int d = 0; d < 6; ++d) sum[d] += coefficients[k] * p[6 * (k + 1) + d];
    return {Vec3f(sum[0], sum[1], sum[2]).cwiseMax(0.0f), Vec3f(sum[3], sum[4], sum[5]).cwiseMax(0.0f)};
  }

  Vec3f voxel_back(std::size_t voxel_index) override {
    const float* coefficients = coefficients_of(voxel_index);
    Vec3f value = Vec3f::Zero();
    if (!coefficients) return value;
    const int components = lookup_.light_.components();
    for (int c = 0; c < 3; ++c) {
      const float* back = lookup_.back_.data() + static_cast<std::size_t>(c) * (components + 1);
      value[c] = back[0];
      for (int k = 0; k < components; ++k) value[c] += coefficients[k] * back[k + 1];
    }
    return value.cwiseMax(0.0f);
  }

 private:
  const float* coefficients_of(std::size_t voxel) {
    const ComponentTable& table = lookup_.light_;
    if (!table.is_filled(voxel)) return nullptr;
    const float* block = cache_.get(table.block_of(voxel),
                                    [&](int number, std::vector<float>& values) { table.unpack(number, values); });
    return block + static_cast<std::size_t>(table.place_in_block(voxel)) * table.components();
  }

  const ComponentLookup& lookup_;
  BlockCache<float> cache_;
};

std::unique_ptr<ShellTextureReader> ComponentLookup::reader() const { return std::make_unique<ComponentReader>(*this); }

class VectorLookup : public CompressedShellTexture {
 public:
  VectorLookup(const ShellTexture& frame, Frame kept, VectorTable light, ComponentTable back)
      : CompressedShellTexture(frame), kept_(std::move(kept)), light_(std::move(light)), back_(std::move(back)) {}

  std::unique_ptr<ShellTextureReader> reader() const override;
  std::size_t bytes() const override { return light_.bytes() + back_.bytes(); }
  NumberArchive archive() const override {
    NumberArchive archive{kinds[0], "", {}, {}};
    light_.save(archive, "light");
    back_.save(archive, "back");
    kept_.save(*this, archive);
    return archive;
  }

 private:
  friend class VectorReader;
  Frame kept_;
  VectorTable light_;
  ComponentTable back_;
};

class VectorReader : public ShellTextureReader {
 public:
  explicit VectorReader(const VectorLookup& lookup) : ShellTextureReader(lookup), lookup_(lookup) {}

  VoxelLight voxel_light(std::size_t voxel_index, const PreparedLight& light) override {
    VoxelLight sum;
    const ComponentTable& places = lookup_.back_;
    if (!places.is_filled(voxel_index)) return sum;
    const VectorTable& table = lookup_.light_;
    const std::uint16_t* numbers =
        words_.get(places.block_of(voxel_index),
                   [&](int block, std::vector<std::uint16_t>& values) { table.unpack(block, values); }) +
        static_cast<std::size_t>(places.place_in_block(voxel_index)) * table.vectors();
    for (const DirectionWeight& part : light.list) {
      const VectorTable::Word& word = table.word(numbers[part.direction]);
      sum.single += part.weight.cwiseProduct(Vec3f(word[0], word[1], word[2]));
      sum.multiple += part.weight.cwiseProduct(Vec3f(word[3], word[4], word[5]));
    }
    return sum;
  }

  Vec3f voxel_back(std::size_t voxel_index) override {
    const ComponentTable& table = lookup_.back_;
    Vec3f value = Vec3f::Zero();
    if (!table.is_filled(voxel_index)) return value;
    const float* coefficients = back_.get(table.block_of(voxel_index), [&](int block, std::vector<float>& values) {
      table.unpack(block, values);
    }) + static_cast<std::size_t>(table.place_in_block(voxel_index)) * table.components();
    for (int c = 0; c < 3; ++c) {
      value[c] = table.mean(c);
      for (int k = 0; k < table.components(); ++k) value[c] += coefficients[k] * table.basis(k, c);
    }
    return value.cwiseMax(0.0f);
  }

 private:
  const VectorLookup& lookup_;
  BlockCache<std::uint16_t> words_;
  BlockCache<float> back_;
};

std::unique_ptr<ShellTextureReader> VectorLookup::reader() const { return std::make_unique<VectorReader>(*this); }

}  // namespace

double psnr_of(const ShellTexture& t, const ShellTextureLookup& lookup) {
  const VectorField field = field_of(t, true, true);
  const std::vector<float> peaks = find_peaks(field);
  const std::size_t voxels = t.voxel_count(), chunk = 2048, chunks = (voxels + chunk - 1) / chunk;
  std::vector<PreparedLight> lights;
  for (int l = 0; l < t.directions.count(); ++l) lights.push_back(lookup.prepare({{l, Vec3f::Ones()}}));
  std::vector<double> error(chunks, 0.0), count(chunks, 0.0);
  parallel_for(
      chunks,
      [&](std::size_t c) {
        const auto reader = lookup.reader();
        for (std::size_t v = c * chunk; v < std::min(voxels, (c + 1) * chunk); ++v) {
          if (!field.filled[v]) continue;
          const auto add = [&](float is, float was, int kind) {
            error[c] += std::pow(static_cast<double>(is - was) / static_cast<double>(peaks[kind]), 2);
            ++count[c];
          };
          for (int l = 0; l < t.directions.count(); ++l) {
            const VoxelLight light = reader->voxel_light(v, lights[l]);
            for (int k = 0; k < 3; ++k) {
              add(light.single[k], t.single[t.at(l, v)][k], k);
              add(light.multiple[k], t.multiple[t.at(l, v)][k], 3 + k);
            }
          }
          const Vec3f back = reader->voxel_back(v);
          for (int k = 0; k < 3; ++k) add(back[k], t.multiple[t.at(t.directions.back(), v)][k], 6 + k);
        }
      },
      1);
  double sum = 0, all = 0;
  for (std::size_t c = 0; c < chunks; ++c) sum += error[c], all += count[c];
  return -10 * std::log10(std::max(sum / std::max(all, 1.0), 1e-30));
}

std::unique_ptr<CompressedShellTexture> compress_shell_texture(const ShellTexture& t, ShellTextureCodec codec,
                                                               const CodecGoal& goal, CodecReport* report) {
  look_up_as_it_is(t);  // refuses arrays that do not fit
  Frame kept{in_bytes(t.matter), compress_below(t)};
  ShellTexture frame = frame_of(t.size, t.voxel, t.directions, kept.matter, kept.below);
  frame.kernels = t.kernels;
  std::unique_ptr<CompressedShellTexture> result;
  int words = 0;
  if (codec == ShellTextureCodec::principal_components) {
    ComponentTable light = ComponentTable::compress(field_of(t, true, true), goal);
    words = light.components();
    result = std::make_unique<ComponentLookup>(frame, std::move(kept), std::move(light));
  } else {
    VectorTable light = VectorTable::compress(field_of(t, true, false), goal);
    words = light.words();
    CodecGoal of_back;
    of_back.psnr = goal.ratio > 0 ? 40 : goal.psnr;
    result = std::make_unique<VectorLookup>(frame, std::move(kept), std::move(light),
                                            ComponentTable::compress(field_of(t, false, true), of_back));
  }
  if (report) {
    report->bytes = result->bytes();
    double filled = 0;
    for (const float share : t.matter) filled += share > least_matter;
    report->ratio = filled * (6 * t.directions.count() + 3) * 4 / static_cast<double>(report->bytes);
    report->psnr = psnr_of(t, *result);
    report->words = words;
  }
  return result;
}

std::unique_ptr<CompressedShellTexture> restore_compressed(const NumberArchive& archive, const std::string& path) {
  if (archive.kind != kinds[0] && archive.kind != kinds[1])
    throw InputError(path + ": not a compressed shell texture function as sg-irradiance writes it");
  RestoredFrame frame = restore_frame(archive, path);
  const int count = frame.texture.directions.count();
  if (archive.kind == kinds[1]) {
    ComponentTable light = ComponentTable::restore(archive, "light", path);
    if (light.dimensions() != 6 * count + 3) fail_lists(path);
    return std::make_unique<ComponentLookup>(frame.texture, std::move(frame.frame), std::move(light));
  }
  VectorTable light = VectorTable::restore(archive, "light", path);
  ComponentTable back = ComponentTable::restore(archive, "back", path);
  if (light.vectors() != count || back.dimensions() != 3 || back.size() != light.size()) fail_lists(path);
  return std::make_unique<VectorLookup>(frame.texture, std::move(frame.frame), std::move(light), std::move(back));
}

}  // namespace shellgrid
