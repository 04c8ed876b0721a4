// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/hexahedra_region.h"

#include <algorithm>
#include <map>

namespace shellgrid {

CellsOfPoints::CellsOfPoints(const std::vector<LatticeHexahedron>& cells, std::size_t point_count)
    : first_(point_count + 1, 0) {
  for (const LatticeHexahedron& cell : cells)
    for (std::int32_t p : cell) ++first_[p + 1];
  for (std::size_t p = 0; p < point_count; ++p) first_[p + 1] += first_[p];
  cells_.resize(first_.back());
  std::vector<std::int32_t> next(first_.begin(), first_.end() - 1);
  for (std::size_t c = 0; c < cells.size(); ++c)
    for (std::int32_t p : cells[c]) cells_[next[p]++] = static_cast<std::int32_t>(c);
}

std::vector<HexahedraRegion> regions_around(const std::vector<LatticeHexahedron>& cells, const CellsOfPoints& around,
                                            const std::vector<std::int32_t>& seeds, int rings) {
  // 1: chosen, 2: in a region already.
  std::vector<std::uint8_t> state(cells.size(), 0);
  std::vector<std::int32_t> chosen, front;
  for (std::int32_t c : seeds)
    if (!state[c]) state[c] = 1, front.push_back(c);
  chosen = front;
  for (int ring = 0; ring < rings; ++ring) {
    std::vector<std::int32_t> next;
    for (std::int32_t c : front)
      for (std::int32_t p : cells[c])
        for (const std::int32_t* n = around.begin(p); n != around.end(p); ++n)
          if (!state[*n]) state[*n] = 1, next.push_back(*n);
    chosen.insert(chosen.end(), next.begin(), next.end());
    front.swap(next);
  }
  std::sort(chosen.begin(), chosen.end());
  std::vector<HexahedraRegion> regions;
  for (std::int32_t start : chosen) {
    if (state[start] != 1) continue;
    HexahedraRegion region;
    region.cells = {start};
    state[start] = 2;
    for (std::size_t at = 0; at < region.cells.size(); ++at)
      for (std::int32_t p : cells[region.cells[at]])
        for (const std::int32_t* n = around.begin(p); n != around.end(p); ++n)
          if (state[*n] == 1) state[*n] = 2, region.cells.push_back(*n);
    std::sort(region.cells.begin(), region.cells.end());
    std::map<std::int32_t, std::int32_t> local;
    for (std::int32_t c : region.cells) {
      LatticeHexahedron cell = cells[c];
      for (std::int32_t& p : cell) {
        const auto [found, fresh] = local.try_emplace(p, static_cast<std::int32_t>(region.points.size()));
        if (fresh) region.points.push_back(p);
        p = found->second;
      }
      region.local.push_back(cell);
    }
    region.locked.assign(region.points.size(), 0);
    for (std::size_t p = 0; p < region.points.size(); ++p)
      for (const std::int32_t* n = around.begin(region.points[p]); n != around.end(region.points[p]); ++n)
        if (!std::binary_search(region.cells.begin(), region.cells.end(), *n)) region.locked[p] = 1;
    regions.push_back(std::move(region));
  }
  return regions;
}

}  // namespace shellgrid
