// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/given_polycube.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/polycube_map.h"
#include "meshing/polycube/sample_raster.h"
#include "meshing/polycube/target_surface.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

constexpr std::int64_t most_along = 512;    // cubes along an axis
constexpr double most_cells = 1e8;          // cubes times cells in each
constexpr double least_covered = 0.05;      // of the object
constexpr double trusted_covered = 0.25;    // by the placement of a file
constexpr double lattice_tolerance = 1e-4;  // of a cube's edge

std::string place_text(const Vec3i& p) {
  return std::to_string(p.x()) + " " + std::to_string(p.y()) + " " + std::to_string(p.z());
}

bool before(const Vec3i& a, const Vec3i& b) {
  return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
}

// A window around the cubes, whose place (1, 1, 1) is their least coordinates.
BlockGrid window_around(const std::vector<Vec3i>& cubes, const Vec3i& low, const Vec3i& high) {
  BlockGrid grid(high - low + Vec3i::Constant(3));
  for (const Vec3i& c : cubes) grid.filled[grid.index(c - low + Vec3i::Ones())] = 1;
  return grid;
}

// Throws where the cubes are no polycube of one part with one manifold boundary. `low`: what was taken off them.
void check_shape(const BlockGrid& grid, const Vec3i& low) {
  const std::size_t count = grid.count();
  BlockGrid largest = grid;
  keep_largest_component(largest);
  if (largest.count() != count)
    for (std::size_t b = 0; b < grid.filled.size(); ++b)
      if (grid.filled[b] && !largest.filled[b])
        throw InputError("the cubes fall into parts that share no face: " + std::to_string(count - largest.count()) +
                         " of " + std::to_string(count) + " are apart from the others, one of them " +
                         place_text(grid.place(b) - Vec3i::Ones() + low));
  for (int k = 1; k < grid.size.z(); ++k)
    for (int j = 1; j < grid.size.y(); ++j)
      for (int i = 1; i < grid.size.x(); ++i)
        if (!is_well_composed(window_at(grid, {i, j, k})))
          throw InputError(
              "the cubes' surface is no manifold: at " + std::to_string(count_ill_composed(grid)) +
              " lattice points cubes touch along an edge or at a corner only, the first the lower corner of cube " +
              place_text(Vec3i(i, j, k) - Vec3i::Ones() + low));
  BlockGrid solid = grid;
  fill_cavities(solid);
  if (solid.count() != count)
    throw InputError("the cubes enclose a cavity of " + std::to_string(solid.count() - count) +
                     " cubes; expected one closed surface");
}

// The greatest length of which all `values` are multiples, within the tolerance; 0 where it is too short.
double common_divisor(const std::vector<double>& values, double longest) {
  double divisor = 0;
  for (double value : values) {
    if (!(value > lattice_tolerance * longest)) continue;
    double rest = divisor;
    divisor = value;
    while (rest > lattice_tolerance * longest) {
      const double next = std::abs(std::remainder(divisor, rest));
      divisor = rest;
      rest = next;
    }
    if (divisor * static_cast<double>(most_along) < longest) return 0;
  }
  return divisor;
}

struct Overlap {
  double covered = 0, common = 0;
};

// By samples of the box around both.
Overlap measure_overlap(const TriangleMesh& surface, const BlockGrid& grid, const Vec3& corner, double edge) {
  const Vec3 low = surface.vertices.colwise().minCoeff().transpose();
  const Vec3 high = surface.vertices.colwise().maxCoeff().transpose();
  const Vec3 cubes_low = corner + Vec3::Constant(edge),
             cubes_high = corner + edge * (grid.size.cast<double>().array() - 1).matrix();
  if ((low.array() >= cubes_high.array()).any() || (high.array() <= cubes_low.array()).any()) return {};
  const double spacing = std::max((high - low).maxCoeff() / 128, edge / 8);
  // Off the round numbers that meshes like to lie on.
  const Vec3 lower = low - spacing * Vec3(0.5137, 0.5171, 0.5113);
  const Vec3i size = ((high - lower) / spacing).array().ceil().cast<int>() + 1;
  const SampleRaster raster = rasterize(surface, lower, spacing, size);
  std::int64_t object = 0, both = 0;
  for (int i = 0; i < size.x(); ++i)
    for (int j = 0; j < size.y(); ++j)
      for (int k = 0; k < size.z(); ++k) {
        if (!raster.inside({i, j, k})) continue;
        ++object;
        both += grid.at(((raster.centre({i, j, k}) - corner) / edge).array().floor().cast<int>().matrix());
      }
  if (object == 0) return {};
  const double of_cubes = std::pow(edge / spacing, 3) * static_cast<double>(grid.count());
  return {static_cast<double>(both) / static_cast<double>(object),
          static_cast<double>(both) / (of_cubes + static_cast<double>(object - both))};
}

// Distances of the surface's samples to the cubes, in cells: 99th percentile and greatest.
void measure_coverage(const TriangleMesh& surface, const BlockGrid& grid, const Vec3& corner, VoxelPolycube& polycube) {
  const double edge = polycube.spacing * polycube.cells_per_block;
  const TargetSurface cubes(polycube_surface(polycube));
  const std::vector<TargetSurface::Sample> samples = TargetSurface(surface).samples(20000);
  std::vector<double> distance(samples.size());
  parallel_for(samples.size(), [&](std::size_t s) {
    const Vec3i home = ((samples[s].point - corner) / edge).array().floor().cast<int>().matrix();
    distance[s] = grid.at(home) ? 0 : cubes.nearest(samples[s].point).distance / polycube.spacing;
  });
  std::sort(distance.begin(), distance.end());
  if (distance.empty()) return;
  polycube.coverage_p99 = distance[static_cast<std::size_t>(0.99 * static_cast<double>(distance.size() - 1))];
  polycube.coverage_max = distance.back();
}

}  // namespace

CubeList cubes_of_mesh(const TriangleMesh& mesh) {
  if (mesh.face_count() == 0) throw InputError("the mesh of cubes has no faces");
  const Vec3 low = mesh.vertices.colwise().minCoeff().transpose();
  const double longest = (mesh.vertices.colwise().maxCoeff().transpose() - low).maxCoeff();
  int slanted = 0, first = -1;
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 span = (mesh.corner(f, 0).cwiseMax(mesh.corner(f, 1)).cwiseMax(mesh.corner(f, 2)) -
                       mesh.corner(f, 0).cwiseMin(mesh.corner(f, 1)).cwiseMin(mesh.corner(f, 2)));
    if (span.minCoeff() > lattice_tolerance * longest) slanted += 1, first = first < 0 ? f : first;
  }
  if (slanted > 0)
    throw InputError(std::to_string(slanted) + " of " + std::to_string(mesh.face_count()) +
                     " faces are not aligned with the axes, the first face " + std::to_string(first) +
                     "; expected the surface of axis-aligned cubes");
  std::vector<double> heights;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> places(mesh.vertices.col(axis).begin(), mesh.vertices.col(axis).end());
    std::sort(places.begin(), places.end());
    double last = -1;
    for (double place : places)
      if (place - low[axis] > last + lattice_tolerance * longest) heights.push_back(last = place - low[axis]);
  }
  const double rough = common_divisor(heights, longest);
  if (!(rough > 0))
    throw InputError("the mesh's vertices lie on no common lattice of up to " + std::to_string(most_along) +
                     " cubes along an axis; expected the surface of equal cubes");
  CubeList list;
  list.placed = true;
  list.origin = low;
  list.edge = longest / std::round(longest / rough);
  const Vec3i size =
      ((mesh.vertices.colwise().maxCoeff().transpose() - low) / list.edge).array().round().cast<int>().matrix();
  // Samples off the cubes' centres, where the diagonals of their faces meet.
  const Vec3 shift(0.137, 0.211, 0.073);
  const SampleRaster raster = rasterize(mesh, low + list.edge * shift, list.edge, size.cwiseMax(1));
  for (int k = 0; k < size.z(); ++k)
    for (int j = 0; j < size.y(); ++j)
      for (int i = 0; i < size.x(); ++i)
        if (raster.inside({i, j, k})) list.cubes.push_back({i, j, k});
  if (list.cubes.empty()) throw InputError("the mesh encloses no cube; expected a closed surface of cubes");
  const double enclosed = std::abs(enclosed_volume(mesh)) / std::pow(list.edge, 3);
  if (std::abs(enclosed - static_cast<double>(list.cubes.size())) > 1e-3 * static_cast<double>(list.cubes.size()))
    throw InputError("the mesh's faces enclose the volume of " + std::to_string(enclosed) + " cubes, but hold " +
                     std::to_string(list.cubes.size()) + "; expected a closed surface with outward faces");
  return list;
}

GivenPolycube place_given_polycube(const CubeList& list, const TriangleMesh& surface,
                                   const GivenPolycubeOptions& options) {
  if (list.cubes.empty()) throw InputError("there are no cubes; expected at least one");
  if (!(enclosed_volume(surface) > 0))
    throw InputError("the surface encloses no volume; expected a closed surface with outward faces");
  std::vector<Vec3i> cubes = list.cubes;
  std::sort(cubes.begin(), cubes.end(), before);
  const auto twice = std::adjacent_find(cubes.begin(), cubes.end());
  if (twice != cubes.end()) throw InputError("cube " + place_text(*twice) + " is listed twice");
  Vec3i least = cubes.front(), most = cubes.front();
  for (const Vec3i& c : cubes) least = least.cwiseMin(c), most = most.cwiseMax(c);
  for (int axis = 0; axis < 3; ++axis)
    if (static_cast<std::int64_t>(most[axis]) - least[axis] >= most_along)
      throw InputError("the cubes spread over " +
                       std::to_string(static_cast<std::int64_t>(most[axis]) - least[axis] + 1) +
                       " places of an axis; expected at most " + std::to_string(most_along));
  const BlockGrid grid = window_around(cubes, least, most);
  check_shape(grid, least);

  const Vec3 low = surface.vertices.colwise().minCoeff().transpose();
  const Vec3 high = surface.vertices.colwise().maxCoeff().transpose();
  const Vec3 extent = (most - least + Vec3i::Ones()).cast<double>();
  struct Frame {
    Vec3 origin;  // lower corner of the least cube
    double edge;
    Vec3 corner() const { return origin - Vec3::Constant(edge); }  // of the window
  };
  const auto about_box = [&](double edge) { return Frame{0.5 * (low + high) - 0.5 * edge * extent, edge}; };
  const double box_edge = options.edge ? *options.edge : std::cbrt((high - low).prod() / extent.prod());
  Frame frame = about_box(box_edge);
  GivenPolycube result;
  Overlap overlap = measure_overlap(surface, grid, frame.corner(), frame.edge);
  if (!options.edge && !options.origin && options.placement != CubePlacement::box) {
    if (options.placement == CubePlacement::file && !list.placed)
      throw InputError("the file does not say where its cubes lie; expected an origin and an edge, or --place box");
    if (list.placed) {
      const Frame of_file{list.origin + list.edge * least.cast<double>(), list.edge};
      const Overlap there = measure_overlap(surface, grid, of_file.corner(), of_file.edge);
      if (options.placement == CubePlacement::file || there.covered >= trusted_covered) {
        result.placement = CubePlacement::file;
        frame = of_file;
        overlap = there;
      }
    }
  }
  if (options.origin) {
    frame.origin = *options.origin + frame.edge * least.cast<double>();
    overlap = measure_overlap(surface, grid, frame.corner(), frame.edge);
  }
  if (!(frame.edge > 0) || !std::isfinite(frame.edge)) throw InputError("the object's bounding box is flat");
  result.covered = overlap.covered;
  result.overlap = overlap.common;
  if (overlap.covered < least_covered) {
    const bool given = options.edge || options.origin, over_box = !given && result.placement == CubePlacement::box;
    throw InputError("the cubes hold " + std::to_string(std::lround(100 * overlap.covered)) +
                     " % of the object's volume" + (over_box ? " even over its bounding box" : "") +
                     "; expected a polycube that roughly follows the object (" +
                     (over_box ? "--origin and --edge lay it elsewhere"
                      : given  ? "without --origin and --edge it is laid over the object's bounding box"
                               : "--place box lays it over the object's bounding box") +
                     ")");
  }

  VoxelPolycube& polycube = result.polycube;
  const double count = static_cast<double>(cubes.size());
  polycube.cells_per_block =
      options.grid > 0 ? options.grid : std::max(1, static_cast<int>(std::round(std::cbrt(options.nodes / count))));
  const double cells = count * std::pow(polycube.cells_per_block, 3);
  if (cells > most_cells)
    throw InputError(std::to_string(cubes.size()) + " cubes of " + std::to_string(polycube.cells_per_block) +
                     "³ cells are more than " + std::to_string(static_cast<long>(most_cells)) + " cells");
  polycube.spacing = frame.edge / polycube.cells_per_block;
  polycube.origin = frame.origin;
  for (const Vec3i& c : cubes) polycube.blocks.push_back(c - least);
  polycube.object_genus = genus(surface);
  polycube.genus = static_cast<int>((2 - boundary_euler_characteristic(grid)) / 2);
  const SingularityCounts singular = count_singularities(grid);
  polycube.singular_edges = singular.edges;
  polycube.singular_corners = singular.corners;
  measure_coverage(surface, grid, frame.corner(), polycube);
  return result;
}

}  // namespace shellgrid
