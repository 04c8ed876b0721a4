// SPDX-License-Identifier: AGPL-3.0-or-later
// Sums over paths, with their variance: each value's square is that of a whole path's contribution.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "meshing/core/vec.h"

namespace shellgrid {

// What happened, counted.
enum class PathEvent : int {
  object_met,         // paths that met the object
  collisions,         // scatterings and absorptions
  leaps,              // many collisions at once, deep in homogeneous matter
  null_collisions,    // of delta tracking
  voxels,             // stepped through
  rays,               // shot at the surface
  rays_skipped,       // flights known to end before it
  boundary_meetings,  // mirrored or refracted
  roulette,           // paths ended because they had become faint
  limit_roulette,     // paths ended by the roulette of those that exceed the limit of events: unbiased
  lost,               // paths that slipped through the surface: their power is tallied as lost
  cut_off,            // paths ended against chance: a bias, tallied as lost
  count
};
constexpr int path_event_count = static_cast<int>(PathEvent::count);
const std::array<std::string, path_event_count>& path_event_names();

// A mean over paths and its standard error.
struct Estimate {
  double value = 0, standard_error = 0;
};

// Of a sum of values and of squares over `paths` paths, times `scale`.
Estimate estimate(double sum, double square, double paths, double scale = 1);

// All that has been gathered of the first `paths` paths: enough to go on.
struct PathState {
  std::uint64_t paths = 0;
  std::vector<double> sum, square;              // of scalars
  std::vector<double> field_sum, field_square;  // of fields of three channels
  std::array<std::uint64_t, path_event_count> events{};

  PathState() = default;
  PathState(std::size_t scalars, std::size_t field_size)
      : sum(scalars), square(scalars), field_sum(3 * field_size), field_square(3 * field_size) {}
  Estimate scalar(std::size_t slot, double scale = 1) const {
    return estimate(sum[slot], square[slot], static_cast<double>(paths), scale);
  }
  std::uint64_t count(PathEvent event) const { return events[static_cast<int>(event)]; }
};

// Gathers a chunk of paths, as lists of what each path adds where: sums over paths are then taken in the paths' order,
// the same bits whatever the chunks were.
class ChunkTally {
 public:
  explicit ChunkTally(std::size_t scalars = 0) : path_(scalars), listed_(scalars) {}

  void add(std::size_t slot, double value) {
    if (!listed_[slot]) {
      listed_[slot] = 1;
      touched_.push_back(static_cast<std::uint32_t>(slot));
    }
    path_[slot] += value;
  }
  void add_to_field(std::uint32_t place, const Eigen::Array3d& value) {
    // A path touches few places: a search through its own is cheap.
    for (std::size_t i = path_begin_; i < field_.size(); ++i)
      if (field_[i].place == place) {
        field_[i].value += value;
        return;
      }
    field_.push_back({place, value});
  }
  void note(PathEvent event, std::uint64_t times = 1) { events_[static_cast<int>(event)] += times; }
  void end_path();
  void clear();
  // Adds what the chunk gathered.
  void pour_into(PathState& state) const;

 private:
  struct Scalar {
    std::uint32_t slot;
    double value;
  };
  struct Deposit {
    std::uint32_t place;
    Eigen::Array3d value;
  };
  std::vector<double> path_;  // of the path that is being followed
  std::vector<char> listed_;
  std::vector<std::uint32_t> touched_;
  std::vector<Scalar> scalars_;
  std::vector<Deposit> field_;
  std::size_t path_begin_ = 0;
  std::uint64_t paths_ = 0;
  std::array<std::uint64_t, path_event_count> events_{};
};

}  // namespace shellgrid
