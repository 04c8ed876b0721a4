// SPDX-License-Identifier: AGPL-3.0-or-later
// Cells whose octants conduct differently: layers, equal octants, pockets.
#include "solvers/diffusion/divided_cell.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <functional>

#include "meshing/core/random.h"
#include "solvers/diffusion/trilinear_cell.h"

namespace shellgrid {
namespace {

using Matrix8 = Eigen::Matrix<double, 8, 8>;

struct Element {
  double metric[8][6], diffusion[8], loss[8] = {}, coupling[28], absorption[8];

  // A parallelepiped with edges `j`'s rows; D of each octant.
  Element(const Mat3& j, const std::function<double(int octant)>& conducts) {
    const Mat3 inverse = j.inverse();
    const Mat3 m = j.determinant() / 8 * inverse.transpose() * inverse;
    for (int q = 0; q < 8; ++q) {
      const double entries[6] = {m(0, 0), m(1, 1), m(2, 2), m(0, 1), m(0, 2), m(1, 2)};
      std::copy(entries, entries + 6, metric[q]);
      diffusion[q] = conducts(q);
      loss[q] = to_unit(hash64(3, q));
    }
    divided_element(metric, diffusion, loss, coupling, absorption);
  }
  Matrix8 matrix() const {
    Matrix8 k = Matrix8::Zero();
    int pair = 0;
    for (int a = 0; a < 8; ++a)
      for (int b = a + 1; b < 8; ++b, ++pair) {
        k(a, b) = k(b, a) = -coupling[pair];
        k(a, a) += coupling[pair];
        k(b, b) += coupling[pair];
      }
    return k;
  }
};

// Corners by bits, of the plain trilinear element for D = 1.
Matrix8 trilinear(const Mat3& j) {
  Matrix8 k = Matrix8::Zero();
  constexpr int vtk_of_bits[8] = {0, 1, 3, 2, 4, 5, 7, 6};
  for (const TrilinearShape& shape : TrilinearQuadrature::instance().gauss) {
    const Eigen::Matrix<double, 8, 3> gradient = shape.gradient * j.inverse().transpose();
    for (int a = 0; a < 8; ++a)
      for (int b = 0; b < 8; ++b)
        k(a, b) += j.determinant() / 8 * gradient.row(vtk_of_bits[a]).dot(gradient.row(vtk_of_bits[b]));
  }
  return k;
}

Mat3 sheared() {
  Mat3 j;
  j << 2, 0.3, 0.1, 0.4, 1, -0.2, 0, 0.5, 3;
  return j;
}

Eigen::VectorXd values(const std::function<double(int)>& of) {
  Eigen::VectorXd v(8);
  for (int a = 0; a < 8; ++a) v[a] = of(a);
  return v;
}

TEST(DividedCell, IsTheTrilinearOneWhereOctantsAreEqual) {
  const Matrix8 k = Element(sheared(), [](int) { return 2.5; }).matrix();
  EXPECT_LT((k - 2.5 * trilinear(sheared())).cwiseAbs().maxCoeff(), 1e-6 * k.cwiseAbs().maxCoeff());
}

TEST(DividedCell, ConductsExactlyAcrossLayersAndAlongThem) {
  const Mat3 j = Eigen::Vector3d(2, 3, 5).asDiagonal();
  for (int axis = 0; axis < 3; ++axis)
    for (const double ratio : {3.0, 1e6}) {
      const Matrix8 k = Element(j, [&](int q) { return q >> axis & 1 ? 1 : ratio; }).matrix();
      for (int flow = 0; flow < 3; ++flow) {
        const Eigen::VectorXd u = values([&](int a) { return a >> flow & 1; });
        const double geometry = 30 / (j(flow, flow) * j(flow, flow));
        const double mean = flow == axis ? 2 * ratio / (1 + ratio) : (1 + ratio) / 2;
        EXPECT_NEAR(u.dot(k * u), mean * geometry, 1e-5 * mean * geometry) << axis << ' ' << flow << ' ' << ratio;
        // The same flow through every face: what one corner gives up another takes.
        EXPECT_NEAR((k * u).sum(), 0, 1e-9 * ratio);
      }
    }
}

// One octant conducts a million times as well: alone among insulating ones it costs its corner next to nothing, where
// the trilinear element with a D at each Gauss point has it pay D.
TEST(DividedCell, APocketIsNoBridge) {
  for (int pocket = 0; pocket < 8; ++pocket) {
    const Matrix8 k = Element(sheared(), [&](int q) { return q == pocket ? 1e6 : 1.0; }).matrix();
    const Matrix8 whole = trilinear(sheared());
    const Eigen::VectorXd u = values([&](int a) { return a == pocket; });
    EXPECT_LT(u.dot(k * u), 20 * whole(pocket, pocket));
    // Elements stay positive, and constants free.
    const Eigen::SelfAdjointEigenSolver<Matrix8> eigen(k);
    EXPECT_GT(eigen.eigenvalues()[1], 0.01 * Eigen::SelfAdjointEigenSolver<Matrix8>(whole).eigenvalues()[1]);
    EXPECT_NEAR(eigen.eigenvalues()[0], 0, 1e-6);
  }
}

TEST(DividedCell, AbsorbsWhatItsOctantsDo) {
  const Element e(sheared(), [](int q) { return to_unit(hash64(9, q)) + 0.01; });
  double lost = 0, absorbed = 0;
  for (int q = 0; q < 8; ++q) {
    lost += e.loss[q];
    absorbed += e.absorption[q];
    EXPECT_GT(e.absorption[q], 0);
  }
  EXPECT_NEAR(absorbed, lost, 1e-6 * lost);
}

}  // namespace
}  // namespace shellgrid
