// SPDX-License-Identifier: AGPL-3.0-or-later
// The shared words for points, colours and index matrices.
// Lengths are millimetres, coefficients per millimetre, everywhere.
#pragma once
#include <Eigen/Core>
#include <cstdint>

namespace shellgrid {

using Vec2 = Eigen::Vector2d;
using Vec3 = Eigen::Vector3d;
using Vec2f = Eigen::Vector2f;
using Vec3f = Eigen::Vector3f;
using Vec3i = Eigen::Vector3i;
using Mat3 = Eigen::Matrix3d;

// Three colour channels R, G, B; arithmetic is componentwise.
using Rgb = Eigen::Array3f;

// Row matrices in libigl's sense: one point, triangle, quadrilateral, tetrahedron or hexahedron a row.
using VertexMatrix = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
using FaceMatrix = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 3, Eigen::RowMajor>;
using QuadMatrix = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
using TetMatrix = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 4, Eigen::RowMajor>;
using HexMatrix = Eigen::Matrix<std::int32_t, Eigen::Dynamic, 8, Eigen::RowMajor>;

}  // namespace shellgrid
