// SPDX-License-Identifier: AGPL-3.0-or-later
// Solid texture from one view: seconds and figures of quality beside texels drawn at random and beside noise whose
// histogram is matched. Prints CSV. Arguments: [PNG] [picture folder]: a view instead of the built-in ones, and where
// to leave pictures of the slices.
#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <numeric>

#include "meshing/core/random.h"
#include "meshing/formats/image_file.h"
#include "synthesis/albedo.h"
#include "synthesis/periodic_noise.h"
#include "synthesis/procedural_sample.h"
#include "synthesis/solid_synthesis.h"

using namespace shellgrid;

namespace {

Material material(const Rgb& absorption, const Rgb& scattering) {
  return Material::from_absorption_scattering(absorption, scattering, Rgb::Zero());
}

// The middle layer of a sample as it looks, sRGB 0 … 1.
SliceStack layer(const SampleDefinition& definition) {
  const MaterialSample sample = make_procedural_sample(definition);
  SliceStack stack{sample.size.x(), sample.size.y(), 1, {}};
  for (int y = 0; y < stack.height; ++y)
    for (int x = 0; x < stack.width; ++x) {
      const Rgb color =
          display_color(diffuse_color(sample.material(sample.index(x, y, sample.size.z() / 2)), 1.5)) / 255;
      stack.values.insert(stack.values.end(), {color[0], color[1], color[2]});
    }
  return stack;
}

SliceStack picture(const std::string& path) {
  const Image image = read_png(path);
  SliceStack stack{image.width, image.height, 1, {}};
  for (std::size_t i = 0; i < stack.texel_count(); ++i) {
    const Rgb color =
        display_color(Rgb(image.channels[0].values[i], image.channels[1].values[i], image.channels[2].values[i]));
    for (int c = 0; c < 3; ++c) stack.values.push_back(color[c] / 255);
  }
  return stack;
}

void print(const std::string& view, const std::string& method, double seconds, double processor,
           const SolidExemplar& exemplar, const Vec3i& size, const std::vector<float>& values, double entropy) {
  const SolidQuality quality = measure_solid(exemplar, size, values);
  fmt::print("{},{},{:.2f},{:.2f},{:.4f},{:.4f},{:.4f},{:.3f}\n", view, method, seconds, processor,
             fmt::join(quality.window_distance, ","), fmt::join(quality.coverage_distance, ","),
             quality.histogram_distance, entropy);
  std::fflush(stdout);
}

// The view, then slices along z, y and x.
void draw(const std::string& path, const SliceStack& view, const Vec3i& n, const std::vector<float>& values) {
  const int width = view.width + 8 + n.x(), height = std::max(view.height, n.y() + 2 * (n.z() + 4));
  std::vector<std::uint8_t> rgb(3ull * width * height, 255);
  const auto put = [&](int column, int row, const float* color) {
    for (int c = 0; c < 3; ++c)
      rgb[3 * (static_cast<std::size_t>(row) * width + column) + c] =
          static_cast<std::uint8_t>(std::clamp(color[c], 0.0f, 1.0f) * 255 + 0.5f);
  };
  const auto at = [&](int x, int y, int z) {
    return values.data() + 3 * ((static_cast<std::size_t>(z) * n.y() + y) * n.x() + x);
  };
  for (int y = 0; y < view.height; ++y)
    for (int x = 0; x < view.width; ++x) put(x, y, view.values.data() + 3 * (y * view.width + x));
  for (int y = 0; y < n.y(); ++y)
    for (int x = 0; x < n.x(); ++x) put(view.width + 8 + x, y, at(x, y, n.z() / 2));
  for (int z = 0; z < n.z(); ++z)
    for (int x = 0; x < n.x(); ++x) put(view.width + 8 + x, n.y() + 4 + z, at(x, n.y() / 2, z));
  for (int z = 0; z < n.z(); ++z)
    for (int y = 0; y < std::min(n.y(), n.x()); ++y)
      put(view.width + 8 + y, n.y() + n.z() + 8 + z, at(n.x() / 2, y, z));
  write_png(path, width, height, rgb);
}

// Noise of the view's coarseness with the view's colours in the order of its lightness.
std::vector<float> matched_noise(const SliceStack& view, const Vec3i& n) {
  const PeriodicNoise noise(n.x(), n.y(), 3);
  const std::size_t count = static_cast<std::size_t>(n.prod());
  std::vector<double> level(count);
  for (std::size_t i = 0; i < count; ++i)
    level[i] = noise.fractal(Vec3(i % n.x() + 0.5, i / n.x() % n.y() + 0.5, i / n.x() / n.y() + 0.5), 10, 3, 1);
  std::vector<std::size_t> order(count), texels(view.texel_count());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::iota(texels.begin(), texels.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return level[a] < level[b]; });
  const auto lightness = [&](std::size_t t) {
    return view.values[3 * t] + view.values[3 * t + 1] + view.values[3 * t + 2];
  };
  std::stable_sort(texels.begin(), texels.end(),
                   [&](std::size_t a, std::size_t b) { return lightness(a) < lightness(b); });
  std::vector<float> values(3 * count);
  for (std::size_t r = 0; r < count; ++r)
    std::copy_n(view.values.begin() + static_cast<std::ptrdiff_t>(3 * texels[r * texels.size() / count]), 3,
                values.begin() + static_cast<std::ptrdiff_t>(3 * order[r]));
  return values;
}

void measure(const std::string& name, const SliceStack& view, const std::string& folder) {
  SolidExemplar exemplar;
  exemplar.axes = {view, view, view};
  SolidOptions options;
  const Vec3i size = options.size;
  SolidTexture random;
  random.size = size;
  for (std::size_t i = 0; i < static_cast<std::size_t>(size.prod()); ++i) {
    random.axis.push_back(0);
    random.texel.push_back(static_cast<std::int32_t>(hash64(9, i) % view.texel_count()));
  }
  print(name, "random texels", 0, 0, exemplar, size, solid_values(exemplar, random), 1);
  print(name, "noise with matched histogram", 0, 0, exemplar, size, matched_noise(view, size), 1);
  for (const double evenness : {0.0, 1.0}) {
    options.evenness = evenness;
    const auto started = std::chrono::steady_clock::now();
    const std::clock_t processor = std::clock();
    const SolidTexture solid = synthesize_solid(exemplar, options);
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
    const std::vector<float> values = solid_values(exemplar, solid);
    print(name, evenness > 0 ? "solid synthesis" : "solid synthesis without even use", seconds,
          static_cast<double>(std::clock() - processor) / CLOCKS_PER_SEC, exemplar, size, values,
          texel_entropy(exemplar, solid));
    if (!folder.empty()) draw(folder + "/" + name + (evenness > 0 ? "" : "-uneven") + ".png", view, size, values);
  }
}

}  // namespace

int main(int argc, char** argv) {
  fmt::print(
      "view,method,seconds,processor_seconds,window_distance_x,window_distance_y,window_distance_z,coverage_distance_x,"
      "coverage_distance_y,coverage_distance_z,histogram_distance,"
      "texel_entropy\n");
  const std::string folder = argc > 2 ? argv[2] : "";
  if (argc > 1 && std::string(argv[1]) != "-") {
    measure("picture", picture(argv[1]), folder);
    return 0;
  }
  SampleDefinition definition;
  const Material body = material({0.004f, 0.02f, 0.08f}, {2.2f, 2.4f, 2.6f}),
                 vein = material({0.4f, 0.2f, 0.1f}, {1.7f, 1.9f, 2.0f});
  definition.pattern = CellsPattern{body, vein, 12, 0.9, 1.2, 0.9};
  measure("cells", layer(definition), folder);
  MarblePattern marble{body, vein, {{3, 0.9, 0.8, 1, 1}, {6, 0.5, 0.8, 0.8, 0.7}}, 5, 0.8};
  definition.pattern = marble;
  measure("marble", layer(definition), folder);
  definition.pattern = SpotsPattern{body, vein, 400, 1.8, 0.5, 0.5};
  measure("spots", layer(definition), folder);
}
