// SPDX-License-Identifier: AGPL-3.0-or-later
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/alpha_wrap_3.h>

#include <array>
#include <vector>

#include "meshing/surface/rewrap.h"

namespace shellgrid {

TriangleMesh wrap_triangles(const TriangleMesh& mesh, double alpha, double offset) {
  using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
  using Point = Kernel::Point_3;
  std::vector<Point> points;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    points.emplace_back(mesh.vertices(v, 0), mesh.vertices(v, 1), mesh.vertices(v, 2));
  std::vector<std::array<std::size_t, 3>> triangles;
  for (int f = 0; f < mesh.face_count(); ++f) {
    std::array<std::size_t, 3> t;
    for (int k = 0; k < 3; ++k) t[k] = static_cast<std::size_t>(mesh.faces(f, k));
    if (!CGAL::collinear(points[t[0]], points[t[1]], points[t[2]])) triangles.push_back(t);
  }
  TriangleMesh result;
  if (triangles.empty()) return result;
  CGAL::Surface_mesh<Point> wrap;
  CGAL::alpha_wrap_3(points, triangles, alpha, offset, wrap);
  std::vector<std::int32_t> index(wrap.num_vertices(), -1);
  std::int32_t count = 0;
  result.vertices.resize(static_cast<Eigen::Index>(wrap.number_of_vertices()), 3);
  for (const auto v : wrap.vertices()) {
    const Point& p = wrap.point(v);
    result.vertices.row(count) << p.x(), p.y(), p.z();
    index[v] = count++;
  }
  result.faces.resize(static_cast<Eigen::Index>(wrap.number_of_faces()), 3);
  Eigen::Index face = 0;
  for (const auto f : wrap.faces()) {
    int k = 0;
    for (const auto v : wrap.vertices_around_face(wrap.halfedge(f))) result.faces(face, k++) = index[v];
    ++face;
  }
  return result;
}

}  // namespace shellgrid
