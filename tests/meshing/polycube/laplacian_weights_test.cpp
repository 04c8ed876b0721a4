// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/laplacian_weights.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "meshing/core/random.h"

namespace shellgrid {
namespace {

TEST(LaplacianWeights, are_exact_for_quadratics_without_cross_terms_on_unequal_steps) {
  const std::array<Vec3, 6> offsets = {Vec3(-0.7, 0, 0), Vec3(1.1, 0, 0), Vec3(0, -0.9, 0),
                                       Vec3(0, 0.4, 0),  Vec3(0, 0, -1),  Vec3(0, 0, 0.1)};
  const LaplacianWeights weights = laplacian_weights(offsets, 1, 1e4);
  EXPECT_EQ(weights.method, WeightMethod::appendix_b);
  const auto f = [](const Vec3& x) {
    return 2 + 3 * x.x() - x.y() + 0.5 * x.z() + 1.5 * x.x() * x.x() - 2 * x.y() * x.y() + 4 * x.z() * x.z();
  };
  double laplacian = 0;
  for (int j = 0; j < 6; ++j) laplacian += weights.weights[j] * (f(offsets[j]) - f(Vec3::Zero()));
  EXPECT_NEAR(laplacian, 2 * (1.5 - 2 + 4), 1e-10);
}

TEST(LaplacianWeights, do_not_depend_on_the_frame) {
  const std::array<Vec3, 6> offsets = {Vec3(-0.7, 0.1, 0), Vec3(1.1, 0, 0.1), Vec3(0, -0.9, 0.05),
                                       Vec3(0.1, 0.8, 0),  Vec3(0, 0.1, -1),  Vec3(0, 0, 0.6)};
  const Mat3 rotation = Eigen::AngleAxisd(0.9, Vec3(1, 2, 3).normalized()).toRotationMatrix();
  std::array<Vec3, 6> turned;
  for (int j = 0; j < 6; ++j) turned[j] = rotation * offsets[j];
  const LaplacianWeights a = laplacian_weights(offsets, 1), b = laplacian_weights(turned, 1);
  for (int j = 0; j < 6; ++j) EXPECT_NEAR(a.weights[j], b.weights[j], 1e-9);
}

TEST(LaplacianWeights, stay_finite_and_positive_where_links_coincide) {
  const std::array<Vec3, 6> offsets = {Vec3(-1, 0, 0), Vec3(1, 0, 0),  Vec3(-1, 0, 0),
                                       Vec3(1, 0, 0),  Vec3(0, 0, -1), Vec3(0, 0, 1)};
  EXPECT_EQ(laplacian_weights(offsets, 1).method, WeightMethod::least_squares);
  EXPECT_EQ(laplacian_weights(offsets, 1, 1e12).method, WeightMethod::three_lines);
  for (const double limit : {ill_conditioned, 1e12}) {
    double sum = 0;
    for (double w : laplacian_weights(offsets, 1, limit).weights) {
      EXPECT_GE(w, 0);
      sum += w;
    }
    EXPECT_GT(sum, 3);
  }
}

TEST(LaplacianWeights, are_of_three_lines_where_all_links_lead_to_one_side) {
  const std::array<Vec3, 6> offsets = {Vec3(-1, 0, 0.2), Vec3(1, 0, 0.2),   Vec3(0, -1, 0.2),
                                       Vec3(0, 1, 0.2),  Vec3(0.3, 0, 0.3), Vec3(0, 0, 1)};
  const LaplacianWeights weights = laplacian_weights(offsets, 1, 1);
  EXPECT_EQ(weights.method, WeightMethod::three_lines);
  for (double w : weights.weights) EXPECT_GT(w, 0);
}

// A stencil of unit steps, bent by random offsets of up to `bend`.
std::array<Vec3, 6> bent_stencil(std::uint64_t number, double bend) {
  std::array<Vec3, 6> offsets;
  for (int j = 0; j < 6; ++j) {
    offsets[j] = (j & 1 ? 1 : -1) * Vec3::Unit(j / 2);
    for (int axis = 0; axis < 3; ++axis) offsets[j][axis] += bend * (2 * to_unit(hash64(number, j, axis)) - 1);
  }
  return offsets;
}

// The greatest error for quadratics, and for cubics, whose second (third) derivatives have unit Frobenius norm.
struct Errors {
  double linear, quadratic, cubic;
};
Errors errors_of(const std::array<double, 6>& weights, const std::array<Vec3, 6>& offsets) {
  Vec3 first = Vec3::Zero();
  Mat3 second = -2 * Mat3::Identity();
  double third = 0;
  for (int j = 0; j < 6; ++j) {
    first += weights[j] * offsets[j];
    second += weights[j] * offsets[j] * offsets[j].transpose();
  }
  for (int a = 0; a < 3; ++a)
    for (int b = 0; b < 3; ++b)
      for (int c = 0; c < 3; ++c) {
        double sum = 0;
        for (int j = 0; j < 6; ++j) sum += weights[j] * offsets[j][a] * offsets[j][b] * offsets[j][c] / 6;
        third += sum * sum;
      }
  return {first.norm(), 0.5 * second.norm(), std::sqrt(third)};
}

TEST(LaplacianWeights, of_least_squares_err_less_where_appendix_b_is_ill_conditioned) {
  std::vector<double> quadratic[2], cubic[2];
  int negative = 0;
  for (std::uint64_t number = 0; quadratic[0].size() < 500; ++number) {
    const std::array<Vec3, 6> offsets = bent_stencil(number, 0.8);
    const LaplacianWeights appendix = laplacian_weights(offsets, 1, 1e12), squares = laplacian_weights(offsets, 1);
    EXPECT_EQ(appendix.method, WeightMethod::appendix_b);
    if (appendix.condition <= ill_conditioned) {
      EXPECT_EQ(appendix.weights, squares.weights);
      continue;
    }
    if (squares.method != WeightMethod::least_squares) continue;
    const Errors with = errors_of(squares.weights, offsets), without = errors_of(appendix.weights, offsets);
    EXPECT_LT(with.linear, 2e-2);
    quadratic[0].push_back(without.quadratic), quadratic[1].push_back(with.quadratic);
    cubic[0].push_back(without.cubic), cubic[1].push_back(with.cubic);
    for (double w : squares.weights) EXPECT_GE(w, 0);
    negative += *std::min_element(appendix.weights.begin(), appendix.weights.end()) < 0;
  }
  for (auto* errors : {quadratic, cubic})
    for (int k = 0; k < 2; ++k) std::sort(errors[k].begin(), errors[k].end());
  for (const auto& [rank, quadratic_gain, cubic_gain] : {std::array{250.0, 1.5, 2.0}, std::array{475.0, 5.0, 5.0}}) {
    const auto r = static_cast<std::size_t>(rank);
    EXPECT_LT(quadratic_gain * quadratic[1][r], quadratic[0][r]) << quadratic[1][r] << " " << quadratic[0][r];
    EXPECT_LT(cubic_gain * cubic[1][r], cubic[0][r]) << cubic[1][r] << " " << cubic[0][r];
  }
  EXPECT_GT(negative, 300);
}

TEST(LaplacianWeights, of_least_squares_are_those_of_an_orthogonal_stencil_and_need_no_frame) {
  const std::array<Vec3, 6> straight = bent_stencil(0, 0);
  for (double w : laplacian_weights(straight, 1, 1).weights) EXPECT_NEAR(w, 1, 1e-5);
  const std::array<Vec3, 6> offsets = bent_stencil(5, 0.5);
  const Mat3 rotation = Eigen::AngleAxisd(0.9, Vec3(1, 2, 3).normalized()).toRotationMatrix();
  std::array<Vec3, 6> turned;
  for (int j = 0; j < 6; ++j) turned[j] = 3 * rotation * offsets[j];
  const LaplacianWeights a = laplacian_weights(offsets, 1, 1), b = laplacian_weights(turned, 3, 1);
  EXPECT_EQ(a.method, WeightMethod::least_squares);
  for (int j = 0; j < 6; ++j) EXPECT_NEAR(a.weights[j], 9 * b.weights[j], 1e-7);
}

}  // namespace
}  // namespace shellgrid
