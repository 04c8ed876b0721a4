// SPDX-License-Identifier: AGPL-3.0-or-later
// A surface whose faces do not share vertices across creases, so that light on one does not spill onto the other.
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

class CreaseSplit {
 public:
  // Faces that meet at an edge by 45° and more, and at edges of other than two faces, get vertices of their own there.
  explicit CreaseSplit(const TriangleMesh& surface);

  // The same faces. Its first vertices are the surface's; copies follow.
  const TriangleMesh& mesh() const { return mesh_; }
  // Where to read a field that is to be a vertex's: itself, of a vertex that has copies the centroid of its hat
  // function over its own faces.
  const VertexMatrix& places() const { return places_; }
  // Values of the surface's vertices: means over their copies, weighted by the hat functions' integrals.
  std::vector<Rgb> merge(const std::vector<Rgb>& values) const;

 private:
  std::size_t vertices_ = 0;  // the surface's
  TriangleMesh mesh_;
  VertexMatrix places_;
  std::vector<std::int32_t> original_;  // of each vertex of the mesh
  std::vector<double> area_;            // three times ∫ h dA of each, mm²
};

}  // namespace shellgrid
