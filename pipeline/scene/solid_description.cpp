// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/scene/sample_recipe.h"
#include "synthesis/albedo.h"
#include "synthesis/half_space_reflectance.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_builder.h"
#include "synthesis/solid_material.h"
#include "synthesis/solid_synthesis.h"

namespace shellgrid {
namespace {

constexpr const char* axis_names[3] = {"x", "y", "z"};

// A view as its pixels say: linear colours, and sRGB values 0 … 1 as what is compared.
struct View {
  int width = 0, height = 0;
  std::vector<Rgb> colors;
};

View read_view(const std::string& path) {
  const Image image = read_png(path);
  View view{image.width, image.height, {}};
  for (std::size_t i = 0; i < static_cast<std::size_t>(view.width) * view.height; ++i)
    view.colors.emplace_back(image.channels[0].values[i], image.channels[1].values[i], image.channels[2].values[i]);
  return view;
}

struct SolidText {
  std::array<std::string, 3> views;  // files; or
  std::string sample;                // a base volume
  ColorMaterial colors;
  SolidOptions options;
};

MadeSample make_of_views(const SolidText& text, const SampleExtent& extent, SolidOptions options) {
  SolidExemplar exemplar;
  std::array<View, 3> views;
  for (int d = 0; d < 3; ++d) {
    views[d] = read_view(text.views[d]);
    SliceStack& stack = exemplar.axes[d];
    stack.width = views[d].width, stack.height = views[d].height;
    for (const Rgb& color : views[d].colors) {
      const Rgb code = display_color(color) / 255;
      stack.values.insert(stack.values.end(), {code[0], code[1], code[2]});
    }
  }
  const SolidTexture solid = synthesize_solid(exemplar, options);
  std::vector<Rgb> colors(solid.axis.size());
  for (std::size_t i = 0; i < colors.size(); ++i) colors[i] = views[solid.axis[i]].colors[solid.texel[i]];
  MadeSample made;
  made.sample = material_of_colors(solid.size, colors, extent.voxel, extent.ior, text.colors);
  const SolidQuality quality = measure_solid(exemplar, solid.size, solid_values(exemplar, solid), 200);
  made.figures = {{"window_distance", quality.window_distance},
                  {"coverage_distance", quality.coverage_distance},
                  {"histogram_distance", quality.histogram_distance},
                  {"texel_entropy", texel_entropy(exemplar, solid)}};
  return made;
}

MadeSample make_of_sample(const SolidText& text, const SampleExtent& extent, const SolidOptions& options) {
  const VdbArchive archive = read_vdb(text.sample);
  const MaterialSample small = is_sample_archive(archive) ? restore_sample(archive) : import_sample(archive, {});
  const SolidExemplar exemplar = naming(text.sample, [&] { return exemplar_of_sample(small); });
  const SolidTexture solid = naming(text.sample, [&] { return synthesize_solid(exemplar, options); });
  MadeSample made;
  made.sample = material_of_texels(small, solid);
  if (extent.voxel_given) made.sample.voxel = extent.voxel;
  made.sample.ior = extent.ior;
  const SolidQuality quality = measure_solid(exemplar, solid.size, solid_values(exemplar, solid), 60);
  made.figures = {{"window_distance", quality.window_distance},
                  {"coverage_distance", quality.coverage_distance},
                  {"histogram_distance", quality.histogram_distance},
                  {"texel_entropy", texel_entropy(exemplar, solid)}};
  return made;
}

}  // namespace

void describe_solid(DescriptionSection& root, SampleRecipe& recipe) {
  SolidText text;
  const bool views = root.has("views"), sample = root.has("sample");
  if (views == sample)
    root.fail("views", "expected either \"views\" {…} of the material or a smaller \"sample\" of it");
  if (sample) {
    text.sample = root.file(root.text("sample", ""));
    if (std::filesystem::path(text.sample).extension() != ".vdb") root.fail("sample", "expected a volume (.vdb)");
    recipe.files = {text.sample};
    recipe.check = [file = text.sample] { require_sample_grids(read_vdb_outline(file)); };
  } else {
    DescriptionSection section = root.section("views");
    std::string first, side;
    for (int d = 2; d >= 0; --d) {
      const std::string name = section.text(axis_names[d], "");
      if (!name.empty()) text.views[d] = section.file(name);
      if (first.empty()) first = text.views[d];
      if (d < 2 && side.empty()) side = text.views[d];
    }
    section.finish();
    if (first.empty()) root.fail("views", "expected the file of at least one view: x, y or z");
    // One view stands for all; a side view for both sides.
    for (int d = 0; d < 3; ++d)
      if (text.views[d].empty()) text.views[d] = d < 2 && !side.empty() ? side : first;
    for (const std::string& view : text.views)
      if (std::find(recipe.files.begin(), recipe.files.end(), view) == recipe.files.end()) recipe.files.push_back(view);
    const Rgb missing = Rgb::Constant(-1);
    text.colors.extinction = root.color("extinction", missing, 1e-6, 1e4);
    if ((text.colors.extinction < 0).any()) root.fail("extinction", "is missing; expected mm⁻¹, a number or [r, g, b]");
    text.colors.anisotropy = root.color("anisotropy", Rgb::Zero(), -0.999, 0.999);
    text.colors.model = root.word("conversion", "transport", {"transport", "dipole"}) == "dipole"
                            ? ReflectanceModel::dipole
                            : ReflectanceModel::transport;
    text.colors.brightest = root.number("brightest", text.colors.brightest, 0.01, 0.9999);
  }
  text.options.window = root.integer("window", text.options.window, 3, 15);
  if (text.options.window % 2 == 0) root.fail("window", "expected an odd number");
  text.options.evenness = root.number("evenness", text.options.evenness, 0, 100);
  recipe.make = [text](const SampleExtent& extent) {
    SolidOptions options = text.options;
    const double layers = std::ceil(extent.thickness / extent.voxel - 1e-6);
    if (!(layers >= 1 && layers <= 512))
      throw InputError(
          fmt::format("a thickness of {:.6g} mm and voxels of {:.6g} mm make {:.6g} layers; expected 1 to 512",
                      extent.thickness, extent.voxel, layers));
    options.size = Vec3i(extent.width, extent.height, static_cast<int>(layers));
    options.seed = extent.seed;
    return text.sample.empty() ? make_of_views(text, extent, options) : make_of_sample(text, extent, options);
  };
}

}  // namespace shellgrid
