// SPDX-License-Identifier: AGPL-3.0-or-later
// The mesh that retile_surface works on; for meshing/surface/retile*.cpp alone.
#pragma once
#include <Eigen/Geometry>
#include <OpenMesh/Core/Mesh/TriMesh_ArrayKernelT.hh>
#include <utility>
#include <vector>

#include "meshing/surface/closest_point.h"
#include "meshing/surface/retile.h"

namespace shellgrid {

struct RetilingTraits : OpenMesh::DefaultTraits {
  typedef OpenMesh::Vec3d Point;
  VertexAttributes(OpenMesh::Attributes::Status);
  EdgeAttributes(OpenMesh::Attributes::Status);
  FaceAttributes(OpenMesh::Attributes::Status);
  HalfedgeAttributes(OpenMesh::Attributes::Status | OpenMesh::Attributes::PrevHalfedge);
};

// A mesh under change: half-edges from OpenMesh, status bits `feature` for sharp edges and their vertices, `locked`
// for their corners.
class Retiling {
 public:
  Retiling(const TriangleMesh& input, const RetileOptions& options);

  // Rounds of splitting, collapsing, flipping and relaxing; then the fit.
  TriangleMesh run(Progress& progress);
  void split_long(double longest);
  TriangleMesh extract() const;

 private:
  using Mesh = OpenMesh::TriMesh_ArrayKernelT<RetilingTraits>;
  using VertexHandle = OpenMesh::VertexHandle;
  using EdgeHandle = OpenMesh::EdgeHandle;
  using HalfedgeHandle = OpenMesh::HalfedgeHandle;
  using FaceHandle = OpenMesh::FaceHandle;

  static Vec3 to_vec(const Mesh::Point& p) { return {p[0], p[1], p[2]}; }
  static Mesh::Point to_point(const Vec3& p) { return {p.x(), p.y(), p.z()}; }
  static Vec3 cross_of(const Vec3& a, const Vec3& b, const Vec3& c) { return (b - a).cross(c - a); }

  Vec3 position(int v) const { return to_vec(points_[v]); }
  Vec3 position(VertexHandle v) const { return to_vec(points_[v.idx()]); }
  // Finds the points again after vertices have come or gone.
  void refresh() { points_ = mesh_.points(); }

  double squared_length(EdgeHandle e) const;
  // The same in units of the local target length over the global one.
  double scaled_squared_length(EdgeHandle e) const;
  double size_factor(const Vec3& p) const;
  double mean_edge() const;
  std::pair<double, double> edge_statistics() const;  // mean, and deviation over mean
  void load(const TriangleMesh& input);
  // Marks chains of sharp edges that are long enough to be meant.
  void find_features();
  // Keeps tips: vertices where the angles of long faces fall short of a full turn by 0.3 or more.
  void find_tips();
  void split(EdgeHandle e);
  void collapse_short(double shortest, double longest);
  // Whether the half-edge's tail may move onto its head.
  bool may_collapse(HalfedgeHandle h, double longest_squared);
  void collapse(HalfedgeHandle h);
  // Evens out valences towards six.
  void flip();
  // Faces (a, b, c), (b, a, d) become (c, a, d), (d, b, c): none may turn by 60 degrees or become a needle.
  static bool flip_keeps_shape(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);
  // Moves every vertex towards the middle of its neighbours within the tangent plane, then back onto the surface.
  // Only those marked, where there are marks.
  void relax(const std::vector<char>& active = {});
  Vec3 relaxed_position(VertexHandle v) const;
  bool turns_over(FaceHandle f, const std::vector<Vec3>& moved) const;

  // Where the input is farther from the mesh than a quarter of the spacing, or the mesh from the input: moves a vertex
  // there, or splits an edge, then turns edges and relaxes around.
  void fit();
  std::vector<Vec3> probes() const;
  struct Misfit {
    double squared_distance;
    Vec3 point;  // of the input
    int face;    // of the mesh, nearest to it
    Vec3 barycentric;
    int edge;  // whose middle hangs in the air, or −1
  };
  bool change(std::vector<Misfit> misfits, std::vector<char>& changed, std::vector<Vec3>& given_up);
  std::vector<Misfit> find_misfits(const std::vector<Vec3>& points, const std::vector<char>& near, bool everywhere,
                                   std::vector<std::int32_t>& vertex_of) const;
  std::vector<char> grown(const std::vector<char>& marks) const;
  void add_bridges(const std::vector<char>& near, std::vector<Misfit>& misfits) const;
  bool reach(const Misfit& misfit, std::vector<char>& changed);
  bool may_move(VertexHandle v, const Vec3& to) const;
  bool may_split(HalfedgeHandle h, const Vec3& at) const;
  bool has_room(const Vec3& a, const Vec3& b, const Vec3& c) const;
  bool may_flip_towards_surface(EdgeHandle e) const;
  void flip_towards_surface(const std::vector<char>& active);

  const TriangleMesh& input_;
  RetileOptions options_;
  Mesh mesh_;
  const Mesh::Point* points_ = nullptr;  // of mesh_
  struct Room {
    double shortest, longest, height;  // of edges that a change may make, spacings; of a triangle over its longest edge
  } room_{};
  ClosestPointQuery surface_, features_;
  struct Refined {
    VertexMatrix at;
    NearestVertexQuery query;
    double factor, core, reach;
  };
  std::vector<Refined> refined_;
  std::vector<Vec3> face_normals_;
};

}  // namespace shellgrid
