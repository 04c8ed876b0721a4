// SPDX-License-Identifier: AGPL-3.0-or-later
// What stages ask of a scene beyond its values.
#pragma once
#include "meshing/core/progress.h"
#include "meshing/polycube/polygrid.h"
#include "meshing/shell/shell_volume.h"
#include "pipeline/scene/scene.h"

namespace shellgrid {

// Whether no light shines: there is none, or all that there are have no power. Such a scene is legal: all is black.
bool is_dark(const Scene& scene);

bool has_extended_light(const Scene& scene);

inline constexpr const char* darkness_warning = "no light shines in this scene: the object is black";
void warn_of_darkness(const Scene& scene, Progress& progress);
inline constexpr const char* unlit_warning = "none of the scene's light enters the object: it is black";

// Throws: InputError where a homogeneous object does not scatter in some channel, where diffusion has nothing to say.
void require_scattering(const Scene& scene);

// Reads a surface that light shall pass. Throws: InputError where it is not closed or its faces look inward.
TriangleMesh read_closed_surface(const std::string& path);

// Whether a shell, a polygrid belongs to a surface, by their places: files of any origin can be asked. Where they are a
// little apart, as of another triangulation of the same surface, a warning. Throws: InputError naming both files where
// they are more.
void require_same_object(const ShellVolume& shell, const std::string& shell_path, const TriangleMesh& surface,
                         const std::string& surface_path, Progress& progress);
void require_same_object(const Polygrid& polygrid, const std::string& polygrid_path, const TriangleMesh& surface,
                         const std::string& surface_path, Progress& progress);

// Warns where a shell's file says something else than the scene beside it: of the core, where the file counts; of the
// refractive index, where the scene counts.
void warn_of_contradictions(const ShellVolume& shell, const std::string& shell_path, const Scene& scene,
                            Progress& progress);

}  // namespace shellgrid
