// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/prepare_surface.h"

#include <fmt/format.h>

#include <vector>

#include "meshing/core/error.h"
#include "meshing/surface/retile.h"

namespace shellgrid {
namespace {

// Centres the bounding box on the origin and makes its longest edge `size`, where that is not 0. Returns the scale.
double place(TriangleMesh& mesh, double size) {
  const Eigen::RowVector3d lower = mesh.vertices.colwise().minCoeff(), upper = mesh.vertices.colwise().maxCoeff();
  const double scale = size > 0 ? size / (upper - lower).maxCoeff() : 1;
  mesh.vertices.rowwise() -= 0.5 * (lower + upper);
  mesh.vertices *= scale;
  return scale;
}

// In the input's units.
double rewrap_resolution(const TriangleMesh& input, const PrepareOptions& options) {
  if (input.vertex_count() == 0) return 0;
  const double length = (input.vertices.colwise().maxCoeff() - input.vertices.colwise().minCoeff()).maxCoeff();
  if (options.rewrap_share > 0) return options.rewrap_share * length;
  return options.size > 0 ? options.rewrap * length / options.size : options.rewrap;
}

// Whether a retiled mesh may take the place of its original; else adds where it crosses itself. `placed` is the
// retiled mesh as it will be written: moving it rounds its coordinates.
bool accept(const TriangleMesh& retiled, const TriangleMesh& placed, const TriangleMesh& original,
            std::vector<Vec3>& crossings) {
  const SurfaceDefects defects = find_defects(retiled);
  if (defects.boundary_edges + defects.non_manifold_edges + defects.non_manifold_vertices > 0) return false;
  if (defects.components != 1 || genus(retiled) != genus(original)) return false;
  const SelfIntersections found = find_self_intersections(placed, {}, folded_flat);
  for (const auto& [face, other] : found.face_pairs)
    for (const int f : {face, other})
      crossings.emplace_back((retiled.corner(f, 0) + retiled.corner(f, 1) + retiled.corner(f, 2)) / 3);
  return found.pairs == 0;
}

constexpr double wanted_fit = 0.3;  // spacings between the surfaces
constexpr int most_refinements = 3;
constexpr int most_refined_vertices = 300'000;  // over all of them

// Retiles again with edges a little shorter where the surfaces are too far apart, and keeps the nearest.
void refine_fit(PreparedSurface& result, const TriangleMesh& original, const PrepareOptions& options,
                RetileOptions retiling, Progress& progress) {
  const double spacing = options.spacing, limit = wanted_fit * spacing;
  retiling.refinements.push_back({{}, 0.6, 0.5, 2});
  std::vector<Vec3>& places = retiling.refinements.back().at;
  TriangleMesh tried = result.mesh;
  int vertices = 0;
  for (int round = 0; round < most_refinements && result.farthest() > limit; ++round) {
    const auto add_far = [&](const TriangleMesh& from, const TriangleMesh& to) {
      const std::vector<Vec3> far = samples_beyond(from, to, spacing, 0.9 * limit);
      places.insert(places.end(), far.begin(), far.end());
    };
    vertices += tried.vertex_count();
    if (vertices > most_refined_vertices) return;
    add_far(tried, original);
    add_far(original, tried);
    const TriangleMesh retiled = retile_surface(original, retiling, progress);
    ++result.retiling_attempts;
    tried = retiled;
    place(tried, options.size);
    if (!accept(retiled, tried, original, places)) continue;
    const double to_input = sampled_distance(tried, original, spacing),
                 from_input = sampled_distance(original, tried, spacing);
    if (std::max(to_input, from_input) >= result.farthest()) continue;
    result.mesh = tried;
    result.to_input = to_input, result.from_input = from_input;
    result.refined_edge = retiling.refinements.back().factor * spacing;
  }
}

}  // namespace

PreparedSurface prepare_surface(const TriangleMesh& input, const PrepareOptions& options, Progress& progress) {
  PreparedSurface result;
  TriangleMesh original;
  if (options.rewrap > 0 || options.rewrap_share > 0) {
    original = rewrap_surface(input, rewrap_resolution(input, options), result.rewrap, progress);
    if (result.rewrap.dropped_components > 0)
      progress.warn(fmt::format("left out {} of the wrap's components, {:.2g} % of its volume",
                                result.rewrap.dropped_components, 100 * result.rewrap.dropped_volume));
    if (result.rewrap.from_input > 2 * result.rewrap.resolution)
      progress.warn(
          fmt::format("given triangles lie up to {:.3g} times the resolution from the wrap, which fills "
                      "cavities and narrow openings",
                      result.rewrap.from_input / result.rewrap.resolution));
  } else {
    original = repair_surface(input, options.close_holes, result.repair, progress);
  }
  result.scale = place(original, options.size);
  for (double* length : {&result.rewrap.resolution, &result.rewrap.to_input, &result.rewrap.from_input})
    *length *= result.scale;
  result.mesh = original;
  if (!options.retile && options.longest_edge > 0) result.mesh = subdivide_long_edges(original, options.longest_edge);
  if (options.retile) {
    const Eigen::RowVector3d extent = original.vertices.colwise().maxCoeff() - original.vertices.colwise().minCoeff();
    if (!(options.spacing > 0) || options.spacing > extent.maxCoeff() / 4)
      throw InputError(
          fmt::format("spacing {:.6g} mm is too coarse for an object {:.6g} mm long; expected at most a quarter",
                      options.spacing, extent.maxCoeff()));
    RetileOptions retiling;
    retiling.spacing = options.spacing;
    retiling.feature_angle = options.feature_angle;
    retiling.refinements.resize(1);
    Refinement& refinement = retiling.refinements[0];
    bool accepted = false;
    for (int attempt = 0; attempt < 4; ++attempt) {
      const std::size_t known = refinement.at.size();
      const TriangleMesh retiled = retile_surface(original, retiling, progress);
      ++result.retiling_attempts;
      // Vertices on the surface reach its extremes only nearly.
      result.mesh = retiled;
      place(result.mesh, options.size);
      accepted = accept(retiled, result.mesh, original, refinement.at);
      // Wrong in a way that refining does not mend, or everywhere, as a plate much thinner than the spacing is.
      const std::size_t crossed = refinement.at.size() - known;
      if (accepted || crossed == 0 || crossed > static_cast<std::size_t>(result.mesh.face_count()) / 50) break;
      refinement.factor *= 0.5;
      refinement.core = refinement.reach * refinement.factor;
    }
    if (result.retiling_attempts > 1) result.refined_edge = options.spacing * refinement.factor;
    if (!accepted) {
      progress.warn("retiling made the surface cross itself; kept its triangles and subdivided the long ones");
      result.mesh = subdivide_long_edges(original, 4.0 / 3 * options.spacing);
      place(result.mesh, options.size);
      result.kept_triangles = true;
      if (const SelfIntersections found = find_self_intersections(result.mesh); found.pairs > 0)
        throw InputError(
            fmt::format("{} pairs of triangles intersect after retiling, first at ({:.6g}, {:.6g}, {:.6g}); "
                        "try a smaller spacing or --no-retile",
                        found.pairs, found.at.x(), found.at.y(), found.at.z()));
    }
    result.to_input = sampled_distance(result.mesh, original, options.spacing);
    result.from_input = sampled_distance(original, result.mesh, options.spacing);
    if (accepted) refine_fit(result, original, options, retiling, progress);
  }
  require_closed_surface(result.mesh);
  result.edges = measure_edges(result.mesh);
  result.genus = genus(result.mesh);
  result.volume = enclosed_volume(result.mesh);
  if (options.retile) {
    result.creases = compare_creases(original, result.mesh, options.feature_angle, options.spacing);
    if (!result.kept_triangles && result.refined_edge > 0)
      progress.warn(fmt::format("the surface is finer than the spacing in places; edges shortened to {:.3g} mm there",
                                result.refined_edge));
    const double farthest = result.farthest() / options.spacing;
    if (farthest > wanted_fit)
      progress.warn(
          fmt::format("the object is finer than the spacing in places: the surfaces are up to {:.2g} spacings "
                      "apart",
                      farthest));
  }
  return result;
}

}  // namespace shellgrid
