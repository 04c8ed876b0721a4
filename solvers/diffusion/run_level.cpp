// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/run_level.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/parallel.h"
#include "solvers/diffusion/level_rows.h"

namespace shellgrid {
namespace {

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
