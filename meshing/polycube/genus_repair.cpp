// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/genus_repair.h"

#include <algorithm>
#include <cmath>

namespace shellgrid {
namespace {

using Blocks = std::vector<Vec3i>;

// Rows of one to `longest` blocks from the origin.
std::vector<Blocks> rows(int longest) {
  std::vector<Blocks> found;
  for (int axis = 0; axis < 3; ++axis)
    for (int length = 1; length <= longest; ++length) {
      Blocks row;
      for (int n = 0; n < length; ++n) row.push_back(n * Vec3i::Unit(axis));
      if (length > 1 || axis == 0) found.push_back(row);
    }
  return found;
}

// Around the origin: three blocks over an edge, five on a flat side. Filled they make a bridge, emptied a tunnel.
std::vector<Blocks> arches() {
  std::vector<Blocks> found;
  for (int up = 0; up < 6; ++up)
    for (int along = 0; along < 6; ++along) {
      if (up / 2 == along / 2) continue;
      const Vec3i u = (up & 1 ? 1 : -1) * Vec3i::Unit(up / 2), v = (along & 1 ? 1 : -1) * Vec3i::Unit(along / 2);
      if (up < along) found.push_back({u, u + v, v});
      if (along & 1) found.push_back({-v, u - v, u, u + v, v});
    }
  return found;
}

// Changes a polycube by flips of a few blocks that keep its boundary a manifold.
class TopologyChanges {
 public:
  TopologyChanges(BlockGrid& grid, const BlockParts& parts) : grid_(grid), fraction_(parts.fractions()) {}

  struct Change {
    Blocks blocks;
    double cost;
  };

  // Volume wrongly filled or emptied by flipping these blocks, all of the same state; infinite where they differ, may
  // not be filled, leave the boundary no manifold or change its Euler characteristic by another number.
  double cost_of(const Blocks& pattern, const Vec3i& at, int euler_change) {
    double cost = 0;
    for (const Vec3i& p : pattern) {
      const Vec3i block = at + p;
      if (!grid_.may_fill(block) || grid_.at(block) != grid_.at(at + pattern.front())) return infinite;
      const double outside = 1 - 2 * fraction_[grid_.index(block)];
      cost += grid_.at(block) ? -outside : outside;
    }
    corners_.clear();
    for (const Vec3i& p : pattern)
      for (int k = 0; k < 8; ++k) {
        const Vec3i corner = at + p + Vec3i(k & 1, k >> 1 & 1, k >> 2);
        if (std::find(corners_.begin(), corners_.end(), corner) == corners_.end()) corners_.push_back(corner);
      }
    const int before = euler_here();
    flip(pattern, at);
    const int after = euler_here();
    bool good = after - before == 4 * euler_change;
    for (std::size_t n = 0; n < corners_.size() && good; ++n) good = is_well_composed(window_at(grid_, corners_[n]));
    flip(pattern, at);
    return good ? cost : infinite;
  }

  // Flips the cheapest blocks that leave one component without cavities; null where there are none.
  const Change* apply_best(std::vector<Change>& changes) {
    std::stable_sort(changes.begin(), changes.end(), [](const Change& a, const Change& b) { return a.cost < b.cost; });
    for (std::size_t n = 0; n < changes.size() && n < 200; ++n) {
      flip(changes[n].blocks, Vec3i::Zero());
      BlockGrid whole = grid_;
      keep_largest_component(whole);
      fill_cavities(whole);
      if (whole.filled == grid_.filled) return &changes[n];
      flip(changes[n].blocks, Vec3i::Zero());
    }
    return nullptr;
  }

  static constexpr double infinite = 1e300;

 private:
  void flip(const Blocks& pattern, const Vec3i& at) {
    for (const Vec3i& p : pattern) grid_.filled[grid_.index(at + p)] ^= 1;
  }
  // Four times the part of the Euler characteristic that the corners at hand add.
  int euler_here() const {
    int sum = 0;
    for (const Vec3i& corner : corners_) {
      const int valence = boundary_valence(window_at(grid_, corner));
      sum += valence > 0 ? 4 - valence : 0;
    }
    return sum;
  }

  BlockGrid& grid_;
  const std::vector<float>& fraction_;
  Blocks corners_;
};

int genus_of(const BlockGrid& grid) { return static_cast<int>((2 - boundary_euler_characteristic(grid)) / 2); }

Blocks shifted(Blocks pattern, const Vec3i& at) {
  for (Vec3i& p : pattern) p += at;
  return pattern;
}

}  // namespace

int repair_genus(BlockGrid& grid, int genus, const std::vector<Vec3>& places, const BlockParts& parts) {
  TopologyChanges topology(grid, parts);
  using Change = TopologyChanges::Change;
  int now = genus_of(grid);
  std::vector<bool> used(places.size(), false);
  std::vector<Blocks> patterns = arches();
  const std::vector<Blocks> long_rows = rows(6), short_rows = rows(3);
  patterns.insert(patterns.end(), long_rows.begin(), long_rows.end());
  while (now < genus) {
    std::vector<Change> changes;
    constexpr int reach = 3;
    for (std::size_t n = 0; n < places.size(); ++n) {
      if (used[n]) continue;
      const Vec3i home = places[n].array().floor().cast<int>().matrix();
      for (int k = 0; k < (2 * reach + 1) * (2 * reach + 1) * (2 * reach + 1); ++k) {
        const Vec3i at =
            home +
            Vec3i(k % (2 * reach + 1), k / (2 * reach + 1) % (2 * reach + 1), k / (2 * reach + 1) / (2 * reach + 1)) -
            Vec3i::Constant(reach);
        for (const Blocks& pattern : patterns) {
          const double cost = topology.cost_of(pattern, at, -2);
          if (cost >= TopologyChanges::infinite) continue;
          Vec3 middle = Vec3::Constant(0.5);
          for (const Vec3i& p : pattern) middle += (at + p).cast<double>() / static_cast<double>(pattern.size());
          changes.push_back({shifted(pattern, at), cost + (middle - places[n]).norm()});
        }
      }
    }
    const Change* done = topology.apply_best(changes);
    if (!done) break;
    // A handle of the object is given to the grid once.
    std::size_t nearest = places.size();
    double least = TopologyChanges::infinite;
    for (std::size_t n = 0; n < places.size(); ++n) {
      const double distance = (places[n] - Vec3::Constant(0.5) - done->blocks.front().cast<double>()).norm();
      if (!used[n] && distance < least) nearest = n, least = distance;
    }
    if (nearest < places.size()) used[nearest] = true;
    now = genus_of(grid);
  }
  while (now > genus) {
    std::vector<Change> changes;
    for (std::size_t b = 0; b < grid.filled.size(); ++b) {
      const Vec3i at = grid.place(b);
      if (!grid.may_fill(at)) continue;
      for (const Blocks& pattern : short_rows) {
        const double cost = topology.cost_of(pattern, at, 2);
        if (cost < TopologyChanges::infinite) changes.push_back({shifted(pattern, at), cost});
      }
    }
    if (!topology.apply_best(changes)) break;
    now = genus_of(grid);
  }
  return now;
}

}  // namespace shellgrid
