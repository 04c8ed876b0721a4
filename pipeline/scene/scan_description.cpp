// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <cmath>
#include <memory>
#include <numbers>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/formats/mesh_file.h"
#include "pipeline/scene/sample_recipe.h"
#include "synthesis/sample_builder.h"
#include "synthesis/scan_conversion.h"

namespace shellgrid {
namespace {

struct PartText {
  ScanPart part;
  std::string file;  // empty: the ground
  int scatter = 0;   // how many placements are spread over the sample
  bool random_turns = false;
};

Vec3 vector_of(DescriptionSection& section, const std::string& key, const Vec3& otherwise, double most) {
  const std::vector<double> values = section.numbers(key, 3, -most, most, "[x, y, z]");
  return values.empty() ? otherwise : Vec3(values[0], values[1], values[2]);
}

Mat3 rotation_of(const Vec3& degrees) {
  const Vec3 angle = degrees * (std::numbers::pi / 180);
  return (Eigen::AngleAxisd(angle.z(), Vec3::UnitZ()) * Eigen::AngleAxisd(angle.y(), Vec3::UnitY()) *
          Eigen::AngleAxisd(angle.x(), Vec3::UnitX()))
      .toRotationMatrix();
}

PartText read_part(DescriptionSection& section) {
  PartText text;
  ScanPart& part = text.part;
  part.free = section.boolean("free", false);
  if (section.has("material")) {
    if (part.free) section.fail("material", "a part that is free space has none");
    part.material = read_material(section.section("material"));
  } else if (!part.free) {
    section.fail("material", "is missing; expected a material, or \"free\": true for what is cut out");
  }
  part.priority = section.integer("priority", 0, -1000000, 1000000);
  part.ior = section.number("ior", 0, 1, 4);
  const bool ground = section.has("ground");
  const double level = section.number("ground", 0, -1e6, 1e6);
  const std::string file = section.text("mesh", "");
  if (ground == !file.empty()) section.fail("mesh", "expected either a mesh or the level of a \"ground\"");
  if (ground) {
    part.placements[0].position = Vec3(0, 0, level);
    section.finish();
    return text;
  }
  text.file = section.file(file);
  if (section.has("scale")) {
    const Rgb scale = section.color("scale", Rgb::Ones(), 1e-6, 1e6);
    part.scale = scale.cast<double>().matrix();
  }
  PartPlacement& placement = part.placements[0];
  placement.position = vector_of(section, "position", Vec3::Zero(), 1e6);
  placement.turn = rotation_of(vector_of(section, "rotation", Vec3::Zero(), 360));
  text.scatter = section.integer("scatter", 0, 0, 10000);
  text.random_turns = section.boolean("random_turns", false);
  section.finish();
  return text;
}

}  // namespace

void describe_meshes(DescriptionSection& root, SampleRecipe& recipe) {
  auto texts = std::make_shared<std::vector<PartText>>();
  for (DescriptionSection& section : root.list("parts")) texts->push_back(read_part(section));
  if (texts->empty()) root.fail("parts", "expected at least one part");
  ScanOptions options;
  options.samples_per_edge = root.integer("samples_per_edge", options.samples_per_edge, 1, 8);
  std::optional<double> top;
  if (root.has("top")) top = root.number("top", 0, -1e6, 1e6);
  for (const PartText& text : *texts) {
    if (!text.file.empty()) recipe.files.push_back(text.file);
    if (!text.part.free) recipe.materials.push_back(text.part.material);
  }
  recipe.make = [texts, options, top](const SampleExtent& extent) {
    std::vector<ScanPart> parts;
    for (const PartText& text : *texts) {
      ScanPart part = text.part;
      if (!text.file.empty()) part.mesh = read_mesh(text.file).mesh;
      if (text.scatter > 0) {
        const double width = extent.width * extent.voxel, height = extent.height * extent.voxel;
        const PartPlacement base = part.placements[0];
        part.placements.clear();
        // The same number of placements stands at the same points, so that dents and what lies in them meet.
        const std::vector<Vec2> points = spread_points(text.scatter, width, height, extent.seed);
        RandomStream random(extent.seed, 61);
        for (const Vec2& point : points) {
          const double angle = text.random_turns ? 360 * random.next() : 0;
          part.placements.push_back(
              {base.position + Vec3(point.x(), point.y(), 0), rotation_of(Vec3(0, 0, angle)) * base.turn});
        }
      }
      parts.push_back(std::move(part));
    }
    ScanOptions now = options;
    now.width = extent.width, now.height = extent.height;
    now.voxel = extent.voxel, now.thickness = extent.thickness, now.ior = extent.ior;
    now.top = top ? *top : highest_point(parts) + 0.25 * extent.voxel;
    ScanResult result = scan_convert(parts, now);
    MadeSample made;
    if (result.above_top > 0)
      made.warnings.push_back(
          fmt::format("parts reach {:.4g} mm above the top and are cut off there; raise \"top\" to {:.4g}",
                      result.above_top, now.top + result.above_top));
    for (const int part : result.unused)
      made.warnings.push_back(fmt::format(
          "parts[{}] fills no place of the sample; look at its position, scale and priority, and at those above it",
          part));
    if (result.lost_material > 0.05)
      made.warnings.push_back(fmt::format(
          "{:.2g} % of the material lies in voxels that are less than half full, and is lost; make the voxel smaller",
          100 * result.lost_material));
    made.figures = {{"parts", parts.size()}, {"lost_material", result.lost_material}, {"top_mm", now.top}};
    made.sample = std::move(result.sample);
    return made;
  };
}

}  // namespace shellgrid
