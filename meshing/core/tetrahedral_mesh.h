// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/vec.h"

namespace shellgrid {

// A tetrahedral mesh of an object's volume.
struct TetrahedralMesh {
  VertexMatrix points;   // n×3, mm
  TetMatrix tetrahedra;  // m×4, positive volumes
};

}  // namespace shellgrid
