// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/multigrid.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

using Key = std::array<std::int32_t, 4>;

constexpr std::size_t grain = 1024;

// Slot of a coarse neighbour among 3×3×3 offsets × {inner, outer}.
int slot_of(const Key& from, const Key& to) {
  return (((to[2] - from[2] + 1) * 3 + (to[1] - from[1] + 1)) * 3 + (to[0] - from[0] + 1)) * 2 + to[3];
}

// Of one of `count` parents, a power of two.
float equal_share(std::int64_t count) { return 1.0f / static_cast<float>(count); }

std::string number_text(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%g", value);
  return text;
}

std::string history_text(const SolveReport& report) {
  std::string text;
  char number[32];
  for (double r : report.residual_history) {
    std::snprintf(number, sizeof number, " %.2e", r);
    text += number;
  }
  return text;
}

}  // namespace

Multigrid::Operator Multigrid::single_precision(const CouplingOperator& matrix) {
  Operator result;
  result.row_start = matrix.row_start;
  result.column = matrix.column;
  result.coupling = matrix.coupling;
  result.reaction.resize(matrix.size());
  for (std::size_t i = 0; i < matrix.size(); ++i) result.reaction[i] = to_float(matrix.reaction[i]);
  return result;
}

void Multigrid::prepare_smoother(Level& level) const {
  const Operator& a = *level.matrix;
  const std::size_t n = level.key.size();
  level.partner.resize(n);
  level.inverse_own.resize(n);
  level.inverse_partner.resize(n);
  std::vector<Float4> diagonal(n), coupling(n);
  parallel_for(
      n,
      [&](std::size_t i) {
        Key twin = level.key[i];
        twin[3] = 1 - twin[3];
        // A twin is the neighbour in the order.
        const std::size_t candidate = twin[3] == 1 ? i + 1 : i - 1;
        const bool paired = candidate < n && level.key[candidate] == twin;
        level.partner[i] = static_cast<std::int32_t>(paired ? candidate : i);
        Float4 sum = a.reaction[i], magnitude = {}, with_partner = {};
        for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k) {
          sum += a.coupling[k];
          magnitude += absolute(a.coupling[k]);
          if (paired && a.column[k] == static_cast<std::int32_t>(candidate)) with_partner = a.coupling[k];
        }
        const Float4 excess = 0.5f * (magnitude - sum);
        diagonal[i] = sum + (excess > 0 ? excess : Float4{});
        coupling[i] = with_partner;
      },
      grain);
  parallel_for(
      n,
      [&](std::size_t i) {
        const std::size_t j = static_cast<std::size_t>(level.partner[i]);
        for (int c = 0; c < 4; ++c) {
          const double d = diagonal[i][c];
          if (!(d > 0)) {
            level.inverse_own[i][c] = level.inverse_partner[i][c] = 0;
            continue;
          }
          if (i == j) {
            level.inverse_own[i][c] = static_cast<float>(1 / d);
            level.inverse_partner[i][c] = 0;
            continue;
          }
          const double e = diagonal[j][c], f = coupling[i][c];
          const double determinant = d * e - f * f;
          // A pair that is singular but for rounding is solved point by point.
          const bool sound = determinant > 1e-6 * d * e;
          level.inverse_own[i][c] = static_cast<float>(sound ? e / determinant : 1 / d);
          level.inverse_partner[i][c] = static_cast<float>(sound ? f / determinant : 0);
        }
      },
      grain);
}

void Multigrid::coarsen(const UnknownTransfer& transfer) {
  Level& fine = levels_.back();
  const std::size_t n = fine.key.size();
  fine.prolongation = transfer;
  Level coarse;
  coarse.key = std::move(fine.prolongation.key);
  const std::size_t m = coarse.key.size();
  const UnknownTransfer& p = fine.prolongation;

  Restriction& r = fine.restriction;
  r.start.assign(m + 1, 0);
  for (std::int32_t parent : p.parent) ++r.start[parent + 1];
  std::partial_sum(r.start.begin(), r.start.end(), r.start.begin());
  r.index.resize(p.parent.size());
  r.weight.resize(p.parent.size());
  std::vector<std::int64_t> next(r.start.begin(), r.start.end() - 1);
  for (std::size_t i = 0; i < n; ++i)
    for (std::int64_t k = p.start[i]; k < p.start[i + 1]; ++k) {
      const std::int64_t at = next[p.parent[k]]++;
      r.index[at] = static_cast<std::int32_t>(i);
      r.weight[at] = equal_share(p.start[i + 1] - p.start[i]);
    }

  // Galerkin product of the couplings, a coarse row at a time; neighbours differ by at most one lattice step.
  const Operator& a = *fine.matrix;
  struct Rows {
    std::vector<std::int32_t> length, column;
    std::vector<Float4> coupling;
  };
  constexpr std::size_t chunk = 256;
  std::vector<Rows> parts((m + chunk - 1) / chunk);
  coarse.own.reaction.resize(m);
  parallel_chunks(m, chunk, [&](std::size_t begin, std::size_t end) {
    Rows& rows = parts[begin / chunk];
    // Neighbours at one place with others, where parts of the object that nearly touch come apart.
    std::vector<std::pair<std::int32_t, Float4>> further;
    for (std::size_t row = begin; row < end; ++row) {
      std::array<Float4, 54> sum{};
      std::array<std::int32_t, 54> column;
      column.fill(-1);
      further.clear();
      Float4 reaction = {};
      for (std::int64_t q = r.start[row]; q < r.start[row + 1]; ++q) {
        const std::int32_t i = r.index[q];
        const float weight = r.weight[q];
        reaction += weight * a.reaction[i];
        Float4 total = {};
        auto spread = [&](std::int32_t j, Float4 value) {
          const Float4 part = equal_share(p.start[j + 1] - p.start[j]) * value;
          for (std::int64_t k = p.start[j]; k < p.start[j + 1]; ++k) {
            const std::int32_t other = p.parent[k];
            const int slot = slot_of(coarse.key[row], coarse.key[other]);
            if (column[slot] < 0) column[slot] = other;
            if (column[slot] == other) {
              sum[slot] += part;
              continue;
            }
            auto at = std::find_if(further.begin(), further.end(), [&](const auto& f) { return f.first == other; });
            if (at == further.end()) at = further.insert(at, {other, Float4{}});
            at->second += part;
          }
        };
        for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k) {
          const Float4 value = weight * a.coupling[k];
          total += value;
          spread(a.column[k], value);
        }
        spread(i, -total);
      }
      std::int32_t length = 0;
      for (int slot = 0; slot < 54; ++slot) {
        if (column[slot] < 0 || column[slot] == static_cast<std::int32_t>(row)) continue;
        rows.column.push_back(column[slot]);
        rows.coupling.push_back(sum[slot]);
        ++length;
      }
      for (const auto& [other, value] : further) {
        if (other == static_cast<std::int32_t>(row)) continue;
        rows.column.push_back(other);
        rows.coupling.push_back(value);
        ++length;
      }
      rows.length.push_back(length);
      coarse.own.reaction[row] = reaction;
    }
  });
  coarse.own.row_start.assign(1, 0);
  for (const Rows& rows : parts) {
    for (std::int32_t length : rows.length) coarse.own.row_start.push_back(coarse.own.row_start.back() + length);
    coarse.own.column.insert(coarse.own.column.end(), rows.column.begin(), rows.column.end());
    coarse.own.coupling.insert(coarse.own.coupling.end(), rows.coupling.begin(), rows.coupling.end());
  }
  levels_.push_back(std::move(coarse));
}

void Multigrid::prepare_coarsest() {
  const Level& level = levels_.back();
  const Operator& a = *level.matrix;
  const std::size_t n = level.key.size();
  direct_ = n <= 4 * parameters_.coarsest_size;
  if (!direct_) return;
  parallel_for(
      3,
      [&](std::size_t c) {
        Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(n, n);
        for (std::size_t i = 0; i < n; ++i) {
          dense(i, i) += a.reaction[i][c];
          for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k) {
            // Both directions' rounding averaged.
            const double half = 0.5 * a.coupling[k][c];
            const std::int32_t j = a.column[k];
            dense(i, j) -= half;
            dense(j, i) -= half;
            dense(i, i) += half;
            dense(j, j) += half;
          }
        }
        // Coarse outer points off the surface's plane may repeat each other: a trace of a shift keeps them apart.
        const double shift = 1e-9 * dense.diagonal().maxCoeff();
        for (std::size_t i = 0; i < n; ++i) dense(i, i) += 1e-7 * dense(i, i) + shift;
        coarsest_[c].compute(dense);
      },
      1);
}

Multigrid::Multigrid(const PolygridSystem& system, const MultigridParameters& parameters) : parameters_(parameters) {
  levels_.reserve(system.transfers.size() + 1);
  finest_ = single_precision(system.matrix);
  levels_.emplace_back();
  levels_.back().key = system.key;
  levels_.back().matrix = &finest_;
  prepare_smoother(levels_.back());
  for (const UnknownTransfer& transfer : system.transfers) {
    if (levels_.back().key.size() <= parameters_.coarsest_size ||
        transfer.key.size() * 10 > levels_.back().key.size() * 9)
      break;
    coarsen(transfer);
    levels_.back().matrix = &levels_.back().own;
    prepare_smoother(levels_.back());
  }
  for (Level& level : levels_)
    for (auto* vector : {&level.x, &level.right_side, &level.residual, &level.step})
      vector->assign(level.key.size(), Float4{});
  prepare_coarsest();
}

std::vector<std::size_t> Multigrid::level_sizes() const {
  std::vector<std::size_t> sizes;
  for (const Level& level : levels_) sizes.push_back(level.key.size());
  return sizes;
}

void Multigrid::residual(Level& level) const {
  const Operator& a = *level.matrix;
  parallel_for(
      level.x.size(),
      [&](std::size_t i) {
        const Float4 own = level.x[i];
        Float4 sum = level.right_side[i] - a.reaction[i] * own;
        for (std::int64_t k = a.row_start[i]; k < a.row_start[i + 1]; ++k)
          sum -= a.coupling[k] * (own - level.x[a.column[k]]);
        level.residual[i] = sum;
      },
      grain);
}

// Chebyshev's polynomials of the fourth kind, which need an upper bound of the spectrum only.
// Source: [Lottes2022 alg. 3.1].
void Multigrid::smooth(Level& level, bool from_zero) const {
  const auto bound = static_cast<float>(parameters_.spectral_bound);
  const std::size_t n = level.x.size();
  for (int k = 1; k <= parameters_.smoothing_degree; ++k) {
    const bool zero = from_zero && k == 1;
    if (!zero) residual(level);
    const std::vector<Float4>& r = zero ? level.right_side : level.residual;
    const float keep = static_cast<float>(2 * k - 3) / static_cast<float>(2 * k + 1);
    const float take = static_cast<float>(8 * k - 4) / static_cast<float>(2 * k + 1) / bound;
    parallel_for(
        n,
        [&](std::size_t i) {
          Float4 z = take * (level.inverse_own[i] * r[i] + level.inverse_partner[i] * r[level.partner[i]]);
          if (k > 1) z += keep * level.step[i];
          level.step[i] = z;
          level.x[i] = zero ? z : level.x[i] + z;
        },
        4 * grain);
  }
}

void Multigrid::solve_coarsest(Level& level) const {
  const std::size_t n = level.key.size();
  for (int c = 0; c < 3; ++c) {
    Eigen::VectorXd b(n);
    for (std::size_t i = 0; i < n; ++i) b[i] = level.right_side[i][c];
    const Eigen::VectorXd x = coarsest_[c].solve(b);
    for (std::size_t i = 0; i < n; ++i) level.x[i][c] = static_cast<float>(x[i]);
  }
}

void Multigrid::cycle(std::size_t index) {
  Level& level = levels_[index];
  if (index + 1 == levels_.size()) {
    if (direct_) {
      solve_coarsest(level);
    } else {
      smooth(level, true);
      for (int sweep = 0; sweep < 20; ++sweep) smooth(level, false);
    }
    return;
  }
  smooth(level, true);
  residual(level);
  Level& coarse = levels_[index + 1];
  parallel_for(
      coarse.x.size(),
      [&](std::size_t i) {
        Float4 sum = {};
        for (std::int64_t k = level.restriction.start[i]; k < level.restriction.start[i + 1]; ++k)
          sum += level.restriction.weight[k] * level.residual[level.restriction.index[k]];
        coarse.right_side[i] = sum;
      },
      grain);
  cycle(index + 1);
  parallel_for(
      level.x.size(),
      [&](std::size_t i) {
        const UnknownTransfer& p = level.prolongation;
        Float4 sum = {};
        for (std::int64_t k = p.start[i]; k < p.start[i + 1]; ++k) sum += coarse.x[p.parent[k]];
        level.x[i] += equal_share(p.start[i + 1] - p.start[i]) * sum;
      },
      4 * grain);
  smooth(level, false);
}

void Multigrid::apply(const std::vector<Double4>& residual, std::vector<Double4>& correction) {
  Level& finest = levels_.front();
  // Scaled to size one, so that tiny and huge lights keep single precision's range.
  Double4 size = {};
  for (const Double4& r : residual)
    for (int c = 0; c < 3; ++c) size[c] = std::max(size[c], std::abs(r[c]));
  const Double4 inverse = safe_quotient(Double4{1, 1, 1, 0}, size);
  for (std::size_t i = 0; i < residual.size(); ++i) finest.right_side[i] = to_float(residual[i] * inverse);
  cycle(0);
  correction.resize(residual.size());
  for (std::size_t i = 0; i < residual.size(); ++i) correction[i] = to_double(finest.x[i]) * size;
}

SolveReport solve_conjugate_gradients(const PolygridSystem& system, Multigrid& multigrid,
                                      const std::vector<Double4>& source, const std::vector<Double4>& irradiance,
                                      double tolerance, int most_iterations, std::vector<Double4>& fluence) {
  const std::size_t n = source.size();
  SolveReport report;
  report.tolerance = tolerance;
  report.unknowns = n;
  report.level_sizes = multigrid.level_sizes();
  const Double4 zero = {};
  auto dot = [&](const std::vector<Double4>& a, const std::vector<Double4>& b) {
    return parallel_sum(n, zero, [&](std::size_t i) { return a[i] * b[i]; });
  };
  auto fail = [&](const std::string& what) {
    throw NumericalError("diffusion: " + what + " after " + std::to_string(report.iterations) +
                         " iterations; relative residuals" + history_text(report));
  };

  std::vector<Double4> r(n), z, direction(n), image, last_r(n);
  if (fluence.size() == n) {
    system.matrix.apply(fluence, image);
    for (std::size_t i = 0; i < n; ++i) r[i] = source[i] - image[i];
  } else {
    fluence.assign(n, zero);
    r = source;
  }
  const Double4 source_norm = dot(source, source);
  for (int c = 0; c < 3; ++c)
    if (!std::isfinite(source_norm[c])) fail("the light is not finite");

  const double half_inverse_factor = 1 / (2 * system.boundary_factor);
  // The error left is about the next correction, of which D3 sees the surface's part.
  auto estimate = [&]() {
    const std::vector<Double4> exitance = boundary_exitance(system, fluence, irradiance);
    const Double4 size =
        parallel_sum(n, zero, [&](std::size_t i) { return system.boundary_area[i] * exitance[i] * exitance[i]; });
    const Double4 error = parallel_sum(n, zero, [&](std::size_t i) {
      const Double4 e = 1.5 * half_inverse_factor * z[i];
      return system.boundary_area[i] * e * e;
    });
    double worst = 0;
    for (int c = 0; c < 3; ++c) {
      if (error[c] == 0) continue;
      worst = std::max(worst, size[c] > 0 ? std::sqrt(error[c] / size[c]) : 1.0);
    }
    return worst;
  };

  Double4 last_energy = {};
  int restarts = 0;
  bool fresh = true;  // the next direction is the preconditioned residual itself
  for (;; ++report.iterations) {
    multigrid.apply(r, z);
    const Double4 energy = dot(r, z), square = dot(r, r);
    double worst_residual = 0;
    for (int c = 0; c < 3; ++c) {
      if (source_norm[c] > 0) worst_residual = std::max(worst_residual, std::sqrt(square[c] / source_norm[c]));
      if (!std::isfinite(energy[c]) || !std::isfinite(square[c])) fail("a number that is not finite appeared");
    }
    report.residual_history.push_back(worst_residual);
    report.estimated_error = estimate();
    report.error_history.push_back(report.estimated_error);
    if (report.estimated_error <= tolerance) {
      // The updated residual drifts from the true one; only the true one counts.
      system.matrix.apply(fluence, image);
      const Double4 drift = parallel_sum(n, zero, [&](std::size_t i) {
        const Double4 d = source[i] - image[i] - r[i];
        return d * d;
      });
      bool settled = true;
      for (int c = 0; c < 3; ++c) settled = settled && drift[c] <= 0.01 * square[c];
      if (settled) break;
      if (++restarts > 5) fail("the tolerance " + number_text(tolerance) + " is below rounding");
      for (std::size_t i = 0; i < n; ++i) r[i] = source[i] - image[i];
      report.residual_history.pop_back();
      report.error_history.pop_back();
      fresh = true;
      --report.iterations;
      continue;
    }
    for (int c = 0; c < 3; ++c)
      if (energy[c] < 0) fail("the preconditioner is indefinite");
    if (report.iterations >= most_iterations) fail("no convergence to " + number_text(tolerance));

    // Polak and Ribière's form forgives the single precision of the preconditioner.
    const Double4 factor = fresh ? zero : safe_quotient(energy - dot(last_r, z), last_energy);
    parallel_for(
        n, [&](std::size_t i) { direction[i] = z[i] + factor * direction[i]; }, 4 * grain);
    system.matrix.apply(direction, image);
    const Double4 curvature = dot(direction, image);
    for (int c = 0; c < 3; ++c)
      if (curvature[c] < 0 || !std::isfinite(curvature[c])) fail("the system is not positive definite");
    const Double4 length = safe_quotient(dot(direction, r), curvature);
    parallel_for(
        n,
        [&](std::size_t i) {
          fluence[i] += length * direction[i];
          last_r[i] = r[i];
          r[i] -= length * image[i];
        },
        4 * grain);
    last_energy = energy;
    fresh = false;
  }

  // The constant whose residual sums to nothing: D4 exactly.
  for (int pass = 0; pass < 2; ++pass) {
    system.matrix.apply(fluence, image);
    const Double4 defect = parallel_sum(n, zero, [&](std::size_t i) { return source[i] - image[i]; });
    const Double4 reaction = parallel_sum(n, zero, [&](std::size_t i) { return system.matrix.reaction[i]; });
    const Double4 shift = safe_quotient(defect, reaction);
    for (Double4& value : fluence) value += shift;
  }
  return report;
}

}  // namespace shellgrid
