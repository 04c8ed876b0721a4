// SPDX-License-Identifier: AGPL-3.0-or-later
// What stages ask of a scene beyond its values.
#pragma once
#include "meshing/core/progress.h"
#include "pipeline/scene/scene.h"

namespace shellgrid {

// Whether no light shines: there is none, or all that there are have no power. Such a scene is legal: all is black.
bool is_dark(const Scene& scene);

inline constexpr const char* darkness_warning = "no light shines in this scene: the object is black";
void warn_of_darkness(const Scene& scene, Progress& progress);

// Throws: InputError where a homogeneous object does not scatter in some channel, where diffusion has nothing to say.
void require_scattering(const Scene& scene);

}  // namespace shellgrid
