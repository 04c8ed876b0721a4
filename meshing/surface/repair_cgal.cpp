// SPDX-License-Identifier: AGPL-3.0-or-later
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/triangulate_hole.h>
#include <CGAL/Triangle_3.h>
#include <CGAL/intersections.h>

#include <algorithm>
#include <array>

#include "meshing/core/parallel.h"
#include "meshing/surface/box_tree.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;

Point to_point(const Vec3& p) { return {p.x(), p.y(), p.z()}; }

// Whether two triangles meet in more than the corners they share.
bool intersect(const TriangleMesh& mesh, int face, int other, double least_angle) {
  std::array<int, 3> a, b;
  for (int k = 0; k < 3; ++k) a[k] = mesh.faces(face, k), b[k] = mesh.faces(other, k);
  int shared = 0;
  // Rotate the shared corners to the front of both.
  for (int i = shared; i < 3; ++i)
    for (int j = shared; j < 3; ++j)
      if (a[i] == b[j]) {
        std::swap(a[i], a[shared]);
        std::swap(b[j], b[shared]);
        ++shared;
        break;
      }
  const auto p = [&](int v) { return to_point(mesh.vertex(v)); };
  if (shared == 3) return true;
  if (shared == 2) {
    // Neighbours meet beyond their edge only when one is folded flat onto the other.
    const Vec3 edge = mesh.vertex(a[1]) - mesh.vertex(a[0]);
    const Vec3 n = edge.cross(mesh.vertex(a[2]) - mesh.vertex(a[0])),
               m = edge.cross(mesh.vertex(b[2]) - mesh.vertex(b[0]));
    if (n.dot(m) > 0 && n.cross(m).norm() < least_angle * n.norm() * m.norm()) return true;
    if (CGAL::orientation(p(a[0]), p(a[1]), p(a[2]), p(b[2])) != CGAL::COPLANAR) return false;
    return CGAL::coplanar_orientation(p(a[0]), p(a[1]), p(a[2]), p(b[2])) == CGAL::POSITIVE;
  }
  const Kernel::Triangle_3 s(p(a[0]), p(a[1]), p(a[2])), t(p(b[0]), p(b[1]), p(b[2]));
  if (shared == 1)  // beyond the shared corner only if an opposite edge cuts the other triangle
    return CGAL::do_intersect(Kernel::Segment_3(p(a[1]), p(a[2])), t) ||
           CGAL::do_intersect(Kernel::Segment_3(p(b[1]), p(b[2])), s);
  return CGAL::do_intersect(s, t);
}

}  // namespace

SelfIntersections find_self_intersections(const TriangleMesh& mesh, const std::vector<char>& marked,
                                          double least_angle) {
  std::vector<Box> boxes(mesh.face_count());
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) boxes[f].add(mesh.corner(f, k));
  std::vector<char> is_flat(boxes.size(), 0);
  parallel_for(boxes.size(), [&](std::size_t f) {
    const auto p = [&](int k) { return to_point(mesh.corner(static_cast<int>(f), k)); };
    is_flat[f] = CGAL::collinear(p(0), p(1), p(2));
  });
  const BoxTree tree(boxes);
  constexpr std::size_t chunk = 512;
  std::vector<std::vector<std::pair<int, int>>> found((boxes.size() + chunk - 1) / chunk);
  parallel_chunks(boxes.size(), chunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t f = begin; f < end; ++f) {
      if (!marked.empty() && !marked[f]) continue;
      if (is_flat[f]) {  // without area it has no inside to cross: bad enough
        found[begin / chunk].emplace_back(static_cast<int>(f), static_cast<int>(f));
        continue;
      }
      tree.visit_overlaps(boxes[f], [&](int leaf) {
        for (int slot = 0; slot < BoxTree::width; ++slot) {
          const int other = tree.item(leaf, slot);
          // A pair is found from its lower face, or from its only marked one.
          if (other < 0 || other == static_cast<int>(f) || is_flat[other] || !boxes[f].overlaps(boxes[other])) continue;
          if (other < static_cast<int>(f) && (marked.empty() || marked[other])) continue;
          if (intersect(mesh, std::min(static_cast<int>(f), other), std::max(static_cast<int>(f), other), least_angle))
            found[begin / chunk].push_back(std::minmax(static_cast<int>(f), other));
        }
      });
    }
  });
  SelfIntersections result;
  for (const auto& part : found) result.face_pairs.insert(result.face_pairs.end(), part.begin(), part.end());
  std::sort(result.face_pairs.begin(), result.face_pairs.end());
  result.pairs = static_cast<int>(result.face_pairs.size());
  if (result.pairs > 0) result.at = mesh.corner(result.face_pairs.front().first, 0);
  return result;
}

std::vector<Eigen::Vector3i> triangulate_hole(const std::vector<Vec3>& polyline) {
  std::vector<Point> points;
  for (const Vec3& p : polyline) points.push_back(to_point(p));
  struct Corners {
    std::array<int, 3> corner;
    Corners(int i, int j, int k) : corner{i, j, k} {}
  };
  std::vector<Corners> triangles;
  namespace parameters = CGAL::Polygon_mesh_processing::parameters;
  CGAL::Polygon_mesh_processing::triangulate_hole_polyline(
      points, std::back_inserter(triangles), parameters::use_delaunay_triangulation(true).geom_traits(Kernel()));
  std::vector<Eigen::Vector3i> result;
  for (const Corners& t : triangles) result.emplace_back(t.corner[0], t.corner[1], t.corner[2]);
  return result;
}

}  // namespace shellgrid
