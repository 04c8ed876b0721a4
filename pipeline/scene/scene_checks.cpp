// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/scene_checks.h"

#include <algorithm>

#include "meshing/core/error.h"

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

}  // namespace

bool is_dark(const Scene& scene) {
  return std::none_of(scene.lights.begin(), scene.lights.end(), [](const Light& light) {
    return std::visit([](const auto& of_its_kind) { return shines(of_its_kind); }, light);
  });
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

}  // namespace shellgrid
