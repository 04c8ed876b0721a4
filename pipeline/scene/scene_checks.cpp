// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/scene_checks.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/polycube/polygrid_fit.h"
#include "meshing/shell/shell_fit.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

bool shines(const Rgb& power) { return (power > 0).any(); }
bool shines(const DirectionalLight& light) { return shines(light.irradiance); }
bool shines(const PointLight& light) { return shines(light.intensity); }
bool shines(const AreaLight& light) { return shines(light.radiance); }
bool shines(const EnvironmentLight& light) {
  if (light.image) {
    for (int k = 0; k < 3; ++k) {
      const Image::Channel* channel = light.image->find(std::string(1, "RGB"[k]));
      if (channel && light.scale[k] > 0 &&
          std::any_of(channel->values.begin(), channel->values.end(), [](float value) { return value > 0; }))
        return true;
    }
    return false;
  }
  Rgb most = light.zenith.max(light.horizon).max(light.ground);
  for (const EnvironmentLight::Lamp& lamp : light.lamps)
    if (lamp.half_angle > 0) most = most.max(lamp.radiance);
  return shines(most * light.scale);
}

// Of a voxel's or a cell's width.
constexpr double noticeable = 0.02, foreign = 0.25;

void judge_misfit(double misfit, double width, const std::string& path, const std::string& surface_path,
                  const std::string& what, Progress& progress) {
  if (misfit > foreign * width)
    throw InputError(fmt::format("{}: is not of the surface {}: {} {:.3g} mm off it; make both from one surface", path,
                                 surface_path, what, misfit));
  if (misfit > noticeable * width)
    progress.warn(
        fmt::format("{} may be of another surface than {}: {} {:.3g} mm off it", path, surface_path, what, misfit));
}

bool alike(const Rgb& a, const Rgb& b) { return ((a - b).abs() <= 1e-4f * (a.abs().max(b.abs()) + 1e-6f)).all(); }

bool alike(const Material& a, const Material& b) {
  return alike(a.absorption(), b.absorption()) && alike(a.scattering(), b.scattering()) &&
         alike(a.anisotropy, b.anisotropy);
}

bool has_core_voxels(const ShellVolume& shell) {
  bool found = false;
  shell.kind.for_each_active([&](int, int, int, std::int32_t kind) { found = found || kind == core_voxel_kind; });
  return found;
}

// Least and greatest index of the mesostructure's surface.
std::optional<std::pair<float, float>> surface_indices(const ShellVolume& shell) {
  std::optional<std::pair<float, float>> range;
  shell.surface_ior.for_each_active([&](int, int, int, float ior) {
    if (!(ior > 0)) return;
    if (!range) range = {ior, ior};
    range = {std::min(range->first, ior), std::max(range->second, ior)};
  });
  return range;
}

}  // namespace

bool is_dark(const Scene& scene) {
  return std::none_of(scene.lights.begin(), scene.lights.end(), [](const Light& light) {
    return std::visit([](const auto& of_its_kind) { return shines(of_its_kind); }, light);
  });
}

bool has_extended_light(const Scene& scene) {
  return std::any_of(scene.lights.begin(), scene.lights.end(), has_extent);
}

void warn_of_darkness(const Scene& scene, Progress& progress) {
  if (is_dark(scene)) progress.warn(darkness_warning);
}

void require_scattering(const Scene& scene) {
  if (!scene.material || scene.material->shell || scene.material->opaque) return;
  const auto* core = std::get_if<Material>(&scene.material->core);
  if (!core) return;
  static const char* const colour[] = {"red", "green", "blue"};
  for (int c = 0; c < 3; ++c)
    if (!(core->scattering()[c] > 0))
      throw InputError(scene.path + ": material.core.scattering is 0 in " + colour[c] +
                       ": diffusion is a model of light that is scattered; sg-reference (or method.type path-tracing) "
                       "follows it through clear and purely absorbing matter");
}

TriangleMesh read_closed_surface(const std::string& path) {
  TriangleMesh mesh = read_mesh(path).mesh;
  naming(path, [&] { require_closed_surface(mesh, true); });
  return mesh;
}

void require_same_object(const ShellVolume& shell, const std::string& shell_path, const TriangleMesh& surface,
                         const std::string& surface_path, Progress& progress) {
  judge_misfit(naming(surface_path, [&] { return shell_misfit(shell, surface); }), shell.frame.voxel, shell_path,
               surface_path, "its voxels' depths are", progress);
}

void require_same_object(const Polygrid& polygrid, const std::string& polygrid_path, const TriangleMesh& surface,
                         const std::string& surface_path, Progress& progress) {
  judge_misfit(naming(surface_path, [&] { return polygrid_misfit(polygrid, surface); }), polygrid.spacing,
               polygrid_path, surface_path, "half of its outer points are", progress);
}

void warn_of_contradictions(const ShellVolume& shell, const std::string& shell_path, const Scene& scene,
                            Progress& progress) {
  if (scene.material) {
    const bool voxels = has_core_voxels(shell);
    const auto* coefficients = std::get_if<Material>(&scene.material->core);
    const auto* continued = std::get_if<ContinuedCore>(&scene.material->core);
    const bool interpolated = continued && continued->kind == "interpolated";
    std::string wanted;
    if (coefficients && (voxels || shell.core_interpolated || !alike(*coefficients, shell.core)))
      wanted = "of other coefficients";
    else if (continued && interpolated != shell.core_interpolated)
      wanted = continued->kind;
    if (!wanted.empty())
      progress.warn(fmt::format("{}: material.core is {}; the core of {} counts", scene.path, wanted, shell_path));
  }
  const double ior = scene.object ? scene.object->ior : shell.ior;
  if (std::abs(ior - shell.ior) > 1e-6 * ior)
    progress.warn(fmt::format("{} was made for the refractive index {:.4g}; the scene's, {:.4g}, counts", shell_path,
                              shell.ior, ior));
  if (const auto range = surface_indices(shell);
      range && std::max(std::abs(range->first - ior), std::abs(range->second - ior)) > 1e-6 * ior)
    progress.warn(fmt::format(
        "{}: the sample's surface has refractive indices of {:.4g} to {:.4g}; light meets {:.4g} everywhere",
        shell_path, range->first, range->second, ior));
}

}  // namespace shellgrid
