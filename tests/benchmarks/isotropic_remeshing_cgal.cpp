// SPDX-License-Identifier: AGPL-3.0-or-later
#include "tests/benchmarks/isotropic_remeshing.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Polygon_mesh_processing/detect_features.h>
#include <CGAL/Polygon_mesh_processing/remesh.h>
#include <CGAL/Surface_mesh.h>

namespace shellgrid::test {

TriangleMesh isotropic_remeshing(const TriangleMesh& mesh, double edge_length, double feature_angle, int iterations) {
  using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
  using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;
  namespace processing = CGAL::Polygon_mesh_processing;
  Mesh work;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    work.add_vertex({mesh.vertices(v, 0), mesh.vertices(v, 1), mesh.vertices(v, 2)});
  for (int f = 0; f < mesh.face_count(); ++f)
    work.add_face(Mesh::Vertex_index(mesh.faces(f, 0)), Mesh::Vertex_index(mesh.faces(f, 1)),
                  Mesh::Vertex_index(mesh.faces(f, 2)));
  auto sharp = work.add_property_map<Mesh::Edge_index, bool>("e:sharp", false).first;
  processing::detect_sharp_edges(work, feature_angle, sharp);
  processing::isotropic_remeshing(faces(work), edge_length, work,
                                  processing::parameters::number_of_iterations(iterations)
                                      .edge_is_constrained_map(sharp)
                                      .protect_constraints(false));
  work.collect_garbage();
  TriangleMesh result;
  result.vertices.resize(static_cast<Eigen::Index>(work.number_of_vertices()), 3);
  result.faces.resize(static_cast<Eigen::Index>(work.number_of_faces()), 3);
  for (const Mesh::Vertex_index v : work.vertices())
    for (int axis = 0; axis < 3; ++axis)
      result.vertices(static_cast<Eigen::Index>(v.idx()), axis) = work.point(v)[axis];
  for (const Mesh::Face_index f : work.faces()) {
    int k = 0;
    for (const Mesh::Vertex_index v : work.vertices_around_face(work.halfedge(f)))
      result.faces(static_cast<Eigen::Index>(f.idx()), k++) = static_cast<int>(v);
  }
  return result;
}

}  // namespace shellgrid::test
