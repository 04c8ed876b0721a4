// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/named_materials.h"

#include <fmt/format.h>

#include "meshing/core/error.h"
#include "pipeline/cli/nearest_name.h"

namespace shellgrid {
namespace {

NamedMaterial measured(const std::string& name, const Rgb& reduced_scattering, const Rgb& absorption,
                       const Rgb& reflectance, double ior) {
  Material material;
  material.extinction = reduced_scattering + absorption;
  material.albedo = reduced_scattering / material.extinction;
  return {name, material, ior, reflectance};
}

}  // namespace

const std::vector<NamedMaterial>& named_materials() {
  // Source: Jensen, Marschner, Levoy, Hanrahan, "A practical model for subsurface light transport", 2001, figure 5:
  // reduced scattering and absorption in mm⁻¹, diffuse reflectance, index.
  static const std::vector<NamedMaterial> table = {
      measured("apple", {2.29f, 2.39f, 1.97f}, {0.0030f, 0.0034f, 0.046f}, {0.85f, 0.84f, 0.53f}, 1.3),
      measured("chicken1", {0.15f, 0.21f, 0.38f}, {0.015f, 0.077f, 0.19f}, {0.31f, 0.15f, 0.10f}, 1.3),
      measured("chicken2", {0.19f, 0.25f, 0.32f}, {0.018f, 0.088f, 0.20f}, {0.32f, 0.16f, 0.10f}, 1.3),
      measured("cream", {7.38f, 5.47f, 3.15f}, {0.0002f, 0.0028f, 0.0163f}, {0.98f, 0.90f, 0.73f}, 1.3),
      measured("ketchup", {0.18f, 0.07f, 0.03f}, {0.061f, 0.97f, 1.45f}, {0.16f, 0.01f, 0.00f}, 1.3),
      measured("marble", {2.19f, 2.62f, 3.00f}, {0.0021f, 0.0041f, 0.0071f}, {0.83f, 0.79f, 0.75f}, 1.5),
      measured("potato", {0.68f, 0.70f, 0.55f}, {0.0024f, 0.0090f, 0.12f}, {0.77f, 0.62f, 0.21f}, 1.3),
      measured("skimmilk", {0.70f, 1.22f, 1.90f}, {0.0014f, 0.0025f, 0.0142f}, {0.81f, 0.81f, 0.69f}, 1.3),
      measured("skin1", {0.74f, 0.88f, 1.01f}, {0.032f, 0.17f, 0.48f}, {0.44f, 0.22f, 0.13f}, 1.3),
      measured("skin2", {1.09f, 1.59f, 1.79f}, {0.013f, 0.070f, 0.145f}, {0.63f, 0.44f, 0.34f}, 1.3),
      measured("spectralon", {11.6f, 20.4f, 14.9f}, {0.0f, 0.0f, 0.0f}, {1.00f, 1.00f, 1.00f}, 1.3),
      measured("wholemilk", {2.55f, 3.21f, 3.77f}, {0.0011f, 0.0024f, 0.014f}, {0.91f, 0.88f, 0.76f}, 1.3),
  };
  return table;
}

const NamedMaterial& named_material(const std::string& name) {
  std::vector<std::string> names;
  for (const NamedMaterial& material : named_materials()) {
    if (material.name == name) return material;
    names.push_back(material.name);
  }
  const std::string near = did_you_mean(name, names);
  throw InputError(fmt::format("unknown material '{}'{}", name,
                               near.empty() ? fmt::format("; known: {}", fmt::join(names, ", ")) : near));
}

}  // namespace shellgrid
