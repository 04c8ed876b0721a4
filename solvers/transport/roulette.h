// SPDX-License-Identifier: AGPL-3.0-or-later
// How paths end that would never: by chance, without bias.
#pragma once
#include <cstdint>

#include "solvers/transport/path_random.h"

namespace shellgrid {

constexpr double faint = 0.1;                     // weight below which a path must win to go on
constexpr double revived = 0.5;                   // weight with which it does
constexpr std::uint64_t event_limit = 1'000'000;  // collisions and meetings of a path; beyond it the roulette turns
constexpr std::uint64_t limit_interval = 100'000;
constexpr double limit_weight = 2;                                         // what the survivors of one turn are worth
constexpr std::uint64_t most_events = event_limit + 200 * limit_interval;  // 2⁻²⁰⁰ of those beyond the limit get here

// Of a path that began with weight one. False: it ends.
inline bool survives_faintness(double& weight, PathRandom& random) {
  if (weight >= faint) return true;
  if (random.next() * revived >= weight) return false;
  weight = revived;
  return true;
}

enum class LimitOutcome { goes_on, ended, cut_off };

// To be asked when `events` reaches `next_limit`. Where the path goes on its weight is to be multiplied by
// limit_weight.
inline LimitOutcome meet_event_limit(std::uint64_t events, std::uint64_t& next_limit, PathRandom& random) {
  if (events >= most_events) return LimitOutcome::cut_off;
  next_limit = events + limit_interval;
  return random.next() * limit_weight < 1 ? LimitOutcome::goes_on : LimitOutcome::ended;
}

}  // namespace shellgrid
