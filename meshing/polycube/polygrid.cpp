// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/polygrid.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/block_grid.h"
#include "meshing/polycube/boundary_layer.h"
#include "meshing/polycube/laplacian_weights.h"
#include "meshing/polycube/transport_start.h"

namespace shellgrid {
namespace {

// VTK_HEXAHEDRON goes around the bottom and the top; lattice order counts in binary.
constexpr int vtk_corner[8] = {0, 1, 3, 2, 4, 5, 7, 6};

LatticeHexahedron lattice_cell(const Polygrid& polygrid, Eigen::Index c) {
  LatticeHexahedron cell;
  for (int k = 0; k < 8; ++k) cell[vtk_corner[k]] = polygrid.cells(c, k);
  return cell;
}

TriangleMesh scaled_surface(const TriangleMesh& surface, const Vec3& origin, double unit) {
  TriangleMesh scaled = surface;
  for (int v = 0; v < scaled.vertex_count(); ++v)
    scaled.vertices.row(v) = ((surface.vertex(v) - origin) / unit).transpose();
  return scaled;
}

void build_graph(Polygrid& polygrid, const LatticeGrid& core, const TargetSurface& surface, double scale,
                 const Vec3& origin, double condition_limit) {
  PolygridGraph& graph = polygrid.graph;
  const Eigen::Index cells = static_cast<Eigen::Index>(core.cells.size());
  graph.interior.setZero(cells, 3);
  for (Eigen::Index c = 0; c < cells; ++c)
    for (int k = 0; k < 8; ++k) graph.interior.row(c) += 0.125 * polygrid.points.row(polygrid.cells(c, k));

  // Neighbours share a face: the cell's four corners on one side are another's on the opposite side. Cells are
  // sorted by (z, y, x), so neighbours are found by search.
  const auto before = [](const Vec3i& a, const Vec3i& b) {
    return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
  };
  graph.links.resize(cells, 6);
  parallel_for(static_cast<std::size_t>(cells), [&](std::size_t c) {
    for (int side = 0; side < 6; ++side) {
      const Vec3i wanted = core.cell_lattice[c] + (side & 1 ? 1 : -1) * Vec3i::Unit(side / 2);
      const auto found = std::lower_bound(core.cell_lattice.begin(), core.cell_lattice.end(), wanted, before);
      graph.links(c, side) = found != core.cell_lattice.end() && *found == wanted
                                 ? static_cast<std::int32_t>(found - core.cell_lattice.begin())
                                 : 0;
    }
  });
  const Eigen::Index quads = static_cast<Eigen::Index>(core.boundary_quads.size());
  graph.boundary.resize(quads, 3);
  graph.boundary_normal.resize(quads, 3);
  graph.boundary_owner.resize(quads);
  graph.boundary_distance.resize(quads);
  parallel_for(static_cast<std::size_t>(quads), [&](std::size_t q) {
    Vec3 centre = Vec3::Zero();
    for (int k = 0; k < 4; ++k) centre += 0.25 * polygrid.points.row(polygrid.boundary_quads(q, k)).transpose();
    const Vec3 u =
        (polygrid.points.row(polygrid.boundary_quads(q, 2)) - polygrid.points.row(polygrid.boundary_quads(q, 0)))
            .transpose();
    const Vec3 v =
        (polygrid.points.row(polygrid.boundary_quads(q, 3)) - polygrid.points.row(polygrid.boundary_quads(q, 1)))
            .transpose();
    const double unit = polygrid.spacing * scale;
    const TargetSurface::Nearest nearest =
        surface.nearest_facing((centre - origin) / unit, u.cross(v).stableNormalized());
    const std::int32_t owner = core.boundary_quads[q].cell;
    const Vec3 place = origin + unit * nearest.point;
    graph.boundary.row(q) = place.transpose();
    graph.boundary_normal.row(q) = nearest.normal.transpose();
    graph.boundary_owner[q] = owner;
    graph.boundary_distance[q] = (place - graph.interior.row(owner).transpose()).norm();
    graph.links(owner, core.boundary_quads[q].side) = -1 - static_cast<std::int32_t>(q);
  });
  weigh_links(graph, polygrid.spacing, condition_limit);
}

double object_size(const TriangleMesh& surface) {
  return (surface.vertices.colwise().maxCoeff() - surface.vertices.colwise().minCoeff()).maxCoeff();
}

}  // namespace

Polygrid build_polygrid(const VoxelPolycube& polycube, const TriangleMesh& surface, const PolygridOptions& options,
                        Progress& progress) {
  if (polycube.blocks.empty()) throw InputError("the polycube has no blocks");
  if (surface.face_count() == 0) throw InputError("the surface has no faces");
  const double block_edge = polycube.spacing * polycube.cells_per_block;
  const TargetSurface target(scaled_surface(surface, polycube.origin, block_edge));
  Vec3i extent = Vec3i::Zero();
  for (const Vec3i& b : polycube.blocks) extent = extent.cwiseMax(b);
  const Vec3 low = target.mesh().vertices.colwise().minCoeff().transpose();
  const Vec3 high = target.mesh().vertices.colwise().maxCoeff().transpose();
  const Vec3 polycube_high = (extent + Vec3i::Ones()).cast<double>();
  if ((low.array() > polycube_high.array()).any() || (high.array() < 0).any())
    throw InputError("the polycube and the surface do not overlap; expected the polycube of this surface");
  // A polycube may leave thin extremities out, or be a rough one of the user's own; but not of another size.
  const double ratio = (high - low).norm() / polycube_high.norm();
  if (!(ratio > 0.25 && ratio < 4))
    throw InputError(
        fmt::format("the surface's box has {:.3g} times the polycube's diagonal; expected the polycube of "
                    "this surface, in the same unit",
                    ratio));

  PolycubeMapOptions map_options;
  map_options.layer_thickness = options.layer_thickness;
  // A polycube made by hand, of cubes that one can count, may follow the object so roughly that nearest points mislead.
  const bool is_rough = polycube.blocks.size() <= 4000 && polycube.coverage_p99 > 0.75 * polycube.cells_per_block;
  const double scale = polycube.cells_per_block;
  LayeredGrid layered =
      is_rough
          ? layer_rough_polycube(polycube.blocks, polycube.cells_per_block, target, map_options, progress)
          : add_boundary_layer(map_polycube(polycube.blocks, polycube.cells_per_block, target, map_options, progress),
                               target, scale, options.layer_thickness, progress);
  if (!inverted_cells(layered).empty()) {
    progress.warn(
        "cells stay inverted at the surface; the grid starts again from the polycube's own shape and keeps farther "
        "from the surface");
    layered = layer_on_lattice(polycube.blocks, polycube.cells_per_block, target, scale, options.layer_thickness);
  }
  if (!inverted_cells(layered).empty()) {
    const std::vector<Vec3i> filled = fill_to_visible(polycube.blocks);
    progress.warn(std::to_string(filled.size() - polycube.blocks.size()) +
                  " blocks are added to the polycube, whose corners leave no room for a boundary layer");
    layered = layer_on_lattice(filled, polycube.cells_per_block, target, scale, options.layer_thickness);
  }
  const std::vector<std::int32_t> inverted = inverted_cells(layered);
  if (!inverted.empty())
    throw InternalError("polygrid: " + std::to_string(inverted.size()) + " cells are inverted on the lattice itself");

  Polygrid polygrid;
  polygrid.spacing = polycube.spacing;
  const LatticeGrid& core = layered.core;
  const Eigen::Index core_points = core.points.rows(), outer_points = static_cast<Eigen::Index>(layered.twin.size());
  const Eigen::Index core_cells = static_cast<Eigen::Index>(core.cells.size());
  const Eigen::Index quads = static_cast<Eigen::Index>(core.boundary_quads.size());
  polygrid.points = layered.points * polycube.spacing;
  polygrid.points.rowwise() += polycube.origin.transpose();
  polygrid.cells.resize(core_cells + quads, 8);
  polygrid.cell_layer.assign(core_cells + quads, 0);
  polygrid.cell_lattice.resize(core_cells + quads, 3);
  for (Eigen::Index c = 0; c < core_cells + quads; ++c) {
    const bool is_core = c < core_cells;
    const LatticeHexahedron& cell = is_core ? core.cells[c] : layered.layer[c - core_cells];
    for (int k = 0; k < 8; ++k) polygrid.cells(c, k) = cell[vtk_corner[k]];
    polygrid.cell_layer[c] = is_core ? 0 : 1;
    polygrid.cell_lattice.row(c) =
        core.cell_lattice[is_core ? c : core.boundary_quads[c - core_cells].cell].transpose();
  }
  polygrid.point_lattice.resize(core_points + outer_points, 3);
  polygrid.outer_twin.assign(core_points + outer_points, -1);
  polygrid.point_normal.setZero(core_points + outer_points, 3);
  for (Eigen::Index p = 0; p < core_points; ++p) polygrid.point_lattice.row(p) = core.point_lattice[p].transpose();
  const VertexMatrix normals = boundary_normals(core);
  parallel_for(static_cast<std::size_t>(outer_points), [&](std::size_t o) {
    const Eigen::Index p = core_points + static_cast<Eigen::Index>(o);
    polygrid.point_lattice.row(p) = core.point_lattice[layered.twin[o]].transpose();
    polygrid.outer_twin[p] = layered.twin[o];
    const Vec3 place = layered.points.row(p).transpose() / scale;
    const Vec3 twin = layered.points.row(layered.twin[o]).transpose() / scale;
    const TargetSurface::Nearest nearest =
        target.nearest_facing(place, normals.row(layered.twin[o]).transpose().stableNormalized());
    const Vec3 normal = target.link_normal(nearest, place - twin);
    polygrid.point_normal.row(p) = normal.transpose();
  });
  polygrid.boundary_quads.resize(quads, 4);
  for (Eigen::Index q = 0; q < quads; ++q)
    polygrid.boundary_quads.row(q) << layered.layer[q][4], layered.layer[q][5], layered.layer[q][7],
        layered.layer[q][6];
  build_graph(polygrid, core, target, scale, polycube.origin, options.condition_limit);
  polygrid.hierarchy = build_hierarchy(polygrid, options.condition_limit);
  return polygrid;
}

PolygridQuality measure_polygrid(const Polygrid& polygrid, const VoxelPolycube& polycube, const TriangleMesh& surface) {
  PolygridQuality quality;
  const std::size_t cells = static_cast<std::size_t>(polygrid.cells.rows());
  quality.nodes = static_cast<long>(polygrid.graph.interior.rows() + polygrid.graph.boundary.rows());
  quality.cubes = static_cast<long>(polycube.blocks.size());

  std::vector<double> scaled(cells);
  std::vector<std::uint8_t> inverted(cells);
  parallel_for(cells, [&](std::size_t c) {
    const LatticeHexahedron cell = lattice_cell(polygrid, static_cast<Eigen::Index>(c));
    scaled[c] = scaled_jacobian(polygrid.points, cell);
    inverted[c] = !(least_jacobian(polygrid.points, cell, 0) > 0);
  });
  quality.scaled_jacobian_min = *std::min_element(scaled.begin(), scaled.end());
  for (std::size_t c = 0; c < cells; ++c) {
    quality.scaled_jacobian_mean += scaled[c] / static_cast<double>(cells);
    quality.inverted_cells += inverted[c];
  }

  double sum = 0, squares = 0;
  long links = 0;
  for (Eigen::Index i = 0; i < polygrid.graph.links.rows(); ++i)
    for (int side = 1; side < 6; side += 2) {
      const std::int32_t j = polygrid.graph.links(i, side);
      if (j < 0) continue;
      const double length = (polygrid.graph.interior.row(j) - polygrid.graph.interior.row(i)).norm();
      sum += length, squares += length * length, ++links;
    }
  if (links > 0) {
    const double mean = sum / static_cast<double>(links);
    quality.link_length_cv = std::sqrt(std::max(0.0, squares / static_cast<double>(links) - mean * mean)) / mean;
  }

  const TargetSurface target(surface);
  std::vector<Eigen::Index> outer;
  for (std::size_t p = 0; p < polygrid.outer_twin.size(); ++p)
    if (polygrid.outer_twin[p] >= 0) outer.push_back(static_cast<Eigen::Index>(p));
  quality.boundary_points = static_cast<long>(outer.size());
  std::vector<double> angle(outer.size()), distance(outer.size()), thickness(outer.size());
  parallel_for(outer.size(), [&](std::size_t o) {
    const Eigen::Index p = outer[o];
    const Vec3 link = (polygrid.points.row(p) - polygrid.points.row(polygrid.outer_twin[p])).transpose();
    const Vec3 normal = polygrid.point_normal.row(p).transpose();
    angle[o] = std::atan2(link.cross(normal).norm(), link.dot(normal)) * 180 / std::numbers::pi;
    distance[o] = target.nearest(polygrid.points.row(p).transpose()).distance;
    thickness[o] = link.norm();
  });
  const double tolerance = 1e-4 * object_size(surface);
  for (std::size_t o = 0; o < outer.size(); ++o) {
    quality.link_angle_mean += angle[o] / static_cast<double>(outer.size());
    quality.link_angle_max = std::max(quality.link_angle_max, angle[o]);
    quality.steep_links += angle[o] > 30;
    quality.layer_thickness_mean += thickness[o] / polygrid.spacing / static_cast<double>(outer.size());
    quality.boundary_distance_max = std::max(quality.boundary_distance_max, distance[o] / polygrid.spacing);
    quality.off_surface += distance[o] > tolerance;
  }
  quality.genus = static_cast<int>(
      (2 - (static_cast<long>(outer.size()) - 2 * polygrid.boundary_quads.rows() + polygrid.boundary_quads.rows())) /
      2);

  TriangleMesh boundary;
  boundary.vertices = polygrid.points;
  boundary.faces.resize(2 * polygrid.boundary_quads.rows(), 3);
  for (Eigen::Index q = 0; q < polygrid.boundary_quads.rows(); ++q) {
    const auto c = polygrid.boundary_quads.row(q);
    boundary.faces.row(2 * q) << c[0], c[1], c[2];
    boundary.faces.row(2 * q + 1) << c[0], c[2], c[3];
  }
  const TargetSurface outer_surface(boundary);
  const std::vector<TargetSurface::Sample> samples = target.samples(20000);
  std::vector<double> cover(samples.size());
  parallel_for(samples.size(),
               [&](std::size_t s) { cover[s] = outer_surface.nearest(samples[s].point).distance / polygrid.spacing; });
  std::sort(cover.begin(), cover.end());
  if (!cover.empty()) {
    quality.coverage_p99 = cover[static_cast<std::size_t>(0.99 * static_cast<double>(cover.size() - 1))];
    quality.coverage_max = cover.back();
  }

  std::vector<double> condition = polygrid.graph.weight_condition;
  std::sort(condition.begin(), condition.end());
  if (!condition.empty()) {
    quality.weight_condition_median = condition[condition.size() / 2];
    quality.weight_condition_max = condition.back();
  }
  for (const std::uint8_t method : polygrid.graph.weight_method) {
    quality.least_squares_weights += method == static_cast<std::uint8_t>(WeightMethod::least_squares);
    quality.singular_weights += method == static_cast<std::uint8_t>(WeightMethod::three_lines);
  }
  return quality;
}

AttributedMesh polygrid_view(const Polygrid& polygrid) {
  const Eigen::Index quads = polygrid.boundary_quads.rows();
  const Eigen::Index core_cells = polygrid.cells.rows() - quads;
  AttributedMesh view;
  std::vector<std::int32_t> local(polygrid.points.rows(), -1);
  std::vector<Eigen::Index> outer;
  for (Eigen::Index q = 0; q < quads; ++q)
    for (int k = 0; k < 4; ++k) {
      std::int32_t& index = local[polygrid.boundary_quads(q, k)];
      if (index < 0) index = static_cast<std::int32_t>(outer.size()), outer.push_back(polygrid.boundary_quads(q, k));
    }
  view.mesh.vertices.resize(static_cast<Eigen::Index>(outer.size()), 3);
  for (std::size_t v = 0; v < outer.size(); ++v) view.mesh.vertices.row(v) = polygrid.points.row(outer[v]);
  std::vector<float> quality(outer.size(), 1.0f);
  view.mesh.faces.resize(2 * quads, 3);
  for (Eigen::Index q = 0; q < quads; ++q) {
    const std::array<std::int32_t, 4> c = {local[polygrid.boundary_quads(q, 0)], local[polygrid.boundary_quads(q, 1)],
                                           local[polygrid.boundary_quads(q, 2)], local[polygrid.boundary_quads(q, 3)]};
    // The shorter diagonal.
    const double d02 = (view.mesh.vertices.row(c[0]) - view.mesh.vertices.row(c[2])).squaredNorm();
    const double d13 = (view.mesh.vertices.row(c[1]) - view.mesh.vertices.row(c[3])).squaredNorm();
    const int turn = d02 <= d13 ? 0 : 1;
    view.mesh.faces.row(2 * q) << c[turn], c[turn + 1], c[turn + 2];
    view.mesh.faces.row(2 * q + 1) << c[turn], c[turn + 2], c[(turn + 3) % 4];
    const double worst =
        std::min(scaled_jacobian(polygrid.points, lattice_cell(polygrid, core_cells + q)),
                 scaled_jacobian(polygrid.points, lattice_cell(polygrid, polygrid.graph.boundary_owner[q])));
    for (std::int32_t v : c) quality[v] = std::min(quality[v], static_cast<float>(worst));
  }
  std::vector<float> red(quality.size()), green(quality.size()), blue(quality.size());
  for (std::size_t v = 0; v < quality.size(); ++v) {
    const float t = std::clamp(quality[v], 0.0f, 1.0f);
    red[v] = 255 * std::min(1.0f, 2 - 2 * t);
    green[v] = 255 * std::min(1.0f, 2 * t);
    blue[v] = 40;
  }
  view.properties = {
      {"quality", std::move(quality)}, {"red", std::move(red)}, {"green", std::move(green)}, {"blue", std::move(blue)}};
  return view;
}

}  // namespace shellgrid
