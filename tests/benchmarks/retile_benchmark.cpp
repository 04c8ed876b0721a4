// SPDX-License-Identifier: AGPL-3.0-or-later
// Retiling beside CGAL's isotropic remeshing: the same mesh, spacing and feature angle, in one run.
//   retile_benchmark [mesh.off]     default assets/meshes/bunny00.off
// Prints CSV. The object is 80 mm long. `variation` is the edges' standard deviation over their mean; `least_angle` and
// `mean_least_angle` are degrees in faces; distances are sampled Hausdorff distances, mm; `crossings` counts pairs of
// faces that intersect.
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/surface/repair.h"
#include "meshing/surface/retile.h"
#include "meshing/surface/surface_quality.h"
#include "tests/benchmarks/isotropic_remeshing.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

void print(const char* method, int rounds, double spacing, double seconds, double ratio, const TriangleMesh& input,
           const TriangleMesh& mesh) {
  const EdgeStatistics edges = measure_edges(mesh);
  double least = 180, sum = 0;
  for (int f = 0; f < mesh.face_count(); ++f) {
    double face = 180;
    for (int k = 0; k < 3; ++k) {
      const Vec3 a = mesh.corner(f, (k + 1) % 3) - mesh.corner(f, k),
                 b = mesh.corner(f, (k + 2) % 3) - mesh.corner(f, k);
      face = std::min(face, std::atan2(a.cross(b).norm(), a.dot(b)) * 180 / std::numbers::pi);
    }
    least = std::min(least, face);
    sum += face;
  }
  fmt::print("{},{},{},{:.3f},{:.2f},{},{:.4f},{:.3f},{:.1f},{:.1f},{:.4f},{:.4f},{}\n", method, rounds, spacing,
             seconds, ratio, mesh.vertex_count(), edges.mean / spacing, edges.variation(), least,
             sum / mesh.face_count(), sampled_distance(mesh, input, spacing), sampled_distance(input, mesh, spacing),
             find_self_intersections(mesh).pairs);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    TriangleMesh mesh = read_mesh(argc > 1 ? argv[1] : "assets/meshes/bunny00.off").mesh;
    RepairReport report;
    mesh = repair_surface(mesh, true, report);
    mesh.vertices *= 80 / (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).maxCoeff();
    fmt::print(
        "method,rounds,spacing_mm,seconds,ratio,vertices,mean_edge_over_spacing,variation,least_angle,mean_least_angle,"
        "to_input_mm,from_input_mm,crossings\n");
    const int runs = test::long_form() ? 5 : 1;
    // The finest has about 2e5 vertices; the short form tries it once.
    for (const double spacing : {1.6, 0.8, 0.295}) {
      const bool once = spacing < 0.5 && !test::long_form();
      TriangleMesh result;
      double own = 0;
      for (const int rounds : once ? std::vector<int>{6} : std::vector<int>{6, 3}) {
        RetileOptions options;
        options.spacing = spacing;
        options.iterations = rounds;
        const double seconds = test::median_seconds(runs, [&] { result = retile_surface(mesh, options); });
        if (rounds == 6) own = seconds;
        print("ours", rounds, spacing, seconds, seconds / own, mesh, result);
      }
      for (const int rounds : once ? std::vector<int>{3} : std::vector<int>{1, 3, 6}) {
        const double seconds =
            test::median_seconds(runs, [&] { result = test::isotropic_remeshing(mesh, spacing, 45, rounds); });
        print("CGAL", rounds, spacing, seconds, seconds / own, mesh, result);
      }
    }
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "retile_benchmark: error: {}\n", error.what());
    return 3;
  }
}
