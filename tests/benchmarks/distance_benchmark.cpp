// SPDX-License-Identifier: AGPL-3.0-or-later
// Narrow-band distance beside OpenVDB's meshToVolume: the same mesh, grid interval, band and threads, medians in one
// run, taken in turn.
//   distance_benchmark [mesh.off]     default assets/meshes/bunny00.off
// Prints CSV. `ratio` is the median time over this project's, which also finds nearest points and nearest vertices;
// "plain" leaves OpenVDB's renormalization and its removal of intersecting voxels out. Errors are in voxels, against
// all triangles in turn, at samples drawn at random from the band.
#include <fmt/format.h>
#include <oneapi/tbb/global_control.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/MeshToVolume.h>

#include <Eigen/Geometry>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/distance/distance_field.h"
#include "meshing/formats/mesh_file.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

// By the triangle's plane and its three edges in turn.
double distance_to_triangle(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 n = (b - a).cross(c - a);
  const Vec3 q = p - n.dot(p - a) / n.squaredNorm() * n;
  if ((b - a).cross(q - a).dot(n) >= 0 && (c - b).cross(q - b).dot(n) >= 0 && (a - c).cross(q - c).dot(n) >= 0)
    return (q - p).norm();
  double least = INFINITY;
  for (const auto& [s, t] : {std::pair(a, b), std::pair(b, c), std::pair(c, a)}) {
    const double along = std::clamp((p - s).dot(t - s) / (t - s).squaredNorm(), 0.0, 1.0);
    least = std::min(least, (s + along * (t - s) - p).norm());
  }
  return least;
}

struct Probe {
  Vec3i sample;
  double distance;  // mm, without sign
};

// Samples of the field's band, drawn at random, with their distances to all triangles in turn.
std::vector<Probe> brute_force(const TriangleMesh& mesh, const DistanceField& field, int count) {
  std::vector<Vec3i> active;
  field.distance.for_each_active([&](int i, int j, int k, float) { active.emplace_back(i, j, k); });
  std::vector<Probe> probes(count);
  parallel_for(
      probes.size(),
      [&](std::size_t n) {
        Probe& probe = probes[n];
        probe.sample = active[hash64(0, 71, n) % active.size()];
        const Vec3 p = field.frame.to_world(probe.sample);
        probe.distance = INFINITY;
        for (int f = 0; f < mesh.face_count(); ++f)
          probe.distance = std::min(probe.distance,
                                    distance_to_triangle(p, mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2)));
      },
      1);
  return probes;
}

void compare(const TriangleMesh& mesh, int along, double band_voxels, int threads, int runs) {
  const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, threads);
  const Vec3 lower = mesh.vertices.colwise().minCoeff().transpose();
  const double voxel = (mesh.vertices.colwise().maxCoeff().transpose() - lower).maxCoeff() / along;
  std::vector<openvdb::Vec3s> points;  // in grid intervals
  std::vector<openvdb::Vec3I> triangles;
  const auto transform = openvdb::math::Transform::createLinearTransform(voxel);
  for (int v = 0; v < mesh.vertex_count(); ++v)
    points.emplace_back(transform->worldToIndex(openvdb::Vec3d(mesh.vertices.row(v).data())));
  for (int f = 0; f < mesh.face_count(); ++f)
    triangles.emplace_back(mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2));

  DistanceStatistics statistics;
  DistanceField field;
  openvdb::FloatGrid::Ptr grids[2];
  const int flags[2] = {0,
                        openvdb::tools::DISABLE_RENORMALIZATION | openvdb::tools::DISABLE_INTERSECTING_VOXEL_REMOVAL};
  const float band = static_cast<float>(band_voxels);
  std::vector<double> seconds[3];
  for (int run = 0; run < runs; ++run) {
    seconds[0].push_back(test::seconds_of([&] {
      field = compute_distance_field(mesh, {voxel, band_voxels * voxel, band_voxels * voxel}, statistics);
    }));
    for (int kind = 0; kind < 2; ++kind)
      seconds[1 + kind].push_back(test::seconds_of([&] {
        openvdb::tools::QuadAndTriangleDataAdapter<openvdb::Vec3s, openvdb::Vec3I> adapter(points, triangles);
        grids[kind] = openvdb::tools::meshToVolume<openvdb::FloatGrid>(adapter, *transform, band, band, flags[kind]);
      }));
  }
  const std::vector<Probe> probes = brute_force(mesh, field, test::long_form() ? 10000 : 500);
  const char* const names[3] = {"ours", "OpenVDB", "OpenVDB plain"};
  for (int method = 0; method < 3; ++method) {
    double greatest = 0, squares = 0;
    int found = 0;
    for (const Probe& probe : probes) {
      const Vec3i& s = probe.sample;
      float value = field.distance.value(s.x(), s.y(), s.z());
      if (method > 0 && !grids[method - 1]->tree().probeValue({s.x(), s.y(), s.z()}, value)) continue;
      const double error = std::abs(std::abs(value) - probe.distance) / voxel;
      greatest = std::max(greatest, error);
      squares += error * error;
      ++found;
    }
    const double time = test::median(seconds[method]);
    fmt::print(
        "{},{},{},{},{},{:.4f},{:.2f},{:.1e},{:.1e}\n", names[method], along, band_voxels, threads,
        method == 0 ? static_cast<openvdb::Index64>(statistics.active_samples) : grids[method - 1]->activeVoxelCount(),
        time, time / test::median(seconds[0]), greatest, std::sqrt(squares / std::max(1, found)));
  }
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    openvdb::initialize();
    const TriangleMesh mesh = read_mesh(argc > 1 ? argv[1] : "assets/meshes/bunny00.off").mesh;
    fmt::print("method,voxels_along,band_voxels,threads,samples,seconds,ratio,greatest_error,rms_error\n");
    for (int along : test::long_form() ? std::vector<int>{128, 256, 512} : std::vector<int>{128, 256})
      for (double band : {3.0, 10.0})
        for (int threads : {1, 2}) compare(mesh, along, band, threads, test::long_form() ? 9 : 3);
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "distance_benchmark: error: {}\n", error.what());
    return 3;
  }
}
