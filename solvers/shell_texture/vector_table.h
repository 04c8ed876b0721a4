// SPDX-License-Identifier: AGPL-3.0-or-later
// Short vectors on a grid, several at a place, each as one word of a codebook, the words' numbers entropy coded in
// blocks of 8×8 places.
#pragma once
#include <array>
#include <string>
#include <vector>

#include "meshing/formats/number_archive.h"
#include "solvers/shell_texture/component_table.h"

namespace shellgrid {

class VectorTable {
 public:
  static constexpr int dimensions = 6;
  using Word = std::array<float, dimensions>;

  VectorTable() = default;
  // Dimension d of vector k of a place is the field's dimension k · 6 + d, of kind d. Source:
  // [BeersAgrawalaChaddha1996] (the use), [LindeBuzoGray1980] (the codebook, by splitting).
  static VectorTable compress(const VectorField& field, const CodecGoal& goal);

  void save(NumberArchive& archive, const std::string& name) const;
  // Throws: InputError where the archive's lists do not fit one another.
  static VectorTable restore(const NumberArchive& archive, const std::string& name, const std::string& path);

  const Vec3i& size() const { return size_; }
  int vectors() const { return vectors_; }
  int words() const { return static_cast<int>(words_.size()); }
  const Word& word(int number) const { return words_[number]; }
  std::size_t bytes() const;
  // Numbers of words: block_places × vectors, a place's side by side.
  void unpack(int block, std::vector<std::uint16_t>& numbers) const;

 private:
  int block_count() const { return (size_.x() + 7) / 8 * ((size_.y() + 7) / 8) * size_.z(); }
  template <class Visit>
  void visit_block(int block, const Visit& visit) const;

  Vec3i size_ = Vec3i::Zero();
  int vectors_ = 0;
  std::vector<char> filled_;
  std::vector<Word> words_;
  SymbolTable table_;
  std::vector<std::uint32_t> offset_;
  std::vector<std::uint8_t> stream_;
};

}  // namespace shellgrid
