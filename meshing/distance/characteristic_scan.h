// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/grid_frame.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// Finds the feature of a surface nearest to each grid point in reach: a face, an edge or a vertex. From a point whose
// nearest point lies within a face, one looks straight down on it: the point stands in the prism over the face.
// Likewise for the wedge over an edge and the cone over a vertex. Only the grid points in a feature's prism, wedge or
// cone are compared with it. Source: [Mauch2000].
// Around an edge that has not two faces that agree, and so no wedge, all grid points in reach are compared with it.
// Deviates: regions are widened by 10⁻⁷ grid intervals instead of being trusted to meet; grid points are taken in
// blocks, which do not depend on each other.
class CharacteristicScan {
 public:
  static constexpr int block_bits = 5;
  static constexpr int block_edge = 1 << block_bits;
  static constexpr int block_size = block_edge * block_edge * block_edge;

  // A block's grid points run from block_edge·coordinate on.
  struct Block {
    Vec3i coordinate;
    std::size_t first, count;  // of the pieces of regions that pass through it
  };

  // Keeps references to the mesh. `reach` in mm; blocks within [lower, upper), in blocks.
  CharacteristicScan(const TriangleMesh& mesh, const GridFrame& frame, double reach, const Vec3i& lower,
                     const Vec3i& upper);

  // The blocks that may hold grid points in reach.
  const std::vector<Block>& blocks() const { return blocks_; }

  // Where a feature nearer than the square root of squared_distance (grid intervals) looks at a grid point of the
  // block, puts its squared distance and its index; the point (x, y, z) of the block stands at (x·32 + y)·32 + z.
  // Returns how many pairs of a grid point and a feature were compared.
  std::int64_t scan(const Block& block, double* squared_distance, std::int32_t* feature) const;

  // The point of a feature nearest to p (both in mm) and a face that the feature belongs to.
  Vec3 nearest_point(std::int32_t feature, const Vec3& p) const;
  int face_of(std::int32_t feature) const;

 private:
  // A part of a feature's region, cut in slices across one axis: for every slice a rectangle that holds the section.
  // Its sides are the outermost of two straight lines each.
  struct Piece {
    std::int32_t feature;
    std::int32_t axis;
    std::int32_t first, last;                      // slices
    double slope[2][2], lower[2][2], upper[2][2];  // [line][u or v], position = lower + slope · slice
  };
  // The region spanned by one or two rays from each of the origins, from slice `first` to slice `last`.
  void add_piece(std::int32_t feature, int axis, const std::vector<Vec3>& origins, const std::vector<Vec3>& rays,
                 double first, double last, std::vector<Piece>& pieces) const;
  void add_face(int face, std::vector<Piece>& pieces) const;
  void add_edge(int half_edge, std::vector<Piece>& pieces) const;
  void add_vertex(int vertex, std::vector<Piece>& pieces) const;
  void distribute(const Vec3i& lower, const Vec3i& upper);

  struct Rectangle {
    int lower[2], upper[2];  // in u and v
  };
  static Rectangle rectangle(const Piece& piece, int slice);
  template <class Slice>
  static std::int64_t scan_piece(const Piece& piece, const Vec3i& corner, const Slice& slice_at,
                                 double* squared_distance, std::int32_t* feature);

  int from(int half_edge) const { return mesh_.faces(half_edge / 3, half_edge % 3); }
  int to(int half_edge) const { return mesh_.faces(half_edge / 3, (half_edge % 3 + 1) % 3); }
  int twin(int half_edge) const;  // −1 where the edge has not two faces that agree
  bool is_regular(int half_edge) const;
  Vec3 position(int vertex) const { return vertices_.row(vertex).transpose(); }
  Vec3 inner_normal(int half_edge) const;  // in its face's plane; 0 for a degenerate face

  const TriangleMesh& mesh_;
  double reach_;                        // grid intervals
  VertexMatrix vertices_;               // grid intervals
  std::vector<Vec3> normals_;           // of faces, unit; 0 for a degenerate one
  std::vector<std::int32_t> outgoing_;  // where the half-edges that leave a vertex begin in half_edges_
  std::vector<std::int32_t> half_edges_;
  bool closed_ = true;  // every edge is regular
  std::vector<Piece> pieces_;
  std::vector<std::int32_t> by_block_;  // indices of pieces
  std::vector<Block> blocks_;
};

}  // namespace shellgrid
