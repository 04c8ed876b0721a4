// SPDX-License-Identifier: AGPL-3.0-or-later
// The rows of one multigrid level: sums over neighbours along runs, and between outer points and their twins. The inner
// loops of the passes over a level.
#pragma once
#include <algorithm>
#include <cstring>
#include <vector>

#include "meshing/core/parallel.h"
#include "solvers/diffusion/run_level.h"

namespace shellgrid {

inline constexpr std::size_t grain = 2048;  // unknowns that are worth a task

// Calls body(run) for all runs, in tasks of many.
template <class Body>
void for_runs(const RunLayout& layout, const Body& body) {
  const std::size_t runs = layout.runs.size();
  if (layout.size() < 2 * grain) {
    for (std::size_t r = 0; r < runs; ++r) body(r);
    return;
  }
  parallel_chunks(runs, std::max<std::size_t>(1, runs * grain / layout.size()),
                  [&](std::size_t begin, std::size_t end) {
                    for (std::size_t r = begin; r < end; ++r) body(r);
                  });
}

template <class Body>
void for_outer(std::size_t count, const Body& body) {
  if (count < 2 * grain)
    for (std::size_t s = 0; s < count; ++s) body(s);
  else
    parallel_for(count, body, grain);
}

// Lines of one run in the nearest cache.
template <class Real>
struct RunLines {
  std::vector<Real> values;
  std::size_t stride = 0;
  void fit(std::size_t length) {
    stride = (length + 31) / 16 * 16;
    if (values.size() < 3 * stride) values.resize(3 * stride);
  }
  Real* operator[](int channel) { return values.data() + channel * stride; }
};

template <class Real>
RunLines<Real>& thread_lines() {
  thread_local RunLines<Real> lines;
  return lines;
}

// What is added up over the neighbours j: coupling_ij (x_i − x_j), the coupling, or its magnitude.
enum class Term { difference, total, magnitude };

template <Term term, class Vector, class Real>
inline Vector term_of(const Vector& coupling, const Vector& centre, const Real* neighbour) {
  if constexpr (term == Term::difference) return coupling * (centre - load_lanes<Vector>(neighbour));
  if constexpr (term == Term::magnitude) return coupling < 0 ? -coupling : coupling;
  return coupling;
}

// The sums over the neighbours of one run's points, by slots.
// Calls finish(channel, place, count, sum, centre) for each chunk.
template <Term term, int copies, class Real, class Store, class Finish>
void couple_run(const RunLayout& layout, const LevelCouplings<Store>& couplings, std::size_t run_index,
                const ChannelPlanes<Real>& x, const Finish& finish) {
  using Vector = typename WideLanes<Real>::Vector;
  using Index = typename WideLanes<Real>::Index;
  using IndexValue = std::decay_t<decltype(Index{}[0])>;
  constexpr int width = WideLanes<Real>::width;
  const LatticeRun run = layout.runs[run_index];
  const std::int64_t length = run.length;
  const Store* values = couplings.values.data();
  const Store* own = values + static_cast<std::int64_t>(coupling_slots) * copies * run.start;
  const RunLink* const first_link = layout.links.data() + layout.link_start[run_index];
  const RunLink* const last_link = layout.links.data() + layout.link_start[run_index + 1];
  const Real* plane[3] = {x[0], x[1], x[2]};
  for (std::int64_t p = 0; p < length; p += width) {
    const std::int64_t u = run.start + p, count = std::min<std::int64_t>(width, length - p);
    // The rows of the next run, a chunk's worth: too many streams for the memory's own guess.
    const char* const ahead = reinterpret_cast<const char*>(own + coupling_slots * copies * (length + p));
    for (std::size_t byte = 0; byte < coupling_slots * copies * width * sizeof(Store); byte += 64)
      __builtin_prefetch(ahead + byte, 0, 2);
    Vector centre[3], sum[3];
    for (int c = 0; c < 3; ++c) {
      centre[c] = load_lanes<Vector>(plane[c] + u);
      sum[c] = Vector{};
    }
    // `at`: the coupling of the first lane; `other`: the neighbour's unknown of the first lane.
    auto add = [&](const Store* at, std::int64_t stride, std::int64_t other) {
      Vector coupling;
      for (int c = 0; c < 3; ++c) {
        if (c < copies) coupling = ReadLanes<Real>::read(at + c * stride);
        sum[c] += term_of<term>(coupling, centre[c], plane[c] + other);
      }
    };
    auto add_between = [&](const Store* at, std::int64_t stride, std::int64_t other, std::int64_t begin,
                           std::int64_t end) {
      const Index place = WideLanes<Real>::iota;
      const Index inside = (place >= static_cast<IndexValue>(begin)) & (place < static_cast<IndexValue>(end));
      Vector coupling;
      for (int c = 0; c < 3; ++c) {
        if (c < copies) coupling = ReadLanes<Real>::read(at + c * stride);
        const Vector part = term_of<term>(coupling, centre[c], plane[c] + other);
        sum[c] += inside ? part : Vector{};
      }
    };
    for (const RunLink* link = first_link; link != last_link; ++link) {
      const Store* base = own + p;
      std::int64_t stride = length;
      std::int64_t there = u + link->shift;  // the other's unknown at the first lane's x
      if (!link->follows) {
        const LatticeRun& other = layout.runs[link->run];
        stride = other.length;
        base = values + static_cast<std::int64_t>(coupling_slots) * copies * other.start + (there - other.start);
      }
      base += (1 + 3 * link->line) * copies * stride;
      for (int dx = 0; dx < 3; ++dx, base += copies * stride) {
        const std::int64_t begin = link->begin[dx] - p, end = link->end[dx] - p;
        if (begin >= count || end <= 0) continue;
        const std::int64_t step = link->follows ? dx - 1 : 1 - dx;
        const Store* at = link->follows ? base : base + step;
        if (begin <= 0 && end >= count)
          add(at, stride, there + step);
        else
          add_between(at, stride, there + step, begin, end);
      }
    }
    add(own + p, length, u + 1);
    if (p > 0)
      add(own + p - 1, length, u - 1);
    else
      add_between(own - 1, length, u - 1, 1, width);
    for (int c = 0; c < 3; ++c)
      finish(c, p, static_cast<int>(count), Vector(sum[c] * static_cast<Real>(couplings.factor[c])), centre[c]);
  }
}

// lines ← the sums of one run.
template <Term term = Term::difference, class Real, class Store>
void couple_run(const RunLayout& layout, const LevelCouplings<Store>& couplings, std::size_t run_index,
                const ChannelPlanes<Real>& x, RunLines<Real>& lines) {
  const auto store = [&](int c, std::int64_t p, int, const auto& sum, const auto&) { store_lanes(lines[c] + p, sum); };
  if (couplings.copies == 3)
    couple_run<term, 3>(layout, couplings, run_index, x, store);
  else
    couple_run<term, 1>(layout, couplings, run_index, x, store);
}

template <class Real>
void couple_extras(const RunLevel& level, std::size_t run_index, const ChannelPlanes<Real>& x, RunLines<Real>& lines) {
  const RunLayout& layout = level.layout;
  for (std::int32_t k = layout.extra_start[run_index]; k < layout.extra_start[run_index + 1]; ++k) {
    const std::int32_t entry = layout.extra_entry[k];
    const ExtraCoupling& e = layout.extras[entry / 2];
    const std::int32_t here = entry % 2 ? e.second : e.first, there = entry % 2 ? e.first : e.second;
    for (int c = 0; c < 3; ++c)
      lines[c][here - layout.runs[run_index].start] +=
          static_cast<Real>(level.extra[entry / 2][c]) * (x[c][here] - x[c][there]);
  }
}

template <class Real>
using Lanes4 = typename RealLanes4<Real>::Type;

inline Float4 widen(Float4 a, Float4) { return a; }
inline Double4 widen(Float4 a, Double4) { return to_double(a); }
inline float widen(float value) { return value; }
inline float widen(Half value) {
  Half padded[16] = {value};
  return ReadLanes<float>::read(padded)[0];
}
template <class Store>
Float4 read3(const Store* from) {
  return Float4{widen(from[0]), widen(from[1]), widen(from[2]), 0};
}

// Nine couplings of a pair, and zeros.
inline Float16Lanes read_pair(const SurfaceCoupling<float>& pair) {
  float padded[16] = {};
  std::memcpy(padded, &pair, sizeof pair);
  return load_lanes<Float16Lanes>(padded);
}
inline Float16Lanes read_pair(const SurfaceCoupling<Half>& pair) {
#if defined(__AVX512BW__) && defined(__AVX512VL__)
  return reinterpret_cast<Float16Lanes>(_mm512_cvtph_ps(_mm256_maskz_loadu_epi16(0x1ff, &pair)));
#else
  Half padded[16] = {};
  std::memcpy(padded, &pair, sizeof pair);
  return ReadLanes<float>::read(padded);
#endif
}

template <class Real>
Lanes4<Real> inner_value(const ChannelPlanes<Real>& x, std::int32_t u) {
  return Lanes4<Real>{x[0][u], x[1][u], x[2][u], 0};
}

// What the twins and the outer points lose to each other: `twin_loss` belongs to the twins' rows, `outer_loss` is the
// outer rows' without reaction. `pair`: values of each outer point and its twin.
template <class Real>
struct SurfaceLosses {
  struct Pair {
    Lanes4<Real> outer, twin;
  };
  std::vector<Pair> pair;
  std::vector<Lanes4<Real>> twin_loss, outer_loss;
};

// Sums of one outer point's row and its twin's.
template <class Store>
void couple_pairs(const SurfaceLayout& surface, const SurfaceCoupling<Store>* couplings,
                  const std::vector<SurfaceLosses<double>::Pair>& pair, std::size_t s, Double4& outer_sum,
                  Double4& twin_sum) {
  const Double4 outer = pair[s].outer, twin = pair[s].twin;
  for (std::int32_t k = surface.start[s]; k < surface.start[s + 1]; ++k) {
    const auto& there = pair[surface.neighbour[k]];
    const SurfaceCoupling<Store>& a = couplings[k];
    outer_sum += to_double(read3(a.outer_outer)) * (outer - there.outer);
    outer_sum += to_double(read3(a.outer_twin)) * (outer - there.twin);
    twin_sum += to_double(read3(a.twin_outer)) * (twin - there.outer);
  }
}

template <class Store>
void couple_pairs(const SurfaceLayout& surface, const SurfaceCoupling<Store>* couplings,
                  const std::vector<SurfaceLosses<float>::Pair>& pair, std::size_t s, Float4& outer_sum,
                  Float4& twin_sum) {
  // Outer with outer, twin with outer, outer with twin, nothing: a pair's lane 3 is zero.
  using Eight = float __attribute__((vector_size(32)));
  const Eight here = load_lanes<Eight>(&pair[s]);
  const Float16Lanes centre = __builtin_shufflevector(here, here, 0, 1, 2, 4, 5, 6, 0, 1, 2, 3, 3, 3, 3, 3, 3, 3);
  Float16Lanes sum = {};
  for (std::int32_t k = surface.start[s]; k < surface.start[s + 1]; ++k) {
    __builtin_prefetch(couplings + k + 64);
    const Eight there = load_lanes<Eight>(&pair[surface.neighbour[k]]);
    const Float16Lanes neighbour =
        __builtin_shufflevector(there, there, 0, 1, 2, 0, 1, 2, 4, 5, 6, 3, 3, 3, 3, 3, 3, 3);
    sum += read_pair(couplings[k]) * (centre - neighbour);
  }
  for (int c = 0; c < 3; ++c) outer_sum[c] = sum[c] + sum[6 + c];
  for (int c = 0; c < 3; ++c) twin_sum[c] = sum[3 + c];
}

template <class Real, class Store>
void couple_surface(const RunLevel& level, const LevelCouplings<Store>& couplings, const LevelVector<Real>& x,
                    SurfaceLosses<Real>& losses) {
  const SurfaceLayout& surface = level.surface;
  const std::size_t n = surface.size();
  losses.pair.resize(n);
  losses.twin_loss.resize(n);
  losses.outer_loss.resize(n);
  for_outer(n, [&](std::size_t s) { losses.pair[s] = {x.outer[s], inner_value(x.inner, surface.twin[s])}; });
  const Lanes4<Real> factor = widen(couplings.surface_factor, Lanes4<Real>{});
  for_outer(n, [&](std::size_t s) {
    Lanes4<Real> outer_sum = {}, twin_sum = {};
    couple_pairs(surface, couplings.surface.data(), losses.pair, s, outer_sum, twin_sum);
    const Lanes4<Real> through = widen(level.link[s], Lanes4<Real>{}) * (losses.pair[s].outer - losses.pair[s].twin);
    losses.outer_loss[s] = factor * outer_sum + through;
    losses.twin_loss[s] = factor * twin_sum - through;
  });
}

// Calls body(couplings) with those to smooth with.
template <class Body>
void with_couplings(const RunLevel& level, const Body& body) {
  if (level.half)
    body(level.half);
  else
    body(level.single);
}

inline SurfaceLosses<float>& surface_losses(const RunLevel& level) {
  // One solver works at a time on a thread; levels share it.
  thread_local std::vector<SurfaceLosses<float>> all(64);
  std::size_t k = 0;
  for (std::size_t n = level.size(); n > 1 && k + 1 < all.size(); n /= 2) ++k;
  return all[k];
}

}  // namespace shellgrid
