// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "synthesis/solid_synthesis.h"

namespace shellgrid {

// The other two axes of a slice perpendicular to `axis`: of its columns and of its rows.
constexpr int column_axis(int axis) { return axis == 0 ? 1 : 0; }
constexpr int row_axis(int axis) { return axis == 2 ? 1 : 2; }

// Half as many texels in each direction: means of two by two, of two slices where there are several.
SliceStack halved(const SliceStack& stack, int channels);

// The square windows of a stack that lie within it, projected on their principal components, and the most similar
// others of each. Windows are counted by their places: column fastest, then row, then slice.
class SliceWindows {
 public:
  static constexpr int dimension = 16;

  // window: texels a side, odd; neighbours: how many similar windows to find for each.
  SliceWindows(const SliceStack& stack, int channels, int window, int neighbours);

  int count() const { return columns_ * rows_ * slices_; }
  int columns() const { return columns_; }
  int rows() const { return rows_; }
  int slices() const { return slices_; }
  int neighbours() const { return neighbours_; }
  int entry_count() const { return window_ * window_ * channels_; }
  // The texel in the middle of a window.
  std::int32_t centre(int window) const;
  // The window `du` columns, `dv` rows and `ds` slices on; −1 where there is none.
  int moved(int window, int du, int dv, int ds) const {
    const int u = window % columns_ + du, v = window / columns_ % rows_ + dv, s = window / columns_ / rows_ + ds;
    return u < 0 || v < 0 || s < 0 || u >= columns_ || v >= rows_ || s >= slices_ ? -1 : (s * rows_ + v) * columns_ + u;
  }
  // The window nearest to a place; places are clamped.
  int at(int column, int row, int slice) const;
  const std::int32_t* similar(int window) const {
    return similar_.data() + static_cast<std::size_t>(window) * neighbours_;
  }
  const float* features(int window) const { return features_.data() + static_cast<std::size_t>(window) * dimension; }
  // The features of a window with these entries: rows of texels of channels.
  void project(const float* entries, float* features) const;
  float distance(const float* features, int window) const;
  // The nearest of all windows.
  int nearest(const float* features, float& distance) const;

 private:
  void gather(int window, float* entries) const;
  void find_basis();
  void find_similar();

  const SliceStack& stack_;
  int channels_, window_, neighbours_;
  int columns_, rows_, slices_;
  std::vector<float> mean_;      // of the entries
  std::vector<float> basis_;     // entry_count × dimension
  std::vector<float> features_;  // count × dimension
  std::vector<std::int32_t> similar_;
};

}  // namespace shellgrid
