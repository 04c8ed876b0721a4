// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/path_tally.h"

#include <algorithm>

namespace shellgrid {

const std::array<std::string, path_event_count>& path_event_names() {
  static const std::array<std::string, path_event_count> names = {
      "object_met",   "collisions",        "leaps",    "null_collisions", "voxels", "rays",
      "rays_skipped", "boundary_meetings", "roulette", "limit_roulette",  "lost",   "cut_off"};
  return names;
}

Estimate estimate(double sum, double square, double paths, double scale) {
  if (!(paths > 0)) return {};
  const double mean = sum / paths;
  // Of one path nothing is known about the error: it may be all.
  const double variance = paths > 1 ? std::max(0.0, square / paths - mean * mean) / (paths - 1) : mean * mean;
  return {scale * mean, std::abs(scale) * std::sqrt(variance)};
}

void ChunkTally::end_path() {
  for (const std::uint32_t slot : touched_) {
    scalars_.push_back({slot, path_[slot]});
    path_[slot] = 0;
    listed_[slot] = 0;
  }
  touched_.clear();
  path_begin_ = field_.size();
  ++paths_;
}

void ChunkTally::clear() {
  std::fill(path_.begin(), path_.end(), 0.0);
  std::fill(listed_.begin(), listed_.end(), 0);
  touched_.clear();
  scalars_.clear();
  field_.clear();
  path_begin_ = 0;
  paths_ = 0;
  events_.fill(0);
}

void ChunkTally::pour_into(PathState& state) const {
  state.paths += paths_;
  for (const Scalar& scalar : scalars_) {
    state.sum[scalar.slot] += scalar.value;
    state.square[scalar.slot] += scalar.value * scalar.value;
  }
  for (const Deposit& deposit : field_)
    for (int c = 0; c < 3; ++c) {
      state.field_sum[3 * deposit.place + c] += deposit.value[c];
      state.field_square[3 * deposit.place + c] += deposit.value[c] * deposit.value[c];
    }
  for (int k = 0; k < path_event_count; ++k) state.events[k] += events_[k];
}

}  // namespace shellgrid
