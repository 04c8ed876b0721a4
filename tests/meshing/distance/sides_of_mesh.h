// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid::test {

// By CGAL: 1 inside a closed mesh, −1 outside, 0 on it.
std::vector<char> sides_of_mesh(const TriangleMesh& mesh, const std::vector<Vec3>& points);

}  // namespace shellgrid::test
