// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/direction_field.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

// Neighbours of each vertex of a level: those whose regions touch. Compressed rows over positions in the level.
struct LevelGraph {
  std::vector<std::int32_t> offsets, neighbours;
};

LevelGraph build_level_graph(const TriangleMesh& mesh, const VertexHierarchy::Level& level) {
  std::vector<std::int32_t> position(mesh.vertex_count(), -1);
  for (std::size_t i = 0; i < level.vertices.size(); ++i) position[level.vertices[i]] = static_cast<std::int32_t>(i);
  std::vector<std::pair<std::int32_t, std::int32_t>> links;
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) {
      const std::int32_t a = position[level.nearest[mesh.faces(f, k)]];
      const std::int32_t b = position[level.nearest[mesh.faces(f, (k + 1) % 3)]];
      if (a != b) links.emplace_back(a, b), links.emplace_back(b, a);
    }
  std::sort(links.begin(), links.end());
  links.erase(std::unique(links.begin(), links.end()), links.end());
  LevelGraph graph;
  graph.offsets.assign(level.vertices.size() + 1, 0);
  for (const auto& [a, b] : links) ++graph.offsets[a + 1], graph.neighbours.push_back(b);
  for (std::size_t i = 0; i < level.vertices.size(); ++i) graph.offsets[i + 1] += graph.offsets[i];
  return graph;
}

// The unit projection of `vector` to the plane across `normal`; `fallback` (tangent) where it vanishes.
Vec3 tangent_unit(const Vec3& vector, const Vec3& normal, const Vec3& fallback) {
  const Vec3 projected = vector - normal * normal.dot(vector);
  const double length = projected.norm();
  return length > 1e-9 ? Vec3(projected / length) : fallback;
}

Vec3 any_tangent(const Vec3& normal) {
  int axis = 0;
  normal.cwiseAbs().minCoeff(&axis);
  return normal.cross(Vec3::Unit(axis)).normalized();
}

double object_size(const TriangleMesh& mesh) {
  return (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).norm();
}

std::string number_text(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

std::string point_text(const Vec3& p) {
  char text[96];
  std::snprintf(text, sizeof text, "(%g, %g, %g)", p.x(), p.y(), p.z());
  return text;
}

// Of the vectors that a turn by 360°/symmetry about `from_normal` makes of `vector`, the one nearest to `own`, which is
// tangent where the normal is `normal`.
Vec3 nearest_turn(const Vec3& vector, const Vec3& from_normal, const Vec3& own, int symmetry) {
  if (symmetry == 1) return vector;
  const double along = vector.dot(own);
  if (symmetry == 2) return along < 0 ? Vec3(-vector) : vector;
  const Vec3 across = from_normal.cross(vector);
  const double beside = across.dot(own);
  if (std::abs(along) >= std::abs(beside)) return along < 0 ? Vec3(-vector) : vector;
  return beside < 0 ? Vec3(-across) : across;
}

struct FixedVector {
  std::int32_t vertex;
  Vec3 direction;  // unit, tangent
  bool is_point;   // wanted at a point instead of a vertex
};

constexpr std::size_t most_spreading = 64;  // constraints that draw their surroundings; more stand close together
constexpr double reach_share = 0.15;        // of the object's size: where one draws as much as the preferred direction
constexpr double most_pull = 6;             // beside a vertex's six neighbours
constexpr double farthest_share = 0.25;     // of the object's size: a point farther from the surface is none of it

// What the constraints want of a vertex, by inverse squared distance, and how strongly: below `most_pull`.
Vec3 pull_of(const TriangleMesh& mesh, const VertexMatrix& normals, const std::vector<FixedVector>& fixed, double reach,
             const Vec3& own, std::int32_t v, int symmetry) {
  Vec3 sum = Vec3::Zero();
  double total = 0;
  const Vec3 n = normals.row(v).transpose(), at = mesh.vertex(v);
  for (const FixedVector& f : fixed) {
    const Vec3 normal = normals.row(f.vertex).transpose();
    const double facing = 0.5 * (1 + n.dot(normal));
    const double distance = std::max((mesh.vertex(f.vertex) - at).squaredNorm(), 1e-12 * reach * reach);
    const double weight = facing * facing * reach * reach / distance;
    const Vec3 carried = carry_tangent(f.direction, normal, n);
    sum += weight * nearest_turn(carried, n, own, symmetry);
    total += weight;
  }
  const double length = sum.norm();
  return length > 1e-9 ? Vec3(sum * (most_pull * total / (1 + total)) / std::max(length, 0.5 * total)) : Vec3::Zero();
}

std::vector<FixedVector> fix_vectors(const TriangleMesh& mesh, const VertexMatrix& normals,
                                     const std::vector<DirectionConstraint>& constraints, int symmetry) {
  std::vector<FixedVector> fixed;
  for (const DirectionConstraint& constraint : constraints) {
    if (!constraint.point.allFinite() || !constraint.direction.allFinite() || !(constraint.direction.norm() > 0))
      throw InputError("the direction wanted at " + point_text(constraint.point) + " is not a direction");
    Eigen::Index nearest = constraint.vertex;
    if (constraint.vertex >= mesh.vertex_count()) throw InternalError("a direction for a vertex that is not there");
    if (nearest < 0)
      (mesh.vertices.rowwise() - constraint.point.transpose()).rowwise().squaredNorm().minCoeff(&nearest);
    const Vec3 n = normals.row(nearest).transpose(), d = constraint.direction.normalized();
    const double off = (mesh.vertex(static_cast<int>(nearest)) - constraint.point).norm();
    if (constraint.vertex < 0 && off > farthest_share * object_size(mesh))
      throw InputError("the direction wanted at " + point_text(constraint.point) + " is wanted " + number_text(off) +
                       " mm away from the surface");
    if ((d - n * n.dot(d)).norm() < 0.05)
      throw InputError("the direction wanted at " + point_text(constraint.point) +
                       " stands across the surface there: it must run along it");
    const FixedVector own{static_cast<std::int32_t>(nearest), tangent_unit(d, n, d), constraint.vertex < 0};
    for (const FixedVector& other : fixed)
      if (own.is_point && other.is_point && other.vertex == own.vertex &&
          nearest_turn(own.direction, n, other.direction, symmetry).dot(other.direction) < -0.5)
        throw InputError("two directions wanted at " + point_text(constraint.point) + " contradict each other");
    fixed.push_back(own);
  }
  return fixed;
}

}  // namespace

VertexMatrix make_direction_field(const TriangleMesh& mesh, const VertexMatrix& normals,
                                  const VertexHierarchy& hierarchy, const Vec3& preferred,
                                  const std::vector<DirectionConstraint>& constraints, int symmetry) {
  if (symmetry != 1 && symmetry != 2 && symmetry != 4) throw InternalError("no direction field of that symmetry");
  if (!(preferred.norm() > 0) || !preferred.allFinite()) throw InputError("preferred direction must not be zero");
  VertexMatrix field(mesh.vertex_count(), 3);
  const std::vector<FixedVector> fixed = fix_vectors(mesh, normals, constraints, symmetry);
  const Vec3 axis = preferred.normalized();
  const double reach = reach_share * object_size(mesh);
  parallel_for(mesh.vertex_count(), [&](std::size_t v) {
    const Vec3 n = normals.row(v).transpose();
    field.row(v) = tangent_unit(axis, n, any_tangent(n)).transpose();
  });
  for (int l = static_cast<int>(hierarchy.levels.size()) - 1; l >= 0; --l) {
    const VertexHierarchy::Level& level = hierarchy.levels[l];
    const LevelGraph graph = build_level_graph(mesh, level);
    const std::size_t count = level.vertices.size();
    if (l + 1 < static_cast<int>(hierarchy.levels.size())) {
      const VertexHierarchy::Level& coarser = hierarchy.levels[l + 1];
      std::vector<Vec3> started(count);
      parallel_for(count, [&](std::size_t i) {
        const std::int32_t v = level.vertices[i], parent = coarser.nearest[v];
        const Vec3 n = normals.row(v).transpose();
        started[i] = tangent_unit(carry_tangent(field.row(parent).transpose(), normals.row(parent).transpose(), n), n,
                                  any_tangent(n));
      });
      for (std::size_t i = 0; i < count; ++i) field.row(level.vertices[i]) = started[i].transpose();
    }
    // What the constraints want of this level's vertices; zero where nothing.
    std::vector<Vec3> wanted(fixed.empty() ? 0 : count, Vec3::Zero());
    if (!fixed.empty()) {
      std::vector<std::int32_t> position(mesh.vertex_count(), -1);
      for (std::size_t i = 0; i < count; ++i) position[level.vertices[i]] = static_cast<std::int32_t>(i);
      for (const FixedVector& f : fixed) {
        const std::int32_t v = level.nearest[f.vertex];
        const Vec3 n = normals.row(v).transpose();
        const Vec3 carried = carry_tangent(f.direction, normals.row(f.vertex).transpose(), n);
        Vec3& sum = wanted[position[v]];
        sum += sum.norm() > 1e-9 ? nearest_turn(carried, n, sum, symmetry) : carried;
      }
      for (std::size_t i = 0; i < count; ++i) {
        if (wanted[i].norm() < 1e-9) continue;
        const Vec3 own = field.row(level.vertices[i]).transpose();
        wanted[i] = tangent_unit(wanted[i], normals.row(level.vertices[i]).transpose(), own);
        field.row(level.vertices[i]) = wanted[i].transpose();
      }
    }
    // Wishes at a few points draw what is about them: a point alone would bend a smooth field beside itself only.
    const bool spreads = !fixed.empty() && fixed.size() <= most_spreading && fixed.front().is_point;
    std::vector<Vec3> pull(spreads ? count : 0);
    if (spreads)
      parallel_for(count, [&](std::size_t i) {
        const std::int32_t v = level.vertices[i];
        const Vec3 own = field.row(v).transpose(), n = normals.row(v).transpose();
        pull[i] = pull_of(mesh, normals, fixed, reach, own, v, symmetry);
        if (pull[i].norm() > 0.5 * most_pull) field.row(v) = tangent_unit(pull[i], n, own).transpose();
      });
    const int sweeps = l + 1 == static_cast<int>(hierarchy.levels.size()) ? 200 : 20;
    std::vector<Vec3> smoothed(count);
    for (int sweep = 0; sweep < sweeps; ++sweep) {
      parallel_for(count, [&](std::size_t i) {
        const std::int32_t v = level.vertices[i];
        const Vec3 own = field.row(v).transpose(), n = normals.row(v).transpose();
        Vec3 sum = own;  // its own share keeps the simultaneous update from oscillating
        if (spreads) sum += nearest_turn(pull[i], n, own, symmetry);
        for (std::int32_t at = graph.offsets[i]; at < graph.offsets[i + 1]; ++at) {
          const std::int32_t w = level.vertices[graph.neighbours[at]];
          const Vec3 other = field.row(w).transpose();
          sum += symmetry == 1 ? other : nearest_turn(other, normals.row(w).transpose(), own, symmetry);
        }
        smoothed[i] = !wanted.empty() && wanted[i].norm() > 0.5 ? wanted[i] : tangent_unit(sum, n, own);
      });
      for (std::size_t i = 0; i < count; ++i) field.row(level.vertices[i]) = smoothed[i].transpose();
    }
  }
  return field;
}

Vec3 carry_tangent(const Vec3& tangent, const Vec3& from_normal, const Vec3& to_normal) {
  const Vec3 axis = from_normal.cross(to_normal);
  const double cosine = from_normal.dot(to_normal);
  if (cosine < -0.999999) return -tangent;
  // Rodrigues with |axis| = sine: R t = c t + axis × t + axis (axis·t) / (1 + c).
  return cosine * tangent + axis.cross(tangent) + axis * (axis.dot(tangent) / (1 + cosine));
}

std::vector<int> direction_field_indices(const TriangleMesh& mesh, const VertexMatrix& normals,
                                         const VertexMatrix& field, int symmetry) {
  std::vector<int> indices(mesh.face_count(), 0);
  const auto normal_of = [&](int v) { return Vec3(normals.row(v).transpose()); };
  // Angle from the carried vector of `a` to the vector of `b`, seen from outside.
  const auto turn = [&](int a, int b) {
    const bool swapped = a > b;
    if (swapped) std::swap(a, b);
    const Vec3 n = normal_of(b);
    const Vec3 carried = carry_tangent(field.row(a).transpose(), normal_of(a), n);
    const Vec3 own = field.row(b).transpose();
    double angle = std::atan2(carried.cross(own).dot(n), carried.dot(own));
    const double period = 2 * M_PI / symmetry;
    angle -= period * std::round(angle / period);
    return swapped ? -angle : angle;
  };
  parallel_for(mesh.face_count(), [&](std::size_t f) {
    const int a = mesh.faces(f, 0), b = mesh.faces(f, 1), c = mesh.faces(f, 2);
    const Vec3 na = normal_of(a), nb = normal_of(b), nc = normal_of(c);
    // Solid angle of the normals' triangle: what the frame turns by when carried around it.
    const double solid_angle = 2 * std::atan2(na.dot(nb.cross(nc)), 1 + na.dot(nb) + nb.dot(nc) + nc.dot(na));
    const double total = turn(a, b) + turn(b, c) + turn(c, a) + solid_angle;
    indices[f] = static_cast<int>(std::lround(symmetry * total / (2 * M_PI)));
  });
  return indices;
}

}  // namespace shellgrid
