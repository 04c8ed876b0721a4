// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/shell/voxel_boundary.h"

#include <algorithm>
#include <array>
#include <cstdint>

namespace shellgrid {
namespace {

// Steps towards the mean of the neighbours and back out, so that the volume stays. Source: [Taubin1995].
constexpr int relaxations = 30;
constexpr double inwards = 0.6, outwards = -0.6;
constexpr double farthest = 0.49;  // from a cell's middle, voxels

// Places in order; 21 bits an axis.
std::uint64_t key_of(const Vec3i& p) {
  constexpr int bias = 1 << 20;
  const auto part = [](int x) { return static_cast<std::uint64_t>(x + bias) & 0x1fffff; };
  return part(p.x()) << 42 | part(p.y()) << 21 | part(p.z());
}

template <class Keys>
bool holds(const Keys& sorted, const Vec3i& place) {
  return std::binary_search(sorted.begin(), sorted.end(), key_of(place));
}

}  // namespace

TriangleMesh voxel_boundary(const GridFrame& frame, const std::vector<Vec3i>& voxels) {
  std::vector<std::uint64_t> members;
  members.reserve(voxels.size());
  for (const Vec3i& voxel : voxels) members.push_back(key_of(voxel));
  std::sort(members.begin(), members.end());

  // Cell (i, j, k) has the voxels (i, j, k) … (i + 1, j + 1, k + 1) at its corners. A face of a voxel, seen from
  // outside, has four cells around it, counter-clockwise.
  std::vector<std::array<Vec3i, 4>> quads;
  for (const Vec3i& voxel : voxels)
    for (int axis = 0; axis < 3; ++axis)
      for (int side = 0; side < 2; ++side) {
        Vec3i next = voxel;
        next[axis] += side == 1 ? 1 : -1;
        if (holds(members, next)) continue;
        const int u = (axis + 1) % 3, v = (axis + 2) % 3;
        std::array<Vec3i, 4> quad;
        for (int corner = 0; corner < 4; ++corner) {
          quad[corner] = voxel;
          quad[corner][axis] -= side == 1 ? 0 : 1;
          quad[corner][u] -= corner == 0 || corner == 3 ? 1 : 0;
          quad[corner][v] -= corner < 2 ? 1 : 0;
        }
        if (side == 0) std::swap(quad[1], quad[3]);
        quads.push_back(quad);
      }
  std::vector<std::pair<std::uint64_t, Vec3i>> cells;
  cells.reserve(4 * quads.size());
  for (const auto& quad : quads)
    for (const Vec3i& cell : quad) cells.emplace_back(key_of(cell), cell);
  const auto before = [](const auto& a, const auto& b) { return a.first < b.first; };
  std::sort(cells.begin(), cells.end(), before);
  cells.erase(std::unique(cells.begin(), cells.end(), [](const auto& a, const auto& b) { return a.first == b.first; }),
              cells.end());
  std::vector<std::array<int, 4>> corners;
  corners.reserve(quads.size());
  for (const auto& quad : quads) {
    std::array<int, 4> index;
    for (int k = 0; k < 4; ++k)
      index[k] = static_cast<int>(
          std::lower_bound(cells.begin(), cells.end(), std::pair(key_of(quad[k]), Vec3i::Zero().eval()), before) -
          cells.begin());
    corners.push_back(index);
  }

  std::vector<Vec3> place(cells.size(), Vec3::Zero()), sum(cells.size());  // from the cells' middles, voxels
  std::vector<int> count(cells.size());
  for (int round = 0; round < relaxations; ++round) {
    std::fill(sum.begin(), sum.end(), Vec3::Zero());
    std::fill(count.begin(), count.end(), 0);
    for (const auto& quad : corners)
      for (int k = 0; k < 4; ++k)
        for (const int other : {quad[(k + 1) & 3], quad[(k + 3) & 3]}) {
          sum[quad[k]] += place[other] + (cells[other].second - cells[quad[k]].second).cast<double>();
          ++count[quad[k]];
        }
    const double share = round % 2 == 0 ? inwards : outwards;
    for (std::size_t c = 0; c < cells.size(); ++c) {
      const Vec3 moved = place[c] + share * (sum[c] / count[c] - place[c]);
      place[c] = moved.cwiseMax(-farthest).cwiseMin(farthest);
    }
  }

  TriangleMesh mesh;
  mesh.vertices.resize(static_cast<Eigen::Index>(cells.size()), 3);
  for (std::size_t c = 0; c < cells.size(); ++c)
    mesh.vertices.row(static_cast<Eigen::Index>(c)) =
        (frame.origin + frame.voxel * (cells[c].second.cast<double>() + Vec3::Constant(0.5) + place[c])).transpose();
  mesh.faces.resize(static_cast<Eigen::Index>(2 * corners.size()), 3);
  for (std::size_t q = 0; q < corners.size(); ++q) {
    const auto& c = corners[q];
    mesh.faces.row(static_cast<Eigen::Index>(2 * q)) << c[0], c[1], c[2];
    mesh.faces.row(static_cast<Eigen::Index>(2 * q + 1)) << c[0], c[2], c[3];
  }
  return mesh;
}

}  // namespace shellgrid
