// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/path_campaign.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr std::uint64_t chunk_paths = 256, round_chunks = 64, round_paths = chunk_paths * round_chunks;
constexpr long progress_steps = 1000;
constexpr double checkpoint_seconds = 60;
constexpr std::uint64_t dark_paths = 500000;  // of which none brings light: there is none to wait for

// The first number of rounds after `rounds` at which the error is judged: they grow by an eighth.
std::uint64_t next_judgement(std::uint64_t rounds) {
  std::uint64_t at = 1;
  while (at <= rounds) at = std::max(at + 1, at + at / 8);
  return at;
}

// Whether a run for this error would have ended at this state or before: it is judged where that run would have judged
// it, or is by so much below the target that it was so then.
bool has_met(const PathKind& kind, double target, const PathState& state) {
  const std::uint64_t rounds = state.paths / round_paths;
  if (rounds == 0) return false;
  const std::optional<double> error = kind.relative_error(state);
  if (!error) return false;
  std::uint64_t judged = 1;
  while (next_judgement(judged) <= rounds) judged = next_judgement(judged);
  if (judged * round_paths == state.paths) return *error <= target;
  constexpr double safety = 1.1;
  return safety * *error * std::sqrt(static_cast<double>(state.paths) / static_cast<double>(judged * round_paths)) <=
         target;
}

}  // namespace

const char* path_end_name(PathEnd end) {
  switch (end) {
    case PathEnd::paths:
      return "paths";
    case PathEnd::seconds:
      return "time";
    case PathEnd::target_error:
      return "target error";
    case PathEnd::interrupted:
      return "interrupted";
  }
  return "";
}

PathEnd follow_paths(const PathKind& kind, const PathLimits& limits, PathState& state,
                     const std::function<void(const PathState&)>& checkpoint, Progress& progress) {
  using Clock = std::chrono::steady_clock;
  if (!(limits.paths >= 0) || limits.paths > 9e18) throw InputError("paths: expected 0 … 9e18");
  if (limits.paths == 0 && limits.seconds == 0 && limits.target_error == 0 && !limits.interrupted)
    throw InputError("paths: no limit of paths, time or error");
  if (state.sum.size() != kind.scalars || state.field_sum.size() != 3 * kind.field_size)
    throw InternalError("the state of paths of another kind");
  const auto most = limits.paths > 0 ? static_cast<std::uint64_t>(std::llround(limits.paths)) : ~std::uint64_t{0};
  const Clock::time_point start = Clock::now();
  const auto elapsed = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };

  std::atomic<int> stop{0};  // 1: time, 2: interrupted
  const auto must_stop = [&] {
    if (stop.load(std::memory_order_relaxed) != 0) return true;
    if (limits.interrupted && limits.interrupted()) stop = 2;
    if (limits.seconds > 0 && elapsed() >= limits.seconds) stop = 1;
    return stop.load(std::memory_order_relaxed) != 0;
  };

  std::vector<ChunkTally> tallies(round_chunks, ChunkTally(kind.scalars));
  std::vector<char> done(round_chunks);
  progress.begin("paths", progress_steps);
  const std::uint64_t first = state.paths;
  long shown = 0;
  double last_checkpoint = 0;
  std::optional<double> error;
  const auto show = [&] {
    double share = 0;
    if (limits.paths > 0 && most > first)
      share = static_cast<double>(state.paths - first) / static_cast<double>(most - first);
    if (limits.seconds > 0) share = std::max(share, elapsed() / limits.seconds);
    if (limits.target_error > 0 && error > 0.0) share = std::max(share, std::pow(limits.target_error / *error, 2));
    const long now = std::min(progress_steps, static_cast<long>(share * progress_steps));
    if (now > shown) progress.advance(now - shown), shown = now;
  };

  if (limits.target_error > 0 && has_met(kind, limits.target_error, state)) {
    progress.end();
    return PathEnd::target_error;
  }
  PathEnd end = PathEnd::paths;
  while (state.paths < most) {
    if (must_stop()) {
      end = stop == 1 ? PathEnd::seconds : PathEnd::interrupted;
      break;
    }
    // Rounds begin at multiples of their size, chunks at multiples of theirs, wherever a run was interrupted.
    const std::uint64_t begin = state.paths, round_end = std::min(most, (begin / round_paths + 1) * round_paths);
    const std::uint64_t first_chunk = begin / chunk_paths;
    const auto chunks = static_cast<std::size_t>((round_end + chunk_paths - 1) / chunk_paths - first_chunk);
    parallel_for(
        chunks,
        [&](std::size_t k) {
          ChunkTally& tally = tallies[k];
          tally.clear();
          done[k] = 0;
          const std::uint64_t chunk = first_chunk + k, from = std::max(begin, chunk * chunk_paths),
                              to = std::min(round_end, (chunk + 1) * chunk_paths);
          for (std::uint64_t path = from; path < to; ++path) {
            if (path % 16 == 0 && must_stop()) return;
            kind.follow(path, tally);
            tally.end_path();
          }
          done[k] = 1;
        },
        1);
    for (std::size_t k = 0; k < chunks && done[k]; ++k) tallies[k].pour_into(state);
    const bool complete = state.paths == round_end;
    if (complete && limits.target_error > 0 && state.paths % round_paths == 0) {
      const std::uint64_t rounds = state.paths / round_paths;
      if (next_judgement(rounds - 1) == rounds) {
        error = kind.relative_error(state);
        const bool dark = !error && state.paths >= dark_paths;
        if (dark) progress.warn("no light has come back after " + std::to_string(state.paths) + " paths");
        if (dark || (error && *error <= limits.target_error)) {
          end = PathEnd::target_error;
          break;
        }
      }
    }
    if (checkpoint && elapsed() - last_checkpoint > checkpoint_seconds) {
      checkpoint(state);
      last_checkpoint = elapsed();
    }
    show();
  }
  progress.end();
  return end;
}

}  // namespace shellgrid
