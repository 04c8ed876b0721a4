// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/triangle_mesh.h"

namespace shellgrid::test {

// CGAL's isotropic remeshing to an edge length, projecting on the input; edges sharper than `feature_angle` degrees
// are kept.
TriangleMesh isotropic_remeshing(const TriangleMesh& mesh, double edge_length, double feature_angle, int iterations);

}  // namespace shellgrid::test
