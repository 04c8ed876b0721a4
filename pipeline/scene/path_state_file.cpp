// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/path_state_file.h"

#include <algorithm>

#include "meshing/core/error.h"
#include "meshing/formats/number_archive.h"

namespace shellgrid {
namespace {

constexpr const char* kind = "light paths";

}  // namespace

void write_path_state(const std::string& path, const std::string& fingerprint, const PathState& state) {
  NumberArchive archive{kind, fingerprint, {}, {}};
  archive.numbers = {{"sum", state.sum},
                     {"square", state.square},
                     {"field_sum", state.field_sum},
                     {"field_square", state.field_square}};
  archive.counts = {{"paths", {state.paths}}, {"events", {state.events.begin(), state.events.end()}}};
  write_number_archive(path, archive);
}

PathState read_path_state(const std::string& path, const std::string& fingerprint, const PathState& expected) {
  const NumberArchive archive = read_number_archive(path);
  if (archive.kind != kind || archive.fingerprint != fingerprint)
    throw InputError(path + ": is the state of a run with other inputs or options; remove it, or name another");
  const auto list = [&](const auto& lists, const char* name, std::size_t size) {
    const auto found = lists.find(name);
    if (found == lists.end() || found->second.size() != size)
      throw InputError(path + ": is damaged: its lists do not fit");
    return found->second;
  };
  PathState state;
  state.sum = list(archive.numbers, "sum", expected.sum.size());
  state.square = list(archive.numbers, "square", expected.square.size());
  state.field_sum = list(archive.numbers, "field_sum", expected.field_sum.size());
  state.field_square = list(archive.numbers, "field_square", expected.field_square.size());
  state.paths = list(archive.counts, "paths", 1)[0];
  const auto events = list(archive.counts, "events", state.events.size());
  std::copy(events.begin(), events.end(), state.events.begin());
  return state;
}

}  // namespace shellgrid
