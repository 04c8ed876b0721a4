// SPDX-License-Identifier: AGPL-3.0-or-later
#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "meshing/formats/mesh_file.h"
#include "meshing/formats/vdb_file.h"
#include "pipeline/cli/option_table.h"
#include "pipeline/cli/stage_program.h"
#include "pipeline/scene/origin.h"
#include "synthesis/sample_archive.h"
#include "synthesis/surface_paint.h"
#include "synthesis/synthesis_quality.h"
#include "synthesis/textured_mesh.h"

using namespace shellgrid;

namespace {

void warn_of_distance(const PaintFit& fit, const TriangleMesh& surface, const std::string& path, Progress& progress) {
  const double size = (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).maxCoeff();
  if (fit.most > 0.02 * size)
    progress.warn(fmt::format(
        "{} is up to {:.3g} mm off the surface, half of it {:.2g} mm: there the nearest painted place counts", path,
        fit.most, fit.median));
}

// Corners of triangles at a vertex: six where all of them hang together, one where none does.
void warn_of_loose_triangles(const TriangleMesh& mesh, const std::string& path, Progress& progress) {
  const double corners = 3.0 * mesh.face_count() / std::max(1, mesh.vertex_count());
  if (mesh.face_count() > 100 && corners < 2)
    progress.warn(fmt::format(
        "{}: its triangles share hardly any vertices, and the sample cannot go on from one to the next; try sg-prepare",
        path));
}

std::vector<double> shares_of(const std::vector<std::int32_t>& sample, int count) {
  std::vector<double> shares;
  for (int s = 0; s < count; ++s)
    shares.push_back(static_cast<double>(std::count(sample.begin(), sample.end(), s)) /
                     static_cast<double>(sample.size()));
  return shares;
}

void warn_of_unwanted_samples(const std::vector<std::int32_t>& wanted, int count, Progress& progress) {
  for (int s = 0; s < count; ++s)
    if (std::find(wanted.begin(), wanted.end(), s) == wanted.end())
      progress.warn(fmt::format("sample {} is painted nowhere", s));
}

}  // namespace

int main(int argc, char** argv) {
  std::string surface_path, textons_path, paint_path, method = "coherence";
  SynthesisOptions options;
  std::vector<double> direction = {0, 1, 0}, orient;
  double voxel = 0, scale = 1;
  StageProgram program("sg-synthesize", "Grows a sample over a surface: a texture coordinate for every vertex.");
  program.input("surface.ply", surface_path, "mesh with vertices a voxel apart, from sg-prepare");
  program.input("textons.vdb", textons_path, "how the samples look, from sg-textons");
  program.input("painted.ply", paint_path,
                "a mesh whose vertices say what is wanted there: direction_x/y/z, scale, and which of several samples: "
                "sample, quality or red",
                true);
  program.output("synthesized.ply", "the mesh with texture_u, texture_v, direction_x/y/z and colours");
  program.option(
      "--method", method,
      "coherent candidates, coarse to fine; every texel as a candidate, a slow yardstick; or the paper's sweep "
      "by textons",
      {"coherence", "exhaustive", "textons"});
  program.option("--neighbourhood", options.neighbourhood, "texels", "across, odd; of the sweep by textons", 3, 31);
  program.option("--voxel", voxel, "mm", "edge of a voxel; 0 takes the sample's", 0, 1e4);
  program.option("--scale", scale, "", "how much larger than it is the sample appears along the surface", 0.25, 4);
  program.option("--direction", direction, "", "the texture's u runs this way where the surface allows");
  program.list_option("--orient", orient, "mm",
                      "where it must run otherwise: point and direction x,y,z,dx,dy,dz, and so on", -1e9, 1e9);
  program.option("--passes", options.passes, "", "correction passes at each level but the finest", 0, 100);
  program.option("--final-passes", options.final_passes, "", "correction passes at the finest level", 0, 100);
  program.option("--window-passes", options.window_passes, "",
                 "then rounds of discrete optimisation of 5x5 windows, one more at coarse levels", 0, 100);
  program.option("--relaxation", options.relaxation_sweeps, "", "smoothing sweeps within patches after each pass", 0,
                 100);
  program.option("--jitter", options.jitter, "texels", "random shift of coordinates at coarse levels", 0, 10);
  program.example("sg-synthesize surface.ply textons.vdb -o synthesized.ply", "then look at it with MeshLab");
  return program.run(argc, argv, [&](StageRun& run) {
    options.method = method == "textons"      ? SynthesisMethod::textons
                     : method == "exhaustive" ? SynthesisMethod::exhaustive
                                              : SynthesisMethod::coherence;
    program.refuse_unless(method == "textons", "--method textons", {"--neighbourhood"});
    program.refuse_unless(method != "textons", "a method but textons",
                          {"--passes", "--final-passes", "--window-passes", "--relaxation", "--jitter"});
    if (options.neighbourhood % 2 == 0) throw UsageError("--neighbourhood: must be odd");
    options.direction = Vec3(direction[0], direction[1], direction[2]);
    if (!(options.direction.norm() > 0)) throw UsageError("--direction: must not be the zero vector");
    if (orient.size() % 6 != 0) throw UsageError("--orient: takes six numbers for each point and direction");
    for (std::size_t k = 0; k < orient.size(); k += 6) {
      const double* o = orient.data() + k;
      options.orient.push_back({Vec3(o[0], o[1], o[2]), Vec3(o[3], o[4], o[5])});
      if (!(options.orient.back().direction.norm() > 0)) throw UsageError("--orient: a direction is the zero vector");
    }
    run.start_timer("read");
    const AttributedMesh surface = read_mesh(surface_path);
    warn_of_loose_triangles(surface.mesh, surface_path, run.progress());
    const VdbArchive archive = read_vdb(textons_path);
    TextonSet textons = restore_textons(archive);
    if (voxel > 0) textons.voxel = voxel;
    options.seed = run.seed();
    PaintFit fit;
    if (!paint_path.empty()) {
      const AttributedMesh painted = read_mesh(paint_path);
      require_paint(painted, textons.layers.sample_count, paint_path, scale);
      options.paint = transfer_paint(painted, surface.mesh, textons.layers.sample_count, paint_path, &fit);
    }
    warn_of_distance(fit, surface.mesh, paint_path, run.progress());
    if (scale != 1) {
      options.paint.scale.resize(surface.mesh.vertex_count(), 1.0f);
      for (float& s : options.paint.scale) s *= static_cast<float>(scale);
    }
    run.start_timer("synthesize");
    const SurfaceTexture texture = synthesize_surface(surface.mesh, textons, options, run.progress());
    run.start_timer("judge");
    const SynthesisQuality quality = measure_synthesis(texture, textons);
    run.start_timer("write");
    write_ply(run.output(), attach_texture(texture, textons),
              {{samples_note, note_of(archive.metadata, samples_note)}});
    nlohmann::json levels, singularities = nlohmann::json::array();
    double positive = 0, negative = 0;
    for (const Singularity& s : texture.singularities) {
      (s.index > 0 ? positive : negative) += std::abs(s.index);
      singularities.push_back({{"point", {s.point.x(), s.point.y(), s.point.z()}}, {"index", s.index}});
    }
    for (const VertexHierarchy::Level& level : texture.hierarchy.levels) levels.push_back(level.vertices.size());
    nlohmann::json wider = nlohmann::json::array();
    for (const WindowDistance& w : quality.wider)
      wider.push_back({{"places", w.places},
                       {"step", w.step},
                       {"distance_over_variance", w.synthesized},
                       {"random", w.random},
                       {"tiling", w.tiling}});
    const std::vector<double> shares = shares_of(texture.sample, textons.layers.sample_count);
    if (textons.layers.sample_count > 1)
      warn_of_unwanted_samples(options.paint.sample, textons.layers.sample_count, run.progress());
    run.results() = {{"vertices", texture.coordinate.size()},
                     {"level_vertices", levels},
                     {"sample_shares", shares},
                     {"symmetry", textons.layers.symmetry},
                     {"singularities_positive", positive},
                     {"singularities_negative", negative},
                     {"singularities", singularities},
                     {"window_distance_over_variance", quality.window_distance},
                     {"window_distance_random", quality.random},
                     {"window_distance_tiling", quality.tiling},
                     {"wider_windows", wider},
                     {"window_distance_at_singularities", quality.at_singularities},
                     {"window_distance_elsewhere", quality.elsewhere},
                     {"texton_chi_squared", quality.texton_chi_squared},
                     {"autocorrelation_error", quality.autocorrelation_error},
                     {"coherence", quality.coherence},
                     {"texel_entropy", quality.texel_entropy},
                     {"patch_entropy", quality.patch_entropy},
                     {"patches", quality.patches},
                     {"median_patch_vertices", quality.median_patch}};
    if (!paint_path.empty())
      run.results()["paint"] = {
          {"moved", fit.moved}, {"median_distance_mm", fit.median}, {"most_distance_mm", fit.most}};
    run.print(fmt::format("{} vertices, window distance {:.3f} (random {:.3f}, copy {:.3f}), coherence {:.2f}",
                          texture.coordinate.size(), quality.window_distance, quality.random, quality.tiling,
                          quality.coherence));
  });
}
