// SPDX-License-Identifier: AGPL-3.0-or-later
// Texture synthesis on a torus: seconds against how unlike the sample the surface looks, for the paper's textons and
// for appearance vectors with their options.
//   synthesis_benchmark [sample.json]     default assets/samples/spots.json
// Prints CSV. `distance` is the mean distance of a 5×5 window to the nearest of the sample, over the variance of
// windows; `random` (texels drawn at random) and `tiling` (an exact copy) bracket it. Analysis is done once a sample.
#include <fmt/format.h>

#include "meshing/core/error.h"
#include "meshing/surface/retile.h"
#include "pipeline/scene/sample_description.h"
#include "synthesis/synthesis_quality.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

struct Method {
  std::string name;
  TextonOptions textons;
  SynthesisOptions synthesis;
};

std::vector<Method> make_methods() {
  std::vector<Method> methods(1);
  methods[0].name = "appearance";
  const auto add = [&](const std::string& name) -> Method& {
    methods.push_back(methods[0]);
    methods.back().name = name;
    return methods.back();
  };
  add("textons' centres").textons.quantize = true;
  Method& papers = add("the paper's sweep");
  papers.textons.quantize = true;
  papers.synthesis.method = SynthesisMethod::textons;
  for (int k : {1, 2, 5, 8}) add(fmt::format("{} candidates", k)).textons.candidate_count = k;
  Method& once = add("one pass");
  once.synthesis.coarse_passes = once.synthesis.passes = once.synthesis.final_passes = 1;
  Method& often = add("many passes");
  often.synthesis.coarse_passes = often.synthesis.passes = often.synthesis.final_passes = 12;
  add("no relaxation").synthesis.relaxation_sweeps = 0;
  add("no jitter").synthesis.jitter = 0;
  add("penalty of 1.05").synthesis.incoherence_penalty = 1.05;
  add("no windows").synthesis.window_passes = 0;
  add("12 rounds of windows").synthesis.window_passes = 12;
  for (int symmetry : {2, 4}) add(fmt::format("turned {} ways", symmetry)).textons.symmetry = symmetry;
  return methods;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const MaterialSample sample = load_sample(argc > 1 ? argv[1] : "assets/samples/spots.json", {});
    RetileOptions tiles;
    tiles.spacing = sample.voxel;
    const double size = (test::long_form() ? 100 : 35) * sample.voxel;
    const TriangleMesh mesh = retile_surface(shapes::torus(size, 0.45 * size, 96, 48), tiles);
    const int runs = test::long_form() ? 5 : 3;
    double own = 0;
    fmt::print(
        "method,vertices,analysis_s,synthesis_s,ratio,distance,random,tiling,coherence,texel_entropy,median_patch\n");
    for (const Method& method : make_methods()) {
      TextonSet textons;
      SurfaceTexture texture;
      const double analysis = test::seconds_of([&] { textons = make_textons(sample, method.textons); });
      const double seconds =
          test::median_seconds(runs, [&] { texture = synthesize_surface(mesh, textons, method.synthesis); });
      if (own == 0) own = seconds;
      const SynthesisQuality quality =
          measure_synthesis(texture, textons, {.windows = test::long_form() ? 4096 : 1024});
      fmt::print("{},{},{:.3f},{:.3f},{:.2f},{:.4f},{:.4f},{:.4f},{:.3f},{:.3f},{:.0f}\n", method.name,
                 mesh.vertex_count(), analysis, seconds, seconds / own, quality.window_distance, quality.random,
                 quality.tiling, quality.coherence, quality.texel_entropy, quality.median_patch);
      std::fflush(stdout);
    }
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "synthesis_benchmark: error: {}\n", error.what());
    return 3;
  }
}
