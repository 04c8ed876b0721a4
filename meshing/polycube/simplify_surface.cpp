// SPDX-License-Identifier: AGPL-3.0-or-later
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <OpenMesh/Tools/Decimater/DecimaterT.hh>
#include <OpenMesh/Tools/Decimater/ModNormalFlippingT.hh>
#include <OpenMesh/Tools/Decimater/ModQuadricT.hh>

#include "meshing/core/error.h"
#include "meshing/polycube/tetrahedralize.h"

namespace shellgrid {
namespace {

struct Traits : OpenMesh::DefaultTraits {
  using Point = OpenMesh::Vec3d;
  using Normal = OpenMesh::Vec3d;
};
using HalfedgeMesh = OpenMesh::TriMesh_ArrayKernelT<Traits>;

}  // namespace

TriangleMesh simplify_surface(const TriangleMesh& surface, int faces) {
  HalfedgeMesh mesh;
  std::vector<HalfedgeMesh::VertexHandle> handles(surface.vertex_count());
  for (int v = 0; v < surface.vertex_count(); ++v) {
    const Vec3 p = surface.vertex(v);
    handles[v] = mesh.add_vertex({p.x(), p.y(), p.z()});
  }
  for (int f = 0; f < surface.face_count(); ++f)
    if (!mesh.add_face(handles[surface.faces(f, 0)], handles[surface.faces(f, 1)], handles[surface.faces(f, 2)])
             .is_valid())
      throw InputError("face " + std::to_string(f) + " meets its neighbours in a non-manifold way; try sg-prepare");
  mesh.request_face_normals();
  mesh.update_face_normals();

  OpenMesh::Decimater::DecimaterT<HalfedgeMesh> decimater(mesh);
  OpenMesh::Decimater::ModQuadricT<HalfedgeMesh>::Handle quadric;
  OpenMesh::Decimater::ModNormalFlippingT<HalfedgeMesh>::Handle flipping;
  decimater.add(quadric);
  decimater.add(flipping);
  decimater.module(quadric).unset_max_err();
  decimater.module(flipping).set_max_normal_deviation(60);
  decimater.initialize();
  decimater.decimate_to_faces(0, static_cast<std::size_t>(faces));
  mesh.garbage_collection();

  TriangleMesh result;
  result.vertices.resize(static_cast<Eigen::Index>(mesh.n_vertices()), 3);
  for (const auto v : mesh.vertices()) {
    const auto& p = mesh.point(v);
    result.vertices.row(v.idx()) << p[0], p[1], p[2];
  }
  result.faces.resize(static_cast<Eigen::Index>(mesh.n_faces()), 3);
  for (const auto f : mesh.faces()) {
    int k = 0;
    for (const auto v : mesh.fv_range(f)) result.faces(f.idx(), k++) = v.idx();
  }
  return result;
}

}  // namespace shellgrid
