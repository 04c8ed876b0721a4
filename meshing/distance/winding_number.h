// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// The generalised winding number of any triangles: 1 inside a closed outward surface, 0 outside, between the two where
// they leave gaps. Far triangles count together, by their area's dipole and its first moment, whose error is bounded;
// where that could matter, nearer ones are taken one by one. Thread-safe after construction.
// Source: [Barill2018], the solid angle of a triangle from [VanOosteromStrackee1983 eq. 8].
// Deviates: the truncation error is bounded by derivatives of 1/r instead of a ratio of distances alone.
class WindingNumber {
 public:
  // Keeps a reference to the mesh.
  explicit WindingNumber(const TriangleMesh& mesh);

  struct Estimate {
    double value;
    double error;  // bound on its distance from the winding number, but for rounding
  };
  // Groups of triangles count together where each adds at most the tolerance to the error; 0: none does.
  Estimate estimate(const Vec3& point, double tolerance) const;

  // Whether the winding number is at least one half; certain but for rounding.
  bool inside(const Vec3& point) const;

 private:
  struct Node {
    Vec3 centre;                // of area
    Vec3 area;                  // Σ area · normal
    Mat3 moment;                // Σ area · normal · (centroid − centre)ᵀ
    double radius = 0;          // about the centre
    double reach = 0;           // (3 ∫ |x − centre|² / 4π)^¼ over the triangles: see estimate
    std::int32_t first, count;  // of triangles
    std::int32_t right;         // the other child; the left one follows its parent; −1: a leaf
  };
  int build(int first, int count);

  const TriangleMesh& mesh_;
  std::vector<std::int32_t> order_;
  std::vector<Vec3> centroids_;
  std::vector<Node> nodes_;
};

}  // namespace shellgrid
