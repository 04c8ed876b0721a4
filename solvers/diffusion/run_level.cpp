// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/run_level.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr std::size_t grain = 2048;  // unknowns that are worth a task

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

SurfaceLosses<float>& surface_losses(const RunLevel& level) {
  // One solver works at a time on a thread; levels share it.
  thread_local std::vector<SurfaceLosses<float>> all(64);
  std::size_t k = 0;
  for (std::size_t n = level.size(); n > 1 && k + 1 < all.size(); n /= 2) ++k;
  return all[k];
}

// lines ← right_side − A x of one run.
template <class Store>
void residual_run(const RunLevel& level, const LevelCouplings<Store>& couplings, std::size_t r,
                  const LevelVector<float>& x, const LevelVector<float>& right_side, bool inner_light,
                  const SurfaceLosses<float>& losses, RunLines<float>& lines) {
  const LatticeRun& run = level.layout.runs[r];
  lines.fit(run.length);
  couple_run(level.layout, couplings, r, x.inner, lines);
  if (!level.extra.empty()) couple_extras(level, r, x.inner, lines);
  for (int c = 0; c < 3; ++c) {
    float* line = lines[c];
    const float* value = x.inner[c] + run.start;
    const float* reaction = level.reaction.inner[c] + run.start;
    if (inner_light) {
      const float* light = right_side.inner[c] + run.start;
      for (std::int32_t p = 0; p < run.length; ++p) line[p] = light[p] - line[p] - reaction[p] * value[p];
    } else {
      for (std::int32_t p = 0; p < run.length; ++p) line[p] = -line[p] - reaction[p] * value[p];
    }
  }
  for (std::int32_t s = level.surface.first_of_run[r]; s < level.surface.first_of_run[r + 1]; ++s)
    for (int c = 0; c < 3; ++c) lines[c][level.surface.twin[s] - run.start] -= losses.twin_loss[s][c];
}

Float4 outer_residual(const RunLevel& level, const LevelVector<float>& x, const LevelVector<float>& right_side,
                      const SurfaceLosses<float>& losses, std::int32_t s) {
  return right_side.outer[s] - level.reaction.outer[s] * x.outer[s] - losses.outer_loss[s];
}

// Sums a run's residual along x with the weights ½, 1, ½ at even places.
void halve_run(const LatticeRun& run, std::int32_t coarse_length, const float* line, float* halved) {
  const int odd = run.x & 1;
  auto at = [&](std::int32_t p) { return p >= 0 && p < run.length ? line[p] : 0.0f; };
  const std::int32_t inside = (run.length - 2 + odd) / 2;  // the last coarse place with three neighbours
  std::int32_t X = 0;
  for (; X < std::min<std::int32_t>(1, coarse_length); ++X)
    halved[X] = 0.5f * at(2 * X - 1 - odd) + at(2 * X - odd) + 0.5f * at(2 * X + 1 - odd);
  for (; X < std::min(inside, coarse_length); ++X)
    halved[X] = 0.5f * line[2 * X - 1 - odd] + line[2 * X - odd] + 0.5f * line[2 * X + 1 - odd];
  for (; X < coarse_length; ++X) halved[X] = 0.5f * at(2 * X - 1 - odd) + at(2 * X - odd) + 0.5f * at(2 * X + 1 - odd);
}

// What one fine run gives to one coarse line.
void restrict_by_weights(const RunLevel& level, const LevelTransfer::CoarsePart& part, int channel, const float* fine,
                         float* to) {
  const LevelTransfer::FineRun& from = level.transfer.fine_runs[part.fine_run];
  const LatticeRun& run = level.layout.runs[part.fine_run];
  const std::int32_t length = from.coarse_length;
  const auto weights = [&](int kind) {
    return level.transfer.weights.line(part.fine_run, length, part.line, kind) +
           static_cast<std::int64_t>(channel) * length;
  };
  const float *even = weights(0), *low = weights(1), *high = weights(2);
  // Places beyond the run's ends have no weight.
  const float* at = fine + run.start - (run.x & 1);
  to[0] += even[0] * at[0] + low[0] * at[1];
  for (std::int32_t X = 1; X < length; ++X)
    to[X] += even[X] * at[2 * X] + low[X] * at[2 * X + 1] + high[X - 1] * at[2 * X - 1];
}

// Adds the halved lines up in the coarse runs; irregular runs' values stand in `fine`.
void restrict_lines(RunLevel& level, const LevelVector<float>& fine, const RunLayout& coarse_layout,
                    LevelVector<float>& coarse) {
  const LevelTransfer& transfer = level.transfer;
  for_runs(coarse_layout, [&](std::size_t S) {
    const LatticeRun& run = coarse_layout.runs[S];
    for (int c = 0; c < 3; ++c) {
      float* sum = coarse.inner[c] + run.start;
      std::fill(sum, sum + run.length, 0.0f);
      for (std::int32_t k = transfer.part_start[S]; k < transfer.part_start[S + 1]; ++k) {
        const LevelTransfer::CoarsePart& part = transfer.parts[k];
        const LevelTransfer::FineRun& from = transfer.fine_runs[part.fine_run];
        float* to = sum + part.coarse_place;
        if (transfer.weights) {
          restrict_by_weights(level, part, c, fine.inner[c], to);
          continue;
        }
        const float* halved = level.halved[c] + from.half_start;
        for (std::int32_t X = 0; X < from.coarse_length; ++X) to[X] += part.weight * halved[X];
      }
    }
  });
  const LevelTransfer::List& list = transfer.inner_down;
  for (std::size_t k = 0; k < list.row.size(); ++k)
    for (std::int64_t e = list.start[k]; e < list.start[k + 1]; ++e)
      for (int c = 0; c < 3; ++c)
        coarse.inner[c][list.row[k]] +=
            (transfer.weights ? transfer.weights.inner_down[e][c] : list.weight[e]) * fine.inner[c][list.index[e]];
}

void restrict_outer(const LevelTransfer& transfer, const std::vector<Float4>& fine, std::vector<Float4>& coarse) {
  const LevelTransfer::List& list = transfer.outer_down;
  for_outer(coarse.size(), [&](std::size_t s) {
    Float4 sum = {};
    if (transfer.weights)
      for (std::int64_t e = list.start[s]; e < list.start[s + 1]; ++e)
        sum += transfer.weights.outer_down[e] * fine[list.index[e]];
    else
      for (std::int64_t e = list.start[s]; e < list.start[s + 1]; ++e) sum += list.weight[e] * fine[list.index[e]];
    coarse[s] = sum;
  });
}

// Hands a run's residual on to the restriction.
void leave_run(RunLevel& level, std::size_t r, const LatticeRun& run, const float* const line[3],
               LevelVector<float>& fine) {
  const LevelTransfer::FineRun& to = level.transfer.fine_runs[r];
  for (int c = 0; c < 3; ++c)
    if (to.lines > 0 && !level.transfer.weights)
      halve_run(run, to.coarse_length, line[c], level.halved[c] + to.half_start);
    else
      std::copy(line[c], line[c] + run.length, fine.inner[c] + run.start);
}

// The magnitudes and sums of a row give what the smoother divides by: on the diagonal also what the couplings of the
// wrong sign exceed the row's sum by. Then the smoother's spectrum ends at 2 whatever the cells' shapes and contrasts.
Float4 damped_diagonal(Float4 sum, Float4 magnitude) {
  const Float4 excess = 0.5f * (magnitude - sum);
  return sum + (excess > 0 ? excess : Float4{});
}

template <class Store>
void prepare_smoother(RunLevel& level, const LevelCouplings<Store>& couplings) {
  const SurfaceLayout& surface = level.surface;
  const std::size_t n = surface.size();
  level.outer_inverse.assign(n, Float4{});
  level.twin_inverse.assign(n, Float4{});
  level.pair_inverse.assign(n, Float4{});
  std::vector<Float4> twin_sum(n), twin_magnitude(n), outer_diagonal(n);
  for_outer(n, [&](std::size_t s) {
    Float4 outer = {}, outer_size = {}, twin = {}, twin_size = {};
    for (std::int32_t k = surface.start[s]; k < surface.start[s + 1]; ++k) {
      const Float4 a = couplings.surface_factor * read3(couplings.surface[k].outer_outer),
                   b = couplings.surface_factor * read3(couplings.surface[k].outer_twin),
                   c = couplings.surface_factor * read3(couplings.surface[k].twin_outer);
      outer += a + b;
      outer_size += absolute(a) + absolute(b);
      twin += c;
      twin_size += absolute(c);
    }
    const Float4 link = level.link[s];
    twin_sum[s] = twin + link;
    twin_magnitude[s] = twin_size + absolute(link);
    outer_diagonal[s] = damped_diagonal(outer + link + level.reaction.outer[s], outer_size + absolute(link));
  });
  for_runs(level.layout, [&](std::size_t r) {
    const LatticeRun& run = level.layout.runs[r];
    RunLines<float> sum, size;
    sum.fit(run.length);
    size.fit(run.length);
    couple_run<Term::total>(level.layout, couplings, r, level.x.inner, sum);
    couple_run<Term::magnitude>(level.layout, couplings, r, level.x.inner, size);
    for (std::int32_t k = level.layout.extra_start[r]; k < level.layout.extra_start[r + 1]; ++k) {
      const std::int32_t entry = level.layout.extra_entry[k];
      const ExtraCoupling& e = level.layout.extras[entry / 2];
      const std::int32_t here = (entry % 2 ? e.second : e.first) - run.start;
      for (int c = 0; c < 3; ++c) {
        sum[c][here] += level.extra[entry / 2][c];
        size[c][here] += std::abs(level.extra[entry / 2][c]);
      }
    }
    std::int32_t s = surface.first_of_run[r];
    for (std::int32_t p = 0; p < run.length; ++p) {
      const std::int32_t u = run.start + p;
      const bool paired = s < surface.first_of_run[r + 1] && surface.twin[s] == u;
      Float4 total = inner_value(level.reaction.inner, u), magnitude = {};
      for (int c = 0; c < 3; ++c) total[c] += sum[c][p], magnitude[c] = size[c][p];
      if (paired) total += twin_sum[s], magnitude += twin_magnitude[s];
      const Float4 diagonal = damped_diagonal(total, magnitude);
      Float4 own = {};
      for (int c = 0; c < 3; ++c) {
        const double d = diagonal[c];
        own[c] = d > 0 ? static_cast<float>(1 / d) : 0.0f;
        if (!paired) continue;
        const double e = outer_diagonal[s][c], f = level.link[s][c];
        const double determinant = d * e - f * f;
        // A pair that is singular but for rounding is solved point by point.
        const bool sound = determinant > 1e-6 * d * e && d > 0 && e > 0;
        if (sound) own[c] = static_cast<float>(e / determinant);
        level.pair_inverse[s][c] = sound ? static_cast<float>(f / determinant) : 0.0f;
        level.outer_inverse[s][c] = sound ? static_cast<float>(d / determinant) : e > 0 ? static_cast<float>(1 / e) : 0;
      }
      // A rounded entry could make the pair's block indefinite.
      for (int c = 0; c < 3; ++c) level.inverse[c][u] = paired ? UpperHalf{0} : to_upper_half(own[c]);
      if (paired) level.twin_inverse[s++] = own;
    }
  });
}

}  // namespace

void prepare_smoother(RunLevel& level) {
  with_couplings(level, [&](const auto& couplings) { prepare_smoother(level, couplings); });
  for (const std::int32_t u : level.frozen)
    for (int c = 0; c < 3; ++c) level.inverse[c][u] = UpperHalf{0};
}

template <class Real>
void apply_level(const RunLevel& level, const LevelVector<Real>& x, LevelVector<Real>& result, bool rounded) {
  const bool single = level.single && !(rounded && level.half);
  SurfaceLosses<Real> losses;
  if (single)
    couple_surface(level, level.single, x, losses);
  else
    couple_surface(level, level.half, x, losses);
  for_runs(level.layout, [&](std::size_t r) {
    const LatticeRun& run = level.layout.runs[r];
    RunLines<Real>& lines = thread_lines<Real>();
    lines.fit(run.length);
    if (single)
      couple_run(level.layout, level.single, r, x.inner, lines);
    else
      couple_run(level.layout, level.half, r, x.inner, lines);
    if (!level.extra.empty()) couple_extras(level, r, x.inner, lines);
    for (std::int32_t s = level.surface.first_of_run[r]; s < level.surface.first_of_run[r + 1]; ++s)
      for (int c = 0; c < 3; ++c) lines[c][level.surface.twin[s] - run.start] += losses.twin_loss[s][c];
    for (int c = 0; c < 3; ++c) {
      const Real* value = x.inner[c] + run.start;
      const float* reaction = level.reaction.inner[c] + run.start;
      Real* to = result.inner[c] + run.start;
      for (std::int32_t p = 0; p < run.length; ++p) to[p] = lines[c][p] + static_cast<Real>(reaction[p]) * value[p];
    }
  });
  for_outer(level.surface.size(), [&](std::size_t s) {
    result.outer[s] = losses.outer_loss[s] + widen(level.reaction.outer[s], Lanes4<Real>{}) * x.outer[s];
  });
}

template void apply_level(const RunLevel&, const LevelVector<float>&, LevelVector<float>&, bool);
template void apply_level(const RunLevel&, const LevelVector<double>&, LevelVector<double>&, bool);

void smooth_level(RunLevel& level, const SmoothingStep& step, bool inner_light) {
  SurfaceLosses<float>& losses = surface_losses(level);
  const float keep = step.keep, take = step.take;
  with_couplings(level, [&](const auto& couplings) {
    couple_surface(level, couplings, level.x, losses);
    for_runs(level.layout, [&](std::size_t r) {
      const LatticeRun& run = level.layout.runs[r];
      RunLines<float>& lines = thread_lines<float>();
      lines.fit(run.length);
      const bool extras = level.layout.extra_start[r] < level.layout.extra_start[r + 1];
      // Residuals go to `lines`, new values to `before`; twins' new values lack what the residual moves.
      const auto finish = [&](int c, std::int64_t p, int count, const Float16Lanes& sum, const Float16Lanes& centre) {
        const std::int64_t u = run.start + p;
        Float16Lanes residual = -sum - load_lanes<Float16Lanes>(level.reaction.inner[c] + u) * centre;
        if (inner_light) residual += load_lanes<Float16Lanes>(level.right_side.inner[c] + u);
        store_lanes(lines[c] + p, residual);
        float* to = level.before.inner[c] + u;
        Float16Lanes moved = centre + take * (ReadLanes<float>::read(level.inverse[c] + u) * residual);
        if (keep != 0) moved += keep * (centre - load_lanes<Float16Lanes>(to));
        store_some(to, moved, count);
      };
      if (couplings.copies == 3)
        couple_run<Term::difference, 3>(level.layout, couplings, r, level.x.inner, finish);
      else
        couple_run<Term::difference, 1>(level.layout, couplings, r, level.x.inner, finish);
      if (extras) {
        // What they take off the residual, and off the new values.
        RunLines<float> loss;
        loss.fit(run.length);
        std::fill(loss.values.begin(), loss.values.end(), 0.0f);
        couple_extras(level, r, level.x.inner, loss);
        for (int c = 0; c < 3; ++c)
          for (std::int32_t p = 0; p < run.length; ++p) {
            lines[c][p] -= loss[c][p];
            const float inverse =
                std::bit_cast<float>(static_cast<std::uint32_t>(level.inverse[c][run.start + p].bits) << 16);
            level.before.inner[c][run.start + p] -= take * (inverse * loss[c][p]);
          }
      }
      for (std::int32_t s = level.surface.first_of_run[r]; s < level.surface.first_of_run[r + 1]; ++s) {
        const std::int32_t p = level.surface.twin[s] - run.start;
        const Float4 r_twin = Float4{lines[0][p], lines[1][p], lines[2][p], 0} - losses.twin_loss[s];
        const Float4 r_outer = outer_residual(level, level.x, level.right_side, losses, s);
        const Float4 z_twin = level.twin_inverse[s] * r_twin + level.pair_inverse[s] * r_outer;
        for (int c = 0; c < 3; ++c) level.before.inner[c][run.start + p] += take * z_twin[c];
        const Float4 z_outer = level.pair_inverse[s] * r_twin + level.outer_inverse[s] * r_outer;
        const Float4 here = level.x.outer[s];
        Float4 moved = here + take * z_outer;
        if (keep != 0) moved += keep * (here - level.before.outer[s]);
        level.before.outer[s] = moved;
      }
    });
  });
  std::swap(level.x, level.before);
}

void smooth_from_zero(RunLevel& level, float take, bool inner_light) {
  for_runs(level.layout, [&](std::size_t r) {
    const LatticeRun& run = level.layout.runs[r];
    for (int c = 0; c < 3; ++c) {
      float* to = level.x.inner[c] + run.start;
      float* before = level.before.inner[c] + run.start;
      const float* light = level.right_side.inner[c] + run.start;
      const UpperHalf* inverse = level.inverse[c] + run.start;
      for (std::int32_t p = 0; p < run.length; ++p) {
        const float z = std::bit_cast<float>(static_cast<std::uint32_t>(inverse[p].bits) << 16);
        to[p] = inner_light ? take * (z * light[p]) : 0.0f;
        before[p] = 0;
      }
    }
    for (std::int32_t s = level.surface.first_of_run[r]; s < level.surface.first_of_run[r + 1]; ++s) {
      const std::int32_t u = level.surface.twin[s];
      const Float4 light = level.right_side.outer[s];
      const Float4 twin_light = inner_light ? inner_value(level.right_side.inner, u) : Float4{};
      const Float4 z = level.twin_inverse[s] * twin_light + level.pair_inverse[s] * light;
      for (int c = 0; c < 3; ++c) level.x.inner[c][u] += take * z[c];
      level.x.outer[s] = take * (level.pair_inverse[s] * twin_light + level.outer_inverse[s] * light);
      level.before.outer[s] = Float4{};
    }
  });
}

void restrict_residual(RunLevel& level, RunLevel& coarse, bool inner_light) {
  SurfaceLosses<float>& losses = surface_losses(level);
  with_couplings(level, [&](const auto& couplings) {
    couple_surface(level, couplings, level.x, losses);
    for_runs(level.layout, [&](std::size_t r) {
      RunLines<float>& lines = thread_lines<float>();
      residual_run(level, couplings, r, level.x, level.right_side, inner_light, losses, lines);
      const float* const line[3] = {lines[0], lines[1], lines[2]};
      leave_run(level, r, level.layout.runs[r], line, level.before);
    });
  });
  for_outer(level.surface.size(), [&](std::size_t s) {
    level.before.outer[s] = outer_residual(level, level.x, level.right_side, losses, static_cast<std::int32_t>(s));
  });
  restrict_lines(level, level.before, coarse.layout, coarse.right_side);
  restrict_outer(level.transfer, level.before.outer, coarse.right_side.outer);
}

// One run's points from their coarse ones.
void prolong_by_weights(const RunLevel& level, std::size_t r, const LevelVector<float>& coarse,
                        LevelVector<float>& fine, bool add) {
  const LevelTransfer::FineRun& from = level.transfer.fine_runs[r];
  const LatticeRun& run = level.layout.runs[r];
  const std::int32_t length = from.coarse_length;
  RunLines<float>& lines = thread_lines<float>();
  lines.fit(2 * static_cast<std::size_t>(length));
  for (int c = 0; c < 3; ++c) {
    float* even = lines[0];
    float* odd = even + length;
    for (int line = 0; line < from.lines; ++line) {
      const float* value = coarse.inner[c] + from.coarse[line];
      const auto weights = [&](int kind) {
        return level.transfer.weights.line(r, length, line, kind) + static_cast<std::int64_t>(c) * length;
      };
      const float *on = weights(0), *low = weights(1), *high = weights(2);
      if (line == 0) {
        for (std::int32_t X = 0; X < length; ++X) even[X] = on[X] * value[X];
        for (std::int32_t X = 0; X + 1 < length; ++X) odd[X] = low[X] * value[X] + high[X] * value[X + 1];
      } else {
        for (std::int32_t X = 0; X < length; ++X) even[X] += on[X] * value[X];
        for (std::int32_t X = 0; X + 1 < length; ++X) odd[X] += low[X] * value[X] + high[X] * value[X + 1];
      }
    }
    float* to = fine.inner[c] + run.start;
    const int first = run.x & 1;
    // Of the line's place X the points 2 X and 2 X + 1, which stand at 2 X − first and one further.
    for (std::int32_t X = first; 2 * X - first < run.length; ++X)
      to[2 * X - first] = add ? to[2 * X - first] + even[X] : even[X];
    for (std::int32_t X = 0; 2 * X + 1 - first < run.length; ++X)
      to[2 * X + 1 - first] = add ? to[2 * X + 1 - first] + odd[X] : odd[X];
  }
}

void prolong_vector(const RunLevel& level, const LevelVector<float>& coarse, LevelVector<float>& fine, bool add) {
  const LevelTransfer& transfer = level.transfer;
  for_runs(level.layout, [&](std::size_t r) {
    const LevelTransfer::FineRun& from = transfer.fine_runs[r];
    if (from.lines == 0) return;
    const LatticeRun& run = level.layout.runs[r];
    if (transfer.weights) {
      prolong_by_weights(level, r, coarse, fine, add);
      return;
    }
    RunLines<float>& lines = thread_lines<float>();
    lines.fit(std::max(run.length, from.coarse_length));
    const int odd = run.x & 1;
    for (int c = 0; c < 3; ++c) {
      float* mean = lines[c];
      const float* const plane = coarse.inner[c];
      const float* a = plane + from.coarse[0];
      if (from.lines == 1) {
        for (std::int32_t X = 0; X < from.coarse_length; ++X) mean[X] = a[X];
      } else if (from.lines == 2) {
        const float* b = plane + from.coarse[1];
        for (std::int32_t X = 0; X < from.coarse_length; ++X) mean[X] = 0.5f * (a[X] + b[X]);
      } else {
        const float *b = plane + from.coarse[1], *d = plane + from.coarse[2], *e = plane + from.coarse[3];
        for (std::int32_t X = 0; X < from.coarse_length; ++X) mean[X] = 0.25f * ((a[X] + b[X]) + (d[X] + e[X]));
      }
      float* to = fine.inner[c] + run.start;
      // Even places at p + odd = 2 X, odd ones between X and X + 1.
      if (odd) {
        const float first = 0.5f * (mean[0] + mean[1]);
        to[0] = add ? to[0] + first : first;
      }
      float* even = to + odd;
      const std::int32_t left = run.length - odd, pairs = left / 2;
      const float* from_mean = mean + odd;
      if (add)
        for (std::int32_t X = 0; X < pairs; ++X) {
          even[2 * X] += from_mean[X];
          even[2 * X + 1] += 0.5f * (from_mean[X] + from_mean[X + 1]);
        }
      else
        for (std::int32_t X = 0; X < pairs; ++X) {
          even[2 * X] = from_mean[X];
          even[2 * X + 1] = 0.5f * (from_mean[X] + from_mean[X + 1]);
        }
      if (left & 1) even[2 * pairs] = add ? even[2 * pairs] + from_mean[pairs] : from_mean[pairs];
    }
  });
  const LevelTransfer::List& list = transfer.inner_up;
  for (std::size_t k = 0; k < list.row.size(); ++k) {
    const float share = 1.0f / static_cast<float>(list.start[k + 1] - list.start[k]);
    for (int c = 0; c < 3; ++c) {
      float sum = 0;
      if (transfer.weights)
        for (std::int64_t e = list.start[k]; e < list.start[k + 1]; ++e)
          sum += transfer.weights.inner_up[e][c] * coarse.inner[c][list.index[e]];
      else
        for (std::int64_t e = list.start[k]; e < list.start[k + 1]; ++e) sum += share * coarse.inner[c][list.index[e]];
      float& to = fine.inner[c][list.row[k]];
      to = add ? to + sum : sum;
    }
  }
  const LevelTransfer::List& up = transfer.outer_up;
  for_outer(fine.outer.size(), [&](std::size_t s) {
    Float4 sum = {};
    const float share = 1.0f / static_cast<float>(up.start[s + 1] - up.start[s]);
    if (transfer.weights)
      for (std::int64_t e = up.start[s]; e < up.start[s + 1]; ++e)
        sum += transfer.weights.outer_up[e] * coarse.outer[up.index[e]];
    else
      for (std::int64_t e = up.start[s]; e < up.start[s + 1]; ++e) sum += share * coarse.outer[up.index[e]];
    fine.outer[s] = add ? fine.outer[s] + sum : sum;
  });
}

void restrict_vector(RunLevel& level, const LevelVector<float>& fine, const RunLayout& coarse_layout,
                     LevelVector<float>& coarse) {
  for_runs(level.layout, [&](std::size_t r) {
    const LatticeRun& run = level.layout.runs[r];
    const LevelTransfer::FineRun& to = level.transfer.fine_runs[r];
    for (int c = 0; c < 3; ++c)
      if (to.lines > 0 && !level.transfer.weights)
        halve_run(run, to.coarse_length, fine.inner[c] + run.start, level.halved[c] + to.half_start);
  });
  restrict_lines(level, fine, coarse_layout, coarse);
  restrict_outer(level.transfer, fine.outer, coarse.outer);
}

void restrict_outer_vector(const RunLevel& level, const std::vector<Float4>& fine, std::vector<Float4>& coarse) {
  restrict_outer(level.transfer, fine, coarse);
}

}  // namespace shellgrid
