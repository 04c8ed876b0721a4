// SPDX-License-Identifier: AGPL-3.0-or-later
// Coarser and coarser levels of a polygrid: of its graph, as the paper averages them, and of its cells' corners, where
// the element solver's unknowns stand. One rule says who is whose child: `coarsen_cells`.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "meshing/core/vec.h"
#include "meshing/polycube/laplacian_weights.h"
#include "meshing/polycube/polygrid_graph.h"

namespace shellgrid {

struct Polygrid;

// One coarser level of the graph. A node's children are up to eight finer nodes, its place their mean. Each side of it
// has one link: to the coarse node that most of its children's faces there lead to, else to a boundary node in the
// middle of its children's. Source: [Diffusion §5.3].
// Deviates: nodes in one 2×2×2 window of the lattice that are not connected within get parents of their own, so that
// sheets that nearly touch never share one; where a window splits so, links need not be mutual.
struct PolygridLevel {
  PolygridGraph graph;                                                      // weights for the level's spacing
  Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor> lattice;  // n×3: in steps of 2^level cells
  std::vector<std::int32_t> parent;           // of each interior node of the next finer level: a node of this one
  std::vector<std::int32_t> boundary_parent;  // of each finer boundary node; −1 where the side leads to a node here
};

// Levels until one has eight nodes or fewer or hardly fewer than the finer one.
// Throws: InputError where the graph does not match the cells.
std::vector<PolygridLevel> build_hierarchy(const Polygrid& polygrid, double condition_limit = ill_conditioned);

// Means over children: `parent` of each value, −1 for none; parents without children get zero.
template <class Value>
std::vector<Value> average_children(const std::vector<std::int32_t>& parent, std::size_t parents,
                                    const std::vector<Value>& values, const Value& zero) {
  std::vector<Value> sum(parents, zero);
  std::vector<int> count(parents, 0);
  for (std::size_t i = 0; i < parent.size(); ++i)
    if (parent[i] >= 0) sum[parent[i]] += values[i], ++count[parent[i]];
  for (std::size_t p = 0; p < parents; ++p)
    if (count[p] > 1) sum[p] /= static_cast<float>(count[p]);
  return sum;
}

// Cells of one level and which of them share a face.
struct CellLevel {
  struct Contact {
    std::int32_t lower, upper;  // `upper` lies towards + axis of `lower`
    std::int32_t axis;
    std::int32_t faces;  // of finest cells that they share
  };
  std::vector<Vec3i> lattice;
  std::vector<Contact> contacts;
};

// The core cells, in their order. Throws: InputError where cells that share a point do not fit on the lattice.
CellLevel finest_cells(const Polygrid& polygrid);

// Children share a parent where they lie in one 2×2×2 window of the lattice and are connected through faces within it.
// Parents ascend in (z, y, x). Returns each child's parent.
std::vector<std::int32_t> coarsen_cells(const CellLevel& fine, CellLevel& coarse);

// From the corners of one level's cells to those of the next coarser level's. Corners of cells that share a face are
// one point; so where parts are apart, their points are, too.
struct PointTransfer {
  std::vector<Vec3i> coarse_lattice;  // of the coarse points, ascending in (z, y, x)
  // Of each fine point the 1, 2, 4 or 8 coarse points whose equal mean it takes; none for outer points.
  std::vector<std::int64_t> start;
  std::vector<std::int32_t> parent;
  std::vector<std::int32_t> cell_parent;     // of each fine core cell
  std::vector<Vec3i> coarse_cell_lattice;    // of the coarse cells
  std::vector<std::int32_t> coarse_corners;  // 8 coarse points a coarse cell; bit k of the corner: towards + axis k
};

// As many as the polygrid's hierarchy has levels, or could have where it has none, finest first. Fine points of the
// first are the polygrid's. Throws: InputError where the hierarchy does not match the cells.
std::vector<PointTransfer> point_transfers(const Polygrid& polygrid);

// The nodes of level 1, 2, … as octahedra, `quality` their number of children, with colours from red (few) to green
// (eight and more). Throws: InputError where there is no such level.
AttributedMesh level_view(const Polygrid& polygrid, int level);

}  // namespace shellgrid
