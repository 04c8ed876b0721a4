// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/block_masks.h"
#include "meshing/polycube/sample_raster.h"
#include "meshing/polycube/target_surface.h"

namespace shellgrid {

// Which samples of an object's surface are near a block of their own part: the filled blocks cover them from inside,
// the empty ones from outside. Blocks of another finger, or beyond a bay or a sheet, do not count: a block covers a
// sample within a radius when samples of the raster connect the two without crossing the surface, inside that radius.
// Where the part is thin, or narrow what is before it, the radius is a third of that, from half a block on.
class BlockCover {
 public:
  enum class Side { inside, outside };

  // Blocks of 4×4×4 raster samples, block (0, 0, 0) beginning at sample `shift`; `largest_radius` in blocks.
  BlockCover(const SampleRaster& raster, const BlockMasks& masks, const Vec3i& shift, const Vec3i& counts,
             const std::vector<TargetSurface::Sample>& samples, double largest_radius, Side side);

  // Takes the blocks of a grid of the same size as they are: filled ones cover from inside, empty ones from outside.
  void take(const BlockGrid& grid);
  // Of samples that no block covers.
  std::size_t uncovered_count() const;
  // Whether some sample has no other cover than this block, which covers now.
  bool is_needed(std::size_t block) const;
  // Whether some sample without cover would gain it.
  bool would_help(std::size_t block) const;
  void add(std::size_t block);
  void remove(std::size_t block);

  // Blocks that would cover some sample without cover, ascending.
  std::vector<std::size_t> helpful_blocks() const;

 private:
  Side side_;
  std::vector<std::uint32_t> first_of_sample_, blocks_of_samples_;  // per sample: blocks that may cover it
  std::vector<std::uint32_t> first_of_block_, samples_of_blocks_;
  std::vector<std::uint16_t> covers_;  // per sample
};

}  // namespace shellgrid
