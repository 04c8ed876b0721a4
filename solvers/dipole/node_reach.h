// SPDX-License-Identifier: AGPL-3.0-or-later
// From where on the nodes of a tree may stand for their points.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "solvers/dipole/point_tree.h"
#include "solvers/dipole/radial_profile.h"

namespace shellgrid {

// How exact a pair of nodes has to be: each grade allows four times the relative error of the one before.
constexpr int reach_grades = 4;

// From where on a node may be interpolated at each grade and order, per channel, and how many points an order takes.
struct NodeReach {
  float squared_distance[reach_grades][PointTree::orders][3];
  int size[PointTree::orders];
};

// Of each node. A bound of the relative error of interpolating e^{−kr} r^{−3} at n Chebyshev points over the half
// extent h of each axis, by the function's derivatives, holds for the worst place of the nearest pair along the worst
// axis. Most pairs add far less than it to a sum, and with either sign: three times the tolerance is allowed to it,
// half of that where a node's points lie along a line, so that errors of neighbours do not cancel; that leaves a fifth
// to two thirds of the tolerance. tolerance: relative, of the first grade.
std::vector<NodeReach> reaches_of(const PointTree& tree, const RadialProfile& profile, double tolerance);

}  // namespace shellgrid
