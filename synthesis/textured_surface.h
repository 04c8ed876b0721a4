// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// A surface that carries a sample: what sg-synthesize writes.
struct TexturedMesh {
  TriangleMesh mesh;
  VertexMatrix normals;           // n×3, unit
  VertexMatrix directions;        // n×3, unit, tangent: texture u; texture v is normal × direction
  std::vector<Vec2f> coordinate;  // n, texels
  // n each, or empty: which of several samples is carried (else the first), and how much longer a texel is than a voxel
  // along the surface (else 1).
  std::vector<std::int32_t> sample;
  std::vector<float> scale;

  // n_x, n_y of each sample as far as the surface tells; else empty.
  std::vector<Eigen::Vector2i> sample_sizes;

  int sample_of(int vertex) const { return sample.empty() ? 0 : sample[vertex]; }
  double scale_of(int vertex) const { return scale.empty() ? 1 : scale[vertex]; }
};

}  // namespace shellgrid
