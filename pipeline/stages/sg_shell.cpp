// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "pipeline/scene/origin.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_check.h"
#include "synthesis/shell_core.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;
using nlohmann::json;

namespace {

struct CoreOptions {
  std::string kind = "bottom-layer", sample_path;
  std::vector<double> absorption, scattering, anisotropy;
  int boundary_triangles = 2000;
  SolidCoreOptions solid;

  bool given() const { return !absorption.empty(); }
  void check() const {
    if (absorption.empty() != scattering.empty())
      throw UsageError("--core-absorption and --core-scattering must be given together");
    if (absorption.empty() && !anisotropy.empty())
      throw UsageError("--core-anisotropy needs --core-absorption and --core-scattering");
    if (given() && kind != "bottom-layer")
      throw UsageError("--core " + kind + " takes its coefficients from the shell; leave out --core-absorption");
  }
  // Below several samples the mean of their bottom layers, by the vertices that carry them.
  Material homogeneous(const std::vector<MaterialSample>& samples, const TexturedMesh& mesh) const {
    const auto color = [](const std::vector<double>& v) {
      return v.empty() ? Rgb(Rgb::Zero()) : Rgb(Eigen::Array3d(v[0], v[1], v[2]).cast<float>());
    };
    if (given()) return Material::from_absorption_scattering(color(absorption), color(scattering), color(anisotropy));
    Rgb absorbed = Rgb::Zero(), scattered = Rgb::Zero(), forward = Rgb::Zero();
    const auto all = static_cast<float>(mesh.mesh.vertex_count());
    for (std::size_t k = 0; k < samples.size(); ++k) {
      const Material m = bottom_layer_mean(samples[k]);
      const auto carried = std::count(mesh.sample.begin(), mesh.sample.end(), static_cast<std::int32_t>(k));
      const float share = mesh.sample.empty() ? (k == 0 ? 1.0f : 0.0f) : static_cast<float>(carried) / all;
      absorbed += share * m.absorption(), scattered += share * m.scattering();
      forward += share * m.scattering() * m.anisotropy;
    }
    if (mesh.sample.empty()) return bottom_layer_mean(samples.front());
    return Material::from_absorption_scattering(absorbed, scattered,
                                                (scattered > 0).select(forward / scattered, Rgb::Zero()));
  }
};

// Makes the core of the shell, and what the record says of it.
json make_core(const CoreOptions& options, ShellVolume& shell, const DistanceField& distance,
               const std::vector<MaterialSample>& samples, Progress& progress) {
  CoreStatistics statistics;
  json result = {{"kind", options.given() ? "coefficients" : options.kind}};
  if (options.kind == "interpolated") shell.core_interpolated = true;
  if (options.kind == "mean-value") {
    fill_core_by_mean_values(shell, distance, options.boundary_triangles, &statistics, progress);
    result["boundary_triangles"] = statistics.boundary_triangles;
    result["boundary_edge_mm"] = statistics.boundary_edge;
  }
  if (options.kind == "solid") {
    fill_core_with_solid(shell, distance,
                         options.sample_path.empty() ? samples.front() : restore_sample(read_vdb(options.sample_path)),
                         options.solid, &statistics, progress);
    result["synthesized_voxels"] = statistics.synthesized_voxels;
    result["step_to_shell_over_samples"] =
        statistics.sample_step > 0 ? statistics.shell_step / statistics.sample_step : 0;
    result["tilings_step_over_samples"] =
        statistics.sample_step > 0 ? statistics.tiling_step / statistics.sample_step : 0;
  }
  if (options.kind == "mean-value" || options.kind == "solid") {
    result["voxels"] = statistics.voxels;
    result["bytes"] = statistics.bytes;
  }
  return result;
}

json coordinate_results(const std::string& kind, const ShellStatistics& s) {
  if (kind == "nearest") return {{"kind", kind}};
  return {{"kind", kind},
          {"incoherent_share", s.incoherent_share},
          {"changed_share", s.changed_share},
          {"reduced_extinction_rms", s.extinction_rms},
          {"reduced_extinction_deviation", s.extinction_deviation},
          {"reduced_albedo_rms", s.albedo_rms},
          {"reduced_albedo_deviation", s.albedo_deviation}};
}

std::string report(const std::string& kind, const ShellStatistics& s, const json& core) {
  std::string line = fmt::format("{} voxels in {} of {} leaves", s.voxels, s.leaves, s.possible_leaves);
  if (core.contains("voxels")) line += fmt::format(", {} below them", core["voxels"].get<long>());
  if (kind == "nearest") return line;
  return line + fmt::format(
                    "; against nearest vertices {:.0f} % are other voxels of the sample, by {:.3g} /mm in reduced "
                    "extinction, which deviates by {:.3g} /mm",
                    100 * s.changed_share, s.extinction_rms, s.extinction_deviation);
}

}  // namespace

int main(int argc, char** argv) {
  std::string mesh_path, distance_path, coordinates = "interpolated";
  std::vector<std::string> sample_paths;
  double thickness = 4;
  CoreOptions core;
  StageProgram program("sg-shell", "Resamples the synthesised shell on a regular two-level grid.");
  program.input("synthesized.ply", mesh_path, "surface with texture coordinates, from sg-synthesize");
  program.input("distance.vdb", distance_path, "distance field of the same surface, from sg-distance");
  program.inputs("sample.vdb", sample_paths, "the base volume, from sg-sample; several in the order of sg-textons");
  program.output("shell.vdb", "the shell's voxels");
  program.output_beside(".view.ply");
  program.option("--thickness", thickness, "mm", "thickness of the shell", 1e-6, 1e4);
  program.option(
      "--coordinates", coordinates,
      "where in the sample a voxel lies: continued from the vertices of the triangle above it, or that of the "
      "nearest vertex, as the paper does",
      {"interpolated", "nearest"});
  program.option("--core", core.kind,
                 "below the shell without coefficients: the mean of the sample's bottom layer everywhere; the shell's "
                 "bottom layer continued smoothly by each later stage on its own grid; or as voxels of this file: "
                 "interpolated by mean value coordinates, or solid synthesis",
                 {"bottom-layer", "interpolated", "mean-value", "solid"});
  program.option("--core-triangles", core.boundary_triangles, "", "of the boundary that mean values are taken from", 50,
                 100000);
  program.option(
      "--core-reach", core.solid.reach, "voxels",
      "how far below the shell, and about the slabs that it is laid in, a solid is synthesised; elsewhere it tiles", 0,
      64);
  program.option("--core-sample", core.sample_path,
                 "the solid of --core solid (.vdb, from sg-sample); else the base volume");
  program.option("--core-absorption", core.absorption, "1/mm", "of a homogeneous core; without it see --core", 0, 1e6);
  program.option("--core-scattering", core.scattering, "1/mm", "of the core", 0, 1e6);
  program.option("--core-anisotropy", core.anisotropy, "", "of the core; 0 where not given", -0.999, 0.999);
  program.example("sg-shell synthesized.ply distance.vdb sample.vdb -o shell.vdb", "a shell 4 mm thick");
  return program.run(argc, argv, [&](StageRun& run) {
    core.check();
    program.refuse_unless(core.kind == "mean-value", "--core mean-value", {"--core-triangles"});
    program.refuse_unless(core.kind == "solid", "--core solid", {"--core-reach", "--core-sample"});
    if (core.kind == "solid" && core.sample_path.empty() && sample_paths.size() > 1)
      throw UsageError("--core solid: name its sample with --core-sample where there are several");
    if (std::error_code none; std::filesystem::equivalent(run.output(), core.sample_path, none))
      throw UsageError("-o " + run.output() + ": would overwrite the core's sample");
    core.solid.seed = run.seed();
    run.start_timer("read");
    const TexturedMesh mesh = detach_texture(read_mesh(mesh_path), mesh_path);
    require_made_from(note_of(read_notes(mesh_path), samples_note), mesh_path, sample_paths);
    const DistanceField distance = read_distance_field(distance_path);
    std::vector<MaterialSample> samples;
    for (const std::string& path : sample_paths) samples.push_back(restore_sample(read_vdb(path)));
    std::vector<const MaterialSample*> all;
    for (const MaterialSample& sample : samples) all.push_back(&sample);
    run.start_timer("resample");
    ShellStatistics s;
    ShellVolume shell = resample_shell(
        mesh, distance, all, core.homogeneous(samples, mesh), thickness,
        coordinates == "nearest" ? ShellCoordinates::nearest : ShellCoordinates::interpolated, &s, run.progress());
    run.start_timer("core");
    const json core_results = make_core(core, shell, distance, samples, run.progress());
    for (std::size_t k = 0; samples.size() > 1 && k < samples.size(); ++k)
      if (std::find(mesh.sample.begin(), mesh.sample.end(), static_cast<std::int32_t>(k)) == mesh.sample.end())
        run.progress().warn(fmt::format("no vertex carries sample {}, {}", k, sample_paths[k]));
    for (std::size_t k = 1; k < samples.size(); ++k)
      if (std::abs(samples[k].ior - samples.front().ior) > 1e-6)
        run.progress().warn(fmt::format("{} was made for the refractive index {:.4g}; that of {}, {:.4g}, counts",
                                        sample_paths[k], samples[k].ior, sample_paths.front(), samples.front().ior));
    int layers = samples.front().size.z();
    for (const MaterialSample& sample : samples) layers = std::min(layers, sample.size.z());
    if (const double depth = layers * samples.front().voxel; depth < thickness * (1 - 1e-6))
      run.progress().warn(
          fmt::format("the shell is {:.4g} mm thick and the sample {:.4g} mm deep: below that its bottom "
                      "layer goes on; make the sample deeper or the shell thinner",
                      thickness, depth));
    if (shell.surface_ior.leaf_count() > 0)
      run.progress().warn(
          "the sample's surface has refractive indices of its own; the shell carries them (surface_ior), but light "
          "meets "
          "the object's one index everywhere");
    const double bare = share_without_matter(mesh, shell);
    if (bare > 0.002)
      run.progress().warn(
          fmt::format("below {:.2g} % of the surface the shell holds no matter: the object is thinner there than the "
                      "sample's relief is deep; make the relief lower or the object larger",
                      100 * bare));
    run.start_timer("write");
    write_shell_volume(run.output(), shell, {{samples_note, hash_files(sample_paths)}});
    const std::string view = view_path(run.output());
    write_ply(view, view_shell(mesh, shell));
    run.note_output(view);
    run.results() = {{"core", core_results},
                     {"leaves", s.leaves},
                     {"possible_leaves", s.possible_leaves},
                     {"voxels", s.voxels},
                     {"free_space_voxels", s.free_voxels},
                     {"share_without_matter", bare},
                     {"bytes", s.bytes},
                     {"dense_bytes", s.possible_leaves * 512 * 64},
                     {"skipped_share_of_leaves", 1 - static_cast<double>(s.leaves) / s.possible_leaves},
                     {"skipped_share_of_band", s.skipped_share},
                     {"coordinates", coordinate_results(coordinates, s)}};
    run.print(report(coordinates, s, core_results));
  });
}
