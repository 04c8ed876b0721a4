// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <functional>
#include <vector>

#include "synthesis/synthesis_level.h"
#include "synthesis/texton_set.h"

namespace shellgrid {

struct WindowOptions {
  int passes = 4;
  bool exhaustive = false;  // look at every texel of the samples besides: a yardstick
  double evenness = 0;      // price of a place for each time that it is used more often than its share, in variances
};

// Lowers the distance of the surface's 5×5 windows at the step of a level to the samples' directly: in turns every
// vertex finds the place whose window is most like its own, among the places of its neighbours' windows, the candidates
// most like these and the nearest of all, and then takes, of all that the windows around it say it should be, what is
// nearest to their mean. Places in use more often than their share count as farther, so that rare features keep theirs.
// Source: [Kwatra2005], discrete as in [Han2006]; evenness in the spirit of [Kopf2007]'s histograms.
// level, neighbours: of the surface's level l. place: n, of every mesh vertex; those of the level are improved.
// allowed(vertex, sample): whether the sample may be there. Returns how many windows were compared. The same at any
// thread count.
long optimize_windows(const TexturedSurface& surface, const VertexHierarchy::Level& level,
                      const SynthesisLevel& neighbours, int l, const TextonSet& textons, const WindowOptions& options,
                      const std::function<bool(std::int32_t, int)>& allowed, std::vector<LayerPlace>& place);

}  // namespace shellgrid
