// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/pattern_description.h"

#include <initializer_list>
#include <utility>

#include "meshing/core/error.h"
#include "pipeline/scene/sample_recipe.h"

namespace shellgrid {

const std::vector<std::string>& procedural_types() {
  static const std::vector<std::string> types = {"marble", "spots", "layers", "bumps",
                                                 "wood",   "cells", "grass",  "weave"};
  return types;
}

namespace {

// A pattern's materials: its body, and others by their names.
void read_materials(DescriptionSection& root, Material& body,
                    std::initializer_list<std::pair<const char*, Material*>> others) {
  DescriptionSection materials = root.section("materials");
  body = read_material(materials.section("body"));
  for (const auto& [name, material] : others) *material = read_material(materials.section(name));
  materials.finish();
}

}  // namespace

SamplePattern read_pattern(DescriptionSection& root, const std::string& type) {
  if (type == "layers") {
    LayersPattern pattern;
    for (DescriptionSection& layer : root.list("layers")) {
      pattern.layers.push_back({read_material(layer.section("material")), layer.number("thickness", 1, 1e-6, 1e4)});
      layer.finish();
    }
    if (pattern.layers.empty()) root.fail("layers", "expected at least one layer");
    pattern.waviness = root.number("waviness", 0, 0, 1e3);
    pattern.cells = root.integer("cells", 4, 1, 256);
    return pattern;
  }
  if (type == "wood") {
    WoodPattern pattern;
    read_materials(root, pattern.body, {{"ring", &pattern.ring}});
    pattern.ring_width = root.number("ring_width", pattern.ring_width, 1e-3, 1e3);
    pattern.pith_depth = root.number("pith_depth", pattern.pith_depth, -1e4, 1e4);
    pattern.waviness = root.number("waviness", pattern.waviness, 0, 1e3);
    pattern.fibre_length = root.number("fibre_length", pattern.fibre_length, 1e-3, 1e4);
    pattern.fibres = root.number("fibres", pattern.fibres, 0, 5);
    pattern.pores = root.number("pores", pattern.pores, 0, 0.3);
    return pattern;
  }
  if (type == "cells") {
    CellsPattern pattern;
    read_materials(root, pattern.body, {{"wall", &pattern.wall}});
    pattern.cells = root.integer("cells", pattern.cells, 1, 256);
    pattern.wall_width = root.number("wall_width", pattern.wall_width, 0, 1e3);
    pattern.variation = root.number("variation", pattern.variation, 0, 5);
    pattern.jitter = root.number("jitter", pattern.jitter, 0, 1);
    return pattern;
  }
  if (type == "grass") {
    GrassPattern pattern;
    read_materials(root, pattern.body, {{"blade", &pattern.blade}});
    pattern.count = root.integer("count", pattern.count, 1, 10000);
    pattern.height = root.number("height", pattern.height, 1e-3, 1e3);
    pattern.radius = root.number("radius", pattern.radius, 1e-3, 1e3);
    pattern.bend = root.number("bend", pattern.bend, 0, 1);
    return pattern;
  }
  if (type == "weave") {
    WeavePattern pattern;
    read_materials(root, pattern.body, {{"warp", &pattern.warp}, {"weft", &pattern.weft}});
    pattern.warp_count = root.integer("warp_count", pattern.warp_count, 1, 256);
    pattern.weft_count = root.integer("weft_count", pattern.weft_count, 1, 256);
    pattern.over = root.integer("over", pattern.over, 1, 16);
    pattern.under = root.integer("under", pattern.under, 1, 16);
    pattern.fill = root.number("fill", pattern.fill, 0.05, 1);
    pattern.height = root.number("height", pattern.height, 1e-3, 1e3);
    pattern.strands = root.integer("strands", pattern.strands, 0, 16);
    return pattern;
  }
  if (type == "spots") {
    SpotsPattern pattern;
    read_materials(root, pattern.body, {{"spot", &pattern.spot}});
    pattern.count = root.integer("count", pattern.count, 1, 10000);
    pattern.radius = root.number("radius", pattern.radius, 1e-3, 1e3);
    pattern.variation = root.number("variation", pattern.variation, 0, 1);
    pattern.softness = root.number("softness", pattern.softness, 0, 1e3);
    return pattern;
  }
  if (type == "bumps") {
    BumpsPattern pattern;
    read_materials(root, pattern.body, {{"bump", &pattern.bump}});
    pattern.count = root.integer("count", pattern.count, 1, 10000);
    pattern.radius = root.number("radius", pattern.radius, 1e-3, 1e3);
    pattern.lift = root.number("lift", pattern.lift, 0, 10);
    return pattern;
  }
  MarblePattern pattern;
  read_materials(root, pattern.body, {{"vein", &pattern.vein}});
  pattern.warp = root.number("warp", pattern.warp, 0, 1e3);
  pattern.cloudiness = root.number("cloudiness", pattern.cloudiness, 0, 5);
  for (DescriptionSection& section : root.list("veins")) {
    VeinFamily vein;
    vein.cells = section.integer("cells", vein.cells, 1, 256);
    vein.width = section.number("width", vein.width, 1e-3, 1e3);
    vein.variation = section.number("variation", vein.variation, 0, 5);
    vein.strength = section.number("strength", vein.strength, 0, 1);
    vein.coverage = section.number("coverage", vein.coverage, 0, 1);
    vein.waves_x = section.integer("waves_x", 0, -64, 64);
    vein.waves_y = section.integer("waves_y", 0, -64, 64);
    section.finish();
    pattern.veins.push_back(vein);
  }
  return pattern;
}

void describe_procedural(DescriptionSection& root, const std::string& type, SampleRecipe& recipe) {
  SampleDefinition definition;
  definition.pattern = read_pattern(root, type);
  const auto define = [definition](const SampleExtent& extent) {
    SampleDefinition defined = definition;
    defined.width = extent.width, defined.height = extent.height;
    defined.voxel = extent.voxel, defined.thickness = extent.thickness, defined.ior = extent.ior;
    defined.seed = extent.seed;
    return defined;
  };
  try {
    procedural_sample_size(define(recipe.extent));
  } catch (const InputError& error) {
    root.refuse(error.what());
  }
  recipe.materials = materials_of(definition.pattern);
  recipe.make = [define](const SampleExtent& extent) {
    MadeSample made;
    made.sample = make_procedural_sample(define(extent));
    return made;
  };
}

std::vector<Material> materials_of(const SamplePattern& pattern) {
  struct Lister {
    std::vector<Material> operator()(const MarblePattern& p) const { return {p.body, p.vein}; }
    std::vector<Material> operator()(const SpotsPattern& p) const { return {p.body, p.spot}; }
    std::vector<Material> operator()(const BumpsPattern& p) const { return {p.body, p.bump}; }
    std::vector<Material> operator()(const WoodPattern& p) const { return {p.body, p.ring}; }
    std::vector<Material> operator()(const CellsPattern& p) const { return {p.body, p.wall}; }
    std::vector<Material> operator()(const GrassPattern& p) const { return {p.body, p.blade}; }
    std::vector<Material> operator()(const WeavePattern& p) const { return {p.body, p.warp, p.weft}; }
    std::vector<Material> operator()(const LayersPattern& p) const {
      std::vector<Material> list;
      for (const LayersPattern::Layer& layer : p.layers) list.push_back(layer.material);
      return list;
    }
  };
  return std::visit(Lister(), pattern);
}

}  // namespace shellgrid
