// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/vertex_buckets.h"

#include <Eigen/Geometry>
#include <compare>

#include "meshing/core/parallel.h"

namespace shellgrid {

std::vector<float> vertex_areas(const TriangleMesh& mesh) {
  std::vector<float> areas(static_cast<std::size_t>(mesh.vertex_count()), 0.0f);
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0), b = mesh.corner(f, 1), c = mesh.corner(f, 2);
    const auto third = static_cast<float>((b - a).cross(c - a).norm() / 6);
    for (int k = 0; k < 3; ++k) areas[mesh.faces(f, k)] += third;
  }
  return areas;
}

int vertex_in_middle(const TriangleMesh& mesh, const std::vector<int>& members) {
  Vec3 middle = Vec3::Zero();
  for (const int v : members) middle += mesh.vertex(v);
  middle /= static_cast<double>(members.size());
  return *std::min_element(members.begin(), members.end(), [&](int a, int b) {
    return (mesh.vertex(a) - middle).squaredNorm() < (mesh.vertex(b) - middle).squaredNorm();
  });
}

VertexBuckets::VertexBuckets(const TexturedFrames& frames, const std::vector<float>& areas, double edge) : edge_(edge) {
  struct Place {
    std::uint64_t cell;
    int side, vertex;
    auto operator<=>(const Place&) const = default;
  };
  const std::size_t n = areas.size();
  std::vector<Place> places(n);
  parallel_for(n, [&](std::size_t i) {
    const int v = static_cast<int>(i);
    const Vec3i cell = (frames.mesh.vertex(v) / edge_).array().floor().cast<int>();
    const Vec3 normal = frames.normals.row(v).transpose();
    int axis = 0;
    normal.cwiseAbs().maxCoeff(&axis);
    places[i] = {key(cell), 2 * axis + (normal[axis] > 0), v};
  });
  std::sort(places.begin(), places.end());
  of_vertex_.resize(n);
  for (std::size_t k = 0; k < places.size(); ++k) {
    if (k == 0 || places[k].cell != places[k - 1].cell || places[k].side != places[k - 1].side) {
      cells_.emplace_back(places[k].cell, static_cast<int>(buckets_.size()));
      buckets_.emplace_back();
    }
    buckets_.back().members.push_back(places[k].vertex);
    of_vertex_[places[k].vertex] = static_cast<int>(buckets_.size()) - 1;
  }
  for (int k = 0; k < static_cast<int>(cells_.size()); ++k)
    columns_.try_emplace(cells_[k].first >> 21, k, k).first->second.second = k + 1;
  parallel_for(buckets_.size(), [&](std::size_t b) {
    Bucket& bucket = buckets_[b];
    for (const int v : bucket.members) {
      const auto area = static_cast<double>(areas[v]);
      bucket.area += area;
      bucket.middle += area * frames.mesh.vertex(v);
      bucket.facing += area * frames.normals.row(v).transpose();
    }
    bucket.middle = bucket.area > 0 ? Vec3(bucket.middle / bucket.area) : frames.mesh.vertex(bucket.members.front());
    for (const int v : bucket.members)
      bucket.radius = std::max(bucket.radius, (frames.mesh.vertex(v) - bucket.middle).norm());
  });
}

}  // namespace shellgrid
