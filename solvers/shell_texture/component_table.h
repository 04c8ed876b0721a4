// SPDX-License-Identifier: AGPL-3.0-or-later
// Vectors on a grid, by principal components: each component's plane in blocks of 8×8, each block a cosine transform in
// whole steps, entropy coded. A block is unpacked without any other.
#pragma once
#include <array>
#include <functional>
#include <string>
#include <vector>

#include "meshing/core/vec.h"
#include "meshing/formats/number_archive.h"
#include "solvers/shell_texture/symbol_coder.h"

namespace shellgrid {

// How small, or else how near: one of them above 0.
struct CodecGoal {
  double ratio = 0;  // single precision over what is left
  double psnr = 42;  // dB, of the peaks of each kind of value
};

// `value(place, dimension)` of the places of a grid that are filled; kinds of values have peaks of their own: `kind` of
// each dimension, 0 …
struct VectorField {
  Vec3i size = Vec3i::Zero();
  std::vector<char> filled;  // per place, at (z·n_y + y)·n_x + x
  std::vector<int> kind;     // per dimension
  std::function<float(std::size_t, int)> value;
};

// The 99.9th percentile of each kind's magnitudes, at least the smallest number above 0. From them PSNR is counted.
std::vector<float> find_peaks(const VectorField& field);

class ComponentTable {
 public:
  static constexpr int edge = 8, block_places = edge * edge;

  ComponentTable() = default;
  static ComponentTable compress(const VectorField& field, const CodecGoal& goal);

  void save(NumberArchive& archive, const std::string& name) const;
  // Throws: InputError where the archive's lists do not fit one another.
  static ComponentTable restore(const NumberArchive& archive, const std::string& name, const std::string& path);

  const Vec3i& size() const { return size_; }
  int dimensions() const { return dimensions_; }
  int components() const { return components_; }
  std::size_t bytes() const;  // of all that decoding takes
  bool is_filled(std::size_t place) const { return filled_[place] != 0; }

  int block_count() const { return blocks_x_ * blocks_y_ * size_.z(); }
  int block_of(std::size_t place) const;
  int place_in_block(std::size_t place) const;
  // block_places × components numbers, a place's side by side.
  void unpack(int block, std::vector<float>& coefficients) const;
  // Of a dimension: its mean, and its part of a component.
  float mean(int dimension) const { return mean_[dimension]; }
  float basis(int component, int dimension) const { return basis_[component * dimensions_ + dimension]; }

 private:
  struct Plan;
  void set_tables();
  void encode(Plan& plan, float step);

  Vec3i size_ = Vec3i::Zero();
  int dimensions_ = 0, components_ = 0, blocks_x_ = 0, blocks_y_ = 0;
  float step_ = 1;
  std::vector<char> filled_;
  std::vector<std::int16_t> basis_steps_;
  std::vector<float> basis_unit_;      // per component
  std::vector<float> peaks_;           // per dimension
  std::vector<float> mean_, basis_;    // in the values' own units
  std::vector<std::uint8_t> spread_;   // components × 64: how widely steps are spread, 0: all are zero
  std::vector<std::uint32_t> offset_;  // of each block's bytes, and the end
  std::vector<std::uint8_t> stream_;
  std::vector<SymbolTable> tables_;  // by spread
};

}  // namespace shellgrid
