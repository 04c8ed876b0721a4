// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/formats/image_file.h"
#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/record.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/origin.h"
#include "pipeline/scene/scene.h"
#include "pipeline/scene/scene_checks.h"
#include "pipeline/scene/shell_texture_file.h"
#include "solvers/render/surface_render.h"
#include "solvers/render/tone_map.h"
#include "solvers/shell_texture/shell_texture_render.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

namespace {

// NAME_r, NAME_g, NAME_b; empty where there are none.
std::vector<Rgb> colours_of(const AttributedMesh& surface, const std::string& name) {
  const std::vector<float>* channels[3];
  for (int k = 0; k < 3; ++k) {
    channels[k] = surface.find(name + "_" + "rgb"[k]);
    if (!channels[k]) return {};
  }
  std::vector<Rgb> colours;
  for (int v = 0; v < surface.mesh.vertex_count(); ++v)
    colours.emplace_back((*channels[0])[v], (*channels[1])[v], (*channels[2])[v]);
  return colours;
}

std::vector<Rgb> exitance_of(const std::string& path, const AttributedMesh& surface, const std::string& writer) {
  for (const char* name : {"exitance_r", "exitance_g", "exitance_b"})
    if (!surface.find(name))
      throw InputError(path + ": no vertex property " + name + "; expected the exitance that " + writer + " writes");
  return colours_of(surface, "exitance");
}

// The files of a picture by the shell texture function.
struct ShellTextureFiles {
  std::string texture, shell, core;
  std::string light = "all", correction = "kernels";
  bool flat = false;

  bool asked_for() const { return !texture.empty(); }
  void declare(StageProgram& program) {
    program.option("--stf", texture,
                   "render by this shell texture function, from sg-irradiance; the surface is then synthesized.ply");
    program.option("--shell", shell, "the shell that it fills, from sg-shell");
    program.option("--core", core, "the core's light, from sg-core; without it the core is black");
    program.option("--light", light,
                   "which light is shown: all of it, that from outside with its mirror images, or that out of the core",
                   {"all", "outside", "core"});
    program.option("--correction", correction, irradiance_correction_help, irradiance_correction_names);
    program.flag("--flat", flat, flat_shell_help);
  }
  void check(const StageProgram& program) const {
    program.refuse_unless(asked_for(), "--stf", {"--shell", "--core", "--light", "--correction", "--flat"});
    if (asked_for() && shell.empty()) throw UsageError("--stf needs the --shell that it fills");
    if (asked_for() && light == "core" && core.empty()) throw UsageError("--light core needs --core");
  }
};

struct ShellFile {
  ShellVolume volume;
  std::map<std::string, std::string> notes;
};

RenderedImage shell_texture_picture(const ShellTextureFiles& files, const ShellFile& shell_file,
                                    const std::string& surface_path, const AttributedMesh& surface_file,
                                    const Scene& scene, const RenderSettings& settings, StageRun& run) {
  const ShellVolume& shell = shell_file.volume;
  TexturedMesh surface;
  std::unique_ptr<ShellTextureLookup> texture;
  std::string sample;
  AttributedMesh core_mesh;
  std::optional<TransportObject> object;
  together([&] { require_same_object(shell, files.shell, surface_file.mesh, surface_path, run.progress()); },
           [&] { surface = detach_texture(surface_file, surface_path); },
           [&] { texture = open_shell_texture(files.texture, ShellTextureParts::all, &sample); },
           [&] {
             if (!files.core.empty()) core_mesh = read_mesh(files.core);
           },
           [&] { object.emplace(TransportObject::of_surfaces(surface_file.mesh, shell, scene.object->ior)); });
  if (!surface.sample.empty())
    throw InputError(surface_path + ": it carries several samples; a shell texture function is that of one");
  if (std::abs(shell.ior - scene.object->ior) > 1e-6)
    run.progress().warn(
        fmt::format("{} is of refractive index {:g}, and so is its sample's light; the scene's {:g} is "
                    "that of the surface alone",
                    files.shell, shell.ior, scene.object->ior));
  require_same_samples(sample, files.texture, note_of(read_notes(surface_path), samples_note), surface_path);
  require_same_samples(sample, files.texture, note_of(shell_file.notes, samples_note), files.shell);
  if (std::abs(texture->voxel() / shell.frame.voxel - 1) > 1e-3)
    throw InputError(fmt::format("{}: its voxels of {:g} mm are not those of {}, {:g} mm", files.texture,
                                 texture->voxel(), files.shell, shell.frame.voxel));
  std::vector<Rgb> core;
  BodyShape shape;
  if (!files.core.empty()) {
    core = exitance_of(files.core, core_mesh, "sg-core");
    if (!files.flat) {
      shape.ratios = colours_of(core_mesh, "shape");
      shape.whole = !shape.ratios.empty() && note_of(read_notes(files.core), shape_note) == "body";
    }
    require_core_of(files.core, sample, files.texture, files.shell, scene);
    if (const std::string core_is_flat = note_of(read_notes(files.core), flat_note);
        !core_is_flat.empty() && (core_is_flat == "yes") != files.flat)
      run.progress().warn(fmt::format("{} was made {} --flat, this picture {}: the two do not fit together", files.core,
                                      files.flat ? "without" : "with", files.flat ? "with" : "without"));
    if (core_mesh.mesh.vertex_count() != surface.mesh.vertex_count())
      throw InputError(fmt::format("{}: {} vertices, but {} has {}", files.core, core_mesh.mesh.vertex_count(),
                                   surface_path, surface.mesh.vertex_count()));
  }
  run.start_timer("render");
  const TexturedFrames frames{surface.mesh, surface.normals, surface.directions};
  std::optional<ShellCurvature> curvature;
  if (!files.flat) curvature.emplace(frames, shell, scene.object->ior);
  ShellTextureSettings shown{settings};
  shown.outside_light = files.light != "core";
  shown.core_light = files.light != "outside";
  shown.correction = irradiance_correction(files.correction);
  ShellTextureStatistics s;
  RenderedImage picture = render_shell_texture(
      {*object, shell, frames, *texture, surface.coordinate, core, curvature ? &*curvature : nullptr, std::move(shape)},
      scene.lights, *scene.camera, shown, &s, run.progress());
  run.results()["marches"] = s.marches;
  run.results()["march_steps"] = s.march_steps;
  run.results()["voxels_lit"] = s.voxels_lit;
  run.results()["leaves_lit"] = s.leaves_lit;
  run.results()["leaves_skipped"] = s.leaves_skipped;
  run.results()["vertices_lit"] = s.vertices_lit;
  run.results()["vertices_corrected"] = s.vertices_corrected;
  run.results()["shadow_rays_shared"] = s.shadow_rays_shared;
  picture.statistics.shadow_rays += s.shadow_rays;
  picture.statistics.shadow_rays_skipped += s.shadow_rays_skipped;
  return picture;
}

double exposure_stops(const std::string& option, const Scene& scene, const Image& image) {
  if (option == "scene" && scene.exposure) return *scene.exposure;
  if (option == "scene" || option == "auto") return automatic_exposure(image);
  std::size_t used = 0;
  double stops = 0;
  try {
    stops = std::stod(option, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  if (used != option.size() || !(std::abs(stops) <= 100))
    throw InputError("--exposure is '" + option + "'; expected scene, auto or a number of stops");
  return stops;
}

// A picture that cannot fit is refused at once: the system may end a program that takes too much without a word.
void require_memory(const std::string& scene_path, const Camera& camera) {
  constexpr double bytes_per_pixel = 130;  // film, layers, and the encoded file
  const double needed = bytes_per_pixel * camera.width * camera.height / (1 << 20), there = available_memory_mib();
  if (needed > there)
    throw InputError(
        fmt::format("{}: camera.resolution: a picture of {} × {} pixels takes about {:.0f} MiB of memory; "
                    "{:.0f} MiB are there; expected at most {:.3g} million pixels",
                    scene_path, camera.width, camera.height, needed, there,
                    std::max(0.0, there) * (1 << 20) / bytes_per_pixel / 1e6));
}

}  // namespace

int main(int argc, char** argv) {
  StageProgram program("sg-render",
                       "takes the picture: exit light, mirror light and surroundings, as EXR layers and PNG");
  std::string scene_path, surface_path, exposure = "scene", tone = "filmic";
  int samples = 0;
  RenderSettings settings;
  program.input("scene.json", scene_path, "camera, lights, object.ior, and material.opaque if the object is opaque");
  program.input("exitance.ply", surface_path, "surface with exitance_r/g/b; for an opaque object any closed surface");
  program.output("image.exr", "layers R G B A, exitance, specular, depth.Z, normal; image.png is written beside it");
  program.output_beside(".png");
  program.option("--samples", samples, "per pixel", "most camera rays a pixel; 0: the scene's method.samples_per_pixel",
                 0, 65536);
  program.option("--contrast", settings.film.contrast, "",
                 "contrast between neighbouring pixels above which they get all samples; 0: everywhere", 0, 1);
  program.option("--environment-samples", settings.environment_samples, "",
                 "parallel lights that stand for an environment where shadows are cast", 1, 65536);
  program.option("--exposure", exposure, "of the PNG: scene, auto, or stops (a number)");
  program.option("--tone", tone, "curve of the PNG", {"filmic", "linear"});
  ShellTextureFiles files;
  files.declare(program);
  program.example("sg-render scene.json exitance.ply -o image.exr --exposure 0.5", "half a stop brighter than 1:1");
  return program.run(argc, argv, [&](StageRun& run) {
    run.start_timer("read");
    files.check(program);
    const Scene scene = read_scene(scene_path);
    if (!scene.camera) throw InputError(scene_path + ": no camera");
    require_memory(scene_path, *scene.camera);
    program.refuse_unless(has_extended_light(scene), "a scene with an environment or area light",
                          {"--environment-samples"});
    AttributedMesh surface;
    ShellFile shell;
    together([&] { surface = read_mesh(surface_path); },
             [&] {
               if (files.asked_for()) shell.volume = read_shell_volume(files.shell, ShellParts::matter, &shell.notes);
             });
    settings.film.samples_per_pixel = samples > 0 ? samples : scene.method.samples_per_pixel;
    settings.film.seed = run.seed();
    settings.background = scene.background;
    settings.floor = scene.floor;

    warn_of_darkness(scene, run.progress());
    if (!files.asked_for()) run.start_timer("render");
    const bool opaque = scene.material && scene.material->opaque;
    if (!opaque && !scene.object) throw InputError(scene_path + ": no object; its ior is needed");
    const auto render = [&] {
      if (files.asked_for()) return shell_texture_picture(files, shell, surface_path, surface, scene, settings, run);
      if (opaque)
        return render_surface(surface.mesh, OpaqueSurface{scene.material->opaque->reflectance}, scene.lights,
                              *scene.camera, settings, run.progress());
      return render_surface(surface.mesh,
                            TranslucentSurface{exitance_of(surface_path, surface, "sg-diffuse"), scene.object->ior},
                            scene.lights, *scene.camera, settings, run.progress());
    };
    const RenderedImage picture = render();

    run.start_timer("write");
    const double stops = exposure_stops(exposure, scene, picture.image);
    const std::string png = std::filesystem::path(run.output()).replace_extension(".png").string();
    together(
        [&] {
          write_png(png, picture.image.width, picture.image.height,
                    tone_map(picture.image, stops, tone == "filmic" ? ToneCurve::filmic : ToneCurve::linear));
        },
        [&] { write_exr(run.output(), picture.image); });
    run.note_output(png);

    const RenderStatistics& s = picture.statistics;
    run.results()["exposure_stops"] = stops;
    run.results()["negative_exitance_vertices"] = s.negative_exitance_vertices;
    run.results()["camera_rays"] = s.film.samples;
    run.results()["camera_rays_skipped"] = s.film.samples_skipped;
    run.results()["refined_pixels"] = s.film.refined_pixels;
    run.results()["mirror_rays"] = s.mirror_rays;
    run.results()["shadow_rays"] = s.shadow_rays;
    run.results()["shadow_rays_skipped"] = s.shadow_rays_skipped;
    run.results()["unseen_vertices_skipped"] = s.unseen_vertices_skipped;
    run.print(fmt::format("{}: {} × {} pixels, {} camera rays ({} saved), exposure {:.2f} stops", run.output(),
                          picture.image.width, picture.image.height, s.film.samples, s.film.samples_skipped, stops));
  });
}
