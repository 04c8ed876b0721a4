// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/mean_value.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <vector>

namespace shellgrid {

Eigen::RowVectorXd mean_value(const TriangleMesh& boundary, const Eigen::MatrixXd& values, const Vec3& point) {
  constexpr double pi = std::numbers::pi, nearly = 1e-9;
  const int n = boundary.vertex_count();
  std::vector<Vec3> way(n);
  std::vector<double> distance(n);
  int nearest = 0;
  double size = 0;
  for (int v = 0; v < n; ++v) {
    way[v] = boundary.vertex(v) - point;
    distance[v] = way[v].norm();
    if (distance[v] < distance[nearest]) nearest = v;
    size = std::max(size, distance[v]);
  }
  if (!(distance[nearest] > nearly * size)) return values.row(nearest);
  for (int v = 0; v < n; ++v) way[v] /= distance[v];
  Eigen::RowVectorXd sum = Eigen::RowVectorXd::Zero(values.cols());
  double total = 0, magnitude = 0;
  for (int f = 0; f < boundary.face_count(); ++f) {
    const std::array<int, 3> v = {boundary.faces(f, 0), boundary.faces(f, 1), boundary.faces(f, 2)};
    std::array<double, 3> angle, sine;
    for (int k = 0; k < 3; ++k) {
      const double length = (way[v[(k + 1) % 3]] - way[v[(k + 2) % 3]]).norm();
      angle[k] = 2 * std::asin(std::min(1.0, length / 2));
      sine[k] = std::sin(angle[k]);
    }
    const double half = (angle[0] + angle[1] + angle[2]) / 2;
    if (pi - half < nearly) {  // the point lies in the triangle
      double weight = 0;
      sum.setZero();
      for (int k = 0; k < 3; ++k) {
        const double w = sine[k] * distance[v[(k + 1) % 3]] * distance[v[(k + 2) % 3]];
        sum += w * values.row(v[k]);
        weight += w;
      }
      return weight > 0 ? Eigen::RowVectorXd(sum / weight) : Eigen::RowVectorXd(values.row(nearest));
    }
    const double sign = way[v[0]].dot(way[v[1]].cross(way[v[2]])) < 0 ? -1 : 1;
    std::array<double, 3> c, s;
    bool flat = false;
    for (int k = 0; k < 3; ++k) {
      c[k] = 2 * std::sin(half) * std::sin(half - angle[k]) / (sine[(k + 1) % 3] * sine[(k + 2) % 3]) - 1;
      s[k] = sign * std::sqrt(std::max(0.0, 1 - c[k] * c[k]));
      flat = flat || !(std::abs(s[k]) > nearly);
    }
    if (flat) continue;  // seen edge-on, from beside it
    for (int k = 0; k < 3; ++k) {
      const int next = (k + 1) % 3, last = (k + 2) % 3;
      const double w =
          (angle[k] - c[next] * angle[last] - c[last] * angle[next]) / (distance[v[k]] * sine[next] * s[last]);
      sum += w * values.row(v[k]);
      total += w;
      magnitude += std::abs(w);
    }
  }
  if (!(total > 1e-9 * magnitude)) return values.row(nearest);
  return sum / total;
}

TriangleMesh cluster_vertices(const TriangleMesh& mesh, double edge, std::vector<std::int32_t>& cluster) {
  std::map<std::array<int, 3>, std::int32_t> number;
  cluster.resize(mesh.vertex_count());
  std::vector<Vec3> sums;
  std::vector<double> counts;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const Vec3i at = (mesh.vertex(v) / edge).array().floor().matrix().cast<int>();
    const auto [entry, added] = number.try_emplace({at.x(), at.y(), at.z()}, static_cast<std::int32_t>(sums.size()));
    if (added) sums.push_back(Vec3::Zero()), counts.push_back(0);
    cluster[v] = entry->second;
    sums[entry->second] += mesh.vertex(v);
    ++counts[entry->second];
  }
  // Each triangle from its lowest corner on, how often it is passed that way less how often the other.
  std::map<std::array<std::int32_t, 3>, int> passed;
  for (int f = 0; f < mesh.face_count(); ++f) {
    std::array<std::int32_t, 3> t = {cluster[mesh.faces(f, 0)], cluster[mesh.faces(f, 1)], cluster[mesh.faces(f, 2)]};
    if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) continue;
    std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
    if (t[1] < t[2])
      ++passed[t];
    else
      --passed[{t[0], t[2], t[1]}];
  }
  TriangleMesh result;
  result.vertices.resize(static_cast<Eigen::Index>(sums.size()), 3);
  for (std::size_t k = 0; k < sums.size(); ++k)
    result.vertices.row(static_cast<Eigen::Index>(k)) = (sums[k] / counts[k]).transpose();
  std::vector<Eigen::RowVector3i> faces;
  for (const auto& [t, count] : passed)
    for (int k = 0; k < std::abs(count); ++k)
      faces.push_back(count > 0 ? Eigen::RowVector3i(t[0], t[1], t[2]) : Eigen::RowVector3i(t[0], t[2], t[1]));
  result.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t k = 0; k < faces.size(); ++k) result.faces.row(static_cast<Eigen::Index>(k)) = faces[k];
  return result;
}

}  // namespace shellgrid
