// SPDX-License-Identifier: AGPL-3.0-or-later
#include <nlohmann/json.hpp>

#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/cli/view_path.h"
#include "pipeline/scene/origin.h"
#include "synthesis/sample_archive.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::vector<std::string> sample_paths;
  std::string method = "appearance", symmetry = "auto";
  TextonOptions options;
  StageProgram program("sg-textons", "Describes how each texel of a sample and its surroundings look.");
  program.inputs("sample.vdb", sample_paths,
                 "the base volume, from sg-sample; several for several areas of one object");
  program.output("textons.vdb", "appearance vectors, textons and candidate sets");
  program.output_beside(".view.ply");
  program.option("--method", method, "what synthesis compares: appearance vectors, or textons as the paper does",
                 {"appearance", "textons"});
  program.option("--candidates", options.candidate_count, "", "most alike texels kept for each texel and level", 1, 8);
  program.option("--separation", options.separation, "texels", "least distance between these", 1, 64);
  program.option("--textons", options.texton_count, "", "number of textons", 2, 4096);
  program.option(
      "--symmetry", symmetry,
      "turns after which the sample looks alike, so that synthesis may lay it in any of them: 1 none, 2 half "
      "turns, 4 quarter turns; auto recognises them, except with --method textons",
      {"auto", "1", "2", "4"});
  program.example("sg-textons sample.vdb -o textons.vdb", "ready for sg-synthesize");
  program.example("sg-textons moss.vdb stone.vdb -o textons.vdb", "two samples that are to share a surface");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    std::vector<MaterialSample> samples;
    for (const std::string& path : sample_paths) samples.push_back(restore_sample(read_vdb(path)));
    std::vector<const MaterialSample*> all;
    for (const MaterialSample& sample : samples) all.push_back(&sample);
    run.start_timer("analyse");
    options.seed = run.seed();
    options.quantize = method == "textons";
    options.symmetry = symmetry != "auto" ? std::stoi(symmetry) : options.quantize ? 1 : 0;
    TextonStatistics statistics;
    const TextonSet textons = make_textons(all, options, &statistics, run.progress());
    run.start_timer("write");
    VdbArchive archive = archive_textons(textons);
    archive.metadata[samples_note] = hash_files(sample_paths);
    write_vdb(run.output(), archive);
    const std::string view = view_path(run.output());
    write_ply(view, view_textons(textons));
    run.note_output(view);
    nlohmann::json sizes = nlohmann::json::array(), turned = nlohmann::json::array();
    for (int s = 0; s < textons.layers.sample_count; ++s)
      sizes.push_back({textons.layers[s].width, textons.layers[s].height});
    for (const SampleSymmetry& s : statistics.symmetry)
      turned.push_back(
          {{"symmetry", s.symmetry}, {"unlike_by_half_turn", s.half_turn}, {"unlike_by_quarter_turn", s.quarter_turn}});
    run.results() = {{"sizes", sizes},
                     {"symmetry", textons.layers.symmetry},
                     {"recognised", turned},
                     {"levels", textons.levels.size()},
                     {"textons", textons.texton_count},
                     {"feature_variance_kept", statistics.feature_variance_kept},
                     {"appearance_variance_kept", statistics.appearance_variance_kept},
                     {"texton_error_over_variance", statistics.texton_error}};
  });
}
