// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// A surface that carries a sample: what sg-synthesize writes.
struct TexturedMesh {
  TriangleMesh mesh;
  VertexMatrix normals;           // n×3, unit
  VertexMatrix directions;        // n×3, unit, tangent: texture u; texture v is normal × direction
  std::vector<Vec2f> coordinate;  // n, texels
};

}  // namespace shellgrid
