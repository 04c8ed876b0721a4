// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "synthesis/principal_components.h"

namespace shellgrid {

struct Clusters {
  RowMatrixf centers;                // k×d
  std::vector<std::int32_t> labels;  // n
  double error = 0;                  // mean squared distance to the own centre over the variance
};

// K-means from seeds chosen with probability proportional to the squared distance [ArthurVassilvitskii2007].
// Fewer clusters come back where fewer rows differ. The same at any thread count.
Clusters cluster(const RowMatrixf& rows, int count, int iterations, std::uint64_t seed);

}  // namespace shellgrid
