// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <functional>
#include <vector>

#include "synthesis/tangent_neighbours.h"
#include "synthesis/texton_set.h"

namespace shellgrid {

// Lowers the distance of the surface's 5×5 windows to the samples' directly: in turns every vertex finds the place
// whose window is most like its own, among the places of its neighbours' windows and the candidates most like these,
// and then takes, of all that the windows around it say it should be, what is nearest to their mean. Source:
// [Kwatra2005], discrete as in [Han2006]. exhaustive: look at every texel of the samples besides. place: n, of every
// mesh vertex, improved. allowed(vertex, sample): whether the sample may be there. Returns how many windows were
// compared. The same at any thread count.
long optimize_windows(const TexturedSurface& surface, const VertexHierarchy::Level& finest, const TextonSet& textons,
                      int passes, bool exhaustive, const std::function<bool(std::int32_t, int)>& allowed,
                      std::vector<LayerPlace>& place);

}  // namespace shellgrid
