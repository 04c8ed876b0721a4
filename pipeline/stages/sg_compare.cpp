// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "meshing/formats/compare_artefacts.h"
#include "pipeline/cli/stage_program.h"

using namespace shellgrid;

int main(int argc, char** argv) {
  std::string path, reference_path, measure = "relative";
  double fail_above = -1, white = 0;
  bool as_json = false;
  StageProgram program("sg-compare", "measures how two images, volumes, grids or meshes differ");
  program.input("A", path, "image (exr png), volume (vdb), grid (hdf) or mesh (ply obj off stl)");
  program.input("REFERENCE", reference_path, "what A is measured against, of the same kind");
  program.output("difference.png", "the difference: a false-colour PNG of images, else a PLY with quality", true,
                 {".ply"});
  program.option("--fail-above", fail_above, "", "exit with 4 where a figure's measure is greater; -1: never", -1);
  program.option("--measure", measure, "what --fail-above looks at: rmse, relative L2 or the greatest difference",
                 {"rmse", "relative", "maximum"});
  program.option("--white", white, "", "difference shown brightest; 0: the greatest there is", 0);
  program.flag("--json", as_json, "print the figures as JSON");
  program.example("sg-compare image.exr reference.exr -o difference.png --fail-above 0.01", "a test of two pictures");
  return program.run(argc, argv, [&](StageRun& run) {
    program.refuse_unless(program.given("--fail-above"), "--fail-above", {"--measure"});
    program.refuse_unless(!run.output().empty(), "a difference picture (-o)", {"--white"});
    const ArtefactComparison comparison = compare_artefacts(path, reference_path);
    nlohmann::json figures = nlohmann::json::array();
    std::string text = fmt::format("{:<32} {:>12} {:>12} {:>12} {:>12}", "", "rmse", "relative", "maximum", "mean");
    std::string failing;
    for (const Comparison& f : comparison.figures) {
      figures.push_back({{"name", f.name()},
                         {"count", f.count()},
                         {"rmse", f.rmse()},
                         {"relative", f.relative()},
                         {"maximum", f.maximum()},
                         {"mean", f.mean()},
                         {"reference_mean", f.reference_mean()},
                         {"mismatches", f.mismatches()}});
      text += fmt::format("\n{:<32} {:>12.4g} {:>12.4g} {:>12.4g} {:>12.4g}", f.name(), f.rmse(), f.relative(),
                          f.maximum(), f.mean());
      const double value = measure == "rmse" ? f.rmse() : measure == "relative" ? f.relative() : f.maximum();
      if (fail_above >= 0 && (value > fail_above || f.mismatches() > 0))
        failing += (failing.empty() ? "" : ", ") + f.name();
    }
    run.results() = {{"kind", comparison.kind}, {"figures", figures}, {"remarks", comparison.remarks}};
    for (const std::string& remark : comparison.remarks) text += "\n" + remark;
    run.print(as_json ? run.results().dump(2, ' ', false, nlohmann::json::error_handler_t::replace) : text);
    if (!run.output().empty()) write_difference(run.output(), comparison, white);
    if (failing.empty()) return;
    if (!as_json) run.print(fmt::format("{} above {} in {}", measure, fail_above, failing));
    run.exit_with(4);
  });
}
