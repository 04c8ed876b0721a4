// SPDX-License-Identifier: AGPL-3.0-or-later
// Narrow-band distance beside OpenVDB's meshToVolume: the same mesh, grid interval, band and threads, medians in one
// run.
//   distance_benchmark [mesh.off]     default assets/meshes/bunny00.off
// Prints CSV. `openvdb_over_ours` is the ratio of the medians; ours also gives nearest point and nearest vertex.
#include <fmt/format.h>
#include <oneapi/tbb/global_control.h>
#include <openvdb/openvdb.h>
#include <openvdb/tools/MeshToVolume.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/distance/distance_field.h"
#include "meshing/formats/mesh_file.h"

using namespace shellgrid;

namespace {

template <class Work>
double median_seconds(int runs, const Work& work) {
  std::vector<double> seconds;
  for (int run = 0; run <= runs; ++run) {
    const auto start = std::chrono::steady_clock::now();
    work();
    if (run > 0) seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
  }
  std::nth_element(seconds.begin(), seconds.begin() + runs / 2, seconds.end());
  return seconds[runs / 2];
}

void compare(const TriangleMesh& mesh, int along, double band_voxels, int threads, int runs) {
  const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, threads);
  const Vec3 lower = mesh.vertices.colwise().minCoeff().transpose();
  const double voxel = (mesh.vertices.colwise().maxCoeff().transpose() - lower).maxCoeff() / along;

  DistanceStatistics statistics;
  const double ours = median_seconds(runs, [&] {
    compute_distance_field(mesh, {voxel, band_voxels * voxel, band_voxels * voxel}, statistics);
  });

  std::vector<openvdb::Vec3s> points;
  std::vector<openvdb::Vec3I> triangles;
  for (int v = 0; v < mesh.vertex_count(); ++v) points.emplace_back(mesh.vertices.row(v).data());
  for (int f = 0; f < mesh.face_count(); ++f)
    triangles.emplace_back(mesh.faces(f, 0), mesh.faces(f, 1), mesh.faces(f, 2));
  const auto transform = openvdb::math::Transform::createLinearTransform(voxel);
  const auto band = static_cast<float>(band_voxels);
  openvdb::Index64 theirs_samples = 0;
  const double theirs = median_seconds(runs, [&] {
    theirs_samples =
        openvdb::tools::meshToSignedDistanceField<openvdb::FloatGrid>(*transform, points, triangles, {}, band, band)
            ->activeVoxelCount();
  });
  fmt::print("{},{},{},{},{},{:.4f},{:.4f},{:.2f}\n", along, band_voxels, threads, statistics.active_samples,
             theirs_samples, ours, theirs, theirs / ours);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    openvdb::initialize();
    const TriangleMesh mesh = read_mesh(argc > 1 ? argv[1] : "assets/meshes/bunny00.off").mesh;
    const bool long_form = std::getenv("SG_LONG") != nullptr;
    fmt::print("voxels_along,band_voxels,threads,samples,openvdb_samples,seconds,openvdb_seconds,openvdb_over_ours\n");
    for (int along : long_form ? std::vector<int>{128, 256, 512} : std::vector<int>{128, 256})
      for (double band : {3.0, 10.0})
        for (int threads : {1, 2}) compare(mesh, along, band, threads, long_form ? 9 : 3);
    return 0;
  } catch (const InputError& error) {
    fmt::print(stderr, "distance_benchmark: error: {}\n", error.what());
    return 3;
  }
}
