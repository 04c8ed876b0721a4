// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <numeric>
#include <optional>

#include "meshing/core/parallel.h"
#include "synthesis/appearance_tree.h"
#include "synthesis/sample_layers.h"

namespace shellgrid {

// What surrounds each texel of all layers, a row of `pieces` times eight numbers, and a tree of the rows' first
// principal components: finds the texels whose surroundings may be most like others.
class WindowIndex {
 public:
  static constexpr int dimension = AppearanceTree::dimension;
  using Point = AppearanceTree::Point;

  // gather(layer, index, row): fills the row of the index-th texel of a layer.
  template <class Gather>
  WindowIndex(const SampleLayers& layers, int pieces, const Gather& gather) {
    RowMatrixf rows(layers.base_texel_count(), pieces * dimension);
    reduced_.resize(layers.texel_count(), dimension);
    for (int l = 0; l < layers.size(); ++l) {
      const SampleLayer& layer = layers[l];
      const int first = l < layers.sample_count ? layer.first : 0;
      parallel_for(layer.texel_count(), [&](std::size_t at) {
        gather(layer, static_cast<int>(at), rows.row(first + static_cast<Eigen::Index>(at)));
      });
      if (l + 1 == layers.sample_count) {
        const Eigen::Index stride = std::max<Eigen::Index>(1, rows.rows() / enough_rows) | 1;
        RowMatrixf some((rows.rows() + stride - 1) / stride, rows.cols());
        for (Eigen::Index i = 0; i < some.rows(); ++i) some.row(i) = rows.row(i * stride);
        components_ = find_principal_components(some, dimension);
        reduced_.topRows(rows.rows()) = project(rows, components_);
        basis_ = components_.basis;
        origin_ = -(components_.mean * components_.basis).transpose().array();
      } else if (l >= layers.sample_count) {
        reduced_.middleRows(layer.first, layer.texel_count()) = project(rows.topRows(layer.texel_count()), components_);
      }
    }
    std::vector<std::int32_t> all(layers.texel_count());
    std::iota(all.begin(), all.end(), 0);
    tree_.emplace(reduced_, std::move(all));
  }

  // A query is origin() plus contribution() of each of its pieces.
  const Point& origin() const { return origin_; }
  template <class Piece>
  void contribute(int piece, const Piece& value, Point& query) const {
    for (int d = 0; d < dimension; ++d)
      query += value[d] * basis_.row(static_cast<Eigen::Index>(piece) * dimension + d).transpose().array();
  }
  // No squared distance between rows is less than that of their components.
  const AppearanceTree& tree() const { return *tree_; }

 private:
  static constexpr Eigen::Index enough_rows = 2048;  // to find components from
  PrincipalComponents components_;
  RowMatrixf basis_, reduced_;
  Point origin_;
  std::optional<AppearanceTree> tree_;
};

}  // namespace shellgrid
