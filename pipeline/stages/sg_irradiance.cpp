// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "solvers/shell_texture/irradiance_tracing.h"
#include "solvers/shell_texture/shell_texture_archive.h"
#include "synthesis/sample_archive.h"

using namespace shellgrid;

namespace {

BaseVolume base_volume(const MaterialSample& sample) {
  BaseVolume volume;
  volume.size = sample.size;
  volume.voxel = sample.voxel;
  volume.ior = sample.ior;
  volume.surface_ior = sample.surface_ior;
  volume.extinction = sample.extinction;
  volume.albedo = sample.albedo;
  volume.anisotropy = sample.anisotropy;
  for (const VoxelKind kind : sample.kind) volume.free.push_back(kind == VoxelKind::free_space);
  return volume;
}

}  // namespace

int main(int argc, char** argv) {
  std::string sample_path, estimator = "track-length";
  IrradianceOptions options;
  options.paths = 16;
  options.most_paths = 1e5;
  StageProgram program("sg-irradiance", "Traces how light from any direction reaches each voxel of a sample.");
  program.input("sample.vdb", sample_path, "the base volume, from sg-sample");
  program.output("stf.vdb", "the shell texture function: I_s and I_m of each voxel and direction, and their error");
  program.output_beside(".view.ply");
  program.option("--paths", options.paths, "a texel", "light paths of each direction", 1e-3, 1e6);
  program.option("--most-paths", options.most_paths, "a texel", "where --target-error ends at the latest", 1e-3, 1e7);
  program.option("--target-error", options.target_error, "",
                 "go on, each time doubling the paths, until half of the voxels and directions have a relative "
                 "standard error of I_m below it; 0: no such end",
                 0, 1);
  program.option("--estimator", estimator,
                 "track-length: ways through voxels, and I_s marched; sphere: collisions within a voxel of each "
                 "centre, as the paper does, dark near the surface",
                 {"track-length", "sphere"});
  program.option("--rings", options.directions.rings, "", "rings of directions from zenith to horizon", 1, 64);
  program.option("--turns", options.directions.turns, "", "directions of each ring", 1, 256);
  program.option("--march-rays", options.march_rays, "", "rays along each side of a texel, for I_s", 1, 64);
  program.example("sg-irradiance sample.vdb -o stf.vdb --target-error 0.05",
                  "half of the values within 5 % standard error");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const MaterialSample sample = restore_sample(read_vdb(sample_path));
    options.most_paths = std::max(options.most_paths, options.paths);
    options.seed = run.seed();
    options.estimator = estimator == "sphere" ? IrradianceEstimator::sphere : IrradianceEstimator::track_length;
    options.interrupted = run.hold_interrupts();
    run.start_timer("trace");
    IrradianceReport report;
    const ShellTexture texture =
        naming(sample_path, [&] { return trace_irradiance(base_volume(sample), options, &report, run.progress()); });
    if (report.interrupted)
      run.progress().warn("interrupted: the values are those of the paths until then");
    else if (options.target_error > 0 && report.median_error > options.target_error)
      run.progress().warn("the error asked for was not reached; try more --most-paths");
    run.start_timer("write");
    write_vdb(run.output(), archive_shell_texture(texture));
    const std::string view = view_path(run.output());
    write_ply(view, view_shell_texture(texture));
    run.note_output(view);
    nlohmann::json balance = nlohmann::json::array();
    for (const DirectionBalance& b : report.balance)
      balance.push_back({{"absorbed", b.absorbed}, {"left_above", b.left_above}, {"left_below", b.left_below}});
    run.results() = {{"size", {texture.size.x(), texture.size.y(), texture.size.z()}},
                     {"directions", texture.directions.count()},
                     {"paths_a_direction", report.paths},
                     {"median_error", report.median_error},
                     {"balance", balance}};
  });
}
