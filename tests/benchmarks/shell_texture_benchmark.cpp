// SPDX-License-Identifier: AGPL-3.0-or-later
// Shell texture functions compressed: size, PSNR, and what looking up costs, in any order and from voxel to voxel,
// against the plain table. Of a sample with bumps and veins; or of a file: shell_texture_benchmark stf.vdb
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <cstdio>

#include "meshing/core/random.h"
#include "meshing/formats/vdb_file.h"
#include "solvers/shell_texture/irradiance_tracing.h"
#include "solvers/shell_texture/shell_texture_archive.h"
#include "solvers/shell_texture/shell_texture_codec.h"
#include "tests/support/base_volumes.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

ShellTexture texture(int arguments, char** argument) {
  if (arguments > 1) return restore_shell_texture(read_vdb(argument[1]));
  IrradianceOptions options;
  options.target_error = test::long_form() ? 0.02 : 0.06;
  return trace_irradiance(test::knobs_over_veins(test::long_form() ? 96 : 48), options);
}

void row(const char* codec, double asked, double ratio, double psnr, std::size_t bytes, int words, double pack,
         const ShellTexture& t, const ShellTextureLookup& lookup) {
  const PreparedLight light = lookup.prepare_direction(Vec3(0.3, 0.2, 1).normalized());
  std::vector<std::size_t> filled;
  for (std::size_t v = 0; v < t.voxel_count(); ++v)
    if (t.matter[v] > 0.5f) filled.push_back(v);
  float sum = 0;
  const auto nanoseconds = [&](std::size_t count, const auto& place) {
    const auto reader = lookup.reader();
    return 1e9 / static_cast<double>(count) * test::seconds_of([&] {
             for (std::size_t k = 0; k < count; ++k) sum += reader->voxel_light(place(k), light).multiple[1];
           });
  };
  const double any = nanoseconds(20'000, [&](std::size_t k) { return filled[hash64(5, k) % filled.size()]; });
  const double near = nanoseconds(filled.size(), [&](std::size_t k) { return filled[k]; });
  std::printf("%s,%g,%zu,%.2f,%.2f,%d,%.0f,%.0f,%.2f\n", codec, asked, bytes, ratio, psnr, words, any, near, pack);
  std::fflush(stdout);
  if (sum < 0) std::abort();
}

}  // namespace

int main(int arguments, char** argument) {
  const ShellTexture t = texture(arguments, argument);
  const oneapi::tbb::global_control one(oneapi::tbb::global_control::max_allowed_parallelism, 1);
  std::printf("codec,asked_psnr,bytes,ratio,psnr,words,any_voxel_ns,next_voxel_ns,compress_s\n");
  const auto plain = look_up_as_it_is(t);
  row("none", 0, 1, 150, plain->bytes(), 0, 0, t, *plain);
  for (const ShellTextureCodec codec :
       {ShellTextureCodec::principal_components, ShellTextureCodec::vector_quantisation})
    for (const double psnr : {28.0, 32.0, 36.0, 40.0, 42.0, 44.0}) {
      if (codec == ShellTextureCodec::vector_quantisation && psnr > 36) continue;
      CodecGoal goal;
      goal.psnr = psnr;
      CodecReport report;
      std::unique_ptr<CompressedShellTexture> lookup;
      const double seconds = test::seconds_of([&] { lookup = compress_shell_texture(t, codec, goal, &report); });
      row(codec == ShellTextureCodec::vector_quantisation ? "vector quantisation" : "principal components", psnr,
          report.ratio, report.psnr, report.bytes, report.words, seconds, t, *lookup);
    }
}
