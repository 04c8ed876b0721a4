// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "pipeline/scene/sample_description.h"
#include "synthesis/sample_archive.h"
#include "synthesis/sample_check.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string description;
  double voxel = 0.4, thickness = 4, ior = 1.5;
  bool strict = false, enlarge = false;
  StageProgram program("sg-sample", "Makes the base volume: a small tilable block of material.");
  program.input("sample.json", description, "description of the sample, or a volume (.vdb)");
  program.output("sample.vdb", "the base volume");
  program.output_beside(".view.ply");
  program.option("--voxel", voxel, "mm", "edge of a voxel, instead of the description's", 1e-6, 1e4);
  program.option("--thickness", thickness, "mm", "thickness, instead of the description's", 1e-6, 1e4);
  program.option("--ior", ior, "", "refractive index inside over outside, instead of the description's", 1, 4);
  program.flag("--strict", strict, "fail where a check of the sample's size or tilability fails");
  program.flag(
      "--enlarge", enlarge,
      "where a check fails make the sample deeper, wider (whole periods repeat, solids grow), and put what does not "
      "tile beside its mirror images");
  program.example("sg-sample assets/samples/marble.json -o sample.vdb", "a block of veined marble");
  return program.run(argc, argv, [&](StageRun& run) {
    SampleOverrides overrides;
    if (program.given("--voxel")) overrides.voxel = voxel;
    if (program.given("--thickness")) overrides.thickness = thickness;
    if (program.given("--ior")) overrides.ior = ior;
    if (program.given("--seed")) overrides.seed = run.seed();
    overrides.enlarge = enlarge;
    run.start_timer("make");
    const MadeSample made = make_sample(description, overrides);
    const MaterialSample& sample = made.sample;
    for (const std::string& warning : made.warnings) run.progress().warn(warning);
    const SampleCheck check = check_sample(sample);
    for (const std::string& complaint : check.complaints) {
      if (strict) throw InputError(description + ": " + complaint);
      run.progress().warn(complaint);
    }
    run.start_timer("write");
    write_vdb(run.output(), archive_sample(sample));
    const std::string view = view_path(run.output());
    write_ply(view, view_sample(sample));
    run.note_output(view);
    const auto colors = [](const Rgb& c) { return nlohmann::json{c[0], c[1], c[2]}; };
    run.results() = {{"size", {sample.size.x(), sample.size.y(), sample.size.z()}},
                     {"voxel_mm", sample.voxel},
                     {"ior", sample.ior},
                     {"free_share", check.free_share},
                     {"mesostructure_depth_mm", check.mesostructure_depth},
                     {"diffuse_mean_free_path_mm", colors(check.diffuse_mean_free_path)},
                     {"mean_free_path_mm", colors(check.mean_free_path)},
                     {"seam_over_inside", {check.seam_x, check.seam_y}},
                     {"checks_passed", check.complaints.empty()}};
    run.results().update(made.figures);
  });
}
