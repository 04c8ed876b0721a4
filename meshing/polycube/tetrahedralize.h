// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/progress.h"
#include "meshing/core/tetrahedral_mesh.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

struct TetrahedralizeOptions {
  int proxy_faces = 60000;     // a heavier surface is simplified to about so many faces first
  double limit_seconds = 120;  // processor time of the mesher's process
  // mm: inside, tetrahedra grow no larger than regular ones of about this edge, and are shaped well, for computing on
  // them; 0: as few as fill the surface. The surface's triangles stay as they are: they want the same edge.
  double spacing = 0;
};

struct TetrahedralizeResult {
  TetrahedralMesh mesh;
  double volume = 0;      // mm³
  int surface_faces = 0;  // of the surface that the tetrahedra fill
  bool simplified = false;
};

// Fills a closed surface with tetrahedra whose boundary is that surface, or its simplification: the
// polycube needs a volume of the right shape and genus at its blocks' scale, not every triangle. TetGen runs in
// a child process with limits, because it crashes on surfaces that cross themselves; where it fails on the
// simplified surface the given one is tried.
// Throws: InputError where the surface cannot be filled, or would take more than about 1e8 tetrahedra.
TetrahedralizeResult tetrahedralize(const TriangleMesh& surface, const TetrahedralizeOptions& options,
                                    Progress& progress = no_progress());

// The faces that belong to one tetrahedron only, facing outwards: a closed surface without unused points.
TriangleMesh boundary_of(const TetrahedralMesh& mesh);

// Simplifies a closed surface to about `faces` faces by quadric error, keeping its topology: of a shape that needs
// more to keep its faces' directions, more stay. Source: [GarlandHeckbert1997].
// Throws: InputError for a surface that is open or not a manifold.
TriangleMesh simplify_surface(const TriangleMesh& surface, int faces);

}  // namespace shellgrid
