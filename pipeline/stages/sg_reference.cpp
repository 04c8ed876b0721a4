// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/formats/output_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "solvers/transport/tally_shapes.h"

using namespace shellgrid;

namespace {

using json = nlohmann::ordered_json;

json estimate_json(const Estimate& e) { return {{"value", e.value}, {"standard_error", e.standard_error}}; }

json estimates_json(const std::vector<Estimate>& estimates) {
  json list = json::array();
  for (const Estimate& e : estimates) list.push_back(estimate_json(e));
  return list;
}

struct TallyOptions {
  std::string shape = "none", source = "usual";
  double thickness = 1, ior = 1, extent = 0;
  std::vector<double> radius, absorption = {0}, scattering = {1}, anisotropy = {0};
  int bins = 50;

  void declare(StageProgram& program) {
    program.option("--tally", shape, "measure a shape that tables know, into JSON; no scene then",
                   {"none", "slab", "half-space", "sphere"});
    program.option("--thickness", thickness, "mm", "tally: of the slab", 1e-12, 1e12);
    program.list_option("--radius", radius, "mm", "tally: to where a sphere's shells reach, from inside out", 1e-12,
                        1e12);
    program.list_option("--absorption", absorption, "1/mm",
                        "tally: absorption coefficient, of each shell or one for all", 0, 1e12);
    program.list_option("--scattering", scattering, "1/mm", "tally: scattering coefficient, likewise", 0, 1e12);
    program.list_option("--anisotropy", anisotropy, "", "tally: mean cosine of Henyey-Greenstein, likewise", -0.999999,
                        0.999999);
    program.option("--ior", ior, "", "tally: refractive index inside over outside", 1, 10);
    program.option("--source", source,
                   "tally: light into all directions from a sphere's centre, parallel light (normal to a slab), or "
                   "diffuse light from outside; usual: centre in a sphere, else parallel",
                   {"usual", "centre", "parallel", "diffuse"});
    program.option("--bins", bins, "", "tally: of the radial profile", 1, 100000);
    program.option("--extent", extent, "mm",
                   "tally: of the radial profile; 0: a sphere's radius, else ten transport mean free paths", 0, 1e12);
  }

  TallyProblem problem(std::uint64_t seed) const {
    TallyProblem p;
    p.shape = shape == "slab" ? TallyShape::slab : shape == "sphere" ? TallyShape::sphere : TallyShape::half_space;
    const bool centre = source == "centre" || (source == "usual" && shape == "sphere");
    p.source = centre ? TallySource::centre : source == "diffuse" ? TallySource::diffuse : TallySource::parallel;
    if (shape == "sphere" && radius.empty()) throw UsageError("--tally sphere needs --radius");
    if (centre && shape != "sphere") throw UsageError("--source centre: only a sphere has a centre");
    const std::size_t count = shape == "sphere" ? radius.size() : 1;
    const auto of = [&](const char* flag, const std::vector<double>& values, std::size_t k) {
      if (values.size() != 1 && values.size() != count)
        throw UsageError(fmt::format("{}: {} values for {} {}", flag, values.size(), count,
                                     shape == "sphere" ? "shells" : "medium"));
      return values[values.size() == 1 ? 0 : k];
    };
    p.layers.clear();
    for (std::size_t k = 0; k < count; ++k)
      p.layers.push_back({of("--absorption", absorption, k), of("--scattering", scattering, k),
                          of("--anisotropy", anisotropy, k), shape == "sphere" ? radius[k] : 0});
    p.thickness = thickness;
    p.ior = ior;
    p.bins = bins;
    p.extent = extent;
    p.seed = seed;
    return p;
  }
};

json tally_json(const TallyResult& r) {
  json result = {{"diffuse_reflectance", estimate_json(r.diffuse_reflectance)},
                 {"specular_reflectance", estimate_json(r.specular_reflectance)},
                 {"transmittance", estimate_json(r.transmittance)},
                 {"unscattered", estimate_json(r.unscattered)},
                 {"absorbed", estimates_json(r.absorbed)},
                 {"lost", estimate_json(r.lost)}};
  json profile = {{"radius", r.radius}};
  if (!r.reflectance_profile.empty()) profile["reflectance"] = estimates_json(r.reflectance_profile);
  if (!r.transmittance_profile.empty()) profile["transmittance"] = estimates_json(r.transmittance_profile);
  if (!r.fluence_profile.empty()) profile["fluence"] = estimates_json(r.fluence_profile);
  result["radial_profile"] = std::move(profile);
  return result;
}

void record(const PathState& state, PathEnd end, nlohmann::json& results) {
  results["paths"] = state.paths;
  results["ended_by"] = path_end_name(end);
  for (int k = 0; k < path_event_count; ++k) results["events"][path_event_names()[k]] = state.events[k];
}

void tally(const TallyOptions& options, const PathLimits& limits, StageRun& run) {
  const TallyTransport transport(options.problem(run.seed()));
  const PathKind kind = transport.kind();
  PathState state(kind.scalars, kind.field_size);
  run.start_timer("follow");
  const PathEnd end = follow_paths(kind, limits, state, {}, run.progress());
  run.start_timer("write");
  const TallyResult result = transport.result(state);
  json content = {{"tally", options.shape}, {"paths", state.paths}};
  content.update(tally_json(result));
  write_text_atomically(run.output(), content.dump(1) + "\n");
  record(state, end, run.results());
  run.print(fmt::format("{}: diffuse reflectance {:.5f} ± {:.5f}, transmittance {:.5f} ± {:.5f}, {} paths",
                        run.output(), result.diffuse_reflectance.value, result.diffuse_reflectance.standard_error,
                        result.transmittance.value, result.transmittance.standard_error, state.paths));
}

}  // namespace

int main(int argc, char** argv) {
  StageProgram program("sg-reference", "follows light paths: the exact answer that the solvers are judged by");
  TallyOptions tally_options;
  PathLimits limits;
  limits.paths = 0;
  program.output("slab.json", "with --tally what was measured");
  program.option("--paths", limits.paths, "", "light paths, in all; without any limit 1e6", 0, 1e18);
  program.option("--time", limits.seconds, "s", "stop after this long; 0: do not", 0, 1e9);
  program.option("--target-error", limits.target_error, "",
                 "stop at this relative standard error of the result; 0: do not", 0, 1);
  tally_options.declare(program);
  program.example(
      "sg-reference --tally slab --thickness 0.2 --absorption 1 --scattering 9 --anisotropy 0.75 "
      "--paths 1e6 -o slab.json",
      "a slab that tables know");
  return program.run(argc, argv, [&](StageRun& run) {
    if (limits.paths == 0 && limits.seconds == 0 && limits.target_error == 0) limits.paths = 1e6;
    limits.interrupted = run.hold_interrupts();
    tally(tally_options, limits, run);
  });
}
