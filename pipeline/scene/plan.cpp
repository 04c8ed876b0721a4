// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/plan.h"

#include <fmt/format.h>

#include <filesystem>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/scene/scene.h"
#include "pipeline/scene/scene_document.h"

namespace shellgrid {
namespace {

using nlohmann::json;

std::string millimetres(double length) { return number_text(length); }

std::string rgb_text(const Rgb& colour) { return fmt::format("{},{},{}", colour[0], colour[1], colour[2]); }

// Distance between vertices of the surface: the shell's voxel, or a fixed share of the object where there is none.
double surface_spacing(const Scene& scene) {
  if (scene.material->shell) return scene.material->shell->voxel;
  constexpr double parts = 200;
  if (scene.object->size > 0) return scene.object->size / parts;
  const TriangleMesh mesh = read_mesh(scene.object->mesh).mesh;
  const double size = mesh.vertex_count() == 0
                          ? 0
                          : (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).maxCoeff();
  if (!(size > 0)) throw InputError(scene.object->mesh + ": has no size");
  return size / parts;
}

struct SceneCase {
  const SceneDocument& document;
  const Scene& scene;
  bool opaque, shell;
  ExternalFile mesh, sample;
  std::vector<ExternalFile> light_files;
  double spacing;

  json part(const char* section) const {
    return document.root.contains(section) ? document.root[section] : json::object();
  }
  // Slices lie in another folder than the scene: paths in them are absolute.
  json lights() const {
    json lights = document.root["lights"];
    for (json& light : lights)
      if (light.contains("image"))
        light["image"] = std::filesystem::absolute(light["image"].get<std::string>()).string();
    return lights;
  }
};

PlannedStage prepare(const SceneCase& c) {
  PlannedStage stage{"prepare", "the closed surface, evenly meshed"};
  stage.reason = "every method needs the repaired surface";
  stage.arguments = {
      "@mesh", "-o", "surface.ply", "--size", millimetres(c.scene.object->size), "--spacing", millimetres(c.spacing)};
  if (c.scene.object->close_holes) stage.arguments.push_back("--close-holes");
  stage.files = {c.mesh};
  stage.outputs = {"surface.ply"};
  return stage;
}

void add_shell_stages(const SceneCase& c, std::vector<PlannedStage>& stages) {
  PlannedStage distance{"distance", "signed distance and nearest vertex around the surface"};
  PlannedStage sample{"sample", "the base volume of the material"};
  PlannedStage textons{"textons", "appearance of each texel of the sample"};
  PlannedStage synthesize{"synthesize", "a texture coordinate for every vertex"};
  PlannedStage shell{"shell", "the material of every voxel of the shell"};
  distance.outputs = {"distance.vdb"};
  distance.views = {"distance.view.ply"};
  sample.outputs = {"sample.vdb"};
  sample.views = {"sample.view.ply"};
  textons.outputs = {"textons.vdb"};
  textons.views = {"textons.view.ply"};
  synthesize.outputs = {"synthesized.ply"};
  shell.outputs = {"shell.vdb"};
  shell.views = {"shell.view.ply"};
  if (!c.shell) {
    for (PlannedStage* stage : {&distance, &sample, &textons, &synthesize, &shell}) {
      stage->needed = false;
      stage->reason = c.opaque ? "the material is opaque: nothing below the surface matters"
                               : "the material is the same everywhere: there is no shell to fill";
      stages.push_back(*stage);
    }
    return;
  }
  const ShellMaterial& material = *c.scene.material->shell;
  const std::string voxel = millimetres(material.voxel), thickness = millimetres(material.thickness);
  distance.reason = "the shell's voxels look up their depth and nearest vertex";
  distance.arguments = {"surface.ply",
                        "-o",
                        "distance.vdb",
                        "--voxel",
                        voxel,
                        "--inside",
                        millimetres(material.thickness + 2 * material.voxel),
                        "--outside",
                        millimetres(2 * material.voxel)};
  distance.artefacts = {"surface.ply"};
  sample.reason = "the shell is filled with this sample";
  sample.arguments = {"@sample", "-o",    "sample.vdb",
                      "--voxel", voxel,   "--thickness",
                      thickness, "--ior", number_text(c.scene.object->ior)};
  sample.files = {c.sample};
  textons.reason = "synthesis compares places of the sample by their appearance";
  textons.arguments = {"sample.vdb", "-o", "textons.vdb"};
  textons.artefacts = {"sample.vdb"};
  synthesize.reason = "the sample is spread over the surface without a seam";
  synthesize.arguments = {"surface.ply", "textons.vdb", "-o", "synthesized.ply", "--voxel", voxel};
  synthesize.artefacts = {"surface.ply", "textons.vdb"};
  shell.reason = "the material varies below the surface";
  shell.arguments = {"synthesized.ply", "distance.vdb", "sample.vdb", "-o", "shell.vdb", "--thickness", thickness};
  if (const Material* core = std::get_if<Material>(&c.scene.material->core))
    shell.arguments.insert(shell.arguments.end(),
                           {"--core-absorption", rgb_text(core->absorption()), "--core-scattering",
                            rgb_text(core->scattering()), "--core-anisotropy", rgb_text(core->anisotropy)});
  if (std::holds_alternative<InterpolatedCore>(c.scene.material->core))
    shell.arguments.insert(shell.arguments.end(), {"--core", "interpolated"});
  shell.artefacts = {"synthesized.ply", "distance.vdb", "sample.vdb"};
  for (const PlannedStage* stage : {&distance, &sample, &textons, &synthesize, &shell}) stages.push_back(*stage);
}

void add_diffusion_stages(const SceneCase& c, std::vector<PlannedStage>& stages) {
  PlannedStage tetrahedralize{"tetrahedralize", "tetrahedra that fill the object"};
  PlannedStage polycube{"polycube", "the object as blocks of cubes"};
  PlannedStage polygrid{"polygrid", "the grid on which light diffuses"};
  PlannedStage diffuse{"diffuse", "light inside the object and what leaves it"};
  tetrahedralize.outputs = {"tets.hdf"};
  polycube.outputs = {"polycube.hdf"};
  polycube.views = {"polycube.view.ply"};
  polygrid.outputs = {"polygrid.hdf"};
  polygrid.views = {"polygrid.view.ply"};
  diffuse.outputs = {"fluence.hdf", "exitance.ply"};
  if (c.opaque) {
    for (PlannedStage* stage : {&tetrahedralize, &polycube, &polygrid, &diffuse}) {
      stage->needed = false;
      stage->reason = "the material is opaque: no light enters the object";
      stages.push_back(*stage);
    }
    return;
  }
  tetrahedralize.reason = "the polycube is mapped from the object's volume";
  tetrahedralize.arguments = {"surface.ply", "-o", "tets.hdf"};
  tetrahedralize.artefacts = {"surface.ply"};
  polycube.reason = "the polygrid takes its connectivity from the polycube";
  polycube.arguments = {"tets.hdf", "-o", "polycube.hdf", "--nodes", number_text(c.scene.method.nodes)};
  polycube.artefacts = {"tets.hdf"};
  polygrid.reason = "the method polygrid-diffusion solves on it";
  polygrid.arguments = {"polycube.hdf", "surface.ply", "-o", "polygrid.hdf"};
  polygrid.artefacts = {"polycube.hdf", "surface.ply"};

  diffuse.reason = c.shell ? "light diffuses through shell and core" : "light diffuses through the homogeneous object";
  diffuse.arguments = {"plan/diffuse.json", "polygrid.hdf", "surface.ply"};
  diffuse.artefacts = {"polygrid.hdf", "surface.ply"};
  if (c.shell) {
    diffuse.arguments.push_back("shell.vdb");
    diffuse.artefacts.push_back("shell.vdb");
  }
  diffuse.arguments.insert(diffuse.arguments.end(), {"-o", "fluence.hdf", "--exitance", "exitance.ply"});
  diffuse.files = c.light_files;
  json material = c.part("material"), method = c.part("method");
  if (material.contains("shell")) material["shell"].erase("sample");
  for (const char* key : {"nodes", "samples_per_pixel"}) method.erase(key);
  diffuse.slice = {
      {"object", {{"ior", c.scene.object->ior}}}, {"material", material}, {"lights", c.lights()}, {"method", method}};
  for (const PlannedStage* stage : {&tetrahedralize, &polycube, &polygrid, &diffuse}) stages.push_back(*stage);
}

PlannedStage render(const SceneCase& c) {
  PlannedStage stage{"render", "the picture"};
  stage.reason = "the picture is asked for";
  const std::string surface = c.opaque ? "surface.ply" : "exitance.ply";
  stage.arguments = {"plan/render.json", surface, "-o", "image.exr"};
  stage.artefacts = {surface};
  stage.files = c.light_files;
  stage.outputs = {"image.exr", "image.png"};
  json method = json::object();
  if (c.part("method").contains("samples_per_pixel"))
    method["samples_per_pixel"] = c.document.root["method"]["samples_per_pixel"];
  stage.slice = {{"object", {{"ior", c.scene.object->ior}}},
                 {"lights", c.lights()},
                 {"camera", c.part("camera")},
                 {"method", method}};
  if (c.document.root.contains("floor")) stage.slice["floor"] = c.document.root["floor"];
  if (c.opaque) stage.slice["material"] = c.part("material");
  return stage;
}

}  // namespace

Plan make_plan(const std::string& scene_path) {
  const SceneDocument document = read_scene_document(scene_path);
  const Scene scene = read_scene(scene_path);
  const auto need = [&](bool there, const std::string& what) {
    if (!there) throw InputError(scene_path + ": " + what + ": is missing");
  };
  need(scene.object.has_value(), "object");
  need(!scene.object->mesh.empty(), "object.mesh");
  need(scene.material.has_value(), "material");
  need(!scene.material->shell || !scene.material->shell->sample.empty(), "material.shell.sample");
  need(scene.camera.has_value(), "camera");
  need(document.root.contains("lights"), "lights");
  if (scene.lights.empty()) throw InputError(scene_path + ": lights: is empty; expected one or more");

  SceneCase scene_case{document,
                       scene,
                       scene.material->opaque.has_value(),
                       scene.material->shell.has_value(),
                       {"mesh", scene.object->mesh},
                       {},
                       {},
                       surface_spacing(scene)};
  if (scene_case.shell) scene_case.sample = {"sample", scene.material->shell->sample};
  for (std::size_t i = 0; i < document.root["lights"].size(); ++i)
    if (document.root["lights"][i].contains("image"))
      scene_case.light_files.push_back({fmt::format("light{}", i), document.root["lights"][i]["image"]});

  Plan plan;
  plan.scene = scene_path;
  plan.read = {scene_path};
  if (scene.object->size == 0) plan.read.push_back(scene.object->mesh);  // its extent gives the spacing
  plan.material = scene_case.opaque ? "opaque" : scene_case.shell ? "heterogeneous shell" : "homogeneous";
  plan.stages.push_back(prepare(scene_case));
  add_shell_stages(scene_case, plan.stages);
  add_diffusion_stages(scene_case, plan.stages);
  plan.stages.push_back(render(scene_case));
  return plan;
}

}  // namespace shellgrid
