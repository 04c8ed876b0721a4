// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <limits>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/surface/box_tree.h"

namespace shellgrid {

// A point of a mesh's surface.
struct SurfacePoint {
  Vec3 point = Vec3::Zero();                                          // mm
  int face_index = -1;                                                // -1: none
  Vec3 barycentric = Vec3::Zero();                                    // of the face's three corners, ≥ 0, sum 1
  double squared_distance = std::numeric_limits<double>::infinity();  // to the query, mm²
};

// Finds the nearest point of a triangle mesh, exactly up to rounding. Eight triangles are tested at
// once. Of triangles equally near the one found first wins; the answer is a function of mesh and
// query alone. Thread-safe after construction.
class ClosestPointQuery {
 public:
  ClosestPointQuery() = default;
  // Whether the faces' normals are kept, for `nearest_facing`.
  enum class Facing { unknown, known };
  // Keeps no reference to the mesh. Faces may be degenerate.
  explicit ClosestPointQuery(const TriangleMesh& mesh, Facing facing = Facing::unknown);

  // The nearest point not farther than `max_distance` (mm); face_index -1 where there is none.
  SurfacePoint nearest(const Vec3& point, double max_distance = std::numeric_limits<double>::infinity()) const;
  // The point of least distance²·(2 − facing·face normal), `facing` being unit, among faces whose normal's product with
  // it is at least `least_cosine`; that cost not above `max_distance`².
  SurfacePoint nearest_facing(const Vec3& point, const Vec3& facing, double least_cosine = -2,
                              double max_distance = std::numeric_limits<double>::infinity()) const;
  // The faces not farther than `radius` (mm), in an order of the mesh's own.
  std::vector<int> faces_within(const Vec3& point, double radius) const;

 private:
  // Eight triangles: corner a, edges ab and ac, and what the projections divide by.
  struct alignas(64) Packet {
    double a[3][8], ab[3][8], ac[3][8];
    double inverse_ab2[8], inverse_ac2[8], inverse_bc2[8], inverse_determinant[8];
    std::int32_t face[8];
  };
  struct alignas(64) NormalPacket {
    double x[8], y[8], z[8];
  };

  // Squared distances of the eight triangles, and where on them: a + v ab + w ac.
  static Lanes squared_distances(const Packet& packet, const Vec3& point, Lanes& v, Lanes& w);
  // The point of least cost(leaf, squared distances), which is nowhere less than the distance.
  template <class Cost>
  SurfacePoint least(const Vec3& point, double best, const Cost& cost) const;

  BoxTree tree_;
  std::vector<Packet> packets_;        // one a leaf
  std::vector<NormalPacket> normals_;  // one a leaf, or none
};

// Finds the nearest of a set of points; of points equally near the lowest index. Thread-safe after construction.
class NearestVertexQuery {
 public:
  NearestVertexQuery() = default;
  explicit NearestVertexQuery(const VertexMatrix& points);

  // Index of the nearest point. `candidate` is an index that bounds the search, or -1.
  int nearest(const Vec3& point, int candidate = -1) const;
  // How many points lie within the radius; stops counting at `most`.
  int count_within(const Vec3& point, double radius, int most) const;

 private:
  struct alignas(64) Packet {
    double position[3][8];
    std::int32_t index[8];
  };

  BoxTree tree_;
  std::vector<Packet> packets_;
  VertexMatrix points_;
};

}  // namespace shellgrid
