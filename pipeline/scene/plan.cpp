// SPDX-License-Identifier: AGPL-3.0-or-later
#include "pipeline/scene/plan.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/scene/sample_description.h"
#include "pipeline/scene/scene.h"
#include "pipeline/scene/scene_checks.h"
#include "pipeline/scene/scene_document.h"
#include "solvers/diffusion/diffusion_validity.h"
#include "synthesis/surface_paint.h"

namespace shellgrid {
namespace {

using nlohmann::json;

constexpr const char* diffusion_method = "polygrid-diffusion";
constexpr const char* texture_method = "shell-texture-function";

std::string millimetres(double length) { return number_text(length); }

// To three digits: an option that a person reads.
double rounded(double length) { return std::strtod(fmt::format("{:.3g}", length).c_str(), nullptr); }

std::string rgb_text(const Rgb& colour) { return fmt::format("{},{},{}", colour[0], colour[1], colour[2]); }

// How the surface is meshed, and why so. The camera has no say: it may move without a new surface.
struct Tiling {
  std::vector<std::string> options;
  std::string reason;
};

Tiling choose_tiling(const Scene& scene, double size) {
  if (scene.material->shell) {
    const std::string voxel = millimetres(scene.material->shell->voxel);
    return {{"--spacing", voxel}, "its vertices stand a voxel apart, because each carries a texel of the sample"};
  }
  constexpr double least_parts = 100;  // edges in the object's size, for its shape in the picture
  if (scene.material->opaque) {
    const std::string longest = millimetres(rounded(size / least_parts));
    return {{"--no-retile", "--longest-edge", longest},
            fmt::format("its triangles are kept, because nothing is solved on them; edges above {} mm are split, "
                        "because soft light is found at vertices",
                        longest)};
  }
  // Objects fill some part of their box, so that a grid's nodes stand closer than in a full cube: about half as far.
  const double nodes_along = std::cbrt(scene.method.nodes);
  const double parts = std::max(least_parts, 4 * nodes_along);
  const std::string spacing = millimetres(rounded(size / parts));
  return {{"--spacing", spacing},
          parts > least_parts
              ? fmt::format("its vertices stand {} mm apart, about half as far as the grid's {} nodes, because the "
                            "light between these is no finer",
                            spacing, number_text(scene.method.nodes))
              : fmt::format("its vertices stand {} mm apart, closer than the grid's few nodes, for the object's shape",
                            spacing)};
}

// The mesh as the file has it, in the scene's place and size.
class PlacedMesh {
 public:
  explicit PlacedMesh(const SceneObject& object) : mesh_(read_mesh(object.mesh).mesh) {
    if (mesh_.vertex_count() == 0 || mesh_.face_count() == 0) throw InputError(object.mesh + ": has no faces");
    const Eigen::RowVector3d lower = mesh_.vertices.colwise().minCoeff(), upper = mesh_.vertices.colwise().maxCoeff();
    size_ = (upper - lower).maxCoeff();
    if (!(size_ > 0) || !std::isfinite(size_)) throw InputError(object.mesh + ": has no size");
    mesh_.vertices.rowwise() -= 0.5 * (lower + upper);
    if (object.size > 0) mesh_.vertices *= object.size / size_;
    if (object.size > 0) size_ = object.size;
  }
  double size() const { return size_; }

  // 4 V/A, mm; 0 where the faces enclose nothing.
  double mean_chord() const {
    double volume = 0, area = 0;
    for (int f = 0; f < mesh_.face_count(); ++f) {
      const Vec3 a = mesh_.corner(f, 0), b = mesh_.corner(f, 1), c = mesh_.corner(f, 2);
      volume += a.dot(b.cross(c)) / 6;
      area += (b - a).cross(c - a).norm() / 2;
    }
    const double chord = 4 * std::abs(volume) / area;
    return std::isfinite(chord) ? chord : 0;
  }

  // By the winding number: the solid angle of all faces. Source: [VanOosteromStrackee1983].
  bool contains(const Vec3& point) const {
    double angle = 0;
    for (int f = 0; f < mesh_.face_count(); ++f) {
      const Vec3 a = mesh_.corner(f, 0) - point, b = mesh_.corner(f, 1) - point, c = mesh_.corner(f, 2) - point;
      const double la = a.norm(), lb = b.norm(), lc = c.norm();
      angle += 2 * std::atan2(a.dot(b.cross(c)), la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb);
    }
    return std::abs(angle) > 2 * std::numbers::pi;
  }

 private:
  TriangleMesh mesh_;
  double size_ = 0;
};

// What is wrong with a scene beyond its single values. The mesh is read only where the answer hangs on it.
void check_whole(const Scene& scene, double size, std::optional<PlacedMesh>& mesh) {
  const auto fail = [&](const std::string& what) { throw InputError(scene.path + ": " + what); };
  if (size < 0.01) fail(fmt::format("object.size: {} mm; expected at least 0.01 mm", number_text(size)));
  if (scene.material->shell && scene.material->shell->voxel > size / 4)
    fail(fmt::format("material.shell.voxel: {} mm is too coarse for an object {} mm long; expected at most a quarter",
                     number_text(scene.material->shell->voxel), number_text(size)));
  const auto inside = [&](const Vec3& point) {
    if (point.cwiseAbs().maxCoeff() > 0.5 * size) return false;
    if (!mesh) mesh.emplace(*scene.object);
    return mesh->contains(point);
  };
  const auto text = [](const Vec3& p) {
    return fmt::format("({}, {}, {})", number_text(p.x()), number_text(p.y()), number_text(p.z()));
  };
  if (inside(scene.camera->position))
    fail(
        fmt::format("camera.position: {} is inside the object, whose box is centred on the origin; expected a place "
                    "outside",
                    text(scene.camera->position)));
  for (std::size_t i = 0; i < scene.lights.size(); ++i)
    if (const std::optional<Vec3> place = light_position(scene.lights[i]); place && inside(*place))
      fail(fmt::format("lights[{}].position: {} is inside the object; expected a place outside", i, text(*place)));
}

// Where diffusion is out of its range whatever the light meets: in a homogeneous object, or one whose shell and core
// are of materials that are all out of it (what their mixture makes of light, sg-diffuse knows). Empty: it is not, or
// what would tell cannot be read, which is left to the stages that need it.
std::string warn_of_diffusion(const Scene& scene) {
  if (scene.method.type != diffusion_method) return "";
  const SceneMaterial& material = *scene.material;
  std::vector<Material> materials;
  if (const auto* core = std::get_if<Material>(&material.core); core && !material.opaque) materials.push_back(*core);
  std::string mildest;
  try {
    std::vector<std::string> samples;
    if (material.shell) samples = material.shell->samples;
    if (const auto* core = std::get_if<ContinuedCore>(&material.core); core && !core->sample.empty())
      samples.push_back(core->sample);
    for (const std::string& sample : samples) {
      const std::vector<Material> described = described_materials(sample);
      if (described.empty()) return "";
      materials.insert(materials.end(), described.begin(), described.end());
    }
    if (materials.empty()) return "";
    const double chord = PlacedMesh(*scene.object).mean_chord();
    if (!(chord > 0)) return "";
    const bool first_collision = scene.method.source == "first-collision";
    float least = 1e30f;
    for (const Material& m : materials) {
      if (!(m.reduced_extinction() > 0).all()) return "";
      const DiffusionRegime regime{m.reduced_albedo(), static_cast<float>(chord) * m.reduced_extinction()};
      const std::string warning = diffusion_warning(regime, first_collision, {true, true, true});
      if (warning.empty()) return "";
      const float error = expected_diffusion_error(regime, first_collision).maxCoeff();
      if (error < least) mildest = warning;
      least = std::min(least, error);
    }
  } catch (const InputError&) {
    return "";
  }
  return mildest;
}

// A shell texture function is that of one sample as it is, in a shell over a homogeneous core.
void require_one_sample(const Scene& scene) {
  const auto fail = [&](const std::string& what) {
    throw InputError(scene.path + ": method.type: shell-texture-function " + what);
  };
  const SceneMaterial& material = *scene.material;
  if (material.opaque) fail("is for translucent objects; this one is opaque");
  if (!material.shell) fail("needs a material.shell; polygrid-diffusion or path-tracing serve a homogeneous object");
  if (material.shell->samples.size() > 1) fail("takes one sample; polygrid-diffusion or path-tracing serve several");
  if (!material.shell->paint.empty() || material.shell->scale != 1)
    fail("takes samples at their own scale; leave material.shell.paint and scale out, or use polygrid-diffusion");
  if (std::holds_alternative<ContinuedCore>(material.core))
    fail("has a homogeneous core; expected coefficients or bottom-layer as material.core");
}

constexpr float mostly_absorbed = 0.3f;  // reduced albedo below which what is scattered twice hardly counts

// Where the method's assumptions fail: light that crosses the shell unscattered, and objects that are little more than
// shell. Empty: they hold, or what would tell cannot be read. Source: [STF §5.2, §8].
std::string warn_of_shell_texture(const Scene& scene) {
  if (scene.method.type != texture_method) return "";
  const ShellMaterial& shell = *scene.material->shell;
  const char* const instead = "; polygrid-diffusion needs no such assumption, path-tracing none";
  try {
    const std::vector<Material> materials = described_materials(shell.samples.front());
    float least = std::numeric_limits<float>::infinity();
    for (const Material& m : materials) least = std::min(least, m.reduced_extinction().minCoeff());
    const double depth = static_cast<double>(least) * shell.thickness;
    if (!materials.empty() && depth < 3)
      return fmt::format(
                 "the shell of {:g} mm is {:.2g} mean free paths thick in its clearest matter; the shell texture "
                 "function expects 3, so that hardly any light crosses it unscattered",
                 shell.thickness, depth) +
             instead;
    double decay = 0;  // mm⁻¹
    for (const Material& m : materials) {
      const Rgb transport = (m.reduced_albedo() > mostly_absorbed).select(m.transport_coefficient(), Rgb::Zero());
      decay = std::max(decay, static_cast<double>(transport.maxCoeff()));
    }
    if (decay * shell.voxel > 1)
      return fmt::format(
          "its voxels of {:g} mm are {:.2g} diffuse mean free paths wide in its densest matter; the shell "
          "texture function holds one value a voxel and comes out dark there; take material.shell.voxel below "
          "{:.2g} mm",
          shell.voxel, decay * shell.voxel, 1 / decay);
    const double chord = PlacedMesh(*scene.object).mean_chord();
    if (chord > 0 && chord < 4 * shell.thickness)
      return fmt::format(
                 "the object is {:.3g} mm thick in the mean, the shell {:g} mm: little core is left below it, "
                 "and light from behind is the shell's alone",
                 chord, shell.thickness) +
             instead;
  } catch (const InputError&) {
  }
  return "";
}

// A sample that a stage of its own makes.
struct SampleFiles {
  std::string name;                 // of the stage; NAME.vdb is its output
  std::vector<ExternalFile> files;  // the description, under the stage's name, and the files that it names
};

struct SceneCase {
  const SceneDocument& document;
  const Scene& scene;
  bool opaque, shell;
  ExternalFile mesh;
  std::vector<SampleFiles> samples;        // of the shell
  std::optional<SampleFiles> core_sample;  // of a core of its own
  std::optional<ExternalFile> paint;
  std::vector<ExternalFile> light_files;
  Tiling tiling;

  bool textured() const { return scene.method.type == texture_method; }
  json part(const char* section) const {
    return document.root.contains(section) ? document.root[section] : json::object();
  }
  // What solvers read: of the shell only that there is one, since its own file tells the rest.
  json light_and_matter() const {
    json material = part("material");
    if (material.contains("shell")) material["shell"] = json::object();
    if (material.contains("core") && material["core"].is_object() && material["core"].contains("sample"))
      material["core"] = "solid";
    return {{"object", {{"ior", scene.object->ior}}}, {"material", material}, {"lights", lights()}};
  }
  // Slices lie in another folder than the scene: paths in them are absolute.
  json lights() const {
    json lights = document.root.contains("lights") ? document.root["lights"] : json::array();
    for (json& light : lights)
      if (light.contains("image"))
        light["image"] = std::filesystem::absolute(light["image"].get<std::string>()).string();
    return lights;
  }
};

PlannedStage prepare(const SceneCase& c) {
  PlannedStage stage{"prepare", "the closed surface"};
  stage.reason = "every method needs the repaired surface; " + c.tiling.reason;
  stage.arguments = {"@mesh", "-o", "surface.ply", "--size", millimetres(c.scene.object->size)};
  stage.arguments.insert(stage.arguments.end(), c.tiling.options.begin(), c.tiling.options.end());
  if (c.scene.object->close_holes) stage.arguments.push_back("--close-holes");
  stage.files = {c.mesh};
  stage.outputs = {"surface.ply"};
  return stage;
}

// The stages that make a shell, in their order, and what each makes.
constexpr std::array<std::pair<const char*, const char*>, 5> shell_purposes = {
    {{"distance", "signed distance and nearest vertex around the surface"},
     {"sample", "the base volume of the material"},
     {"textons", "appearance of each texel of the sample"},
     {"synthesize", "a texture coordinate for every vertex"},
     {"shell", "the material of every voxel of the shell"}}};

PlannedStage shell_stage(const std::string& name, const std::string& program) {
  for (const auto& [known, purpose] : shell_purposes)
    if (program == known) {
      PlannedStage stage{name, purpose};
      stage.tool = program;
      return stage;
    }
  throw InternalError("no stage " + program);
}

PlannedStage make_sample_stage(const SampleFiles& sample, const std::string& reason) {
  PlannedStage stage = shell_stage(sample.name, "sample");
  stage.reason = reason;
  stage.arguments = {"@" + sample.name, "-o", sample.name + ".vdb"};
  stage.files = sample.files;
  stage.outputs = {sample.name + ".vdb"};
  stage.views = {sample.name + ".view.ply"};
  return stage;
}

std::vector<std::string> volumes_of(const SceneCase& c) {
  std::vector<std::string> names;
  for (const SampleFiles& sample : c.samples) names.push_back(sample.name + ".vdb");
  return names;
}

template <class Words>
void append(std::vector<std::string>& words, const Words& more) {
  words.insert(words.end(), more.begin(), more.end());
}
void append(std::vector<std::string>& words, std::initializer_list<std::string> more) {
  words.insert(words.end(), more.begin(), more.end());
}

std::vector<PlannedStage> sample_stages(const SceneCase& c) {
  const ShellMaterial& material = *c.scene.material->shell;
  const std::string voxel = millimetres(material.voxel), ior = number_text(c.scene.object->ior);
  std::vector<PlannedStage> stages;
  for (std::size_t i = 0; i < c.samples.size(); ++i) {
    stages.push_back(make_sample_stage(
        c.samples[i], c.samples.size() == 1
                          ? "the shell is filled with this sample"
                          : fmt::format("the shell is filled with this sample where {} is painted", i)));
    append(stages.back().arguments, {"--voxel", voxel, "--thickness", millimetres(material.thickness), "--ior", ior});
  }
  if (c.core_sample) {
    stages.push_back(make_sample_stage(*c.core_sample, "the core is a solid of this sample"));
    append(stages.back().arguments, {"--voxel", voxel, "--ior", ior});
  }
  return stages;
}

PlannedStage textons(const SceneCase& c) {
  const ShellMaterial& material = *c.scene.material->shell;
  PlannedStage stage = shell_stage("textons", "textons");
  stage.reason = "synthesis compares places of the sample by their appearance";
  stage.arguments = stage.artefacts = volumes_of(c);
  append(stage.arguments, {"-o", "textons.vdb"});
  if (material.synthesis != "coherence") append(stage.arguments, {"--method", material.synthesis});
  if (material.symmetry != "auto") append(stage.arguments, {"--symmetry", material.symmetry});
  stage.outputs = {"textons.vdb"};
  stage.views = {"textons.view.ply"};
  return stage;
}

// Numbers with commas between.
void append_numbers(std::string& list, const Vec3& numbers) {
  for (int k = 0; k < 3; ++k) list += (list.empty() ? "" : ",") + number_text(numbers[k]);
}

PlannedStage synthesize(const SceneCase& c) {
  const ShellMaterial& material = *c.scene.material->shell;
  PlannedStage stage = shell_stage("synthesize", "synthesize");
  stage.reason = "the sample is spread over the surface without a seam";
  stage.arguments = {"surface.ply", "textons.vdb"};
  if (c.paint) {
    stage.reason = c.samples.size() > 1 ? "the samples are spread over the surface as it is painted"
                                        : "the sample is spread over the surface as it is painted";
    stage.arguments.push_back("@" + c.paint->name);
    stage.files = {*c.paint};
  }
  append(stage.arguments, {"-o", "synthesized.ply", "--voxel", millimetres(material.voxel)});
  if (material.synthesis != "coherence") append(stage.arguments, {"--method", material.synthesis});
  if (material.scale != 1) append(stage.arguments, {"--scale", number_text(material.scale)});
  if (material.direction != ShellMaterial{}.direction) {
    std::string direction;
    append_numbers(direction, material.direction);
    append(stage.arguments, {"--direction", direction});
  }
  if (!material.orient.empty()) {
    std::string wanted;
    for (const DirectionConstraint& o : material.orient)
      append_numbers(wanted, o.point), append_numbers(wanted, o.direction);
    append(stage.arguments, {"--orient", wanted});
  }
  stage.artefacts = {"surface.ply", "textons.vdb"};
  stage.outputs = {"synthesized.ply"};
  return stage;
}

PlannedStage shell(const SceneCase& c) {
  const ShellMaterial& material = *c.scene.material->shell;
  PlannedStage stage = shell_stage("shell", "shell");
  stage.reason = "the material varies below the surface";
  stage.artefacts = {"synthesized.ply", "distance.vdb"};
  append(stage.artefacts, volumes_of(c));
  stage.arguments = stage.artefacts;
  append(stage.arguments, {"-o", "shell.vdb", "--thickness", millimetres(material.thickness)});
  if (const Material* core = std::get_if<Material>(&c.scene.material->core))
    append(stage.arguments, {"--core-absorption", rgb_text(core->absorption()), "--core-scattering",
                             rgb_text(core->scattering()), "--core-anisotropy", rgb_text(core->anisotropy)});
  if (const auto* core = std::get_if<ContinuedCore>(&c.scene.material->core))
    append(stage.arguments, {"--core", core->kind});
  if (c.core_sample) {
    append(stage.arguments, {"--core-sample", c.core_sample->name + ".vdb"});
    stage.artefacts.push_back(c.core_sample->name + ".vdb");
  }
  if (material.coordinates != "interpolated") append(stage.arguments, {"--coordinates", material.coordinates});
  stage.outputs = {"shell.vdb"};
  stage.views = {"shell.view.ply"};
  return stage;
}

void add_shell_stages(const SceneCase& c, std::vector<PlannedStage>& stages) {
  if (!c.shell) {
    for (const auto& [name, purpose] : shell_purposes) {
      PlannedStage stage{name, purpose};
      stage.needed = false;
      stage.reason = c.opaque ? "the material is opaque: nothing below the surface matters"
                              : "the material is the same everywhere: there is no shell to fill";
      stages.push_back(stage);
    }
    return;
  }
  PlannedStage distance = shell_stage("distance", "distance");
  const ShellMaterial& material = *c.scene.material->shell;
  distance.reason = "the shell's voxels look up their depth and nearest vertex";
  distance.arguments = {"surface.ply",
                        "-o",
                        "distance.vdb",
                        "--voxel",
                        millimetres(material.voxel),
                        "--inside",
                        millimetres(material.thickness + 2 * material.voxel),
                        "--outside",
                        millimetres(2 * material.voxel)};
  distance.artefacts = {"surface.ply"};
  distance.outputs = {"distance.vdb"};
  distance.views = {"distance.view.ply"};
  stages.push_back(distance);
  for (const PlannedStage& stage : sample_stages(c)) stages.push_back(stage);
  for (const PlannedStage& stage : {textons(c), synthesize(c), shell(c)}) stages.push_back(stage);
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
  const bool core = c.textured() && c.scene.method.core == "polygrid";
  if (c.opaque || (c.scene.method.type != diffusion_method && !core)) {
    for (PlannedStage* stage : {&tetrahedralize, &polycube, &polygrid, &diffuse}) {
      stage->needed = false;
      stage->reason = c.opaque ? "the material is opaque: no light enters the object"
                      : c.textured()
                          ? "the method shell-texture-function looks the shell's light up and has a dipole below it"
                          : "the method path-tracing follows light through the surface and the shell itself";
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
  polygrid.reason = core ? "the core's light is solved on it" : "the method polygrid-diffusion solves on it";
  polygrid.arguments = {"polycube.hdf", "surface.ply", "-o", "polygrid.hdf"};
  polygrid.artefacts = {"polycube.hdf", "surface.ply"};

  diffuse.reason = c.shell ? "light diffuses through shell and core" : "light diffuses through the homogeneous object";
  diffuse.arguments = {"plan/diffuse.json", "polygrid.hdf", "surface.ply"};
  diffuse.artefacts = {"surface.ply", "polygrid.hdf"};
  if (c.shell) {
    diffuse.arguments.push_back("shell.vdb");
    // Make takes them in this order: what is wrong with a sample shows before the grid is made.
    diffuse.artefacts.insert(diffuse.artefacts.begin() + 1, "shell.vdb");
  }
  diffuse.arguments.insert(diffuse.arguments.end(), {"-o", "fluence.hdf", "--exitance", "exitance.ply"});
  diffuse.files = c.light_files;
  diffuse.slice = c.light_and_matter();
  diffuse.slice["method"] = c.part("method");
  for (const char* key : {"nodes", "paths", "samples_per_pixel", "irradiance_error", "core"})
    diffuse.slice["method"].erase(key);
  for (const PlannedStage* stage : {&tetrahedralize, &polycube, &polygrid, &diffuse}) stages.push_back(*stage);
}

// Exact transport: instead of diffusion, or beside it for whoever asks for it.
void add_reference_stage(const SceneCase& c, std::vector<PlannedStage>& stages) {
  if (c.opaque) return;
  PlannedStage stage{"reference", "what leaves the object, by light paths"};
  stage.on_demand = c.scene.method.type == diffusion_method || c.textured();
  const std::string output = stage.on_demand ? "reference.ply" : "exitance.ply";
  stage.reason = !stage.on_demand ? "the method path-tracing is exact transport"
                 : c.textured()   ? "it judges how far the shell texture function is off"
                                  : "it judges how far diffusion is off";
  stage.arguments = {"plan/reference.json", "surface.ply"};
  stage.artefacts = {"surface.ply"};
  if (c.shell) {
    stage.arguments.push_back("shell.vdb");
    stage.artefacts.push_back("shell.vdb");
  }
  stage.arguments.insert(stage.arguments.end(), {"-o", output, "--paths", number_text(c.scene.method.paths)});
  stage.files = c.light_files;
  stage.outputs = {output};
  stage.slice = c.light_and_matter();
  stages.push_back(stage);
}

// The sample's light, and the core's.
void add_texture_stages(const SceneCase& c, std::vector<PlannedStage>& stages) {
  PlannedStage irradiance{"irradiance", "how light from any direction reaches each voxel of the sample"};
  PlannedStage core{"core", "light that the core gives back to the shell"};
  irradiance.outputs = {"stf.vdb"};
  irradiance.views = {"stf.view.ply"};
  core.outputs = {"core.ply"};
  if (!c.textured()) {
    for (PlannedStage* stage : {&irradiance, &core}) {
      stage->needed = false;
      stage->reason = c.opaque ? "the material is opaque: no light enters the object"
                               : "the method " + c.scene.method.type + " works out the object's own light";
      stages.push_back(*stage);
    }
    return;
  }
  irradiance.reason = "the shell's light is looked up in it, for any light and view";
  irradiance.arguments = {"sample.vdb", "-o", "stf.vdb", "--target-error",
                          number_text(c.scene.method.irradiance_error)};
  irradiance.artefacts = {"sample.vdb"};
  core.reason = "light that passes the shell comes back through it";
  core.artefacts = {"synthesized.ply", "shell.vdb", "stf.vdb"};
  core.arguments = {"plan/core.json"};
  append(core.arguments, core.artefacts);
  append(core.arguments, {"-o", "core.ply"});
  if (c.scene.method.core == "paper") append(core.arguments, {"--dipole", "paper", "--bounces", "0"});
  if (c.scene.method.core == "polygrid") {
    append(core.arguments, {"--fluence", "fluence.hdf"});
    core.artefacts.push_back("fluence.hdf");
  }
  core.files = c.light_files;
  core.slice = c.light_and_matter();
  if (c.scene.method.core == "none") {
    core.needed = false;
    core.reason = "the scene wants a black core";
    core.slice = nullptr;
  }
  stages.push_back(irradiance);
  stages.push_back(core);
}

PlannedStage render(const SceneCase& c) {
  PlannedStage stage{"render", "the picture"};
  stage.reason = "the picture is asked for";
  const std::string surface = c.opaque ? "surface.ply" : c.textured() ? "synthesized.ply" : "exitance.ply";
  stage.arguments = {"plan/render.json", surface, "-o", "image.exr"};
  stage.artefacts = {surface};
  if (c.textured()) {
    append(stage.arguments, {"--stf", "stf.vdb", "--shell", "shell.vdb"});
    append(stage.artefacts, {"stf.vdb", "shell.vdb"});
    if (c.scene.method.core != "none") {
      append(stage.arguments, {"--core", "core.ply"});
      stage.artefacts.push_back("core.ply");
    }
  }
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

// A sample of the scene, checked as far as its text tells, and the files that it is made of.
SampleFiles find_sample(const std::string& name, const std::string& path, const std::string& place,
                        const SampleOverrides& overrides, const Scene& scene) {
  SampleFiles sample{name, {{name, path}}};
  try {
    const std::vector<std::string> files = check_sample_description(path, overrides);
    const std::string volume = name == "sample" ? "volume" : name + "-volume";
    for (std::size_t i = 0; i < files.size(); ++i)
      sample.files.push_back({i == 0 ? volume : fmt::format("{}{}", volume, i), files[i]});
  } catch (const InputError& error) {
    throw InputError(scene.path + ": " + place + ": " + error.what());
  }
  return sample;
}

// The samples of shell and core, and the paint.
void find_samples(SceneCase& c, Plan& plan) {
  const ShellMaterial& shell = *c.scene.material->shell;
  SampleOverrides overrides{shell.voxel, shell.thickness, c.scene.object->ior, {}};
  for (std::size_t i = 0; i < shell.samples.size(); ++i) {
    const std::string name = i == 0 ? "sample" : fmt::format("sample-{}", i + 1);
    c.samples.push_back(find_sample(name, shell.samples[i], "material.shell", overrides, c.scene));
    plan.read.push_back(shell.samples[i]);
  }
  if (const auto* core = std::get_if<ContinuedCore>(&c.scene.material->core); core && !core->sample.empty()) {
    overrides.thickness.reset();
    c.core_sample = find_sample("core-sample", core->sample, "material.core", overrides, c.scene);
    plan.read.push_back(core->sample);
  }
  if (shell.paint.empty()) return;
  c.paint = ExternalFile{"paint", shell.paint};
  plan.read.push_back(shell.paint);
  try {
    require_paint(read_mesh(shell.paint), static_cast<int>(shell.samples.size()), shell.paint, shell.scale);
  } catch (const InputError& error) {
    throw InputError(c.scene.path + ": material.shell.paint: " + error.what());
  }
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
  need(!scene.material->shell || !scene.material->shell->samples.empty(), "material.shell.sample");
  need(scene.camera.has_value(), "camera");
  if (scene.method.operator_name == "paper" && scene.method.source == "first-collision")
    throw InputError(scene_path + ": method.source: first-collision: only the operator elements takes it");

  if (scene.method.type == diffusion_method) require_scattering(scene);
  if (scene.method.type == texture_method) require_one_sample(scene);

  std::optional<PlacedMesh> mesh;
  if (scene.object->size == 0) mesh.emplace(*scene.object);
  const double size = mesh ? mesh->size() : scene.object->size;
  check_whole(scene, size, mesh);

  SceneCase scene_case{document,
                       scene,
                       scene.material->opaque.has_value(),
                       scene.material->shell.has_value(),
                       {"mesh", scene.object->mesh},
                       {},
                       {},
                       {},
                       {},
                       choose_tiling(scene, size)};
  Plan plan;
  plan.scene = scene_path;
  plan.read = {scene_path};
  if (mesh) plan.read.push_back(scene.object->mesh);
  if (scene_case.shell) find_samples(scene_case, plan);
  const json lights = scene_case.lights();
  for (std::size_t i = 0; i < lights.size(); ++i)
    if (lights[i].contains("image"))
      scene_case.light_files.push_back({fmt::format("light{}", i), document.root["lights"][i]["image"]});

  const std::string warning = is_dark(scene)                        ? darkness_warning
                              : scene.method.type == texture_method ? warn_of_shell_texture(scene)
                                                                    : warn_of_diffusion(scene);
  if (!warning.empty()) plan.warnings.push_back(warning);
  plan.material = scene_case.opaque ? "opaque" : scene_case.shell ? "heterogeneous shell" : "homogeneous";
  plan.stages.push_back(prepare(scene_case));
  add_shell_stages(scene_case, plan.stages);
  add_diffusion_stages(scene_case, plan.stages);
  add_texture_stages(scene_case, plan.stages);
  add_reference_stage(scene_case, plan.stages);
  plan.stages.push_back(render(scene_case));
  return plan;
}

}  // namespace shellgrid
