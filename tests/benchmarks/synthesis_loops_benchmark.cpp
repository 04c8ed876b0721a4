// SPDX-License-Identifier: AGPL-3.0-or-later
// Whether closed loops over a surface are seams: windows along a loop against those of the whole surface.
//   synthesis_loops_benchmark [mesh|plate|torus [sample.json…]]   default: plate (genus 3),
//   assets/samples/{cells,marble}.json
// Loops: geodesic circles of 4, 8, 16 and 32 texels around vertices drawn at random, and loops around all handles; each
// a band of vertices two texels wide. Every loop is measured with many seeds of the synthesis; its ratio is the mean
// distance of its vertices' windows over that of all vertices, its error the scatter of the seeds' ratios over the root
// of their number. Prints CSV: of each kind of loops how many there are, their mean vertices, the mean ratio, the
// ratios' spread and what their errors alone would spread, how many lie above 1.1, above it by more than two errors,
// and how many of these are without a singularity of the directions within three texels in most seeds. Then a line for
// each loop that is above 1.1 by two errors: vertices, ratio, error, mean number of singularities by it, rms turn of
// the normal within a texel (degrees).
#include <fmt/format.h>

#include <cmath>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/surface/retile.h"
#include "pipeline/scene/sample_description.h"
#include "synthesis/synthesis_quality.h"
#include "tests/support/holed_plate.h"
#include "tests/support/timing.h"
#include "tests/synthesis/closed_loops.h"

using namespace shellgrid;

namespace {

struct Loop {
  std::string kind;
  std::vector<int> band;
  std::vector<double> ratios;  // by seed
  double singularities = 0;    // mean number within three texels
  double turn = 0;

  double mean() const {
    return std::accumulate(ratios.begin(), ratios.end(), 0.0) / static_cast<double>(ratios.size());
  }
  double error() const {
    double sum = 0;
    for (double r : ratios) sum += (r - mean()) * (r - mean());
    const double n = static_cast<double>(ratios.size());
    return std::sqrt(sum / (n - 1) / n);
  }
};

TriangleMesh load_surface(const std::string& path, double spacing) {
  RetileOptions tiles;
  tiles.spacing = spacing;
  if (path == "plate") return retile_surface(shapes::holed_plate(140 * spacing), tiles);
  if (path == "torus") return retile_surface(shapes::torus(25 * spacing, 10 * spacing, 96, 48), tiles);
  TriangleMesh mesh = read_mesh(path).mesh;
  // Of about 15 000 vertices.
  double area = 0;
  for (int f = 0; f < mesh.face_count(); ++f)
    area += 0.5 * (mesh.vertex(mesh.faces(f, 1)) - mesh.vertex(mesh.faces(f, 0)))
                      .cross(mesh.vertex(mesh.faces(f, 2)) - mesh.vertex(mesh.faces(f, 0)))
                      .norm();
  mesh.vertices *= spacing * std::sqrt(15e3 / (1.155 * area));
  return retile_surface(mesh, tiles);
}

std::vector<Loop> find_loops(const TriangleMesh& mesh, double voxel) {
  const HalfEdges half_edges = build_half_edges(mesh);
  std::vector<Loop> loops;
  for (const double radius : {4.0, 8.0, 16.0, 32.0})
    for (int k = 0; k < 48; ++k) {
      const int centre = static_cast<int>(hash64(1, static_cast<std::uint64_t>(radius), k) % mesh.vertex_count());
      Loop loop{fmt::format("circle {:g}", radius),
                testing::geodesic_circle(mesh, half_edges, centre, radius * voxel, 2 * voxel),
                {}};
      if (static_cast<double>(loop.band.size()) > 4 * radius) loops.push_back(loop);
    }
  for (int root = 0; root < 4; ++root)
    for (std::vector<int>& band :
         testing::handle_loops(mesh, half_edges, static_cast<int>(hash64(2, root) % mesh.vertex_count()), 2 * voxel))
      loops.push_back({"handle", std::move(band), {}});
  const VertexMatrix normals = vertex_normals(mesh);
  for (Loop& loop : loops) {
    double sum = 0;
    int count = 0;
    for (int v : loop.band)
      half_edges.for_each_outgoing(v, [&](std::int32_t h) {
        const int w = HalfEdges::to(mesh, h);
        sum += (normals.row(v) - normals.row(w)).squaredNorm() / (mesh.vertex(v) - mesh.vertex(w)).squaredNorm() *
               voxel * voxel;
        ++count;
      });
    loop.turn = std::sqrt(sum / std::max(1, count)) * 180 / M_PI;
  }
  return loops;
}

void measure(const std::string& mesh_path, const std::string& path) {
  const MaterialSample sample = load_sample(path, {});
  TextonOptions own;
  own.symmetry = 0;
  const TextonSet textons = make_textons(sample, own);
  const TriangleMesh mesh = load_surface(mesh_path, sample.voxel);
  std::vector<Loop> loops = find_loops(mesh, sample.voxel);
  std::vector<int> all(mesh.vertex_count());
  std::iota(all.begin(), all.end(), 0);
  const int seeds = test::long_form() ? 32 : 8;
  for (int seed = 0; seed < seeds; ++seed) {
    SynthesisOptions options;
    options.seed = static_cast<std::uint64_t>(seed);
    const SurfaceTexture texture = synthesize_surface(mesh, textons, options);
    const std::vector<double> distance = window_distances(texture, textons, all);
    const double mean = std::accumulate(distance.begin(), distance.end(), 0.0) / mesh.vertex_count();
    parallel_for(
        loops.size(),
        [&](std::size_t l) {
          Loop& loop = loops[l];
          double along = 0;
          for (int v : loop.band) along += distance[v];
          loop.ratios.push_back(along / static_cast<double>(loop.band.size()) / mean);
          for (const Singularity& s : texture.singularities) {
            bool near = false;
            for (int v : loop.band) near = near || (mesh.vertex(v) - s.point).norm() < 3 * sample.voxel;
            loop.singularities += near / static_cast<double>(seeds);
          }
        },
        1);
  }
  const std::string name = path.substr(path.find_last_of('/') + 1);
  const std::string shape = mesh_path.substr(mesh_path.find_last_of('/') + 1);
  std::vector<std::string> kinds;
  for (const Loop& loop : loops)
    if (std::find(kinds.begin(), kinds.end(), loop.kind) == kinds.end()) kinds.push_back(loop.kind);
  for (const std::string& kind : kinds) {
    double count = 0, vertices = 0, mean = 0, squares = 0, errors = 0;
    int above = 0, surely = 0, plain = 0;
    for (const Loop& loop : loops) {
      if (loop.kind != kind) continue;
      count += 1, vertices += static_cast<double>(loop.band.size());
      mean += loop.mean(), squares += loop.mean() * loop.mean(), errors += loop.error() * loop.error();
      const bool sure = loop.mean() - 2 * loop.error() > 1.1;
      above += loop.mean() > 1.1, surely += sure, plain += sure && loop.singularities < 0.5;
    }
    fmt::print("{},{},{},{:.0f},{:.0f},{:.3f},{:.3f},{:.3f},{},{},{}\n", shape, name, kind, count, vertices / count,
               mean / count, std::sqrt(std::max(0.0, squares / count - mean * mean / count / count)),
               std::sqrt(errors / count), above, surely, plain);
  }
  for (const Loop& loop : loops)
    if (loop.mean() - 2 * loop.error() > 1.1)
      fmt::print("# {},{},{}: {} vertices, ratio {:.3f} +- {:.3f}, {:.1f} singularities, normals turn {:.1f}\n", shape,
                 name, loop.kind, loop.band.size(), loop.mean(), loop.error(), loop.singularities, loop.turn);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    fmt::print(
        "mesh,sample,loops,count,vertices,mean_ratio,spread,expected_spread,above,surely_above,without_singularity\n");
    const std::string mesh = argc > 1 ? argv[1] : "plate";
    if (argc > 2)
      for (int i = 2; i < argc; ++i) measure(mesh, argv[i]);
    else
      for (const char* name : {"cells", "marble"}) measure(mesh, fmt::format("assets/samples/{}.json", name));
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "synthesis_loops_benchmark: error: {}\n", error.what());
    return 3;
  }
}
