// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/formats/vtkhdf_file.h"
#include "meshing/surface/repair.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/exitance_mesh.h"
#include "pipeline/scene/origin.h"
#include "pipeline/scene/scene.h"
#include "pipeline/scene/scene_checks.h"
#include "pipeline/scene/shell_texture_file.h"
#include "solvers/dipole/dipole.h"
#include "solvers/shell_texture/body_shape.h"
#include "solvers/shell_texture/core_light.h"
#include "synthesis/half_space_reflectance.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

namespace {

// The dipole of light that comes out of a shell of the same refractive index, returning as much in all as transport
// says; or the paper's, of light that comes from outside.
std::array<Dipole, 3> core_dipoles(const Material& core, double ior, bool paper) {
  if (paper) return dipoles(core, ior, DipoleEntry::beam, DipoleBoundary::polynomial);
  std::array<Dipole, 3> channels = dipoles(core, 1, DipoleEntry::diffuse);
  for (Dipole& d : channels)
    if (d.total() > 0) d.scale = half_space_reflectance(d.reduced_albedo, 1) / d.total();
  return channels;
}

Eigen::Array3d power(const CoreSurface& surface, const std::vector<Rgb>& values) {
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  for (std::size_t i = 0; i < values.size(); ++i)
    sum += values[i].cast<double>() * static_cast<double>(surface.areas[i]);
  return sum;
}

nlohmann::json list(const Eigen::Array3d& a) { return {a[0], a[1], a[2]}; }

// Fluence at the points of hexahedra, as sg-diffuse writes it for a shell and a scene's lights.
FluenceField read_fluence_field(const std::string& path, const TriangleMesh& surface, const std::string& surface_path,
                                const std::string& shell_path, const Scene& scene) {
  UnstructuredGrid grid = read_vtkhdf(path);
  const DataArray* data = grid.find_point("fluence");
  const auto* values = data ? std::get_if<std::vector<float>>(&data->values) : nullptr;
  if (!values || data->columns != 3 ||
      std::any_of(grid.types.begin(), grid.types.end(), [](std::uint8_t type) { return type != 12; }))
    throw InputError(path + ": no hexahedra with point data named fluence; give sg-diffuse's");
  const auto box = [](const VertexMatrix& points) {
    Box all;
    for (Eigen::Index p = 0; p < points.rows(); ++p) all.add(points.row(p).transpose());
    return all;
  };
  const Box grid_box = box(grid.points), mesh_box = box(surface.vertices);
  const double apart = std::max((grid_box.lower - mesh_box.lower).norm(), (grid_box.upper - mesh_box.upper).norm());
  if (!(apart < 0.05 * (mesh_box.upper - mesh_box.lower).norm()))
    throw InputError(fmt::format("{} and {} are not of the same object: their bounds are {:.3g} mm apart", path,
                                 surface_path, apart));
  std::map<std::string, std::string> notes;
  for (const DataArray& array : grid.field_data)
    if (const auto* text = std::get_if<std::vector<std::uint8_t>>(&array.values))
      notes[array.name] = std::string(text->begin(), text->end());
  require_shell_and_lights_of(notes, path, "sg-diffuse", shell_path, scene);
  std::vector<Rgb> fluence;
  for (std::size_t p = 0; p + 2 < values->size(); p += 3)
    fluence.emplace_back((*values)[p], (*values)[p + 1], (*values)[p + 2]);
  return naming(path,
                [&] { return FluenceField(std::move(grid.points), std::move(grid.connectivity), std::move(fluence)); });
}

// 3 V/A, mm: a ball's radius. By the shell's volume between its two surfaces, as if it were a ball's.
double core_size(const TexturedFrames& frames, const CoreSurface& core, double thickness) {
  double above = 0, below = 0;
  for (const float a : vertex_areas(frames.mesh)) above += static_cast<double>(a);
  for (const float a : core.areas) below += static_cast<double>(a);
  const double shell = thickness * (above + std::sqrt(above * below) + below) / 3;
  return below > 0 ? std::max(0.0, 3 * (enclosed_volume(frames.mesh) - shell) / below) : 0;
}

// Through a clear shell the core is seen sharply: of pieces' edges, the share that a shell of so many reduced mean free
// paths allows.
double clearness(const ShellVolume& shell) {
  constexpr double hidden = 3, least = 1.0 / 3;  // mean free paths; share
  const std::vector<ShellLayer> layers = shell_layers(shell);
  Rgb depth = Rgb::Zero();
  for (const ShellLayer& layer : layers)
    depth += layer.reduced * static_cast<float>(shell.thickness / static_cast<double>(layers.size()));
  return std::clamp(static_cast<double>(depth.minCoeff()) / hidden, least, 1.0);
}

// What the core gives back, one a point, W mm⁻²; and what there is to tell.
struct CoreShine {
  std::vector<Rgb> exitance, irradiance;
  nlohmann::json results;
  std::string account;
};

// The dipole between a core's points.
struct CoreDipole {
  std::array<Dipole, 3> channels;
  bool paper = false;

  CoreDipole(const ShellVolume& shell, double ior, bool as_paper)
      : channels(core_dipoles(shell.core, ior, as_paper)), paper(as_paper) {}

  // size: of the core, 3 V/A, mm; 0: it returns what a half-space does.
  CoreExchangeOptions options(CoreExchangeOptions given, double size) const {
    if (!paper)
      for (int c = 0; c < 3; ++c)
        given.returned[c] = channels[c].total() * (size > 0 ? body_return(channels[c], size) : 1);
    return given;
  }
  // Of so many points that share the core's area.
  RadialProfile profile(const CoreSurface& core, std::size_t points) const {
    double area = 0;
    for (const float a : core.areas) area += static_cast<double>(a);
    return dipole_profile(channels,
                          std::sqrt(area / std::max<double>(1, static_cast<double>(points)) / std::numbers::pi));
  }
};

// The core as dipole_shine has it.
FlatCore flat_core(const TexturedFrames& frames, const CoreDipole& dipole, double thickness,
                   const CoreExchangeOptions& options) {
  FlatCore core;
  for (int c = 0; c < 3; ++c) core.total[c] = static_cast<float>(dipole.channels[c].total());
  core.exitance = [&frames, &options, &dipole, thickness](CoreSurface& surface) {
    if (options.bounces == 0) surface.shell_reflection.clear();
    std::vector<Rgb> exitance = exchange_core_light(surface, dipole.profile(surface, surface.points.size()),
                                                    dipole.options(options, core_size(frames, surface, thickness)))
                                    .exitance;
    spread_over_edges(surface, 2 * thickness, exitance);
    return exitance;
  };
  return core;
}

// size: as CoreDipole has it.
CoreShine dipole_shine(CoreSurface& core, const TexturedFrames& frames, const VertexBuckets* pieces,
                       const CoreDipole& dipole, double thickness, double size, const CoreExchangeOptions& given,
                       StageRun& run) {
  if (given.bounces == 0) core.shell_reflection.clear();
  CoreExchangeOptions options = dipole.options(given, size);
  CoarserCore coarser;
  std::optional<RadialProfile> coarser_profile;
  std::optional<VertexBuckets> larger;
  if (pieces && options.bounces > 0) {
    larger.emplace(frames, vertex_areas(frames.mesh), 2 * pieces->edge());
    coarser.surface = merged(core, *pieces, *larger);
    coarser_profile.emplace(dipole.profile(core, static_cast<std::size_t>(larger->count())));
    coarser.profile = &*coarser_profile;
    coarser.at_points = [&](const std::vector<Rgb>& values) { return at_pieces(*larger, *pieces, values); };
    options.coarser = &coarser;
  }
  CoreExchange exchange = exchange_core_light(core, dipole.profile(core, core.points.size()), options);
  if (exchange.greatest_return > 1.5)
    run.progress().warn(
        fmt::format("the core is thin or folded: by the dipole it would return up to {:.1f} times its light there, "
                    "and was held to it; a thinner shell leaves more of a core",
                    exchange.greatest_return));
  spread_over_edges(core, 2 * thickness, exchange.exitance);
  CoreShine shine;
  shine.irradiance.assign(core.points.size(), Rgb::Zero());
  for (std::size_t i = 0; i < shine.irradiance.size(); ++i)
    if (core.areas[i] > 0) shine.irradiance[i] = exchange.power[i] / core.areas[i];
  shine.exitance = std::move(exchange.exitance);
  const double pairs = static_cast<double>(core.points.size()) * static_cast<double>(core.points.size());
  const auto evaluations = static_cast<double>(exchange.evaluations);
  shine.results = {{"model", dipole.paper ? "paper" : "dipole"},
                   {"bounces", exchange.bounces},
                   {"residual", exchange.residual},
                   {"greatest_return", exchange.greatest_return},
                   {"evaluations", exchange.evaluations},
                   {"pairs", pairs},
                   {"tree_bytes", exchange.statistics.bytes}};
  shine.account = fmt::format("{} bounces, {:.3g} of all pairs evaluated", exchange.bounces, evaluations / pairs);
  return shine;
}

CoreShine diffusion_shine(const CoreSurface& core, const ShellVolume& shell, const TexturedFrames& frames,
                          const FluenceField& fluence) {
  CoreDiffusion diffusion =
      core_from_fluence(frames, core, shell.thickness, fluence, 1 / (3 * shell.core.reduced_extinction()));
  CoreShine shine{std::move(diffusion.exitance), std::move(diffusion.irradiance), {}, {}};
  shine.results = {{"model", "polygrid"}, {"scale", diffusion.scale}};
  shine.account = fmt::format("diffusion's light times {:.3g}, {:.3g}, {:.3g}", diffusion.scale[0], diffusion.scale[1],
                              diffusion.scale[2]);
  return shine;
}

}  // namespace

int main(int argc, char** argv) {
  std::string scene_path, mesh_path, shell_path, texture_path, fluence_path, model = "matched", correction = "kernels",
                                                                             shape = "body";
  int environment_samples = 384;
  double piece = 0.3;
  BodyShapeOptions shaping;
  bool no_interreflection = false;
  bool flat = false;
  CoreExchangeOptions options;
  options.sums.tolerance = 0.02;
  StageProgram program("sg-core", "Finds the light that the core below a shell gives back, by the dipole.");
  program.input("scene.json", scene_path, "lights, object.ior");
  program.input("synthesized.ply", mesh_path, "surface with texture coordinates, from sg-synthesize");
  program.input("shell.vdb", shell_path, "thickness and core, from sg-shell");
  program.input("stf.vdb", texture_path, "the sample's shell texture function, from sg-irradiance");
  program.output("core.ply", "the core's surface: irradiance from the shell, exitance into it");
  program.option("--fluence", fluence_path,
                 "fluence.hdf of sg-diffuse: the core's light is that of diffusion in the whole object, which needs no "
                 "flat core, rather than a dipole's");
  program.option("--dipole", model,
                 "matched: lit by diffuse light out of a shell of the same index, its total that of transport; paper: "
                 "lit by a beam from outside, with Jensen's polynomial",
                 {"matched", "paper"});
  program.option("--tolerance", options.sums.tolerance, "", "greatest relative error of each point's sum", 1e-4, 0.5);
  program.option("--bounces", options.bounces, "",
                 "how often at most light that the core gives back, and the shell returns, enters again; 0: as the "
                 "paper does",
                 0, 100);
  program.option(
      "--piece", piece, "of the shell's thickness",
      "edge of the pieces of the core's surface that each stand as one point, down to a third of it where the "
      "shell is clear; 0: each vertex by itself",
      0, 1);
  program.flag("--brute-force", options.sums.brute_force, "sum over all pairs, to check the hierarchy");
  program.option("--environment-samples", environment_samples, "", "parallel lights that stand for an environment", 1,
                 65536);
  program.option("--correction", correction, irradiance_correction_help, irradiance_correction_names);
  program.option(
      "--shape", shape,
      "how scattered light knows the object's shape, of which the sample's knows nothing; body: by diffusion "
      "in the whole object, where a grid can follow it; bends: by its curvature",
      {"body", "bends"});
  program.option("--shape-cells", shaping.most_cells, "", "of the grid that --shape body solves on, at most", 1e3, 1e8);
  program.flag("--no-interreflection", no_interreflection,
               "light that leaves the object and falls on it again is not followed");
  program.flag("--flat", flat, flat_shell_help);
  program.example("sg-core scene.json synthesized.ply shell.vdb stf.vdb -o core.ply", "ready for sg-render");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const Scene scene = read_scene(scene_path);
    program.refuse_unless(has_extended_light(scene), "a scene with an environment or area light",
                          {"--environment-samples"});
    program.refuse_unless(fluence_path.empty(), "a core by the dipole, without --fluence",
                          {"--dipole", "--tolerance", "--bounces", "--piece", "--brute-force", "--shape"});
    program.refuse_unless(!flat, "a core that is not --flat", {"--shape", "--no-interreflection"});
    program.refuse_unless(!flat && shape == "body" && fluence_path.empty(), "--shape body", {"--shape-cells"});
    TexturedMesh surface;
    ShellVolume shell;
    std::map<std::string, std::string> shell_notes;
    std::unique_ptr<ShellTextureLookup> texture;
    std::string sample;
    together([&] { surface = detach_texture(read_mesh(mesh_path), mesh_path); },
             [&] { shell = read_shell_volume(shell_path, ShellParts::matter, &shell_notes); },
             [&] { texture = open_shell_texture(texture_path, ShellTextureParts::bottom, &sample); });
    std::optional<SceneGeometry> built;
    together([&] { require_same_object(shell, shell_path, surface.mesh, mesh_path, run.progress()); },
             [&] { built.emplace(surface.mesh); });
    const SceneGeometry& geometry = *built;
    require_same_samples(sample, texture_path, note_of(read_notes(mesh_path), samples_note), mesh_path);
    require_same_samples(sample, texture_path, note_of(shell_notes, samples_note), shell_path);
    if (std::abs(texture->voxel() / shell.frame.voxel - 1) > 1e-3)
      throw InputError(fmt::format("{}: its voxels of {:g} mm are not those of {}, {:g} mm", texture_path,
                                   texture->voxel(), shell_path, shell.frame.voxel));
    if (!(shell.core.reduced_extinction() > 0).all())
      throw InputError(shell_path + ": its core neither scatters nor absorbs; a dipole needs matter there");
    warn_of_contradictions(shell, shell_path, scene, run.progress());
    const double ior = scene.object ? scene.object->ior : shell.ior;
    warn_of_darkness(scene, run.progress());

    run.start_timer("light");
    for (const Light& light : scene.lights)
      if (const std::optional<Vec3> place = light_position(light); place && geometry.contains(*place))
        throw InputError(scene_path + ": lights: a light stands inside the object");
    const TexturedFrames frames{surface.mesh, surface.normals, surface.directions};
    const IncidentLight light(frames, geometry, scene.lights, texture->directions(), environment_samples);
    const IrradianceKernels kernels = corrected_by(texture->kernels(), irradiance_correction(correction));
    const SpreadLight spread(light, kernels, texture->size(), surface.coordinate,
                             kernels.empty() ? std::vector<Vec3f>() : band_responses(*texture, true));
    const double edge = fluence_path.empty() && piece > 0 ? piece * clearness(shell) * shell.thickness : 0;
    std::optional<VertexBuckets> pieces;
    if (edge > 0) pieces.emplace(frames, vertex_areas(surface.mesh), edge);
    const CoreDipole dipole(shell, ior, model == "paper");
    BodyShape body;
    shaping.diffusion = shape == "body" && fluence_path.empty();
    shaping.returns = !no_interreflection;
    if (!flat)
      body = body_shape(frames, geometry, shell, ior, spread, texture->directions(),
                        flat_core(frames, dipole, shell.thickness, options), shaping);
    std::optional<ShellCurvature> curvature;
    if (!flat && !body.whole) curvature.emplace(frames, shell, ior);
    CoreSurface core = core_surface(frames, spread, *texture, surface.coordinate, shell.thickness,
                                    pieces ? &*pieces : nullptr, curvature ? &*curvature : nullptr);
    run.start_timer("exchange");
    CoreShine shine =
        fluence_path.empty()
            ? dipole_shine(core, frames, pieces ? &*pieces : nullptr, dipole, shell.thickness,
                           flat ? 0 : core_size(frames, core, shell.thickness), options, run)
            : diffusion_shine(core, shell, frames,
                              read_fluence_field(fluence_path, surface.mesh, mesh_path, shell_path, scene));

    const Eigen::Array3d leaving = power(core, shine.exitance);
    if (pieces) {
      shine.exitance = at_vertices(frames, *pieces, shine.exitance);
      shine.irradiance = at_vertices(frames, *pieces, shine.irradiance);
    }

    run.start_timer("write");
    const std::string shape_taken = flat ? "flat" : body.whole ? "body" : "bends";
    TriangleMesh below = surface.mesh;
    below.vertices -= shell.thickness * frames.normals;
    AttributedMesh written = exitance_mesh(below, shine.exitance, shine.irradiance);
    if (!body.ratios.empty()) add_colour_property(written, "shape", body.ratios);
    write_ply(run.output(), written,
              {{samples_note, sample},
               {shell_note, hash_files({shell_path})},
               {lights_note, hash_lights(scene.lights)},
               {flat_note, flat ? "yes" : "no"},
               {shape_note, shape_taken}});
    Eigen::Array3d entering = Eigen::Array3d::Zero();
    for (const Rgb& one : core.power) entering += one.cast<double>();
    run.results() = shine.results;
    run.results()["shape"] = shape_taken;
    if (body.whole)
      run.results()["body"] = {{"spacing", body.spacing}, {"cells", body.cells}, {"iterations", body.iterations}};
    run.results()["vertices"] = surface.mesh.vertex_count();
    run.results()["points"] = core.points.size();
    run.results()["entering_power"] = list(entering);
    run.results()["leaving_power"] = list(leaving);
    run.results()["vertices_corrected"] = spread.spread_vertices();
    run.results()["shadow_rays"] = light.statistics().shadow_rays;
    run.results()["shadow_rays_skipped"] = light.statistics().shadow_rays_skipped;
    run.results()["shadow_rays_shared"] = light.statistics().shadow_rays_shared;
    run.print(fmt::format("{}: {} points, {}", run.output(), core.points.size(), shine.account));
  });
}
