// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/number_archive.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/output_set.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "pipeline/scene/irradiance_state_file.h"
#include "pipeline/scene/origin.h"
#include "solvers/shell_texture/irradiance_tracing.h"
#include "solvers/shell_texture/shell_texture_archive.h"
#include "solvers/shell_texture/shell_texture_codec.h"
#include "synthesis/clustering.h"
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

// Texels alike in what lies below and about them share a kernel [STF §7].
IrradianceKernels irradiance_kernels(const BaseVolume& volume, int count, std::uint64_t seed) {
  std::vector<std::uint8_t> of_texel(volume.texel_count(), 0);
  const std::vector<std::vector<float>> domains = kernel_domains(volume);
  if (count > 1 && !domains.front().empty()) {
    RowMatrixf rows(static_cast<Eigen::Index>(domains.size()), static_cast<Eigen::Index>(domains.front().size()));
    for (std::size_t t = 0; t < domains.size(); ++t)
      rows.row(static_cast<Eigen::Index>(t)) =
          Eigen::Map<const Eigen::RowVectorXf>(domains[t].data(), static_cast<Eigen::Index>(domains[t].size()));
    const Clusters clusters = cluster(rows, count, 25, seed);
    for (std::size_t t = 0; t < of_texel.size(); ++t) of_texel[t] = static_cast<std::uint8_t>(clusters.labels[t]);
  }
  KernelOptions options;
  options.seed = seed;
  return trace_kernels(volume, of_texel, options);
}

// Follows light from where the state's file, if any, left off, and keeps it there.
ShellTexture follow(const BaseVolume& volume, IrradianceOptions options, const std::string& state_path,
                    const std::string& fingerprint, StageRun& run, IrradianceReport& report) {
  IrradianceSums sums = empty_sums(volume, options);
  if (!state_path.empty() && std::filesystem::exists(state_path))
    sums = read_irradiance_state(state_path, fingerprint, sums);
  run.results()["batches_of_earlier_runs"] = sums.upper_batches;
  const auto save = [&](const IrradianceSums& now) {
    const OutputSet::Aside at_once;
    write_irradiance_state(state_path, fingerprint, now);
  };
  if (!state_path.empty()) options.checkpoint = save;
  ShellTexture texture = trace_irradiance(volume, options, sums, &report, run.progress());
  if (!state_path.empty()) {
    save(sums);
    run.note_output(state_path);
  }
  return texture;
}

// As a volume, or compressed where the output is an .stf.
void write(const ShellTexture& texture, const std::string& sample, const std::string& codec, const CodecGoal& goal,
           StageRun& run) {
  if (codec == "none") {
    VdbArchive archive = archive_shell_texture(texture);
    archive.metadata[samples_note] = sample;
    write_vdb(run.output(), archive);
    return;
  }
  CodecReport report;
  const auto compressed = compress_shell_texture(
      texture,
      codec == "vector-quantisation" ? ShellTextureCodec::vector_quantisation : ShellTextureCodec::principal_components,
      goal, &report);
  NumberArchive archive = compressed->archive();
  archive.fingerprint = sample;
  write_number_archive(run.output(), archive);
  run.results()["compression"] = {
      {"bytes", report.bytes}, {"ratio", report.ratio}, {"psnr", report.psnr}, {"words", report.words}};
  if (goal.ratio > 0 && report.ratio < 0.98 * goal.ratio)
    run.progress().warn(fmt::format("the ratio asked for was not reached: {:.1f}", report.ratio));
  if (!(goal.ratio > 0) && report.psnr < goal.psnr - 0.5)
    run.progress().warn(fmt::format("the PSNR asked for was not reached: {:.1f} dB", report.psnr));
}

nlohmann::json in_figures(const IrradianceReport& report, const ShellTexture& texture) {
  nlohmann::json balance = nlohmann::json::array();
  for (const DirectionBalance& b : report.balance)
    balance.push_back({{"absorbed", b.absorbed}, {"left_above", b.left_above}, {"left_below", b.left_below}});
  return {{"size", {texture.size.x(), texture.size.y(), texture.size.z()}},
          {"directions", texture.directions.count()},
          {"paths", report.paths},
          {"paths_from_below", report.back_paths},
          {"march_rays_a_texel", report.march_rays},
          {"median_error", report.median_error},
          {"median_error_from_below", report.back_error},
          {"balance", balance}};
}

}  // namespace

int main(int argc, char** argv) {
  std::string sample_path, state_path, estimator = "shared-walks", smoothing = "wavelets", codec = "none";
  CodecGoal goal;
  int kernels = 8;
  IrradianceOptions options;
  options.target_error = 0.02;
  StageProgram program("sg-irradiance", "Traces how light from any direction reaches each voxel of a sample.");
  program.input("sample.vdb", sample_path, "the base volume, from sg-sample");
  program.output(
      "stf.vdb",
      "the shell texture function: I_s and I_m of each voxel and direction, and their error; .stf: compressed", false,
      {".stf"});
  program.output_beside(".view.ply");
  program.option("--paths", options.paths, "a texel", "light paths, in all or of each direction, at least", 1e-3, 1e6);
  program.option("--most-paths", options.most_paths, "a texel", "where --target-error ends at the latest", 1e-3, 1e7);
  program.option("--target-error", options.target_error, "",
                 "go on until half of the voxels and directions have a relative error of I_m below it, one standard "
                 "deviation; 0: no such end, as where only --paths is given",
                 0, 1);
  program.option("--estimator", estimator,
                 "of I_m; shared-walks: walks that serve all directions; track-length: paths of each direction, ways "
                 "through voxels; sphere: collisions within a voxel of each centre, as the paper does, dark near the "
                 "surface, and so I_s, which is marched otherwise",
                 {"shared-walks", "track-length", "sphere"});
  program.option("--smoothing", smoothing,
                 "of what shared walks tell; wavelets: details in place and direction shrink as far as two halves of "
                 "the walks disagree on them, errors count what that takes away, and --target-error holds for three "
                 "times the errors of layers' means too; none: as the walks tell",
                 {"wavelets", "none"});
  program.option("--rings", options.directions.rings, "", "rings of directions from zenith to horizon", 1, 64);
  program.option("--turns", options.directions.turns, "", "directions of each ring", 1, 256);
  program.option("--march-rays", options.march_rays, "", "rays along each side of a texel, at most, for I_s", 1, 64);
  program.option("--march-error", options.march_error, "",
                 "rays double until I_s changes by less, in its sum over the voxels", 0, 1);
  program.output_option("--state", state_path, "",
                        "file in which the paths are kept: where it is there, the run goes on from it, to the same "
                        "bytes as without a break");
  program.option("--kernels", kernels, "",
                 "how many irradiance correction kernels: for light that is uneven about a place, as at shadows' "
                 "borders; 0: none",
                 0, 200);
  program.option("--codec", codec,
                 "of an .stf; principal-components: of all of a voxel's values; vector-quantisation: the paper's, a "
                 "codeword for each voxel and direction, entropy coded; none: a .vdb",
                 {"none", "vector-quantisation", "principal-components"});
  program.option("--psnr", goal.psnr, "dB", "compressed as small as this allows", 10, 120);
  program.option("--ratio", goal.ratio, "", "compressed so many times instead, to single precision; 0: by --psnr", 0,
                 1e4);
  program.example("sg-irradiance sample.vdb -o stf.stf --ratio 48", "compressed");
  program.example("sg-irradiance sample.vdb -o stf.vdb", "half of the values within 2 %");
  program.example("sg-irradiance sample.vdb -o stf.vdb --target-error 0.01 --state stf.state",
                  "to be stopped with Ctrl-C, and gone on with by the same command");
  return program.run(argc, argv, [&](StageRun& run) {
    const bool compressed = std::filesystem::path(run.output()).extension() == ".stf";
    program.refuse_unless(compressed, "a compressed output (.stf)", {"--psnr", "--ratio"});
    if (compressed && !program.given("--codec")) codec = "principal-components";
    if (compressed == (codec == "none"))
      throw UsageError(compressed ? "--codec none writes a .vdb" : "--codec writes an .stf");
    if (program.given("--paths") && program.given("--most-paths") && options.most_paths < options.paths)
      throw UsageError(fmt::format("--most-paths {:g} is below --paths {:g}", options.most_paths, options.paths));
    program.refuse_unless(estimator == "shared-walks", "--estimator shared-walks", {"--smoothing"});
    run.start_timer("read");
    const MaterialSample sample = restore_sample(read_vdb(sample_path));
    if (program.given("--paths") && !program.given("--target-error")) options.target_error = 0;
    options.most_paths = std::max(options.most_paths, options.paths);
    options.seed = run.seed();
    options.estimator = estimator == "sphere"         ? IrradianceEstimator::sphere
                        : estimator == "track-length" ? IrradianceEstimator::track_length
                                                      : IrradianceEstimator::shared_walks;
    options.smooth = smoothing == "wavelets" && options.estimator == IrradianceEstimator::shared_walks;
    options.interrupted = run.hold_interrupts();
    const std::string fingerprint =
        fmt::format("irradiance 2 {} {} {} {} {} {} {} {} {} {}", hash_file(sample_path), estimator, options.smooth,
                    options.directions.rings, options.directions.turns, options.march_rays, options.march_error,
                    options.paths, run.seed(), SHELLGRID_VERSION);
    run.start_timer("trace");
    IrradianceReport report;
    const BaseVolume volume = base_volume(sample);
    ShellTexture texture =
        naming(sample_path, [&] { return follow(volume, options, state_path, fingerprint, run, report); });
    run.start_timer("kernels");
    if (kernels > 0) texture.kernels = irradiance_kernels(volume, kernels, run.seed());
    if (report.interrupted)
      run.progress().warn("interrupted: the values are those of the paths until then");
    else if (options.target_error > 0 && report.median_error > options.target_error)
      run.progress().warn("the error asked for was not reached; try more --most-paths");
    run.start_timer("write");
    write(texture, hash_files({sample_path}), codec, goal, run);
    const std::string view = view_path(run.output());
    write_ply(view, view_shell_texture(texture));
    run.note_output(view);
    run.results().update(in_figures(report, texture));
    run.results()["kernels"] = texture.kernels.count();
    run.results()["kernel_radius_mm"] = texture.kernels.empty() ? 0 : texture.kernels.radius(0.97);
    run.print(fmt::format("{}: {:.0f} paths, median error {:.2g} %, from below {:.2g} %", run.output(), report.paths,
                          100 * report.median_error, 100 * report.back_error));
  });
}
