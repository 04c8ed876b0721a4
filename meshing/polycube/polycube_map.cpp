// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/polycube_map.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/hexahedra_region.h"

namespace shellgrid {
namespace {

// Dense look-up of lattice points.
struct PointTable {
  Vec3i size;
  std::vector<std::int32_t> index;
  explicit PointTable(const Vec3i& counts)
      : size(counts), index(static_cast<std::size_t>(counts.x()) * counts.y() * counts.z(), -1) {}
  std::int32_t& at(const Vec3i& p) {
    return index[(static_cast<std::size_t>(p.z()) * size.y() + p.y()) * size.x() + p.x()];
  }
};

Vec3i extent_of(const std::vector<Vec3i>& blocks) {
  Vec3i extent = Vec3i::Zero();
  for (const Vec3i& b : blocks) extent = extent.cwiseMax(b + Vec3i::Ones());
  return extent;
}

Vec3i corner_offset(int k) { return {k & 1, k >> 1 & 1, k >> 2}; }

TriangleMesh triangulated_boundary(const LatticeGrid& grid) {
  TriangleMesh mesh;
  mesh.vertices = grid.points;
  mesh.faces.resize(2 * static_cast<Eigen::Index>(grid.boundary_quads.size()), 3);
  for (std::size_t q = 0; q < grid.boundary_quads.size(); ++q) {
    const auto& c = grid.boundary_quads[q].corners;
    mesh.faces.row(2 * q) << c[0], c[1], c[2];
    mesh.faces.row(2 * q + 1) << c[0], c[2], c[3];
  }
  return mesh;
}

// Relative to a cell's volume: what counts as inverted.
constexpr double least_core_jacobian = 1e-3;

struct Schedule {
  int steps, iterations;
  double first_weight, last_weight;
};

class Embedding {
 public:
  Embedding(LatticeGrid& grid, const TargetSurface& surface, double cells_per_unit, double depth)
      : grid_(grid),
        surface_(surface),
        scale_(cells_per_unit),
        depth_(depth),
        optimization_(grid.cells, grid.cell_lattice, std::vector<double>(grid.cells.size(), 1.0)) {
    std::vector<std::uint8_t> on_boundary(grid.points.rows(), 0);
    for (const auto& quad : grid.boundary_quads)
      for (std::int32_t v : quad.corners) on_boundary[v] = 1;
    for (std::size_t v = 0; v < on_boundary.size(); ++v)
      if (on_boundary[v]) boundary_.push_back(static_cast<std::int32_t>(v));
    samples_ = surface.samples(static_cast<int>(1.5 * static_cast<double>(boundary_.size())));
    optimization_.single_precision = true;
  }

  void set_folded_shares(const EnergyShares& shares) { optimization_.folded_shares = shares; }

  void run(const Schedule& schedule, bool barrier, Progress& progress) {
    for (int step = 0; step < schedule.steps; ++step) {
      const double part = schedule.steps > 1 ? static_cast<double>(step) / (schedule.steps - 1) : 1.0;
      const double weight = schedule.first_weight * std::pow(schedule.last_weight / schedule.first_weight, part);
      attract(weight);
      if (step + 2 < schedule.steps)
        pull(std::min(weight, 64.0));
      else
        optimization_.quad_attractions.clear();
      // A large ε first: valid from the start it converges slower and to worse cells.
      const bool last = step + 1 == schedule.steps;
      double epsilon = barrier ? 0 : std::max(0.3 * std::pow(0.6, step), 1e-3);
      if (last && least() > 0) epsilon = 0;
      optimization_.minimize(grid_.points, schedule.iterations, epsilon);
      progress.advance();
    }
  }

  // Around inverted cells alone: lowers ε with the least determinant ([Garanzha2021] eq. 9) while the surface's pull
  // fades and the neighbourhood grows, until no cell is inverted.
  bool untangle(int rounds, int iterations) {
    const CellsOfPoints around(grid_.cells, static_cast<std::size_t>(grid_.points.rows()));
    std::vector<std::int32_t> pull_of(grid_.points.rows(), -1);
    for (std::size_t i = 0; i < optimization_.plane_attractions.size(); ++i)
      pull_of[optimization_.plane_attractions[i].point] = static_cast<std::int32_t>(i);
    std::vector<double> cell_weight(grid_.cells.size(), 1);
    std::vector<std::uint8_t> inside(grid_.cells.size(), 0);
    for (int round = 0; round < rounds; ++round) {
      const std::vector<std::int32_t> bad = inverted();
      if (bad.empty()) return true;
      for (std::int32_t c : bad) cell_weight[c] = std::min(64.0, 2 * cell_weight[c]), inside[c] = 1;
      // Regions share no point.
      const std::vector<HexahedraRegion> regions = regions_around(grid_.cells, around, bad, 2 + round / 2);
      parallel_for(
          regions.size(),
          [&](std::size_t r) {
            const HexahedraRegion& region = regions[r];
            std::vector<Vec3i> lattice;
            std::vector<double> weights;
            std::vector<std::uint8_t> judged;
            for (std::int32_t c : region.cells) {
              lattice.push_back(grid_.cell_lattice[c]);
              weights.push_back(cell_weight[c]);
              judged.push_back(inside[c]);
            }
            HexahedraOptimization local(region.local, lattice, std::vector<double>(region.cells.size(), 1.0));
            local.locked = region.locked;
            local.cell_weight = std::move(weights);
            local.inside = std::move(judged);
            VertexMatrix points(region.points.size(), 3);
            for (std::size_t p = 0; p < region.points.size(); ++p) {
              points.row(p) = grid_.points.row(region.points[p]);
              const std::int32_t pull = pull_of[region.points[p]];
              if (pull < 0 || region.locked[p]) continue;
              local.plane_attractions.push_back(optimization_.plane_attractions[pull]);
              local.plane_attractions.back().point = static_cast<std::int32_t>(p);
              local.plane_attractions.back().weight *= std::pow(0.5, round);
            }
            for (int step = 0; step < 4; ++step) {
              const double lowest = local.least_corner_jacobian(points);
              const double reach = 0.5 * (std::sqrt(1e-12 + lowest * lowest) + lowest) + 0.01;
              const double epsilon =
                  lowest > least_core_jacobian ? 0 : 2 * std::sqrt(reach * std::max(reach - lowest, 0.0));
              local.minimize(points, iterations, epsilon);
              if (epsilon == 0) break;
            }
            for (std::size_t p = 0; p < region.points.size(); ++p) grid_.points.row(region.points[p]) = points.row(p);
          },
          1);
    }
    return inverted().empty();
  }

  std::vector<std::int32_t> inverted() const {
    std::vector<std::uint8_t> low(grid_.cells.size());
    parallel_for(low.size(), [&](std::size_t c) {
      low[c] = !(least_jacobian(grid_.points, grid_.cells[c], least_core_jacobian) > least_core_jacobian);
    });
    std::vector<std::int32_t> result;
    for (std::size_t c = 0; c < low.size(); ++c)
      if (low[c]) result.push_back(static_cast<std::int32_t>(c));
    return result;
  }

  double least() const { return optimization_.least_corner_jacobian(grid_.points); }

 private:
  void attract(double weight) {
    const VertexMatrix normals = boundary_normals(grid_);
    optimization_.plane_attractions.resize(boundary_.size());
    parallel_for(boundary_.size(), [&](std::size_t i) {
      const std::int32_t v = boundary_[i];
      const Vec3 facing = normals.row(v).transpose().stableNormalized();
      const TargetSurface::Nearest nearest =
          surface_.nearest_same_side(grid_.points.row(v).transpose() / scale_, facing, reach_ / scale_);
      PlaneAttraction& pull = optimization_.plane_attractions[i];
      pull.point = v;
      pull.normal = nearest.normal;
      pull.target = nearest.point * scale_ - depth_ * nearest.normal;
      pull.weight = weight;
    });
  }

  // Parts of the object that no boundary quadrilateral is near draw the nearest one to themselves.
  void pull(double weight) {
    optimization_.quad_attractions = pulls_to_uncovered(triangulated_boundary(grid_), samples_, scale_, depth_, weight);
  }

  LatticeGrid& grid_;
  const TargetSurface& surface_;
  double scale_, depth_;
  static constexpr double reach_ = 2;  // cells
  HexahedraOptimization optimization_;
  std::vector<std::int32_t> boundary_;
  std::vector<TargetSurface::Sample> samples_;
};

// Points of the finer grid from the coarser one's cells.
void prolongate(const LatticeGrid& coarse, const std::vector<Vec3i>& blocks, int from, int to, LatticeGrid& fine) {
  PointTable table(extent_of(blocks) * from + Vec3i::Ones());
  for (std::size_t p = 0; p < coarse.point_lattice.size(); ++p)
    table.at(coarse.point_lattice[p]) = static_cast<std::int32_t>(p);
  const double ratio = static_cast<double>(to) / from;
  std::vector<std::uint8_t> done(fine.points.rows(), 0);
  for (std::size_t c = 0; c < fine.cells.size(); ++c)
    for (int k = 0; k < 8; ++k) {
      const std::int32_t p = fine.cells[c][k];
      if (done[p]) continue;
      done[p] = 1;
      const Vec3i host = fine.cell_lattice[c] * from / to;
      const Vec3 local = fine.point_lattice[p].cast<double>() / ratio - host.cast<double>();
      Vec3 place = Vec3::Zero();
      for (int n = 0; n < 8; ++n) {
        double weight = 1;
        for (int axis = 0; axis < 3; ++axis) weight *= n >> axis & 1 ? local[axis] : 1 - local[axis];
        if (weight != 0) place += weight * coarse.points.row(table.at(host + corner_offset(n))).transpose();
      }
      fine.points.row(p) = (ratio * place).transpose();
    }
}

}  // namespace

LatticeGrid refine_blocks(const std::vector<Vec3i>& blocks, int refinement) {
  LatticeGrid grid;
  const Vec3i extent = extent_of(blocks) * refinement;
  PointTable cell_table(extent + Vec3i::Constant(2)), point_table(extent + Vec3i::Ones());
  for (const Vec3i& block : blocks)
    for (int k = 0; k < refinement; ++k)
      for (int j = 0; j < refinement; ++j)
        for (int i = 0; i < refinement; ++i) grid.cell_lattice.push_back(block * refinement + Vec3i(i, j, k));
  std::sort(grid.cell_lattice.begin(), grid.cell_lattice.end(), [](const Vec3i& a, const Vec3i& b) {
    return a.z() != b.z() ? a.z() < b.z() : a.y() != b.y() ? a.y() < b.y() : a.x() < b.x();
  });
  for (std::size_t c = 0; c < grid.cell_lattice.size(); ++c)
    cell_table.at(grid.cell_lattice[c] + Vec3i::Ones()) = static_cast<std::int32_t>(c);
  grid.cells.resize(grid.cell_lattice.size());
  for (std::size_t c = 0; c < grid.cells.size(); ++c)
    for (int k = 0; k < 8; ++k) {
      const Vec3i place = grid.cell_lattice[c] + corner_offset(k);
      std::int32_t& point = point_table.at(place);
      if (point < 0) {
        point = static_cast<std::int32_t>(grid.point_lattice.size());
        grid.point_lattice.push_back(place);
      }
      grid.cells[c][k] = point;
    }
  grid.points.resize(static_cast<Eigen::Index>(grid.point_lattice.size()), 3);
  for (std::size_t p = 0; p < grid.point_lattice.size(); ++p)
    grid.points.row(p) = grid.point_lattice[p].cast<double>().transpose();
  constexpr int side_corners[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                      {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
  for (std::size_t c = 0; c < grid.cells.size(); ++c)
    for (int side = 0; side < 6; ++side) {
      const Vec3i neighbour = grid.cell_lattice[c] + Vec3i::Ones() + (side & 1 ? 1 : -1) * Vec3i::Unit(side / 2);
      if (cell_table.at(neighbour) >= 0) continue;
      LatticeGrid::BoundaryQuad quad;
      for (int k = 0; k < 4; ++k) quad.corners[k] = grid.cells[c][side_corners[side][k]];
      quad.cell = static_cast<std::int32_t>(c);
      quad.side = side;
      grid.boundary_quads.push_back(quad);
    }
  return grid;
}

std::vector<QuadAttraction> pulls_to_uncovered(const TriangleMesh& boundary,
                                               const std::vector<TargetSurface::Sample>& samples, double scale,
                                               double depth, double weight) {
  const TargetSurface faces(boundary);
  std::vector<QuadAttraction> pulls(samples.size());
  parallel_for(samples.size(), [&](std::size_t i) {
    const Vec3 place = samples[i].point * scale - depth * samples[i].face_normal;
    const TargetSurface::Nearest nearest = faces.nearest_facing(place, samples[i].face_normal);
    if (nearest.distance <= 0.25 || nearest.face < 0) return;
    for (int k = 0; k < 3; ++k) {
      pulls[i].corners[k] = boundary.faces(nearest.face, k);
      pulls[i].beta[k] = nearest.barycentric[k];
    }
    pulls[i].corners[3] = pulls[i].corners[0];
    pulls[i].target = place;
    pulls[i].weight = weight;
  });
  std::erase_if(pulls, [](const QuadAttraction& pull) { return !(pull.weight > 0); });
  return pulls;
}

TriangleMesh polycube_surface(const VoxelPolycube& polycube) {
  const LatticeGrid grid = refine_blocks(polycube.blocks, 1);
  TriangleMesh surface = triangulated_boundary(grid);
  std::vector<std::int32_t> index(grid.points.rows(), -1);
  std::vector<Eigen::Index> used;
  for (Eigen::Index f = 0; f < surface.faces.rows(); ++f)
    for (int k = 0; k < 3; ++k) {
      std::int32_t& local = index[surface.faces(f, k)];
      if (local < 0) local = static_cast<std::int32_t>(used.size()), used.push_back(surface.faces(f, k));
      surface.faces(f, k) = local;
    }
  surface.vertices.resize(static_cast<Eigen::Index>(used.size()), 3);
  const double edge = polycube.spacing * polycube.cells_per_block;
  for (std::size_t v = 0; v < used.size(); ++v)
    surface.vertices.row(v) = polycube.origin.transpose() + edge * grid.points.row(used[v]);
  return surface;
}

VertexMatrix boundary_normals(const LatticeGrid& grid) {
  VertexMatrix normals = VertexMatrix::Zero(grid.points.rows(), 3);
  for (const auto& quad : grid.boundary_quads) {
    const auto& c = quad.corners;
    const Vec3 u = (grid.points.row(c[2]) - grid.points.row(c[0])).transpose();
    const Vec3 v = (grid.points.row(c[3]) - grid.points.row(c[1])).transpose();
    const Vec3 normal = u.cross(v);
    for (std::int32_t p : c) normals.row(p) += normal.transpose();
  }
  return normals;
}

std::vector<Vec3> visible_normals(const LatticeGrid& grid, const std::vector<std::int32_t>& points) {
  std::vector<std::int32_t> place(grid.points.rows(), -1);
  for (std::size_t i = 0; i < points.size(); ++i) place[points[i]] = static_cast<std::int32_t>(i);
  std::vector<std::vector<Vec3>> corners(points.size());
  for (const auto& quad : grid.boundary_quads)
    for (int k = 0; k < 4; ++k) {
      if (place[quad.corners[k]] < 0) continue;
      const Vec3 here = grid.points.row(quad.corners[k]).transpose();
      const Vec3 next = grid.points.row(quad.corners[(k + 1) % 4]).transpose();
      const Vec3 last = grid.points.row(quad.corners[(k + 3) % 4]).transpose();
      corners[place[quad.corners[k]]].push_back((next - here).cross(last - here).stableNormalized());
    }
  std::vector<Vec3> result(corners.size());
  parallel_for(corners.size(), [&](std::size_t i) {
    Vec3 direction = Vec3::Zero();
    for (const Vec3& n : corners[i]) direction += n;
    direction.stableNormalize();
    result[i] = direction;
    double best = -2;
    for (int round = 0; round < 100; ++round) {
      const Vec3* worst = &corners[i][0];
      for (const Vec3& n : corners[i])
        if (n.dot(direction) < worst->dot(direction)) worst = &n;
      if (worst->dot(direction) > best) best = worst->dot(direction), result[i] = direction;
      if (best > 0.5) break;
      direction = (direction + *worst / (2 + round)).stableNormalized();
    }
  });
  return result;
}

LatticeGrid map_polycube(const std::vector<Vec3i>& blocks, int cells_per_block, const TargetSurface& surface,
                         const PolycubeMapOptions& options, Progress& progress) {
  std::vector<int> levels = {cells_per_block};
  while (levels.back() % 2 == 0) levels.push_back(levels.back() / 2);
  if (levels.back() != 1) levels.push_back(1);
  std::reverse(levels.begin(), levels.end());
  progress.begin("polycube map", options.coarse_steps + (static_cast<long>(levels.size()) - 1) * options.fine_steps);
  LatticeGrid grid = refine_blocks(blocks, 1);
  const bool grid_starts_near = options.start.rows() == grid.points.rows();
  if (grid_starts_near) grid.points = options.start;
  for (std::size_t level = 0; level < levels.size(); ++level) {
    const int refinement = levels[level];
    if (level > 0) {
      LatticeGrid fine = refine_blocks(blocks, refinement);
      prolongate(grid, blocks, levels[level - 1], refinement, fine);
      grid = std::move(fine);
    }
    const double depth = options.layer_thickness * refinement / cells_per_block;
    Embedding embedding(grid, surface, refinement, depth);
    // Most folds are made on coarse levels.
    if (refinement == cells_per_block) embedding.set_folded_shares(angular_shares);
    const VertexMatrix before = refinement == cells_per_block ? grid.points : VertexMatrix();
    const auto run = [&] {
      if (level == 0)
        embedding.run({options.coarse_steps, options.coarse_iterations, grid_starts_near ? 16.0 : 1.0, 64}, false,
                      progress);
      else
        embedding.run({options.fine_steps, options.fine_iterations, 16, 64}, false, progress);
    };
    run();
    if (refinement != cells_per_block) continue;
    bool valid = embedding.untangle(20, options.fine_iterations);
    if (!valid) {
      grid.points = before;
      embedding.set_folded_shares(unfolding_shares);
      run();
      valid = embedding.untangle(20, options.fine_iterations);
    }
    if (!valid) {
      // The lattice itself is valid, and with ε = 0 it stays so.
      progress.warn(
          "the grid could not be untangled; it starts again from the lattice and keeps farther from the surface");
      grid = refine_blocks(blocks, refinement);
      Embedding safe(grid, surface, refinement, depth);
      safe.run({options.fine_steps, options.fine_iterations, 1, 16}, true, progress);
    }
  }
  progress.end();
  return grid;
}

}  // namespace shellgrid
