// SPDX-License-Identifier: AGPL-3.0-or-later
// A solved fluence, at any point of the object.
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/surface/box_tree.h"

namespace shellgrid {

// Trilinear in each of a grid's hexahedra. Threads may share it.
class FluenceField {
 public:
  // points: n×3, mm. cells: eight corners each, VTK_HEXAHEDRON order. fluence: one a point, W mm⁻².
  // Throws: InputError where sizes do not match, a corner is no point, or a value is not finite.
  FluenceField(VertexMatrix points, std::vector<std::int64_t> cells, std::vector<Rgb> fluence);

  struct Value {
    Rgb fluence = Rgb::Zero();                                  // W mm⁻²
    Eigen::Matrix3d gradient = Eigen::Matrix3d::Zero();         // a row a channel, W mm⁻³
    double distance = std::numeric_limits<double>::infinity();  // of the point to the nearest hexahedron, mm
  };
  // In the hexahedron that holds the point, or else the nearest one's value at its nearest place.
  Value at(const Vec3& point) const;

 private:
  struct Place {
    Vec3 reference;
    double squared_distance;
  };
  Place nearest_place(std::size_t cell, const Vec3& point) const;

  VertexMatrix points_;
  std::vector<std::int64_t> cells_;
  std::vector<Rgb> fluence_;
  BoxTree tree_;
};

}  // namespace shellgrid
