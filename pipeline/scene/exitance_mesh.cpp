// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/exitance_mesh.h"

#include <algorithm>
#include <cmath>
#include <functional>

namespace shellgrid {
namespace {

void add(AttributedMesh& mesh, const std::string& name, std::size_t count,
         const std::function<float(std::size_t)>& value) {
  VertexProperty property{name, std::vector<float>(count)};
  for (std::size_t v = 0; v < count; ++v) property.values[v] = value(v);
  mesh.properties.push_back(std::move(property));
}

}  // namespace

void add_colour_property(AttributedMesh& mesh, const std::string& name, const std::vector<Rgb>& values) {
  for (int c = 0; c < 3; ++c)
    add(mesh, name + "_" + "rgb"[c], values.size(), [&](std::size_t v) { return values[v][c]; });
}

AttributedMesh exitance_mesh(const TriangleMesh& surface, const std::vector<Rgb>& exitance,
                             const std::vector<Rgb>& irradiance) {
  AttributedMesh mesh{surface, {}};
  add_colour_property(mesh, "exitance", exitance);
  add_colour_property(mesh, "irradiance", irradiance);
  add(mesh, "quality", exitance.size(), [&](std::size_t v) {
    const Rgb& c = exitance[v];
    return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2];
  });
  std::vector<float> sorted = mesh.properties.back().values;
  const auto rank = sorted.begin() + static_cast<std::ptrdiff_t>(0.98 * (sorted.size() - 1));
  std::nth_element(sorted.begin(), rank, sorted.end());
  const float white = std::max(*rank, 1e-30f);
  const char* names[3] = {"red", "green", "blue"};
  for (int c = 0; c < 3; ++c)
    add(mesh, names[c], exitance.size(),
        [&](std::size_t v) { return 255 * std::pow(std::clamp(exitance[v][c] / white, 0.0f, 1.0f), 1 / 2.2f); });
  return mesh;
}

}  // namespace shellgrid
