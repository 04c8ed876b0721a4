// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/tetrahedralize.h"

#include <tetgen.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/guarded_child.h"

namespace shellgrid {
namespace {

// In the child: runs TetGen and sends the mesh through the pipe. `largest`: volume of a tetrahedron, mm³; 0: any.
bool send_tetrahedra(const TriangleMesh& surface, double largest, int pipe) {
  tetgenio in, out;
  in.firstnumber = 0;
  in.numberofpoints = surface.vertex_count();
  in.pointlist = new REAL[3 * static_cast<std::size_t>(in.numberofpoints)];
  std::copy(surface.vertices.data(), surface.vertices.data() + surface.vertices.size(), in.pointlist);
  in.numberoffacets = surface.face_count();
  in.facetlist = new tetgenio::facet[in.numberoffacets];
  for (int f = 0; f < in.numberoffacets; ++f) {
    tetgenio::facet& facet = in.facetlist[f];
    tetgenio::init(&facet);
    facet.numberofpolygons = 1;
    facet.polygonlist = new tetgenio::polygon[1];
    tetgenio::polygon& polygon = facet.polygonlist[0];
    tetgenio::init(&polygon);
    polygon.numberofvertices = 3;
    polygon.vertexlist = new int[3];
    for (int k = 0; k < 3; ++k) polygon.vertexlist[k] = surface.faces(f, k);
  }
  char switches[64] = "pYQ";
  if (largest > 0) std::snprintf(switches, sizeof switches, "pYq1.4a%.12fQ", largest);
  {
    const ForeignCode foreign;
    ::tetrahedralize(switches, &in, &out);
  }
  const std::int64_t counts[2] = {out.numberofpoints, out.numberoftetrahedra};
  const bool sent = counts[1] > 0 && out.numberofcorners == 4 && write_all(pipe, counts, sizeof counts) &&
                    write_all(pipe, out.pointlist, sizeof(double) * 3 * static_cast<std::size_t>(counts[0])) &&
                    write_all(pipe, out.tetrahedronlist, sizeof(int) * 4 * static_cast<std::size_t>(counts[1]));
  ::_exit(sent ? 0 : 1);  // sooner than by giving back what TetGen holds
}

double signed_volume(const TetrahedralMesh& mesh, Eigen::Index t) {
  const Vec3 a = mesh.points.row(mesh.tetrahedra(t, 0)).transpose();
  const Vec3 b = mesh.points.row(mesh.tetrahedra(t, 1)).transpose();
  const Vec3 c = mesh.points.row(mesh.tetrahedra(t, 2)).transpose();
  const Vec3 d = mesh.points.row(mesh.tetrahedra(t, 3)).transpose();
  return (b - a).cross(c - a).dot(d - a) / 6;
}

double total_volume(const TetrahedralMesh& mesh) {
  double volume = 0;
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t) volume += signed_volume(mesh, t);
  return volume;
}

std::optional<TetrahedralMesh> fill(const TriangleMesh& surface, const TetrahedralizeOptions& options) {
  // A regular tetrahedron has 0.118 edge³. TetGen's stay well below the largest volume allowed: their mean is about
  // half of it.
  const double largest = 2 * 0.118 * std::pow(options.spacing, 3);
  const GuardedAnswer answer = run_guarded(options.limit_seconds, 4 * options.limit_seconds,
                                           [&](int pipe) { return send_tetrahedra(surface, largest, pipe); });
  const std::string& bytes = answer.bytes;
  if (!answer.finished || bytes.size() < 2 * sizeof(std::int64_t)) return std::nullopt;
  std::int64_t counts[2];
  std::memcpy(counts, bytes.data(), sizeof counts);
  const std::size_t point_bytes = sizeof(double) * 3 * static_cast<std::size_t>(counts[0]);
  if (bytes.size() != sizeof counts + point_bytes + sizeof(int) * 4 * static_cast<std::size_t>(counts[1]))
    return std::nullopt;
  TetrahedralMesh mesh;
  mesh.points.resize(counts[0], 3);
  mesh.tetrahedra.resize(counts[1], 4);
  std::memcpy(mesh.points.data(), bytes.data() + sizeof counts, point_bytes);
  std::memcpy(mesh.tetrahedra.data(), bytes.data() + sizeof counts + point_bytes, sizeof(int) * 4 * counts[1]);
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t)
    if (signed_volume(mesh, t) < 0) std::swap(mesh.tetrahedra(t, 2), mesh.tetrahedra(t, 3));
  return mesh;
}

}  // namespace

TriangleMesh boundary_of(const TetrahedralMesh& mesh) {
  // Faces opposite each corner, outward for a positive tetrahedron.
  constexpr int corners[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
  struct Face {
    std::array<std::int32_t, 3> key, corners;
    bool operator<(const Face& other) const { return key < other.key; }
  };
  std::vector<Face> faces;
  faces.reserve(4 * static_cast<std::size_t>(mesh.tetrahedra.rows()));
  for (Eigen::Index t = 0; t < mesh.tetrahedra.rows(); ++t)
    for (const auto& c : corners) {
      Face face;
      for (int k = 0; k < 3; ++k) face.key[k] = face.corners[k] = mesh.tetrahedra(t, c[k]);
      std::sort(face.key.begin(), face.key.end());
      faces.push_back(face);
    }
  std::sort(faces.begin(), faces.end());
  std::vector<std::array<std::int32_t, 3>> outer;
  for (std::size_t f = 0; f < faces.size();) {
    std::size_t next = f + 1;
    while (next < faces.size() && faces[next].key == faces[f].key) ++next;
    if (next - f == 1) outer.push_back(faces[f].corners);
    f = next;
  }
  std::vector<std::int32_t> index(mesh.points.rows(), -1);
  for (const auto& face : outer)
    for (std::int32_t p : face) index[p] = 0;
  TriangleMesh surface;
  std::int32_t count = 0;
  for (std::int32_t& i : index)
    if (i == 0) i = count++;
  surface.vertices.resize(count, 3);
  for (std::size_t p = 0; p < index.size(); ++p)
    if (index[p] >= 0) surface.vertices.row(index[p]) = mesh.points.row(p);
  surface.faces.resize(static_cast<Eigen::Index>(outer.size()), 3);
  for (std::size_t f = 0; f < outer.size(); ++f)
    for (int k = 0; k < 3; ++k) surface.faces(f, k) = index[outer[f][k]];
  return surface;
}

TetrahedralizeResult tetrahedralize(const TriangleMesh& surface, const TetrahedralizeOptions& options,
                                    Progress& progress) {
  if (surface.face_count() < 4) throw InputError("the surface has fewer than four faces; expected a closed surface");
  if (options.spacing > 0) {
    const double edges = (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).prod() /
                         std::pow(options.spacing, 3);
    if (!(edges < 2e7))
      throw InputError("spacing " + std::to_string(options.spacing) +
                       " mm: the object would take more than 1e8 tetrahedra; give a greater spacing");
  }
  TetrahedralizeResult result;
  progress.begin("tetrahedra", 0);
  if (surface.face_count() > options.proxy_faces) {
    const TriangleMesh proxy = simplify_surface(surface, options.proxy_faces);
    if (std::optional<TetrahedralMesh> mesh = fill(proxy, options)) {
      progress.end();
      result.mesh = std::move(*mesh);
      result.volume = total_volume(result.mesh);
      result.surface_faces = proxy.face_count();
      result.simplified = true;
      return result;
    }
    progress.warn("the simplified surface could not be filled with tetrahedra; trying the given one");
  }
  std::optional<TetrahedralMesh> mesh = fill(surface, options);
  progress.end();
  if (!mesh)
    throw InputError(
        "the surface cannot be filled with tetrahedra; expected a closed surface that does not cross itself; try "
        "sg-prepare");
  result.mesh = std::move(*mesh);
  result.volume = total_volume(result.mesh);
  result.surface_faces = surface.face_count();
  return result;
}

}  // namespace shellgrid
