// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <vector>

#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

// A handle of a surface: a short closed curve on it that does not part it.
struct SurfaceHandle {
  Vec3 centre = Vec3::Zero();  // of the curve
  double length = 0;
};

// Up to `most` handles of a closed oriented surface, none of which goes over another: each is a short loop of a tree of
// shortest paths and its dual tree, along which the surface is then cut and closed. The shortest come first, about.
// Source: [Erickson2005 §3] for the loops of one root.
// Deviates: the loops are short, not the shortest: two roots are tried for each.
std::vector<SurfaceHandle> find_handles(const TriangleMesh& surface, int most);

}  // namespace shellgrid
