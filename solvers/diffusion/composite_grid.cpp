// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/composite_grid.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

using Point = Eigen::Vector3f;

// Farthest that a child's point may lie from where its parent's corners put it, over the child's size.
constexpr float largest_bend = 0.25f;

std::vector<std::array<std::int32_t, 8>> find_children(const GridLevel& fine, std::size_t coarse_cells) {
  std::vector<std::array<std::int32_t, 8>> child(coarse_cells);
  for (auto& own : child) own.fill(-1);
  for (std::size_t c = 0; c < fine.cells(); ++c) {
    const Vec3i& at = fine.cell_lattice[c];
    child[fine.parent[c]][(at.x() & 1) | (at.y() & 1) << 1 | (at.z() & 1) << 2] = static_cast<std::int32_t>(c);
  }
  return child;
}

// Of each cell whether `layers` cells or more lie between it and the surface.
std::vector<char> find_depth(const GridLevel& level, int layers) {
  std::vector<std::uint8_t> reach(level.lattice.size());
  for (std::size_t p = 0; p < reach.size(); ++p) reach[p] = level.at_surface[p] ? 0 : 255;
  const std::size_t cells = level.cells();
  std::vector<std::uint8_t> least(cells);
  const auto find_least = [&] {
    parallel_for(
        cells,
        [&](std::size_t c) {
          std::uint8_t own = 255;
          for (int k = 0; k < 8; ++k) own = std::min(own, reach[level.corners[8 * c + k]]);
          least[c] = own;
        },
        4096);
  };
  for (int pass = 0; pass < layers; ++pass) {
    find_least();
    for (std::size_t c = 0; c < cells; ++c)
      if (least[c] == pass)
        for (int k = 0; k < 8; ++k) {
          std::uint8_t& own = reach[level.corners[8 * c + k]];
          own = std::min<std::uint8_t>(own, static_cast<std::uint8_t>(pass + 1));
        }
  }
  find_least();
  std::vector<char> deep(cells);
  for (std::size_t c = 0; c < cells; ++c) deep[c] = least[c] >= layers;
  return deep;
}

// Whether a cell's children lie about where its corners put them.
bool is_straight(const GridLevel& fine, const std::vector<Point>& position, const std::array<std::int32_t, 8>& child) {
  Point corner[8];
  for (int k = 0; k < 8; ++k) corner[k] = position[fine.corners[8 * static_cast<std::size_t>(child[k]) + k]];
  float size = 0;
  for (int k = 0; k < 8; ++k)
    for (int axis = 0; axis < 3; ++axis)
      if (!(k >> axis & 1)) size += (corner[k | 1 << axis] - corner[k]).norm();
  const float bend = largest_bend * size / 24;  // twelve edges, each two children long
  for (int o = 0; o < 8; ++o)
    for (int k = 0; k < 8; ++k) {
      Point mean = Point::Zero();
      int count = 0;
      for (int a = 0; a < 8; ++a) {
        bool takes = true;
        for (int axis = 0; axis < 3; ++axis) {
          const int local = (o >> axis & 1) + (k >> axis & 1);
          takes = takes && (local == 1 || local == 2 * (a >> axis & 1));
        }
        if (takes) mean += corner[a], ++count;
      }
      const Point& own = position[fine.corners[8 * static_cast<std::size_t>(child[o]) + k]];
      if (!((own - mean / static_cast<float>(count)).squaredNorm() <= bend * bend)) return false;
    }
  return true;
}

bool is_inverted(const GridLevel& level, const std::vector<Point>& position, std::size_t cell) {
  const std::int32_t* corner = level.corners.data() + 8 * cell;
  for (int k = 0; k < 8; ++k) {
    Mat3 edges;
    for (int axis = 0; axis < 3; ++axis) {
      const Point edge = position[corner[k ^ 1 << axis]] - position[corner[k]];
      edges.col(axis) = (k >> axis & 1 ? -edge : edge).cast<double>();
    }
    if (!(edges.determinant() > 0)) return true;
  }
  return false;
}

void cover_nothing(const std::vector<GridLevel>& levels, std::vector<CompositeLevel>& composite) {
  for (std::size_t l = 0; l < levels.size(); ++l) {
    composite[l].deep.clear();
    composite[l].child.clear();
    composite[l].covered.assign(levels[l].cells(), 0);
  }
}

}  // namespace

std::vector<CompositeLevel> choose_deep_cells(const std::vector<GridLevel>& levels,
                                              const std::vector<PointTransfer>& transfers,
                                              std::vector<Eigen::Vector3f> position, int depth, std::size_t coarsest) {
  std::vector<CompositeLevel> composite(levels.size());
  cover_nothing(levels, composite);
  composite[0].position = std::move(position);
  if (depth <= 0) return composite;
  const std::vector<Eigen::Vector3f> own_position = composite[0].position;

  std::size_t used = 1;  // levels that hold deep cells, and the finest
  for (std::size_t l = 0; l + 1 < levels.size(); ++l) {
    if (levels[l + 1].lattice.size() < 2 * coarsest || levels[l + 1].lattice.size() * 10 > levels[l].lattice.size() * 9)
      break;
    const GridLevel &fine = levels[l], &coarse = levels[l + 1];
    const PointTransfer& transfer = transfers[l];
    CompositeLevel& own = composite[l + 1];
    own.position.assign(coarse.lattice.size(), Point::Zero());
    for (std::size_t p = 0; p < fine.lattice.size(); ++p)
      if (transfer.start[p + 1] - transfer.start[p] == 1)
        own.position[transfer.parent[transfer.start[p]]] = composite[l].position[p];
    own.child = find_children(fine, coarse.cells());
    const std::vector<char> is_deep = find_depth(fine, 2 * depth);
    own.deep.assign(coarse.cells(), 0);
    parallel_for(
        coarse.cells(),
        [&](std::size_t c) {
          for (std::int32_t child : own.child[c])
            if (child < 0 || !is_deep[child] || (l > 0 && !composite[l].deep[child])) return;
          own.deep[c] = is_straight(fine, composite[l].position, own.child[c]) && !is_inverted(coarse, own.position, c);
        },
        256);
    for (std::size_t c = 0; c < fine.cells(); ++c) composite[l].covered[c] = own.deep[fine.parent[c]];
    used = l + 2;
    if (std::find(own.deep.begin(), own.deep.end(), 1) == own.deep.end()) break;
  }

  // Points on the faces of leaves, from the coarsest level down.
  for (std::size_t l = used - 1; l-- > 0;) {
    const GridLevel& level = levels[l];
    std::vector<char> seen(level.lattice.size(), 0);
    for (std::size_t c = 0; c < level.cells(); ++c)
      for (int k = 0; k < 8; ++k) seen[level.corners[8 * c + k]] |= composite[l].covered[c] ? 2 : 1;
    for (std::size_t p = 0; p < seen.size(); ++p) {
      if (!(seen[p] & 2)) continue;
      Point sum = Point::Zero();
      const std::int64_t first = transfers[l].start[p], last = transfers[l].start[p + 1];
      for (std::int64_t k = first; k < last; ++k) sum += composite[l + 1].position[transfers[l].parent[k]];
      composite[l].position[p] = sum / static_cast<float>(last - first);
    }
    bool inverted = false;
    for (std::size_t c = 0; c < level.cells() && !inverted; ++c) {
      if (composite[l].covered[c] || (l > 0 && !composite[l].is_leaf(c))) continue;
      bool moved = false;
      for (int k = 0; k < 8; ++k) moved = moved || (seen[level.corners[8 * c + k]] & 2);
      inverted = moved && is_inverted(level, composite[l].position, c);
    }
    if (inverted) {
      cover_nothing(levels, composite);
      composite[0].position = own_position;
      return composite;
    }
  }
  return composite;
}

}  // namespace shellgrid
