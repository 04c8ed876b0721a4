// SPDX-License-Identifier: AGPL-3.0-or-later
#include "tests/meshing/distance/sides_of_mesh.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Side_of_triangle_mesh.h>
#include <CGAL/Surface_mesh.h>

namespace shellgrid::test {

std::vector<char> sides_of_mesh(const TriangleMesh& mesh, const std::vector<Vec3>& points) {
  using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
  using Surface = CGAL::Surface_mesh<Kernel::Point_3>;
  using Vertex = Surface::Vertex_index;
  Surface surface;
  for (int v = 0; v < mesh.vertex_count(); ++v)
    surface.add_vertex(Kernel::Point_3(mesh.vertices(v, 0), mesh.vertices(v, 1), mesh.vertices(v, 2)));
  for (int f = 0; f < mesh.face_count(); ++f)
    surface.add_face(Vertex(static_cast<std::uint32_t>(mesh.faces(f, 0))),
                     Vertex(static_cast<std::uint32_t>(mesh.faces(f, 1))),
                     Vertex(static_cast<std::uint32_t>(mesh.faces(f, 2))));
  const CGAL::Side_of_triangle_mesh<Surface, Kernel> side(surface);
  std::vector<char> result;
  for (const Vec3& p : points) {
    const CGAL::Bounded_side found = side(Kernel::Point_3(p.x(), p.y(), p.z()));
    result.push_back(found == CGAL::ON_BOUNDED_SIDE ? 1 : found == CGAL::ON_UNBOUNDED_SIDE ? -1 : 0);
  }
  return result;
}

}  // namespace shellgrid::test
