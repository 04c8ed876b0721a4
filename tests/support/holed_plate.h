// SPDX-License-Identifier: AGPL-3.0-or-later
// A closed surface of genus 3: a bent plate with three holes in a row.
#pragma once
#include <array>
#include <map>
#include <utility>
#include <vector>

#include "tests/support/closed_shapes.h"

namespace shellgrid::shapes {

// The smoothed boundary of cubes; `length` from end to end, mm.
inline TriangleMesh holed_plate(double length) {
  const auto filled = [](int x, int y, int z) {
    const double a = (x - 39) / 39.5, b = (y - 15) / 15.5, c = (z - 6) / 6.8;
    if (std::pow(a, 4) + std::pow(b, 4) + std::pow(c, 6) >= 1) return false;
    for (int middle : {15, 39, 63})
      if ((x - middle) * (x - middle) + (y - 15) * (y - 15) < 55) return false;
    return true;
  };
  std::map<std::array<int, 3>, int> number;
  std::vector<Vec3> points;
  std::vector<Eigen::Vector3i> faces;
  const auto vertex = [&](const Eigen::Vector3i& p) {
    const auto [entry, added] = number.try_emplace({p.x(), p.y(), p.z()}, static_cast<int>(points.size()));
    if (added) points.push_back(p.cast<double>());
    return entry->second;
  };
  for (int x = 0; x < 79; ++x)
    for (int y = 0; y < 31; ++y)
      for (int z = 0; z < 13; ++z)
        for (int axis = 0; filled(x, y, z) && axis < 3; ++axis)
          for (int side : {0, 1}) {
            Eigen::Vector3i cube(x, y, z), beyond = cube;
            beyond[axis] += 2 * side - 1;
            if (filled(beyond.x(), beyond.y(), beyond.z())) continue;
            const Eigen::Vector3i u = Eigen::Vector3i::Unit((axis + 1) % 3), v = Eigen::Vector3i::Unit((axis + 2) % 3);
            const Eigen::Vector3i corner = cube + side * Eigen::Vector3i::Unit(axis);
            std::array<int, 4> quad = {vertex(corner), vertex(corner + u), vertex(corner + u + v), vertex(corner + v)};
            if (side == 0) std::swap(quad[1], quad[3]);
            faces.emplace_back(quad[0], quad[1], quad[2]);
            faces.emplace_back(quad[0], quad[2], quad[3]);
          }
  for (int step = 0; step < 60; ++step) {
    std::vector<Vec3> sum(points.size(), Vec3::Zero());
    std::vector<int> degree(points.size(), 0);
    for (const Eigen::Vector3i& f : faces)
      for (int k = 0; k < 3; ++k) sum[f[k]] += points[f[(k + 1) % 3]], ++degree[f[k]];
    const double share = step % 3 == 2 ? -0.52 : 0.5;  // [Taubin1995], between its pairs of steps some that only smooth
    for (std::size_t v = 0; v < points.size(); ++v) points[v] += share * (sum[v] / degree[v] - points[v]);
  }
  for (Vec3& p : points) p = (p - Vec3(39.5, 15.5, 6.5)) * (length / 79), p.z() += 0.01 * 79 / length * p.x() * p.x();
  return from_lists(points, faces);
}

}  // namespace shellgrid::shapes
