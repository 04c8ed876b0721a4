// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "synthesis/sample_archive.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string sample_path, method = "appearance";
  TextonOptions options;
  StageProgram program("sg-textons", "Describes how each texel of a sample and its surroundings look.");
  program.input("sample.vdb", sample_path, "the base volume, from sg-sample");
  program.output("textons.vdb", "appearance vectors, textons and candidate sets");
  program.output_beside(".view.ply");
  program.option("--method", method, "what synthesis compares: appearance vectors, or textons as the paper does",
                 {"appearance", "textons"});
  program.option("--candidates", options.candidate_count, "", "most alike texels kept for each texel and level", 1, 8);
  program.option("--separation", options.separation, "texels", "least distance between these", 1, 64);
  program.option("--textons", options.texton_count, "", "number of textons", 2, 4096);
  program.example("sg-textons sample.vdb -o textons.vdb", "ready for sg-synthesize");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    const MaterialSample sample = restore_sample(read_vdb(sample_path));
    run.start_timer("analyse");
    options.seed = run.seed();
    options.quantize = method == "textons";
    TextonStatistics statistics;
    const TextonSet textons = make_textons(sample, options, &statistics, run.progress());
    run.start_timer("write");
    write_vdb(run.output(), archive_textons(textons));
    const std::string view = view_path(run.output());
    write_ply(view, view_textons(textons));
    run.note_output(view);
    run.results() = {{"size", {textons.width, textons.height}},
                     {"levels", textons.levels.size()},
                     {"textons", textons.texton_count},
                     {"feature_variance_kept", statistics.feature_variance_kept},
                     {"appearance_variance_kept", statistics.appearance_variance_kept},
                     {"texton_error_over_variance", statistics.texton_error}};
  });
}
