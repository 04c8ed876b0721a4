// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/slab_leaps.h"

#include <algorithm>
#include <array>
#include <map>

namespace shellgrid {
namespace {

constexpr double least_depth = 24;  // mean free paths to anything else: nearer no leap is worth it

std::array<float, 9> key(const SlabMatter& m) {
  return {m.extinction[0], m.extinction[1], m.extinction[2], m.albedo[0],    m.albedo[1],
          m.albedo[2],     m.anisotropy[0], m.anisotropy[1], m.anisotropy[2]};
}

float lane_greatest(const Float4& v) { return std::max({v[0], v[1], v[2]}); }

}  // namespace

bool SlabMatter::operator==(const SlabMatter& other) const { return key(*this) == key(other); }

SlabLeaps::SlabLeaps(const Vec3i& size, double voxel, const std::vector<SlabMatter>& matter,
                     const std::vector<char>& whole)
    : size_(size), voxel_(voxel) {
  const std::size_t n = matter.size(), layer = static_cast<std::size_t>(size.x()) * size.y();
  std::map<std::array<float, 9>, std::int32_t> kinds;
  std::vector<std::int32_t> kind(n, -1);
  double densest = 0;
  for (std::size_t k = 0; k < n; ++k) {
    if (!whole[k]) continue;
    kind[k] = kinds.try_emplace(key(matter[k]), static_cast<std::int32_t>(kinds.size())).first->second;
    densest = std::max(densest, static_cast<double>(lane_greatest(matter[k].extinction)));
  }
  if (densest * voxel * 0.5 * std::max({size.x(), size.y(), size.z()}) < least_depth) return;

  reaches_.resize(n);
  // Rings, one by one, about each voxel where all neighbours are of its matter and have as many; `deep` 1: above and
  // below too.
  const auto count_rings = [&](int deep, std::uint16_t Reach::*rings) {
    const auto neighbours_are = [&](std::size_t k, const auto& fits) {
      const auto at = static_cast<int>(k);
      const int x = at % size.x(), y = at / size.x() % size.y(), z = at / static_cast<int>(layer);
      if (z < deep || z + deep >= size.z()) return false;
      for (int dz = -deep; dz <= deep; ++dz)
        for (int dy = -1; dy <= 1; ++dy)
          for (int dx = -1; dx <= 1; ++dx) {
            const int i = (x + dx + size.x()) % size.x(), j = (y + dy + size.y()) % size.y();
            if (!fits((static_cast<std::size_t>(z + dz) * size.y() + j) * size.x() + i)) return false;
          }
      return true;
    };
    std::vector<std::size_t> front;
    for (std::size_t k = 0; k < n; ++k)
      if (kind[k] >= 0 && neighbours_are(k, [&](std::size_t o) { return kind[o] == kind[k]; })) front.push_back(k);
    // Beyond the tile's width no leap goes.
    const int most = std::max({size.x(), size.y(), size.z()});
    for (int ring = 1; !front.empty() && ring <= most; ++ring) {
      for (const std::size_t k : front) reaches_[k].*rings = static_cast<std::uint16_t>(ring);
      std::erase_if(front, [&](std::size_t k) {
        return !neighbours_are(k, [&](std::size_t o) { return reaches_[o].*rings >= ring; });
      });
    }
  };
  count_rings(1, &Reach::around);
  count_rings(0, &Reach::beside);
  for (std::size_t k = 0; k < n; ++k) {
    const auto alike = [&](std::size_t o) { return kind[o] == kind[k] && reaches_[o].beside >= reaches_[k].beside; };
    if (kind[k] < 0) continue;
    std::size_t at = k;
    for (; at >= layer && alike(at - layer); at -= layer) ++reaches_[k].above;
    for (at = k; at + layer < n && alike(at + layer); at += layer) ++reaches_[k].below;
  }

  std::vector<std::int32_t> leap_of(kinds.size(), -2);  // −2: not looked at
  kind_.assign(n, -1);
  for (std::size_t k = 0; k < n; ++k) {
    if (kind[k] < 0) continue;
    const Reach& reach = reaches_[k];
    const double widest =
        std::max<double>(reach.around + 0.5, std::min(reach.beside + 0.5, 0.5 * (reach.above + reach.below + 1)));
    const SlabMatter& m = matter[k];
    if (static_cast<double>(lane_greatest(m.extinction)) * voxel * widest < least_depth) continue;
    std::int32_t& leap = leap_of[kind[k]];
    if (leap == -2) {
      const ChannelLeaps made = channel_leaps(to_double(m.extinction), to_double(m.albedo), to_double(m.anisotropy));
      leap = made.possible ? static_cast<std::int32_t>(leaps_.size()) : -1;
      if (made.possible) leaps_.push_back(made);
    }
    kind_[k] = leap;
  }
  if (leaps_.empty()) kind_.clear();
}

double SlabLeaps::clearance(std::size_t voxel_index, const Vec3& point) const {
  const auto at = static_cast<int>(voxel_index);
  const Vec3i cell(at % size_.x(), at / size_.x() % size_.y(), at / (size_.x() * size_.y()));
  const Reach& reach = reaches_[voxel_index];
  double beside = voxel_;
  for (int axis = 0; axis < 2; ++axis) {
    const double in = point[axis] - cell[axis] * voxel_;
    beside = std::min({beside, in, voxel_ - in});
  }
  const double above = point.z() - cell.z() * voxel_, below = voxel_ - above;
  return std::max(
      {0.0, reach.around * voxel_ + std::min({beside, above, below}),
       std::min({reach.beside * voxel_ + beside, reach.above * voxel_ + above, reach.below * voxel_ + below})});
}

}  // namespace shellgrid
