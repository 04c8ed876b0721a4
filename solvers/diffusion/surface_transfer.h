// SPDX-License-Identifier: AGPL-3.0-or-later
// Carries fields between the triangle mesh of the surface and the quads of the polygrid's boundary.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/polygrid.h"

namespace shellgrid {

class SurfaceTransfer {
 public:
  // `places`: where to_vertices reads for each vertex, n×3, mm; none: at the vertices. Throws: InputError where the
  // polygrid has no boundary quads or the mesh no faces.
  SurfaceTransfer(const Polygrid& polygrid, const TriangleMesh& surface, const VertexMatrix* places = nullptr);

  // Mean of a vertex field over each outer point's hat function, by 3×3 samples a quad that read the mesh at
  // their nearest points; zero at other points. A constant stays that constant.
  std::vector<Rgb> to_points(const std::vector<Rgb>& vertex_values) const;

  // Frees what to_points needs, which then cannot be called again.
  void drop_samples() { samples_ = {}; }

  // A point field at the mesh's vertices: bilinear at the nearest point of the boundary quads.
  std::vector<Rgb> to_vertices(const std::vector<Rgb>& point_values) const;

  // Largest distance of a vertex to the boundary quads, and of a quad's sample to the mesh, mm.
  double largest_distance() const { return largest_distance_; }

 private:
  struct QuadSample {
    std::array<std::int32_t, 3> vertices;
    std::array<float, 3> weights;
    std::array<float, 4> areas;  // share of the area that belongs to each corner of the quad
  };
  struct VertexLocation {
    std::int32_t quad;
    std::array<float, 4> weights;
  };
  const Polygrid& polygrid_;
  std::vector<QuadSample> samples_;  // nine a quad
  std::vector<VertexLocation> locations_;
  double largest_distance_ = 0;
};

// ∫ f dA of a vertex field over the mesh, per channel.
Eigen::Array3d surface_integral(const TriangleMesh& mesh, const std::vector<Rgb>& values);

}  // namespace shellgrid
