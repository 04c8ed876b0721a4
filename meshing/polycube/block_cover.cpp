// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/block_cover.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/parallel.h"
#include "meshing/polycube/sample_pieces.h"

namespace shellgrid {
namespace {

// The piece whose raster sample lies nearest to a place a little off the surface, −1 where none is near.
int piece_at(const SamplePieces& pieces, const SampleRaster& raster, const TargetSurface::Sample& sample, double off) {
  const Vec3 place = (sample.point + off * raster.spacing * sample.face_normal - raster.lower) / raster.spacing;
  const Vec3i home = place.array().floor().cast<int>().matrix();
  int best = -1;
  double least = 1.5 * 1.5;
  for (int n = 0; n < 27; ++n) {
    const Vec3i s = home + Vec3i(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
    const double distance2 = (s.cast<double>() + Vec3::Constant(0.5) - place).squaredNorm();
    if (distance2 >= least) continue;
    const int piece = pieces.piece_of(s);
    if (piece >= 0) best = piece, least = distance2;
  }
  return best;
}

// How far the object reaches behind a sample, or what is around it before it, in blocks and at most 3.
double depth_behind(const SampleRaster& raster, const TargetSurface::Sample& sample, bool inside) {
  const Vec3 start = (sample.point - raster.lower) / raster.spacing;
  const Vec3 step = (inside ? -0.5 : 0.5) * sample.face_normal;
  constexpr int most = 6 * SamplePieces::samples_per_block;
  int n = 2;  // the nearest samples may be on the other side still
  while (n < most && raster.inside((start + n * step).array().floor().cast<int>().matrix()) == inside) ++n;
  return 0.5 * n / SamplePieces::samples_per_block;
}

}  // namespace

BlockCover::BlockCover(const SampleRaster& raster, const BlockMasks& masks, const Vec3i& shift, const Vec3i& counts,
                       const std::vector<TargetSurface::Sample>& samples, double largest_radius, Side side)
    : side_(side), covers_(samples.size(), 0) {
  const SamplePieces pieces(masks, shift, counts, side == Side::inside);
  const BlockGrid shape(counts);
  const double block_edge = SamplePieces::samples_per_block * raster.spacing;
  const Vec3 origin = raster.lower + raster.spacing * shift.cast<double>();
  const int reach = static_cast<int>(std::ceil(largest_radius));
  std::vector<std::vector<std::uint32_t>> found(samples.size());
  parallel_for(
      samples.size(),
      [&](std::size_t s) {
        const Vec3 place = (samples[s].point - origin) / block_edge;
        const double thickness =
            std::min(depth_behind(raster, samples[s], true), depth_behind(raster, samples[s], false));
        const double radius = std::clamp(thickness / 3, std::min(0.5, largest_radius), largest_radius);
        const auto is_near = [&](const Vec3i& block) {
          const Vec3 low = block.cast<double>();
          return (low - place).cwiseMax(place - low - Vec3::Ones()).cwiseMax(Vec3::Zero()).squaredNorm() <=
                 radius * radius;
        };
        std::vector<std::uint32_t>& list = found[s];
        const int start = piece_at(pieces, raster, samples[s], side == Side::inside ? -0.5 : 0.5);
        if (start < 0) {  // thinner than the raster's samples: any block near
          const Vec3i home = place.array().floor().cast<int>().matrix();
          for (int dk = -reach; dk <= reach; ++dk)
            for (int dj = -reach; dj <= reach; ++dj)
              for (int di = -reach; di <= reach; ++di) {
                const Vec3i block = home + Vec3i(di, dj, dk);
                if (shape.contains(block) && is_near(block))
                  list.push_back(static_cast<std::uint32_t>(shape.index(block)));
              }
          return;
        }
        std::vector<int> reached = {start};
        for (std::size_t n = 0; n < reached.size(); ++n) {
          const std::size_t block = pieces.block_of(reached[n]);
          if (pieces.main_piece(block) == reached[n]) list.push_back(static_cast<std::uint32_t>(block));
          for (int next : pieces.neighbours(reached[n]))
            if (is_near(shape.place(pieces.block_of(next))) &&
                std::find(reached.begin(), reached.end(), next) == reached.end())
              reached.push_back(next);
        }
      },
      64);
  first_of_sample_.assign(samples.size() + 1, 0);
  first_of_block_.assign(shape.filled.size() + 1, 0);
  for (std::size_t s = 0; s < samples.size(); ++s) {
    first_of_sample_[s + 1] = first_of_sample_[s] + static_cast<std::uint32_t>(found[s].size());
    for (std::uint32_t b : found[s]) ++first_of_block_[b + 1];
  }
  for (std::size_t b = 0; b < shape.filled.size(); ++b) first_of_block_[b + 1] += first_of_block_[b];
  blocks_of_samples_.resize(first_of_sample_.back());
  samples_of_blocks_.resize(first_of_sample_.back());
  std::vector<std::uint32_t> next(first_of_block_.begin(), first_of_block_.end() - 1);
  for (std::size_t s = 0; s < samples.size(); ++s) {
    std::copy(found[s].begin(), found[s].end(), blocks_of_samples_.begin() + first_of_sample_[s]);
    for (std::uint32_t b : found[s]) samples_of_blocks_[next[b]++] = static_cast<std::uint32_t>(s);
  }
}

void BlockCover::take(const BlockGrid& grid) {
  for (std::size_t s = 0; s < covers_.size(); ++s) {
    covers_[s] = 0;
    for (std::uint32_t n = first_of_sample_[s]; n < first_of_sample_[s + 1]; ++n)
      covers_[s] += (grid.filled[blocks_of_samples_[n]] != 0) == (side_ == Side::inside);
  }
}

std::size_t BlockCover::uncovered_count() const { return std::count(covers_.begin(), covers_.end(), 0); }

bool BlockCover::is_needed(std::size_t block) const {
  for (std::uint32_t n = first_of_block_[block]; n < first_of_block_[block + 1]; ++n)
    if (covers_[samples_of_blocks_[n]] == 1) return true;
  return false;
}

bool BlockCover::would_help(std::size_t block) const {
  for (std::uint32_t n = first_of_block_[block]; n < first_of_block_[block + 1]; ++n)
    if (covers_[samples_of_blocks_[n]] == 0) return true;
  return false;
}

void BlockCover::add(std::size_t block) {
  for (std::uint32_t n = first_of_block_[block]; n < first_of_block_[block + 1]; ++n) ++covers_[samples_of_blocks_[n]];
}

void BlockCover::remove(std::size_t block) {
  for (std::uint32_t n = first_of_block_[block]; n < first_of_block_[block + 1]; ++n) --covers_[samples_of_blocks_[n]];
}

std::vector<std::size_t> BlockCover::helpful_blocks() const {
  std::vector<std::size_t> blocks;
  for (std::size_t s = 0; s < covers_.size(); ++s)
    if (covers_[s] == 0)
      blocks.insert(blocks.end(), blocks_of_samples_.begin() + first_of_sample_[s],
                    blocks_of_samples_.begin() + first_of_sample_[s + 1]);
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
  return blocks;
}

}  // namespace shellgrid
