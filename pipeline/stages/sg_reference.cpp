// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>

#include "meshing/core/error.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/output_file.h"
#include "meshing/formats/output_set.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/exitance_mesh.h"
#include "pipeline/scene/path_state_file.h"
#include "pipeline/scene/scene.h"
#include "pipeline/scene/scene_checks.h"
#include "solvers/render/tone_map.h"
#include "solvers/transport/camera_paths.h"
#include "solvers/transport/light_tracing.h"
#include "solvers/transport/roulette.h"
#include "solvers/transport/tally_shapes.h"

using namespace shellgrid;

namespace {

using json = nlohmann::ordered_json;

// What `paths` paths let be said of an estimate. One path says nothing of its error. Where something may be and no path
// has found it, the error is unknown, too: at most so much is there, with 95 % confidence.
struct Finding {
  Estimate estimate;
  double paths;
  bool may_be = true;

  bool found_nothing() const { return may_be && estimate.value == 0; }
  bool is_known() const { return paths > 1 && !found_nothing(); }
  double upper_bound() const { return 1 - std::pow(0.05, 1 / paths); }
  json as_json(bool bounded = true) const {
    json j = {{"value", estimate.value}, {"standard_error", nullptr}};
    if (is_known()) j["standard_error"] = estimate.standard_error;
    if (bounded && found_nothing()) j["upper_bound"] = upper_bound();
    return j;
  }
  std::string in_words() const {
    if (found_nothing()) return fmt::format("none found, below {:.2g}", upper_bound());
    if (!is_known()) return fmt::format("{:.5f} ± unknown", estimate.value);
    return fmt::format("{:.5f} ± {:.5f}", estimate.value, estimate.standard_error);
  }
};

json profile_json(const std::vector<Estimate>& estimates, double paths, bool may_be) {
  json list = json::array();
  for (const Estimate& e : estimates) list.push_back(Finding{e, paths, may_be}.as_json(false));
  return list;
}

// A relative standard error.
nlohmann::json error_json(const std::optional<double>& error) { return error ? nlohmann::json(*error) : nullptr; }
std::string error_in_words(const std::optional<double>& error) {
  return error ? fmt::format("± {:.2g} %", 100 * *error) : "± unknown";
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

  // Refuses options that have no meaning for what is measured.
  void check(const StageProgram& program) const {
    program.refuse_unless(shape != "none", "--tally",
                          {"--thickness", "--radius", "--absorption", "--scattering", "--anisotropy", "--ior",
                           "--source", "--bins", "--extent"});
    program.refuse_unless(shape == "none" || shape == "slab", "--tally slab", {"--thickness"});
    program.refuse_unless(shape == "none" || shape == "sphere", "--tally sphere", {"--radius"});
    program.refuse_unless(shape != "sphere", "--tally slab or half-space", {"--extent"});
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

// From a slab or half-space that does not scatter nothing comes back.
bool may_return(const TallyProblem& problem) {
  if (problem.source == TallySource::centre) return false;
  return problem.shape == TallyShape::sphere || problem.layers[0].scattering > 0;
}

json tally_json(const TallyResult& r, const TallyProblem& problem, double paths) {
  const bool from_inside = problem.source == TallySource::centre;
  const bool passes = from_inside || problem.shape == TallyShape::slab;
  const auto finding = [&](const Estimate& e, bool may_be) { return Finding{e, paths, may_be}.as_json(); };
  json absorbed = json::array();
  for (std::size_t k = 0; k < r.absorbed.size(); ++k)
    absorbed.push_back(finding(r.absorbed[k], problem.layers[k].absorption > 0));
  json result = {{"diffuse_reflectance", finding(r.diffuse_reflectance, may_return(problem))},
                 {"specular_reflectance", finding(r.specular_reflectance, false)},
                 {"transmittance", finding(r.transmittance, passes)},
                 {"unscattered", finding(r.unscattered, passes)},
                 {"absorbed", std::move(absorbed)},
                 {"lost", finding(r.lost, false)}};
  json profile = {{"radius", r.radius}};
  if (!r.reflectance_profile.empty()) profile["reflectance"] = profile_json(r.reflectance_profile, paths, true);
  if (!r.transmittance_profile.empty()) profile["transmittance"] = profile_json(r.transmittance_profile, paths, true);
  if (!r.fluence_profile.empty()) profile["fluence"] = profile_json(r.fluence_profile, paths, true);
  result["radial_profile"] = std::move(profile);
  return result;
}

// Where many paths ended by chance for their length alone, the few that went on carry much, and rarely.
void warn_of_heavy_paths(const PathKind& kind, const PathState& state, Progress& progress) {
  const double ended = static_cast<double>(state.count(PathEvent::limit_roulette)) / static_cast<double>(state.paths);
  if (ended > std::min(0.001, kind.relative_error(state).value_or(0)))
    progress.warn(
        fmt::format("{:.2g} % of the paths ended by chance beyond {} collisions: few heavy ones stand for "
                    "them, and the standard error may be too small",
                    100 * ended, event_limit));
}

// What paths are followed and when it ends; and the state in a file, to go on from.
struct Campaign {
  PathLimits limits;
  std::string state_path;

  PathState follow(const PathKind& kind, const std::string& fingerprint, StageRun& run) const {
    PathState state(kind.scalars, kind.field_size);
    if (!state_path.empty() && std::filesystem::exists(state_path))
      state = read_path_state(state_path, fingerprint, state);
    const std::uint64_t first = state.paths;
    if (limits.paths > 0 && static_cast<double>(first) > limits.paths)
      run.progress().warn(fmt::format("{} holds {} paths already: the result is that of them all, not of {:.0f}",
                                      state_path, first, limits.paths));
    const auto save = [&](const PathState& now) {
      const OutputSet::Aside at_once;
      write_path_state(state_path, fingerprint, now);
    };
    PathLimits held = limits;
    held.interrupted = run.hold_interrupts();
    const auto checkpoint = state_path.empty() ? std::function<void(const PathState&)>() : save;
    const PathEnd end = follow_paths(kind, held, state, checkpoint, run.progress());
    if (!state_path.empty()) {
      save(state);
      run.note_output(state_path);
    }
    if (end == PathEnd::interrupted)
      run.progress().warn(fmt::format("interrupted after {} paths; the result is that of these", state.paths));
    if (state.paths == 0) throw InputError("stopped before the first paths had ended; there is no result");
    if (const std::optional<double> error = kind.relative_error(state);
        limits.target_error > 0 && end != PathEnd::target_error && end != PathEnd::interrupted &&
        !(error && *error <= limits.target_error))
      run.progress().warn(
          fmt::format("--{} ended the run before --target-error {:g} was met: the relative standard "
                      "error is {}",
                      end == PathEnd::paths ? "paths" : "time", limits.target_error,
                      error ? fmt::format("{:.2g}", *error) : "unknown"));
    nlohmann::json& results = run.results();
    results["paths"] = state.paths;
    results["paths_of_earlier_runs"] = first;
    results["ended_by"] = path_end_name(end);
    for (int k = 0; k < path_event_count; ++k) results["events"][path_event_names()[k]] = state.events[k];
    warn_of_heavy_paths(kind, state, run.progress());
    return state;
  }
};

void tally(const TallyOptions& options, const Campaign& campaign, StageRun& run) {
  const TallyProblem problem = options.problem(run.seed());
  const TallyTransport transport(problem);
  run.start_timer("follow");
  std::string fingerprint =
      fmt::format("tally 2 {} {} {} {} {} {} {} {}", options.shape, static_cast<int>(problem.source), problem.thickness,
                  problem.ior, problem.bins, problem.extent, problem.seed, SHELLGRID_VERSION);
  for (const TallyLayer& l : problem.layers)
    fingerprint += fmt::format(" {} {} {} {}", l.absorption, l.scattering, l.anisotropy, l.radius);
  const PathState state = campaign.follow(transport.kind(), fingerprint, run);
  run.start_timer("write");
  const TallyResult result = transport.result(state);
  json content = {{"tally", options.shape}, {"paths", state.paths}};
  const auto paths = static_cast<double>(state.paths);
  content.update(tally_json(result, problem, paths));
  write_text_atomically(run.output(), content.dump(1) + "\n");
  const bool from_inside = problem.source == TallySource::centre;
  std::string found;
  if (!from_inside)
    found += "diffuse reflectance " + Finding{result.diffuse_reflectance, paths, may_return(problem)}.in_words() + ", ";
  if (from_inside || problem.shape == TallyShape::slab)
    found += "transmittance " + Finding{result.transmittance, paths}.in_words() + ", ";
  run.print(fmt::format("{}: {}{} paths", run.output(), found, state.paths));
}

// Of each power its three channels, and their standard errors beside them.
nlohmann::json energy_json(const LightTracingResult& r, std::uint64_t paths) {
  nlohmann::json energy, errors;
  const auto put = [&](const char* name, const PowerEstimate& power) {
    for (const Estimate& e : power.channel) {
      energy[name].push_back(e.value);
      errors[name].push_back(paths > 1 ? nlohmann::json(e.standard_error) : nullptr);
    }
  };
  put("incoming", r.incoming);
  put("entering", r.entering);
  put("mirrored", r.mirrored);
  put("leaving", r.leaving);
  put("absorbed_core", r.absorbed_core);
  put("absorbed_shell", r.absorbed_shell);
  put("lost", r.lost);
  put("roulette", r.roulette);
  put("exchange", r.exchange);
  for (int c = 0; c < 3; ++c) {
    const double in = r.entering.channel[c].value;
    const double defect = in + r.roulette.channel[c].value + r.exchange.channel[c].value - r.leaving.channel[c].value -
                          r.absorbed_core.channel[c].value - r.absorbed_shell.channel[c].value -
                          r.lost.channel[c].value;
    energy["relative_defect"].push_back(in > 0 ? std::abs(defect) / in : 0);
  }
  energy["standard_error"] = errors;
  return energy;
}

struct SceneInputs {
  std::string scene, surface, shell;

  // Of all that the paths depend on.
  std::string fingerprint(const Scene& read, const std::string& mode, std::uint64_t seed) const {
    std::string text = mode + " 2 " + hash_file(scene) + " " + hash_file(surface) + " " +
                       (shell.empty() ? "-" : hash_file(shell)) + fmt::format(" {} {}", seed, SHELLGRID_VERSION);
    for (const Light& light : read.lights)
      if (const auto* environment = std::get_if<EnvironmentLight>(&light); environment && environment->image) {
        std::uint64_t hash = 0;
        for (const Image::Channel& channel : environment->image->channels)
          for (const float value : channel.values) hash = hash64(hash, std::bit_cast<std::uint32_t>(value));
        text += fmt::format(" {:x}", hash);
      }
    return text;
  }
};

TransportObject read_object(const SceneInputs& inputs, const Scene& scene, const TriangleMesh& mesh, StageRun& run) {
  if (scene.material && scene.material->opaque)
    throw InputError(scene.path + ": material.opaque: no light passes into this object");
  const bool homogeneous = inputs.shell.empty();
  if (homogeneous && (!scene.material || !std::holds_alternative<Material>(scene.material->core)))
    throw InputError(scene.path + ": no homogeneous core; give shell.vdb, or material.core with coefficients");
  if (homogeneous)
    return naming(inputs.surface, [&] {
      return TransportObject(mesh, std::get<Material>(scene.material->core),
                             scene.object ? scene.object->ior : SceneObject{}.ior);
    });
  const ShellVolume shell = read_shell_volume(inputs.shell);
  require_same_object(shell, inputs.shell, mesh, inputs.surface, run.progress());
  warn_of_contradictions(shell, inputs.shell, scene, run.progress());
  TransportObject object =
      naming(inputs.shell, [&] { return TransportObject(mesh, shell, scene.object ? scene.object->ior : shell.ior); });
  const LeafMethodCounts& leaves = std::get<ShellMedium>(object.medium()).methods();
  run.results()["leaves"] = {{"uniform", leaves.uniform},
                             {"voxels", leaves.voxels},
                             {"delta", leaves.delta},
                             {"without", leaves.without_leaf},
                             {"one_majorant", leaves.one_majorant}};
  run.results()["free_space_faces"] = object.free_space().face_count();
  return object;
}

// Without light there is nothing to wait for.
void end_soon_if_dark(const Scene& scene, double paths, Campaign& campaign, StageRun& run) {
  if (!is_dark(scene)) return;
  warn_of_darkness(scene, run.progress());
  campaign.limits = PathLimits{};
  campaign.limits.paths = paths;
}

void trace_light(const SceneInputs& inputs, const LightTracingOptions& how, Campaign campaign, StageRun& run) {
  run.start_timer("read");
  const Scene scene = read_scene(inputs.scene);
  end_soon_if_dark(scene, 1, campaign, run);
  const TriangleMesh mesh = read_closed_surface(inputs.surface);
  const TransportObject object = read_object(inputs, scene, mesh, run);
  LightTracingOptions options = how;
  options.seed = run.seed();
  const std::string mode =
      std::string("light") + (options.interreflection ? "" : " once") + (options.channels_apart ? " apart" : "");
  const LightTracing tracing(object, scene.lights, options);
  run.start_timer("follow");
  const PathState state = campaign.follow(tracing.kind(), inputs.fingerprint(scene, mode, run.seed()), run);
  run.start_timer("write");
  const LightTracingResult result = tracing.result(state);
  double entering = 0;
  for (const Estimate& e : result.entering.channel) entering += e.value;
  constexpr std::uint64_t telling_paths = 1000;
  if (!(entering > 0) && state.paths >= telling_paths) run.progress().warn(unlit_warning);
  AttributedMesh written = exitance_mesh(mesh, result.exitance, result.irradiance);
  add_colour_property(written, "exitance_error", result.exitance_error);
  add_colour_property(written, "irradiance_error", result.irradiance_error);
  write_ply(run.output(), written);
  run.results()["energy"] = energy_json(result, state.paths);
  const std::optional<double> error = result.relative_error;
  run.results()["relative_standard_error"] = error_json(error);
  run.print(fmt::format("{}: {} paths, exitance {}, entering {:.6g} W, leaving {:.6g} W", run.output(), state.paths,
                        error_in_words(error), result.entering.channel[1].value, result.leaving.channel[1].value));
}

void take_picture(const SceneInputs& inputs, Campaign campaign, bool limited, StageRun& run) {
  run.start_timer("read");
  const Scene scene = read_scene(inputs.scene);
  if (!scene.camera) throw InputError(scene.path + ": no camera");
  const TriangleMesh mesh = read_closed_surface(inputs.surface);
  const TransportObject object = read_object(inputs, scene, mesh, run);
  if (scene.floor) run.progress().warn("the scene's floor is left out");
  CameraPathOptions options;
  options.seed = run.seed();
  options.background = scene.background;
  const CameraPaths paths(object, scene.lights, *scene.camera, options);
  const double usual = 1.0 * scene.method.samples_per_pixel * static_cast<double>(paths.pixel_count());
  if (!limited) campaign.limits.paths = usual;
  end_soon_if_dark(scene, usual, campaign, run);
  run.start_timer("follow");
  const PathState state = campaign.follow(paths.kind(), inputs.fingerprint(scene, "camera", run.seed()), run);
  run.start_timer("write");
  const Image picture = paths.picture(state);
  const double stops = scene.exposure ? *scene.exposure : automatic_exposure(picture);
  const std::string png = std::filesystem::path(run.output()).replace_extension(".png").string();
  write_png(png, picture.width, picture.height, tone_map(picture, stops, ToneCurve::filmic));
  run.note_output(png);
  write_exr(run.output(), picture);
  run.results()["exposure_stops"] = stops;
  const std::optional<double> error = paths.relative_error(state);
  run.results()["relative_standard_error"] = error_json(error);
  run.print(fmt::format("{}: {} paths, {:.3g} a pixel, radiance {}", run.output(), state.paths,
                        static_cast<double>(state.paths) / static_cast<double>(paths.pixel_count()),
                        error_in_words(error)));
}

}  // namespace

int main(int argc, char** argv) {
  StageProgram program("sg-reference", "follows light paths: the exact answer that the solvers are judged by");
  TallyOptions tally_options;
  SceneInputs inputs;
  Campaign campaign;
  campaign.limits.paths = 0;
  bool once = false;
  LightTracingOptions tracing;
  program.input("scene.json", inputs.scene,
                "lights, object.ior, material.core where there is no shell, for pictures camera; none with --tally",
                true);
  program.input("surface.ply", inputs.surface, "the object's surface", true);
  program.input("shell.vdb", inputs.shell, "its shell of voxels and core; left out for a homogeneous object", true);
  program.output("exitance.ply",
                 "the surface with its exitance, for sg-render; .exr: the picture by camera paths, with a .png beside "
                 "it; .json: with --tally "
                 "what was measured",
                 false, {".exr", ".json"});
  program.option(
      "--paths", campaign.limits.paths, "",
      "light paths, in all; 0: no such limit. Without any limit 1e6, of a picture method.samples_per_pixel for each", 0,
      1e18);
  program.option("--time", campaign.limits.seconds, "s", "stop after this long; 0: do not", 0, 1e9);
  program.option("--target-error", campaign.limits.target_error, "",
                 "stop at this relative standard error of the result; 0: do not", 0, 1);
  program.output_beside(".png", ".exr");
  program.output_option("--state", campaign.state_path, "",
                        "file in which the state is kept: where it is there, the run goes on from it, to the same "
                        "bytes as without a break");
  program.flag("--no-interreflection", once, "light that leaves the object or is mirrored does not come back to it");
  program.flag(
      "--channels-apart", tracing.channels_apart,
      "a path each for red, green and blue instead of one with spectral weights: thrice the work; white objects "
      "return each channel exactly");
  tally_options.declare(program);
  program.example("sg-reference scene.json surface.ply -o reference.ply --target-error 0.01", "exitance, to 1 %");
  program.example(
      "sg-reference --tally slab --thickness 0.2 --absorption 1 --scattering 9 --anisotropy 0.75 --paths 1e6 -o "
      "slab.json",
      "a slab that tables know");
  return program.run(argc, argv, [&](StageRun& run) {
    const std::string extension = std::filesystem::path(run.output()).extension().string();
    const bool tallies = tally_options.shape != "none";
    if (tallies && !inputs.scene.empty()) throw UsageError("--tally takes no scene");
    if (tallies != (extension == ".json"))
      throw UsageError(tallies ? "--tally writes .json" : "expected an output .ply or .exr, or --tally");
    program.refuse_unless(extension == ".ply", "the trace of light (.ply)",
                          {"--channels-apart", "--no-interreflection"});
    tally_options.check(program);
    if (!tallies && inputs.surface.empty())
      throw UsageError(inputs.scene.empty() ? "missing scene.json surface.ply, or --tally" : "missing surface.ply");
    PathLimits& limits = campaign.limits;
    if (limits.paths > 0 && limits.paths < 1)
      throw UsageError("--paths: expected at least one path, or 0 for no limit");
    const bool limited = limits.paths > 0 || limits.seconds > 0 || limits.target_error > 0;
    if (!limited) limits.paths = 1e6;
    tracing.interreflection = !once;
    if (tallies)
      tally(tally_options, campaign, run);
    else if (extension == ".exr")
      take_picture(inputs, campaign, limited, run);
    else
      trace_light(inputs, tracing, campaign, run);
  });
}
