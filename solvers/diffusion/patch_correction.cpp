// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/patch_correction.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"

namespace shellgrid {
namespace {

constexpr int relaxations = 8;       // sweeps that find slow points
constexpr float damping = 0.9f;      // of them; the smoother's spectrum ends below 2
constexpr std::size_t always = 200;  // slow points, whatever their share

float read(float value) { return value; }
float read(Half value) {
  Half padded[16] = {value};
  return ReadLanes<float>::read(padded)[0];
}
template <class Store>
Float4 read_channels(const Store* from, std::int64_t stride, int copies) {
  const float first = read(from[0]);
  if (copies == 1) return Float4{first, first, first, 0};
  return Float4{first, read(from[stride]), read(from[2 * stride]), 0};
}
template <class Store>
Float4 read_channels(const Store (&from)[3]) {
  return Float4{read(from[0]), read(from[1]), read(from[2]), 0};
}

// Calls visit(unknown, coupling) for all that an inner unknown couples with inside.
template <class Store, class Visit>
void visit_inner(const RunLevel& level, const LevelCouplings<Store>& couplings, std::int32_t u, const Visit& visit) {
  const RunLayout& layout = level.layout;
  const std::int32_t r = layout.run_of[u];
  const LatticeRun& run = layout.runs[r];
  const int copies = couplings.copies;
  const std::int32_t p = u - run.start;
  const Store* const values = couplings.values.data();
  const auto row_of = [&](const LatticeRun& of) {
    return values + static_cast<std::int64_t>(coupling_slots) * copies * of.start;
  };
  const auto at = [&](const LatticeRun& of, std::int32_t place, int slot) {
    return couplings.factor *
           read_channels(row_of(of) + static_cast<std::int64_t>(slot) * copies * of.length + place, of.length, copies);
  };
  if (p + 1 < run.length) visit(u + 1, at(run, p, 0));
  if (p > 0) visit(u - 1, at(run, p - 1, 0));
  for (std::int64_t k = layout.link_start[r]; k < layout.link_start[r + 1]; ++k) {
    const RunLink& link = layout.links[k];
    const LatticeRun& other = layout.runs[link.run];
    for (int dx = 0; dx < 3; ++dx) {
      if (p < link.begin[dx] || p >= link.end[dx]) continue;
      const std::int32_t there = u + link.shift + (link.follows ? dx - 1 : 1 - dx);
      const int slot = 1 + 3 * link.line + dx;
      visit(there, link.follows ? at(run, p, slot) : at(other, there - other.start, slot));
    }
  }
  for (std::int32_t k = layout.extra_start[r]; k < layout.extra_start[r + 1]; ++k) {
    const std::int32_t entry = layout.extra_entry[k];
    const ExtraCoupling& e = layout.extras[entry / 2];
    if ((entry % 2 ? e.second : e.first) == u) visit(entry % 2 ? e.first : e.second, level.extra[entry / 2]);
  }
}

std::int32_t outer_above(const RunLevel& level, std::int32_t u) {
  const std::vector<std::int32_t>& twin = level.surface.twin;
  const std::int32_t r = level.layout.run_of[u];
  const auto end = twin.begin() + level.surface.first_of_run[r + 1];
  const auto found = std::lower_bound(twin.begin() + level.surface.first_of_run[r], end, u);
  return found != end && *found == u ? static_cast<std::int32_t>(found - twin.begin()) : -1;
}

// All that an unknown couples with; outer unknowns count after the inner ones.
template <class Store, class Visit>
void visit_row(const RunLevel& level, const LevelCouplings<Store>& couplings, std::int32_t unknown,
               const Visit& visit) {
  const auto inner = static_cast<std::int32_t>(level.inner_size());
  const SurfaceLayout& surface = level.surface;
  const bool is_outer = unknown >= inner;
  const std::int32_t s = is_outer ? unknown - inner : outer_above(level, unknown);
  if (!is_outer) visit_inner(level, couplings, unknown, visit);
  if (s < 0) return;
  visit(is_outer ? surface.twin[s] : inner + s, level.link[s]);
  for (std::int32_t k = surface.start[s]; k < surface.start[s + 1]; ++k) {
    const SurfaceCoupling<Store>& pair = couplings.surface[k];
    const std::int32_t t = surface.neighbour[k];
    if (is_outer) {
      visit(inner + t, couplings.surface_factor * read_channels(pair.outer_outer));
      visit(surface.twin[t], couplings.surface_factor * read_channels(pair.outer_twin));
    } else {
      visit(inner + t, couplings.surface_factor * read_channels(pair.twin_outer));
    }
  }
}

template <class Visit>
void visit_row(const RunLevel& level, std::int32_t unknown, const Visit& visit) {
  if (level.half)
    visit_row(level, level.half, unknown, visit);
  else
    visit_row(level, level.single, unknown, visit);
}

float greatest(Float4 a) { return std::max({std::abs(a[0]), std::abs(a[1]), std::abs(a[2])}); }

// Holds the coarse level's points at zero.
void clear_coarse_points(RunLevel& level) {
  for (const LatticeRun& run : level.layout.runs) {
    if ((run.y | run.z) & 1) continue;
    for (std::int32_t p = run.x & 1; p < run.length; p += 2)
      for (int c = 0; c < 3; ++c) level.x.inner[c][run.start + p] = 0;
  }
  for (std::size_t s = 0; s < level.surface.size(); ++s) {
    const std::int32_t u = level.surface.twin[s];
    const LatticeRun& run = level.layout.runs[level.layout.run_of[u]];
    if (!((run.y | run.z | (run.x + u - run.start)) & 1)) level.x.outer[s] = Float4{};
  }
}

// Inner unknowns that are slow themselves, or the outer point above them.
std::vector<std::int32_t> slow_points(RunLevel& level, const PatchLimits& limits) {
  const std::size_t inner = level.inner_size(), outer = level.surface.size();
  const auto start = [](std::size_t i, int channel) {
    return static_cast<float>(2 * to_unit(hash64(static_cast<std::uint64_t>(channel), i)) - 1);
  };
  for (int c = 0; c < 3; ++c) {
    float* x = level.x.inner[c];
    parallel_for(
        inner, [&](std::size_t u) { x[u] = start(u, c); }, 4096);
  }
  for (const std::int32_t u : level.frozen)
    for (int c = 0; c < 3; ++c) level.x.inner[c][u] = 0;
  for (std::size_t s = 0; s < outer; ++s) {
    level.right_side.outer[s] = Float4{};
    for (int c = 0; c < 3; ++c) level.x.outer[s][c] = start(inner + s, c);
  }
  for (int sweep = 0; sweep < relaxations; ++sweep) {
    clear_coarse_points(level);
    smooth_level(level, {0, damping}, false);
  }
  clear_coarse_points(level);
  std::vector<std::pair<float, std::int32_t>> found;
  std::int32_t s = 0;
  for (std::size_t u = 0; u < inner; ++u) {
    float size = 0;
    for (int c = 0; c < 3; ++c) size = std::max(size, std::abs(level.x.inner[c][u]));
    if (static_cast<std::size_t>(s) < outer && level.surface.twin[s] == static_cast<std::int32_t>(u))
      size = std::max(size, greatest(level.x.outer[s++]));
    if (size > limits.slow) found.emplace_back(-size, static_cast<std::int32_t>(u));
  }
  const std::size_t most = std::max(always, static_cast<std::size_t>(limits.share * static_cast<double>(inner)));
  if (found.size() > most) {
    std::sort(found.begin(), found.end());
    found.resize(most);
  }
  std::vector<std::int32_t> points;
  points.reserve(found.size());
  for (const auto& [size, u] : found) points.push_back(u);
  std::sort(points.begin(), points.end());
  return points;
}

// Neighbouring slow points together, not too many at once.
std::vector<std::vector<std::int32_t>> gather_seeds(const RunLevel& level, const std::vector<std::int32_t>& slow_ones,
                                                    std::size_t most_seeds) {
  const auto inner = static_cast<std::int32_t>(level.inner_size());
  std::vector<std::vector<std::int32_t>> groups;
  std::vector<char> taken(slow_ones.size(), 0);
  for (std::size_t k = 0; k < slow_ones.size(); ++k) {
    if (taken[k]) continue;
    taken[k] = 1;
    std::vector<std::int32_t> group = {slow_ones[k]};
    for (std::size_t next = 0; next < group.size(); ++next)
      visit_row(level, group[next], [&](std::int32_t other, Float4) {
        if (other >= inner || group.size() >= most_seeds) return;
        const auto at = std::lower_bound(slow_ones.begin(), slow_ones.end(), other);
        if (at == slow_ones.end() || *at != other || taken[at - slow_ones.begin()]) return;
        taken[at - slow_ones.begin()] = 1;
        group.push_back(other);
      });
    groups.push_back(std::move(group));
  }
  return groups;
}

}  // namespace

void PatchCorrection::prepare(RunLevel& level, const PatchLimits& limits) {
  *this = {};
  if (level.transfer.empty()) return;
  const std::vector<std::vector<std::int32_t>> groups = gather_seeds(level, slow_points(level, limits), limits.seeds);
  if (groups.empty()) return;
  const auto inner = static_cast<std::int32_t>(level.inner_size());
  std::vector<char> frozen;
  if (!level.frozen.empty()) {
    frozen.assign(level.inner_size(), 0);
    for (const std::int32_t u : level.frozen) frozen[u] = 1;
  }

  std::vector<std::int32_t> place(level.size(), -1);        // in the reach of the patch at hand
  std::vector<std::uint64_t> writes, reads;                 // colours that do so at an unknown
  std::vector<std::int32_t> colour_slot(level.size(), -1);  // of an unknown in these two
  std::vector<std::vector<Patch>> colours;
  std::size_t factor_size = 0;
  for (const std::vector<std::int32_t>& seeds : groups) {
    std::vector<std::int32_t> own;
    const auto take = [&](std::int32_t u) {
      if (u >= inner || (!frozen.empty() && frozen[u]) || place[u] >= 0) return;
      place[u] = 0;
      own.push_back(u);
      const std::int32_t s = outer_above(level, u);
      if (s < 0) return;
      place[inner + s] = 0;
      own.push_back(inner + s);
    };
    for (const std::int32_t seed : seeds) {
      take(seed);
      visit_row(level, seed, [&](std::int32_t other, Float4) { take(other); });
    }
    // Outer points beside their twins keep the factors narrow.
    std::sort(own.begin(), own.end(), [&](std::int32_t a, std::int32_t b) {
      const std::int32_t at = a < inner ? a : level.surface.twin[a - inner];
      const std::int32_t bt = b < inner ? b : level.surface.twin[b - inner];
      return at != bt ? at < bt : a < b;
    });
    Patch patch;
    patch.reach = reach_.size();
    patch.row = row_.size();
    patch.points = static_cast<std::int32_t>(own.size());
    for (std::size_t k = 0; k < own.size(); ++k) place[own[k]] = static_cast<std::int32_t>(k);
    reach_.insert(reach_.end(), own.begin(), own.end());
    for (const std::int32_t u : own) {
      Row row;
      row.begin = static_cast<std::int64_t>(entries_.size());
      visit_row(level, u, [&](std::int32_t other, Float4 coupling) {
        if (greatest(coupling) == 0) return;
        if (place[other] < 0) {
          place[other] = static_cast<std::int32_t>(reach_.size() - patch.reach);
          reach_.push_back(other);
        }
        entries_.push_back({coupling, place[other]});
      });
      row.end = static_cast<std::int64_t>(entries_.size());
      const auto i = static_cast<std::int32_t>(row_.size() - patch.row);
      row.first = i;
      for (std::int64_t e = row.begin; e < row.end; ++e) row.first = std::min(row.first, entries_[e].other);
      row.reaction = u < inner
                         ? Float4{level.reaction.inner[0][u], level.reaction.inner[1][u], level.reaction.inner[2][u], 0}
                         : level.reaction.outer[u - inner];
      row_.push_back(row);
    }
    patch.reached = static_cast<std::int32_t>(reach_.size() - patch.reach);
    patch.factor = factor_size;
    for (std::size_t k = patch.row; k < row_.size(); ++k)
      factor_size += k - patch.row - static_cast<std::size_t>(row_[k].first);
    patch_points_ += own.size();

    // The first colour whose patches neither read what this one writes nor write what it reads.
    std::uint64_t used = 0;
    for (std::int32_t k = 0; k < patch.reached; ++k) {
      const std::int32_t unknown = reach_[patch.reach + k];
      place[unknown] = -1;
      std::int32_t& slot = colour_slot[unknown];
      if (slot < 0) {
        slot = static_cast<std::int32_t>(writes.size());
        writes.push_back(0);
        reads.push_back(0);
      }
      used |= writes[slot] | (k < patch.points ? reads[slot] : 0);
    }
    const int colour = std::countr_one(used);
    if (colour == 64) continue;  // 64 patches overlap here already
    for (std::int32_t k = 0; k < patch.reached; ++k) {
      const std::int32_t slot = colour_slot[reach_[patch.reach + k]];
      reads[slot] |= std::uint64_t{1} << colour;
      if (k < patch.points) writes[slot] |= std::uint64_t{1} << colour;
    }
    if (colours.size() <= static_cast<std::size_t>(colour)) colours.resize(colour + 1);
    colours[colour].push_back(patch);
  }
  colour_start_ = {0};
  for (const std::vector<Patch>& of_colour : colours) {
    patches_.insert(patches_.end(), of_colour.begin(), of_colour.end());
    colour_start_.push_back(patches_.size());
  }
  factors_.resize(factor_size);
  parallel_for(
      patches_.size(), [&](std::size_t k) { factor(patches_[k]); }, 4);
}

// L D Lᵀ within each row's envelope, in double precision.
void PatchCorrection::factor(const Patch& patch) {
  const std::int32_t n = patch.points;
  std::vector<std::int32_t> first(n);
  std::vector<std::size_t> start(n + 1, 0);
  for (std::int32_t i = 0; i < n; ++i) {
    first[i] = row_[patch.row + i].first;
    start[i + 1] = start[i] + static_cast<std::size_t>(i - first[i]);
  }
  std::vector<Double4> lower(start[n], Double4{}), pivot(n);
  for (std::int32_t i = 0; i < n; ++i) {
    Row& row = row_[patch.row + i];
    Double4* const own = lower.data() + start[i] - first[i];  // by column
    Double4 diagonal = to_double(row.reaction);
    for (std::int64_t e = row.begin; e < row.end; ++e) {
      diagonal += to_double(entries_[e].coupling);
      if (entries_[e].other < i) own[entries_[e].other] -= to_double(entries_[e].coupling);
    }
    const Double4 before = diagonal;
    for (std::int32_t j = first[i]; j < i; ++j) {
      const Double4* const other = lower.data() + start[j] - first[j];
      Double4 sum = own[j];
      for (std::int32_t k = std::max(first[i], first[j]); k < j; ++k) sum -= own[k] * other[k];
      own[j] = sum;  // L_ij D_j, divided below
    }
    for (std::int32_t j = first[i]; j < i; ++j) {
      const Double4 scaled = own[j] * pivot[j];
      diagonal -= own[j] * scaled;
      own[j] = scaled;
    }
    // Rounded couplings may leave a pivot that is not sound: that point then keeps its value.
    for (int c = 0; c < 4; ++c) {
      const bool sound = c < 3 && diagonal[c] > 1e-7 * before[c] && before[c] > 0;
      pivot[i][c] = sound ? 1 / diagonal[c] : 0;
    }
    row.inverse_pivot = to_float(pivot[i]);
  }
  for (std::size_t k = 0; k < lower.size(); ++k) factors_[patch.factor + k] = to_float(lower[k]);
}

void PatchCorrection::solve(const Patch& patch, RunLevel& level, bool inner_light) const {
  const auto inner = static_cast<std::int32_t>(level.inner_size());
  const std::int32_t* const reach = reach_.data() + patch.reach;
  thread_local std::vector<Float4> values, correction;
  values.resize(patch.reached);
  correction.resize(patch.points);
  for (std::int32_t k = 0; k < patch.reached; ++k) {
    const std::int32_t u = reach[k];
    values[k] =
        u < inner ? Float4{level.x.inner[0][u], level.x.inner[1][u], level.x.inner[2][u], 0} : level.x.outer[u - inner];
  }
  const Row* const rows = row_.data() + patch.row;
  const Float4* lower = factors_.data() + patch.factor;
  for (std::int32_t i = 0; i < patch.points; ++i) {
    const std::int32_t u = reach[i];
    Float4 residual = {};
    if (u >= inner)
      residual = level.right_side.outer[u - inner];
    else if (inner_light)
      residual = Float4{level.right_side.inner[0][u], level.right_side.inner[1][u], level.right_side.inner[2][u], 0};
    const Row& row = rows[i];
    residual -= row.reaction * values[i];
    for (std::int64_t e = row.begin; e < row.end; ++e)
      residual -= entries_[e].coupling * (values[i] - values[entries_[e].other]);
    for (std::int32_t j = row.first; j < i; ++j) residual -= *lower++ * correction[j];
    correction[i] = residual;
  }
  for (std::int32_t i = 0; i < patch.points; ++i) correction[i] *= rows[i].inverse_pivot;
  for (std::int32_t i = patch.points; i-- > 0;) {
    const Row& row = rows[i];
    const std::int32_t width = i - row.first;
    lower -= width;
    for (std::int32_t j = 0; j < width; ++j) correction[row.first + j] -= lower[j] * correction[i];
  }
  for (std::int32_t i = 0; i < patch.points; ++i) {
    const std::int32_t u = reach[i];
    if (u < inner)
      for (int c = 0; c < 3; ++c) level.x.inner[c][u] += correction[i][c];
    else
      level.x.outer[u - inner] += correction[i];
  }
}

void PatchCorrection::apply(RunLevel& level, bool inner_light, bool backward) const {
  const std::size_t colours = colour_start_.empty() ? 0 : colour_start_.size() - 1;
  for (std::size_t k = 0; k < colours; ++k) {
    const std::size_t colour = backward ? colours - 1 - k : k;
    const std::size_t begin = colour_start_[colour];
    parallel_for(
        colour_start_[colour + 1] - begin, [&](std::size_t i) { solve(patches_[begin + i], level, inner_light); }, 8);
  }
}

std::size_t PatchCorrection::bytes() const {
  return reach_.size() * sizeof(std::int32_t) + row_.size() * sizeof(Row) + entries_.size() * sizeof(Entry) +
         factors_.size() * sizeof(Float4);
}

}  // namespace shellgrid
