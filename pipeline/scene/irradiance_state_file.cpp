// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/irradiance_state_file.h"

#include <cstring>

#include "meshing/core/error.h"
#include "meshing/formats/number_archive.h"

namespace shellgrid {
namespace {

constexpr const char* kind = "irradiance paths";

// Two to a number; an odd one has a zero beside it.
std::vector<std::uint64_t> paired(const std::vector<float>& values) {
  std::vector<std::uint64_t> result((values.size() + 1) / 2);
  if (!values.empty()) std::memcpy(result.data(), values.data(), values.size() * sizeof(float));
  return result;
}

}  // namespace

void write_irradiance_state(const std::string& path, const std::string& fingerprint, const IrradianceSums& sums) {
  NumberArchive archive{kind, fingerprint, {}, {}};
  archive.counts = {{"batches", {sums.upper_batches, sums.back_batches, sums.next_judged}},
                    {"upper", paired(sums.upper)},
                    {"upper_square", paired(sums.upper_square)},
                    {"back", paired(sums.back)},
                    {"back_square", paired(sums.back_square)},
                    {"upper_half", paired(sums.upper_half)},
                    {"back_half", paired(sums.back_half)},
                    {"single", paired(sums.single)}};
  archive.numbers = {{"absorbed", sums.absorbed}, {"layer_square", sums.layer_square}};
  write_number_archive(path, archive);
}

IrradianceSums read_irradiance_state(const std::string& path, const std::string& fingerprint,
                                     const IrradianceSums& expected) {
  const NumberArchive archive = read_number_archive(path);
  if (archive.kind != kind || archive.fingerprint != fingerprint)
    throw InputError(path + ": is the state of a run with other inputs or options; remove it, or name another");
  const auto list = [&](const auto& lists, const char* name, std::size_t size) -> const auto& {
    const auto found = lists.find(name);
    if (found == lists.end() || found->second.size() != size)
      throw InputError(path + ": is damaged: its lists do not fit");
    return found->second;
  };
  IrradianceSums sums = expected;
  const auto take = [&](const char* name, std::vector<float>& values) {
    const std::vector<std::uint64_t>& pairs = list(archive.counts, name, (values.size() + 1) / 2);
    if (!values.empty()) std::memcpy(values.data(), pairs.data(), values.size() * sizeof(float));
  };
  const std::vector<std::uint64_t>& batches = list(archive.counts, "batches", 3);
  sums.upper_batches = batches[0];
  sums.back_batches = batches[1];
  sums.next_judged = batches[2];
  take("upper", sums.upper);
  take("upper_square", sums.upper_square);
  take("back", sums.back);
  take("back_square", sums.back_square);
  take("upper_half", sums.upper_half);
  take("back_half", sums.back_half);
  take("single", sums.single);
  sums.absorbed = list(archive.numbers, "absorbed", expected.absorbed.size());
  sums.layer_square = list(archive.numbers, "layer_square", expected.layer_square.size());
  return sums;
}

}  // namespace shellgrid
