// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/lattice_runs.h"

#include <algorithm>
#include <numeric>

namespace shellgrid {
namespace {

constexpr std::int32_t longest_run = 1 << 14;

std::vector<std::int32_t> ordered_points(const std::vector<Vec3i>& lattice, const std::vector<char>& takes_part) {
  const auto part = [](int x) { return static_cast<std::uint64_t>(x + (1 << 20)) & ((std::uint64_t{1} << 21) - 1); };
  std::vector<std::pair<std::uint64_t, std::int32_t>> order;
  order.reserve(lattice.size());
  for (std::size_t p = 0; p < lattice.size(); ++p)
    if (takes_part.empty() || takes_part[p])
      order.emplace_back(part(lattice[p].z()) << 42 | part(lattice[p].y()) << 21 | part(lattice[p].x()),
                         static_cast<std::int32_t>(p));
  std::sort(order.begin(), order.end());
  std::vector<std::int32_t> points(order.size());
  for (std::size_t k = 0; k < order.size(); ++k) points[k] = order[k].second;
  return points;
}

void lay_out_points(const std::vector<Vec3i>& lattice, const std::vector<char>& takes_part,
                    const std::vector<std::int32_t>& corners, RunLayout& layout) {
  std::vector<std::int32_t> next(lattice.size(), -1), last(lattice.size(), -1);
  for (std::size_t cell = 0; cell < corners.size() / 8; ++cell)
    for (int k = 0; k < 8; k += 2) {
      const std::int32_t a = corners[8 * cell + k], b = corners[8 * cell + k + 1];
      if (next[a] < 0 && last[b] < 0) next[a] = b, last[b] = a;
    }
  layout.unknown_of.assign(lattice.size(), -1);
  for (const std::int32_t first : ordered_points(lattice, takes_part)) {
    if (last[first] >= 0) continue;
    std::int32_t length = longest_run;
    for (std::int32_t p = first; p >= 0; p = next[p]) {
      const auto unknown = static_cast<std::int32_t>(layout.point_of.size());
      if (length == longest_run) {
        layout.runs.push_back({unknown, 0, lattice[p].x(), lattice[p].y(), lattice[p].z()});
        length = 0;
      }
      layout.unknown_of[p] = unknown;
      layout.point_of.push_back(p);
      layout.run_of.push_back(static_cast<std::int32_t>(layout.runs.size() - 1));
      layout.runs.back().length = ++length;
    }
  }
}

// The links of a run to following ones, from the owner of each of its places' slots.
void add_links(const RunLayout& layout, const std::vector<std::int32_t>& owner, std::int32_t run_index,
               std::vector<RunLink>& links) {
  const LatticeRun& run = layout.runs[run_index];
  for (int line = 0; line < 4; ++line) {
    const std::size_t first = links.size();
    for (int dx = 0; dx < 3; ++dx) {
      RunLink* link = nullptr;
      for (std::int32_t p = 0; p < run.length; ++p) {
        const std::int32_t other = owner[static_cast<std::size_t>(run.start + p) * coupling_slots + 1 + 3 * line + dx];
        if (other < 0) continue;
        const std::int32_t other_run = layout.run_of[other];
        if (!link || link->run != other_run) {
          const auto at = std::find_if(links.begin() + first, links.end(), [&](const RunLink& l) {
            return l.run == other_run && l.begin[dx] == l.end[dx];
          });
          if (at == links.end()) {
            links.push_back(
                {other_run, other - (dx - 1) - (run.start + p), {}, {}, static_cast<std::int8_t>(line), true});
            link = &links.back();
          } else {
            link = &*at;
          }
          link->begin[dx] = static_cast<std::int16_t>(p);
        }
        link->end[dx] = static_cast<std::int16_t>(p + 1);
      }
    }
  }
}

}  // namespace

RunLayout lay_out_runs(const std::vector<Vec3i>& lattice, const std::vector<char>& takes_part,
                       const std::vector<std::int32_t>& corners) {
  RunLayout layout;
  lay_out_points(lattice, takes_part, corners, layout);
  const std::size_t cells = corners.size() / 8;

  // Each slot belongs to the neighbour that asks first; others are extras.
  std::vector<std::int32_t> owner(layout.size() * coupling_slots, -1);
  layout.irregular.assign(cells, 0);
  for (std::size_t u = 0; u + 1 < layout.size(); ++u)
    if (layout.run_of[u] == layout.run_of[u + 1]) owner[u * coupling_slots] = static_cast<std::int32_t>(u + 1);
  for (std::size_t cell = 0; cell < cells; ++cell) {
    std::int32_t u[8];
    for (int k = 0; k < 8; ++k) u[k] = layout.unknown_of[corners[8 * cell + k]];
    for (int a = 0; a < 8; ++a)
      for (int b = a + 1; b < 8; ++b) {
        const int dx = (b & 1) - (a & 1), dy = (b >> 1 & 1) - (a >> 1 & 1), dz = (b >> 2) - (a >> 2);
        const int slot = slot_of_step(dx, dy, dz);
        std::int32_t& own = owner[static_cast<std::size_t>(u[a]) * coupling_slots + slot];
        if (own < 0 && slot > 0) own = u[b];
        if (own != u[b]) {
          layout.irregular[cell] = 1;
          layout.extras.push_back({u[a], u[b]});
        }
      }
  }
  std::sort(layout.extras.begin(), layout.extras.end(), [](const ExtraCoupling& a, const ExtraCoupling& b) {
    return a.first != b.first ? a.first < b.first : a.second < b.second;
  });
  layout.extras.erase(std::unique(layout.extras.begin(), layout.extras.end(),
                                  [](const ExtraCoupling& a, const ExtraCoupling& b) {
                                    return a.first == b.first && a.second == b.second;
                                  }),
                      layout.extras.end());

  const std::size_t runs = layout.runs.size();
  std::vector<RunLink> following;
  std::vector<std::int64_t> following_start(1, 0);
  std::vector<std::int32_t> preceding_count(runs + 1, 0);
  for (std::size_t r = 0; r < runs; ++r) {
    add_links(layout, owner, static_cast<std::int32_t>(r), following);
    for (std::size_t k = following_start.back(); k < following.size(); ++k) ++preceding_count[following[k].run];
    following_start.push_back(static_cast<std::int64_t>(following.size()));
  }
  layout.link_start.assign(runs + 1, 0);
  for (std::size_t r = 0; r < runs; ++r)
    layout.link_start[r + 1] = layout.link_start[r] + preceding_count[r] + following_start[r + 1] - following_start[r];
  layout.links.resize(layout.link_start.back());
  std::vector<std::int64_t> next(layout.link_start.begin(), layout.link_start.end() - 1);
  for (std::size_t r = 0; r < runs; ++r)
    for (std::int64_t k = following_start[r]; k < following_start[r + 1]; ++k) {
      const RunLink& link = following[k];
      RunLink back{static_cast<std::int32_t>(r), -link.shift, {}, {}, link.line, false};
      // Place p here is place p + dx there, in the other run's own count.
      const std::int32_t offset = layout.runs[r].start + link.shift - layout.runs[link.run].start;
      for (int dx = 0; dx < 3; ++dx)
        if (link.begin[dx] < link.end[dx]) {
          back.begin[dx] = static_cast<std::int16_t>(link.begin[dx] + offset + dx - 1);
          back.end[dx] = static_cast<std::int16_t>(link.end[dx] + offset + dx - 1);
        }
      layout.links[next[link.run]++] = back;
    }
  for (std::size_t r = 0; r < runs; ++r)
    std::copy(following.begin() + following_start[r], following.begin() + following_start[r + 1],
              layout.links.begin() + next[r]);

  layout.extra_start.assign(runs + 1, 0);
  for (const ExtraCoupling& e : layout.extras)
    ++layout.extra_start[layout.run_of[e.first] + 1], ++layout.extra_start[layout.run_of[e.second] + 1];
  std::partial_sum(layout.extra_start.begin(), layout.extra_start.end(), layout.extra_start.begin());
  layout.extra_entry.resize(layout.extra_start.back());
  std::vector<std::int32_t> place(layout.extra_start.begin(), layout.extra_start.end() - 1);
  for (std::size_t e = 0; e < layout.extras.size(); ++e) {
    layout.extra_entry[place[layout.run_of[layout.extras[e].first]]++] = static_cast<std::int32_t>(2 * e);
    layout.extra_entry[place[layout.run_of[layout.extras[e].second]]++] = static_cast<std::int32_t>(2 * e + 1);
  }
  return layout;
}

}  // namespace shellgrid
