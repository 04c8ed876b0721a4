// SPDX-License-Identifier: AGPL-3.0-or-later
// Following many paths: in parallel, stopping when told to, resumable.
#pragma once
#include <cstdint>
#include <functional>
#include <optional>

#include "meshing/core/progress.h"
#include "solvers/transport/path_tally.h"

namespace shellgrid {

// When to stop: whichever comes first; 0 means no such limit.
struct PathLimits {
  double paths = 1e6;                 // in all, with those of a state that is gone on from
  double seconds = 0;                 // of this run
  double target_error = 0;            // relative standard error
  std::function<bool()> interrupted;  // asked now and then; may be empty
};

enum class PathEnd { paths, seconds, target_error, interrupted };
const char* path_end_name(PathEnd end);

// A kind of path and what is gathered of it.
struct PathKind {
  std::size_t scalars = 0, field_size = 0;
  // Follows one path. Called from several threads, with a tally of the thread's own.
  std::function<void(std::uint64_t path_index, ChunkTally& tally)> follow;
  // The relative standard error of what was asked for: of more than one path, of which some found anything.
  std::function<std::optional<double>(const PathState& state)> relative_error;
};

// Follows paths from `state.paths` on and adds them to the state. Paths are taken in chunks and added in their order:
// the state is a function of the number of its paths alone, at any thread count, however often it was interrupted. The
// error is judged after numbers of paths that grow by an eighth, so a target stops at the same path on every machine; a
// state that has met it before is left as it is.
// `checkpoint`, if any, gets the state about once a minute.
PathEnd follow_paths(const PathKind& kind, const PathLimits& limits, PathState& state,
                     const std::function<void(const PathState&)>& checkpoint = {}, Progress& progress = no_progress());

}  // namespace shellgrid
