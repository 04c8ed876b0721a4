// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_check.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string mesh_path, distance_path, sample_path;
  double thickness = 4;
  std::vector<double> absorption, scattering, anisotropy;
  std::string core_kind = "bottom-layer", coordinates = "interpolated";
  StageProgram program("sg-shell", "Resamples the synthesised shell on a regular two-level grid.");
  program.input("synthesized.ply", mesh_path, "surface with texture coordinates, from sg-synthesize");
  program.input("distance.vdb", distance_path, "distance field of the same surface, from sg-distance");
  program.input("sample.vdb", sample_path, "the base volume, from sg-sample");
  program.output("shell.vdb", "the shell's voxels");
  program.output_beside(".view.ply");
  program.option("--thickness", thickness, "mm", "thickness of the shell", 1e-6, 1e4);
  program.option(
      "--coordinates", coordinates,
      "where in the sample a voxel lies: continued from the vertices of the triangle above it, or those of the "
      "nearest vertex, as the paper does",
      {"interpolated", "nearest"});
  program.option("--core", core_kind,
                 "below the shell without coefficients: the mean of the sample's bottom layer everywhere, or the "
                 "shell's bottom layer continued smoothly",
                 {"bottom-layer", "interpolated"});
  program.option("--core-absorption", absorption, "1/mm", "of a homogeneous core; without it see --core", 0, 1e6);
  program.option("--core-scattering", scattering, "1/mm", "of the core", 0, 1e6);
  program.option("--core-anisotropy", anisotropy, "", "of the core; 0 where not given", -0.999, 0.999);
  program.example("sg-shell synthesized.ply distance.vdb sample.vdb -o shell.vdb", "a shell 4 mm thick");
  return program.run(argc, argv, [&](StageRun& run) {
    if (absorption.empty() != scattering.empty())
      throw UsageError("--core-absorption and --core-scattering must be given together");
    if (absorption.empty() && !anisotropy.empty())
      throw UsageError("--core-anisotropy needs --core-absorption and --core-scattering");
    if (!absorption.empty() && core_kind == "interpolated")
      throw UsageError("--core interpolated takes its coefficients from the shell; leave out --core-absorption");
    run.start_timer("read");
    const TexturedMesh mesh = detach_texture(read_mesh(mesh_path), mesh_path);
    const DistanceField distance = read_distance_field(distance_path);
    const MaterialSample sample = restore_sample(read_vdb(sample_path));
    const auto color = [](const std::vector<double>& v) {
      return v.empty() ? Rgb(Rgb::Zero()) : Rgb(Eigen::Array3d(v[0], v[1], v[2]).cast<float>());
    };
    const Material core = absorption.empty() ? bottom_layer_mean(sample)
                                             : Material::from_absorption_scattering(
                                                   color(absorption), color(scattering), color(anisotropy));
    run.start_timer("resample");
    ShellStatistics statistics;
    ShellVolume shell =
        resample_shell(mesh, distance, sample, core, thickness,
                       coordinates == "nearest" ? ShellCoordinates::nearest : ShellCoordinates::interpolated,
                       &statistics, run.progress());
    shell.core_interpolated = core_kind == "interpolated";
    if (!sample.surface_ior.empty())
      run.progress().warn(
          fmt::format("{}: its surface has refractive indices of its own; the shell carries them (surface_ior), but "
                      "light meets the "
                      "object's one index everywhere",
                      sample_path));
    run.start_timer("write");
    write_shell_volume(run.output(), shell);
    const std::string view = view_path(run.output());
    write_ply(view, view_shell(mesh, shell));
    run.note_output(view);
    run.results() = {
        {"core", shell.core_interpolated ? "interpolated"
                 : absorption.empty()    ? "bottom-layer"
                                         : "coefficients"},
        {"leaves", statistics.leaves},
        {"possible_leaves", statistics.possible_leaves},
        {"voxels", statistics.voxels},
        {"free_space_voxels", statistics.free_voxels},
        {"bytes", statistics.bytes},
        {"dense_bytes", statistics.possible_leaves * 512 * 64},
        {"skipped_share_of_leaves", 1 - static_cast<double>(statistics.leaves) / statistics.possible_leaves},
        {"skipped_share_of_band", statistics.skipped_share},
        {"coordinates", {{"kind", coordinates}}}};
    std::string line =
        fmt::format("{} voxels in {} of {} leaves", statistics.voxels, statistics.leaves, statistics.possible_leaves);
    if (coordinates == "interpolated") {
      run.results()["coordinates"] = {{"kind", coordinates},
                                      {"incoherent_share", statistics.incoherent_share},
                                      {"changed_share", statistics.changed_share},
                                      {"reduced_extinction_rms", statistics.extinction_rms},
                                      {"reduced_extinction_deviation", statistics.extinction_deviation},
                                      {"reduced_albedo_rms", statistics.albedo_rms},
                                      {"reduced_albedo_deviation", statistics.albedo_deviation}};
      line += fmt::format(
          "; against nearest vertices {:.0f} % are other voxels of the sample, by {:.3g} /mm in reduced "
          "extinction, which deviates by {:.3g} /mm",
          100 * statistics.changed_share, statistics.extinction_rms, statistics.extinction_deviation);
    }
    run.print(line);
  });
}
