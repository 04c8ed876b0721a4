// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/dipole/radial_profile.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

constexpr double accuracy = 5e-4, least_share = 1e-20;

// Nodes and weights of eight-point Gauss quadrature on [−1, 1].
constexpr double gauss_nodes[4] = {0.1834346424956498, 0.5255324099163290, 0.7966664774136267, 0.9602898564975363};
constexpr double gauss_weights[4] = {0.3626837833783620, 0.3137066458778873, 0.2223810344533745, 0.1012285362903763};

template <class F>
double integral(const F& f, double from, double to) {
  double sum = 0;
  const double middle = (from + to) / 2, half = (to - from) / 2;
  for (int i = 0; i < 4; ++i)
    sum += gauss_weights[i] * (f(middle - half * gauss_nodes[i]) + f(middle + half * gauss_nodes[i]));
  return sum * half;
}

// The same by the Laplacian: where the function hardly bends over the disc.
double gently_bent_mean(const std::function<double(double)>& f, double r, double a) {
  const double h = a / 2, at = f(r), before = f(r - h), after = f(r + h);
  return at + a * a / 8 * ((before - 2 * at + after) / (h * h) + (after - before) / (2 * h * r));
}

// The mean of f over the disc of radius a in the plane whose middle is r away: rings about the target, each by the
// share of it that the disc covers. Pieces grow from where f varies fastest.
double disc_mean(const std::function<double(double)>& f, double r, double a, double width) {
  constexpr double pi = std::numbers::pi;
  const double least = std::abs(r - a), most = r + a;
  double sum = 0;
  const auto pieces = [&](double from, double to, const auto& weight, bool root_at_from, bool root_at_to) {
    if (!(to > from)) return;
    double at = from;
    while (at < to) {
      double next = std::min(to, at + 0.5 * std::max(width, at));
      if (to - next < 0.1 * (next - at)) next = to;
      // The covered angle has square roots at the ends: substituted away.
      if (root_at_from && at == from) {
        sum += integral([&](double s) { return 2 * s * weight(from + s * s); }, 0, std::sqrt((next - from) / 2));
        at = from + (next - from) / 2;
      }
      if (root_at_to && next == to) {
        const double middle = at + (to - at) / 2;
        sum += integral(weight, at, middle);
        sum += integral([&](double s) { return 2 * s * weight(to - s * s); }, 0, std::sqrt(to - middle));
      } else {
        sum += integral(weight, at, next);
      }
      at = next;
    }
  };
  if (r < a)
    pieces(
        0, a - r, [&](double d) { return 2 * pi * d * f(d); }, false, false);
  if (r > 0)
    pieces(
        least, most,
        [&](double d) {
          const double cosine = d > 0 ? (d * d + r * r - a * a) / (2 * d * r) : -1;
          return 2 * d * std::acos(std::clamp(cosine, -1.0, 1.0)) * f(d);
        },
        true, true);
  return sum / (pi * a * a);
}

}  // namespace

RadialProfile::RadialProfile(const Channels& channels, double averaged) {
  if (!(averaged >= 0)) throw InputError("a radial profile is averaged over a disc of no size");
  table_.assign(1, Node{});
  double narrowest = std::numeric_limits<double>::infinity();
  double greatest[3], farthest = 0;
  const auto value = [&](int c, double r) {
    const Channel& channel = channels[c];
    if (averaged < 0.3 * channel.width) return channel.value(r);
    if (r > 6 * averaged && channel.decay * averaged < 0.5) return gently_bent_mean(channel.value, r, averaged);
    return disc_mean(channel.value, r, averaged, channel.width);
  };
  for (int c = 0; c < 3; ++c) {
    if (!(channels[c].width > 0) || !std::isfinite(channels[c].width))
      throw InputError("a radial profile needs a width above 0");
    decay_[c] = channels[c].decay;
    width_[c] = channels[c].width;
    greatest[c] = value(c, 0);
    if (!(greatest[c] >= 0) || !std::isfinite(greatest[c]))
      throw InputError("a radial profile is negative or not finite");
    if (!(greatest[c] > 0)) continue;
    narrowest = std::min(narrowest, width_[c]);
    double r = width_[c];
    while (r < 1e12 * width_[c] && channels[c].value(r) > least_share * greatest[c]) r *= 2;
    farthest = std::max(farthest, r);
  }
  if (!std::isfinite(narrowest)) return;  // black: all is 0
  offset_ = static_cast<float>(0.25 * narrowest * narrowest);
  const auto told = [&](int c, double r) {
    const double v = value(c, r);
    return v > least_share * greatest[c] ? static_cast<float>(v) : 0.0f;
  };
  const float top = static_cast<float>(std::min(farthest * farthest, 1e30));
  reach_ = std::sqrt(static_cast<double>(top));
  const auto distance_of = [&](std::uint32_t node, double part) {
    const auto u = static_cast<double>(std::bit_cast<float>((node + first_) << shift_));
    const auto v = static_cast<double>(std::bit_cast<float>((node + first_ + 1) << shift_));
    return std::sqrt(std::max(0.0, u + part * (v - u) - static_cast<double>(offset_)));
  };
  // From step to step half as far apart: between the nodes before are those values by which they were judged.
  std::vector<Float4> values, between;
  std::uint32_t first_before = 0;
  for (int bits = 5; bits <= 12; ++bits) {
    shift_ = 23 - bits;
    mask_ = (1u << shift_) - 1;
    per_node_ = 1 / static_cast<float>(1u << shift_);
    first_ = std::bit_cast<std::uint32_t>(offset_) >> shift_;
    last_ = (std::bit_cast<std::uint32_t>(offset_ + top) >> shift_) - first_ + 1;
    const std::vector<Float4> values_before = std::move(values), between_before = std::move(between);
    values.assign(last_ + 1, Float4{});
    between.assign(last_, Float4{});
    std::vector<float> errors(last_, 0);
    parallel_for(
        last_ + 1,
        [&](std::size_t i) {
          const auto node = static_cast<std::uint32_t>(i);
          const std::uint32_t before = ((node + first_) >> 1) - first_before;
          const bool is_between = ((node + first_) & 1) != 0;
          if (!values_before.empty() && (node + first_) >> 1 >= first_before &&
              before < (is_between ? between_before : values_before).size()) {
            values[i] = (is_between ? between_before : values_before)[before];
            return;
          }
          for (int c = 0; c < 3; ++c)
            if (greatest[c] > 0) values[i][c] = told(c, distance_of(node, 0));
        },
        64);
    parallel_for(
        last_,
        [&](std::size_t i) {
          for (int c = 0; c < 3; ++c) {
            if (!(greatest[c] > 0) || !(values[i][c] > 0)) continue;
            between[i][c] = told(c, distance_of(static_cast<std::uint32_t>(i), 0.5));
            if (!(values[i + 1][c] > 0)) continue;
            const double half = 0.5 * (static_cast<double>(values[i][c]) + static_cast<double>(values[i + 1][c]));
            errors[i] =
                std::max(errors[i], static_cast<float>(std::abs(half / static_cast<double>(between[i][c]) - 1)));
          }
        },
        64);
    first_before = first_;
    table_.assign(last_ + 1, Node{});
    for (std::uint32_t i = 0; i < last_; ++i) table_[i] = {values[i], values[i + 1] - values[i]};
    if (*std::max_element(errors.begin(), errors.end()) <= accuracy) break;
  }
}

Rgb RadialProfile::at(double r) const {
  const Float4 value = (*this)(static_cast<float>(r * r));
  return {value[0], value[1], value[2]};
}

}  // namespace shellgrid
