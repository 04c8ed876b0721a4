// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/core/progress.h"

namespace shellgrid {

Progress& no_progress() {
  static Progress silent;
  return silent;
}

}  // namespace shellgrid
