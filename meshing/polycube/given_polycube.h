// SPDX-License-Identifier: AGPL-3.0-or-later
// A polycube that its user hands in: checked, and laid over the object.
#pragma once
#include <optional>
#include <vector>

#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"
#include "meshing/polycube/voxel_polycube.h"

namespace shellgrid {

// Cubes of a lattice as their author wrote them down.
struct CubeList {
  std::vector<Vec3i> cubes;    // in any order, at any place of Z³
  bool placed = false;         // whether it is known where they lie:
  Vec3 origin = Vec3::Zero();  // mm, the lower corner of cube (0, 0, 0)
  double edge = 0;             // mm
};

// The cubes that a mesh of axis-aligned faces encloses, whose edge is the greatest that fits all vertices. Faces
// between two cubes do not matter. Throws: InputError for a slanted face, vertices on no common lattice, an open mesh.
CubeList cubes_of_mesh(const TriangleMesh& mesh);

enum class CubePlacement {
  automatic,  // as the file says where that covers a quarter of the object and more, else as `box`
  file,       // as the file says
  box         // about the middle of the object's bounding box, of the same volume as that
};

struct GivenPolycubeOptions {
  double nodes = 1e5;  // wanted in the polygrid, where grid is 0
  int grid = 0;        // cells along a cube's edge
  CubePlacement placement = CubePlacement::automatic;
  std::optional<Vec3> origin;  // mm; overrides the placement
  std::optional<double> edge;  // mm
};

struct GivenPolycube {
  VoxelPolycube polycube;
  CubePlacement placement = CubePlacement::box;  // the one that was taken
  double covered = 0;                            // share of the object's volume that lies in the cubes
  double overlap = 0;                            // volume of the intersection over that of the union
};

// Makes a polycube of given cubes. Throws: InputError where there are none, one is listed twice, they fall into parts
// that share no face, their surface is no manifold or encloses a cavity, they are too many or too far apart, or hardly
// overlap the object. Another genus than the object's is allowed; the result tells both.
GivenPolycube place_given_polycube(const CubeList& list, const TriangleMesh& surface,
                                   const GivenPolycubeOptions& options);

}  // namespace shellgrid
