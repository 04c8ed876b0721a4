// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include "meshing/core/progress.h"
#include "meshing/core/triangle_mesh.h"

namespace shellgrid {

struct RewrapReport {
  double resolution = 0;       // what was asked for, in the mesh's units
  double to_input = 0;         // sampled distance from the wrap to the mesh, in the mesh's units
  double from_input = 0;       // and back; of parts inside others too
  int dropped_components = 0;  // of the wrap, all but the largest
  double dropped_volume = 0;   // their share of the volume
};

// Wraps any heap of triangles, however open, crossing, doubled or disconnected, in one closed, manifold surface that
// does not cross itself: the outer boundary of what a ball of radius `resolution` cannot reach, a tenth of it off the
// triangles. Holes and gaps narrower than about twice the resolution are closed; cavities without an opening
// are filled. Runs in a guarded child with limits of time and memory. Source: [Portaneri2022].
// resolution: in the mesh's units, > 0.
// Throws: InputError for a mesh without triangles, or where wrapping fails or takes too long or too much.
TriangleMesh rewrap_surface(const TriangleMesh& mesh, double resolution, RewrapReport& report,
                            Progress& progress = no_progress());

// The wrap itself, with every component, in this process. alpha, offset: in the mesh's units, > 0.
TriangleMesh wrap_triangles(const TriangleMesh& mesh, double alpha, double offset);

}  // namespace shellgrid
