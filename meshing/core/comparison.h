// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

namespace shellgrid {

// How two lists of numbers differ; the second is the reference.
class Comparison {
 public:
  explicit Comparison(const std::string& name) : name_(name) {}

  // One pair. Equal infinities are equal; a pair of which one is not finite otherwise counts as a mismatch and
  // enters no sum.
  void add(double value, double reference) {
    ++count_;
    if (!std::isfinite(value) || !std::isfinite(reference)) {
      const bool same = value == reference || (std::isnan(value) && std::isnan(reference));
      mismatches_ += same ? 0 : 1;
      return;
    }
    const double difference = value - reference;
    squares_ += difference * difference;
    value_squares_ += value * value;
    reference_squares_ += reference * reference;
    value_sum_ += value;
    reference_sum_ += reference;
    maximum_ = std::max(maximum_, std::abs(difference));
    ++finite_;
  }

  const std::string& name() const { return name_; }
  std::size_t count() const { return count_; }
  std::size_t mismatches() const { return mismatches_; }
  double rmse() const { return finite_ == 0 ? 0 : std::sqrt(squares_ / static_cast<double>(finite_)); }
  // Makes relative() mean rmse() / scale, for distances, whose reference is zero.
  void set_scale(double scale) { scale_ = scale; }
  // ‖a − b‖ / ‖b‖; where the reference is zero, ‖a − b‖ / ‖a‖.
  double relative() const {
    if (scale_ > 0) return rmse() / scale_;
    const double scale = reference_squares_ > 0 ? reference_squares_ : value_squares_;
    return scale > 0 ? std::sqrt(squares_ / scale) : 0;
  }
  double maximum() const { return maximum_; }
  double mean() const { return finite_ == 0 ? 0 : value_sum_ / static_cast<double>(finite_); }
  double reference_mean() const { return finite_ == 0 ? 0 : reference_sum_ / static_cast<double>(finite_); }

 private:
  std::string name_;
  std::size_t count_ = 0, finite_ = 0, mismatches_ = 0;
  double squares_ = 0, value_squares_ = 0, reference_squares_ = 0, value_sum_ = 0, reference_sum_ = 0, maximum_ = 0,
         scale_ = 0;
};

}  // namespace shellgrid
