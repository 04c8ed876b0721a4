// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/counted_polycube.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/held_warnings.h"

namespace shellgrid {
VoxelPolycube build_counted_polycube(const TriangleMesh& surface, PolycubeOptions options, Progress& progress) {
  const double wanted = options.blocks;
  constexpr double close_enough = 0.02;  // of the count
  constexpr double wrong_genus = 0.1;    // counts as much as so much of the count
  constexpr int most_steps = 8, sweep_steps = 24;
  constexpr double sweep_width = 0.25;  // of the logarithm of the nodes, to either side
  constexpr double swept_below = 2000;  // blocks: larger counts jump by less
  std::optional<VoxelPolycube> best;
  std::vector<std::string> warnings;
  double best_error = std::numeric_limits<double>::infinity(), best_place = 0;
  // The count at so many nodes, 0 where none can be filled.
  const auto count_at = [&](double log_nodes) -> double {
    options.nodes = std::exp(log_nodes);
    try {
      HeldWarnings held(progress);
      VoxelPolycube polycube = build_voxel_polycube(surface, options, held);
      const double count = static_cast<double>(polycube.blocks.size());
      const double error =
          std::abs(std::log(count / wanted)) + (polycube.genus == polycube.object_genus ? 0 : wrong_genus);
      if (error < best_error) {
        best_error = error;
        best_place = log_nodes;
        best = std::move(polycube);
        warnings = std::move(held.warnings);
      }
      return count;
    } catch (const InputError&) {
      return 0;
    }
  };
  // Nodes whose grid has too few and too many blocks.
  double low = -std::numeric_limits<double>::infinity(), high = std::numeric_limits<double>::infinity();
  double at = std::log(wanted * std::pow(options.grid, 3));
  for (int step = 0; step < most_steps && best_error > close_enough && high - low > 1e-3; ++step) {
    const double count = count_at(at);
    (count < wanted ? low : high) = at;
    at += count > 0 ? std::log(wanted / count) : std::log(2.0);
    if (at <= low || at >= high) at = 0.5 * (low + high);
  }
  if (best && wanted < swept_below) {
    const double middle = best_place;
    for (int step = 0; step < sweep_steps && best_error > close_enough; ++step)
      count_at(middle + sweep_width * (step / 2 + 1) / (sweep_steps / 2) * (step % 2 ? 1 : -1));
  }
  if (!best)
    throw InputError("no polycube of about " + std::to_string(std::lround(wanted)) +
                     " cubes was found: the object is too thin for so few, or too long for their size");
  for (const std::string& warning : warnings) progress.warn(warning);
  return *std::move(best);
}

long polygrid_nodes(const VoxelPolycube& polycube) {
  const auto before = [](const Vec3i& a, const Vec3i& b) {
    return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
  };
  long faces = 6 * static_cast<long>(polycube.blocks.size());
  for (const Vec3i& block : polycube.blocks)
    for (int axis = 0; axis < 3; ++axis)
      faces -=
          2 * std::binary_search(polycube.blocks.begin(), polycube.blocks.end(), block + Vec3i::Unit(axis), before);
  const long n = polycube.cells_per_block;
  return static_cast<long>(polycube.blocks.size()) * n * n * n + faces * n * n;
}

}  // namespace shellgrid
