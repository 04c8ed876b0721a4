// SPDX-License-Identifier: AGPL-3.0-or-later
// Synthesis of 96×96×10 samples: what analysis and synthesis cost against the number of vertices, and how near the
// result is to the sample beside exhaustive search and beside the paper's way on the same small mesh.
//   synthesis_cost_benchmark [sample.json…]     default assets/samples/{spots,cells,wood}.json
// Prints CSV, first of growing tori, then of one small torus by method. Seconds are of this run's threads, processor
// seconds of all threads. `distance` as in synthesis_benchmark, of all vertices' windows at the small torus (mean of
// seeds); `ratio`: processor seconds a vertex over those of the smallest torus, or distance over exhaustive search's.
#include <fmt/format.h>

#include <cmath>
#include <ctime>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/surface/retile.h"
#include "pipeline/scene/sample_description.h"
#include "synthesis/synthesis_quality.h"
#include "tests/support/closed_shapes.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

struct Cost {
  double seconds = 0, processor_seconds = 0;
};

template <class Work>
Cost cost_of(const Work& work) {
  Cost cost;
  const std::clock_t start = std::clock();
  cost.seconds = test::seconds_of(work);
  cost.processor_seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
  return cost;
}

TriangleMesh torus_of(double vertices, double spacing) {
  // 4π² R r of area, about 1.155 vertices in a squared spacing.
  const double size = spacing * std::sqrt(vertices / (1.155 * 4 * M_PI * M_PI * 0.45));
  RetileOptions tiles;
  tiles.spacing = spacing;
  return retile_surface(shapes::torus(size, 0.45 * size, 192, 96), tiles);
}

double mean_distance(const SurfaceTexture& texture, const TextonSet& textons) {
  std::vector<int> all(texture.coordinate.size());
  std::iota(all.begin(), all.end(), 0);
  const std::vector<double> distances = window_distances(texture, textons, all);
  return std::accumulate(distances.begin(), distances.end(), 0.0) / static_cast<double>(distances.size());
}

void print_row(const std::string& sample, const std::string& method, int vertices, const Cost& analysis,
               const Cost& synthesis, double comparisons, double distance, double ratio) {
  fmt::print("{},{},{},{:.2f},{:.2f},{:.2f},{:.2f},{:.1f},{:.4f},{:.3f}\n", sample, method, vertices, analysis.seconds,
             analysis.processor_seconds, synthesis.seconds, synthesis.processor_seconds, comparisons, distance, ratio);
  std::fflush(stdout);
}

void measure(const std::string& path) {
  const std::string name = path.substr(path.find_last_of('/') + 1);
  const MaterialSample sample = load_sample(path, {});
  TextonOptions own;
  own.symmetry = 0;
  TextonSet textons;
  const Cost analysis = cost_of([&] { textons = make_textons(sample, own); });
  double first = 0;
  std::vector<double> sizes = {25e3, 100e3};
  if (test::long_form()) sizes.insert(sizes.end(), {300e3, 1e6});
  for (double size : sizes) {
    const TriangleMesh mesh = torus_of(size, sample.voxel);
    SurfaceTexture texture;
    const Cost synthesis = cost_of([&] { texture = synthesize_surface(mesh, textons, {}); });
    const double each = synthesis.processor_seconds / mesh.vertex_count();
    if (first == 0) first = each;
    const SynthesisQuality quality = measure_synthesis(texture, textons, {.windows = 1024});
    print_row(name, "coherence", mesh.vertex_count(), analysis, synthesis,
              static_cast<double>(texture.comparisons) / mesh.vertex_count(), quality.window_distance, each / first);
  }
  const TriangleMesh small = torus_of(test::long_form() ? 12e3 : 3e3, sample.voxel);
  double exhaustive = 0;
  TextonOptions papers;
  papers.quantize = true;
  const TextonSet quantized = make_textons(sample, papers);
  for (const auto& [method, method_name] :
       {std::pair{SynthesisMethod::exhaustive, "exhaustive"}, std::pair{SynthesisMethod::coherence, "coherence"},
        std::pair{SynthesisMethod::textons, "textons"}}) {
    const TextonSet& set = method == SynthesisMethod::textons ? quantized : textons;
    const int seeds = 4;
    Cost total;
    double distance = 0, comparisons = 0;
    for (int seed = 0; seed < seeds; ++seed) {
      SynthesisOptions options;
      options.method = method;
      options.seed = static_cast<std::uint64_t>(seed);
      SurfaceTexture texture;
      const Cost cost = cost_of([&] { texture = synthesize_surface(small, set, options); });
      total.seconds += cost.seconds / seeds, total.processor_seconds += cost.processor_seconds / seeds;
      distance += mean_distance(texture, set) / seeds;
      comparisons += static_cast<double>(texture.comparisons) / small.vertex_count() / seeds;
    }
    if (method == SynthesisMethod::exhaustive) exhaustive = distance;
    print_row(name, method_name, small.vertex_count(), analysis, total, comparisons, distance, distance / exhaustive);
  }
}

}  // namespace

int main(int argc, char** argv) {
  try {
    fmt::print(
        "sample,method,vertices,analysis_s,analysis_cpu_s,synthesis_s,synthesis_cpu_s,comparisons_a_vertex,distance,"
        "ratio\n");
    if (argc > 1)
      for (int i = 1; i < argc; ++i) measure(argv[i]);
    else
      for (const char* name : {"spots", "cells", "wood"}) measure(fmt::format("assets/samples/{}.json", name));
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "synthesis_cost_benchmark: error: {}\n", error.what());
    return 3;
  }
}
