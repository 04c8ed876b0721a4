// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/polycube/transport_start.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <map>
#include <string>

#include "meshing/core/held_warnings.h"
#include "meshing/core/parallel.h"
#include "meshing/polycube/polycube_map.h"
#include "meshing/polycube/sample_raster.h"
#include "meshing/polycube/target_surface.h"
#include "meshing/surface/repair.h"

namespace shellgrid {
namespace {

constexpr double volume_samples = 3000;    // of the object, about
constexpr std::size_t most_groups = 1500;  // of cubes that are transported together
constexpr double least_blur = 0.25;        // of the transport, in edges of a group
constexpr int scalings = 20;               // for each blur
constexpr int smoothing_sweeps = 60;
constexpr double smoothness = 0.5;  // of the ways of neighbouring groups, against their own transport

using Places = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;

// Cubes of one window of the lattice, transported together.
struct Groups {
  int edge = 1;  // cubes
  std::vector<Vec3i> place;
  Places centre;
  Eigen::VectorXd mass;  // sums to 1
  std::vector<int> of_block;
};

Vec3i window_of(const Vec3i& block, int edge) {
  const auto down = [&](int x) { return x >= 0 ? x / edge : -((-x + edge - 1) / edge); };
  return {down(block.x()), down(block.y()), down(block.z())};
}

Groups group_blocks(const std::vector<Vec3i>& blocks) {
  Groups groups;
  for (;; ++groups.edge) {
    std::map<std::array<int, 3>, int> number;
    groups.place.clear();
    groups.of_block.clear();
    for (const Vec3i& block : blocks) {
      const Vec3i at = window_of(block, groups.edge);
      const auto [found, fresh] = number.try_emplace({at.z(), at.y(), at.x()}, static_cast<int>(groups.place.size()));
      if (fresh) groups.place.push_back(at);
      groups.of_block.push_back(found->second);
    }
    if (groups.place.size() <= most_groups) break;
  }
  const auto count = static_cast<Eigen::Index>(groups.place.size());
  groups.centre = Places::Zero(count, 3);
  groups.mass = Eigen::VectorXd::Zero(count);
  for (std::size_t b = 0; b < blocks.size(); ++b) {
    groups.centre.row(groups.of_block[b]) += (blocks[b].cast<double>() + Vec3::Constant(0.5)).transpose();
    groups.mass[groups.of_block[b]] += 1;
  }
  for (Eigen::Index g = 0; g < count; ++g) groups.centre.row(g) /= groups.mass[g];
  groups.mass /= static_cast<double>(blocks.size());
  return groups;
}

Places inner_samples(const TriangleMesh& surface) {
  const Vec3 low = surface.vertices.colwise().minCoeff().transpose();
  const Vec3 high = surface.vertices.colwise().maxCoeff().transpose();
  const double spacing = std::max(std::cbrt(enclosed_volume(surface) / volume_samples), (high - low).maxCoeff() / 256);
  // Off the round numbers that meshes like to lie on.
  const Vec3 lower = low - spacing * Vec3(0.5137, 0.5171, 0.5113);
  const Vec3i size = ((high - lower) / spacing).array().ceil().cast<int>() + 1;
  const SampleRaster raster = rasterize(surface, lower, spacing, size);
  std::vector<Vec3> inside;
  for (int i = 0; i < size.x(); ++i)
    for (int j = 0; j < size.y(); ++j)
      for (int k = 0; k < size.z(); ++k)
        if (raster.inside({i, j, k})) inside.push_back(raster.centre({i, j, k}));
  Places places(static_cast<Eigen::Index>(inside.size()), 3);
  for (std::size_t s = 0; s < inside.size(); ++s) places.row(static_cast<Eigen::Index>(s)) = inside[s].transpose();
  return places;
}

// The mean place to which each group's mass goes.
Places transported_centres(const Groups& groups, const Places& samples) {
  const Eigen::Index n = groups.centre.rows(), m = samples.rows();
  const double share = 1.0 / static_cast<double>(m);
  using Kernel = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Kernel kernel(n, m);
  Eigen::VectorXd from = Eigen::VectorXd::Zero(n), to = Eigen::VectorXd::Zero(m);  // potentials
  const double extent = (samples.colwise().maxCoeff() - samples.colwise().minCoeff()).maxCoeff();
  const double last = least_blur * groups.edge;
  for (double blur = std::max(last, 0.25 * extent);; blur = std::max(last, 0.6 * blur)) {
    const double scale = 1 / (2 * blur * blur);
    // Rows are scaled to their greatest entry, so that none vanishes.
    parallel_for(
        static_cast<std::size_t>(n),
        [&](std::size_t i) {
          kernel.row(i) =
              (to.transpose() - (samples.rowwise() - groups.centre.row(i)).rowwise().squaredNorm().transpose()) * scale;
          const double greatest = kernel.row(i).maxCoeff();
          from[i] = -greatest / scale;
          kernel.row(i) = (kernel.row(i).array() - greatest).exp();
        },
        16);
    Eigen::VectorXd u = Eigen::VectorXd::Ones(n), v = Eigen::VectorXd::Ones(m);
    for (int k = 0; k < scalings; ++k) {
      parallel_for(
          static_cast<std::size_t>(n),
          [&](std::size_t i) { u[i] = groups.mass[i] / std::max(1e-300, kernel.row(i).dot(v)); }, 16);
      // Columns in fixed chunks: the same sums at any number of threads.
      parallel_chunks(static_cast<std::size_t>(m), 256, [&](std::size_t begin, std::size_t end) {
        const auto first = static_cast<Eigen::Index>(begin), length = static_cast<Eigen::Index>(end - begin);
        Eigen::RowVectorXd sum = Eigen::RowVectorXd::Zero(length);
        for (Eigen::Index i = 0; i < n; ++i) sum += u[i] * kernel.row(i).segment(first, length);
        for (Eigen::Index s = 0; s < length; ++s) v[first + s] = share / std::max(1e-300, sum[s]);
      });
    }
    for (Eigen::Index s = 0; s < m; ++s) to[s] += std::log(v[s]) / scale;
    if (blur > last) continue;
    Places centres(n, 3);
    parallel_for(
        static_cast<std::size_t>(n),
        [&](std::size_t i) {
          const Eigen::RowVectorXd weight = kernel.row(i).cwiseProduct(v.transpose());
          centres.row(i) = weight * samples / std::max(1e-300, weight.sum());
        },
        16);
    return centres;
  }
}

// Distances between a grid's boundary and the surface that but one in a hundred exceeds, one way and the other, added.
double misfit(const LayeredGrid& grid, int cells_per_block, const TargetSurface& surface) {
  TriangleMesh boundary;
  boundary.vertices = grid.points / cells_per_block;
  boundary.faces.resize(2 * static_cast<Eigen::Index>(grid.layer.size()), 3);
  std::vector<std::int32_t> points;
  for (std::size_t q = 0; q < grid.layer.size(); ++q) {
    const LatticeHexahedron& cell = grid.layer[q];
    boundary.faces.row(2 * q) << cell[4], cell[5], cell[7];
    boundary.faces.row(2 * q + 1) << cell[4], cell[7], cell[6];
    points.insert(points.end(), cell.begin() + 4, cell.end());
  }
  const TargetSurface own(boundary);
  const std::vector<TargetSurface::Sample> samples = surface.samples(10000);
  std::vector<double> there(samples.size()), back(points.size());
  parallel_for(samples.size(), [&](std::size_t s) { there[s] = own.nearest(samples[s].point).distance; });
  parallel_for(points.size(), [&](std::size_t p) {
    back[p] = surface.nearest(boundary.vertices.row(points[p]).transpose()).distance;
  });
  double sum = 0;
  for (std::vector<double>* distances : {&there, &back}) {
    if (distances->empty()) continue;
    const auto rank =
        distances->begin() + static_cast<std::ptrdiff_t>(0.99 * static_cast<double>(distances->size() - 1));
    std::nth_element(distances->begin(), rank, distances->end());
    sum += *rank;
  }
  return sum;
}

}  // namespace

VertexMatrix transport_start(const std::vector<Vec3i>& blocks, const TriangleMesh& surface) {
  const LatticeGrid grid = refine_blocks(blocks, 1);
  const Groups groups = group_blocks(blocks);
  const Places samples = inner_samples(surface);
  if (samples.rows() == 0) return grid.points;
  const Places wanted = transported_centres(groups, samples) - groups.centre;
  // Ways that follow the transport and those of neighbours through faces.
  std::map<std::array<int, 3>, int> number;
  for (std::size_t g = 0; g < groups.place.size(); ++g)
    number[{groups.place[g].x(), groups.place[g].y(), groups.place[g].z()}] = static_cast<int>(g);
  Places way = wanted;
  for (int sweep = 0; sweep < smoothing_sweeps; ++sweep) {
    Places next = wanted;
    for (std::size_t g = 0; g < groups.place.size(); ++g) {
      double weight = 1;
      for (int side = 0; side < 6; ++side) {
        const Vec3i beside = groups.place[g] + (side & 1 ? 1 : -1) * Vec3i::Unit(side / 2);
        const auto found = number.find({beside.x(), beside.y(), beside.z()});
        if (found == number.end()) continue;
        next.row(g) += smoothness * way.row(found->second);
        weight += smoothness;
      }
      next.row(g) /= weight;
    }
    way = std::move(next);
  }
  // A corner takes the mean of the ways of the cubes around it.
  VertexMatrix sum = VertexMatrix::Zero(grid.points.rows(), 3);
  Eigen::VectorXd weight = Eigen::VectorXd::Zero(grid.points.rows());
  for (std::size_t c = 0; c < grid.cells.size(); ++c)
    for (const std::int32_t corner : grid.cells[c]) {
      sum.row(corner) += way.row(groups.of_block[c]);
      weight[corner] += 1;
    }
  VertexMatrix start = grid.points;
  for (Eigen::Index p = 0; p < start.rows(); ++p) start.row(p) += sum.row(p) / weight[p];
  return start;
}

LayeredGrid layer_rough_polycube(const std::vector<Vec3i>& blocks, int cells_per_block, const TargetSurface& surface,
                                 const PolycubeMapOptions& options, Progress& progress) {
  PolycubeMapOptions from_transport = options;
  from_transport.start = transport_start(blocks, surface.mesh());
  HeldWarnings warnings_of_lattice(progress), warnings_of_transport(progress);
  const auto attempt = [&](const PolycubeMapOptions& own, Progress& held) {
    return add_boundary_layer(map_polycube(blocks, cells_per_block, surface, own, held), surface, cells_per_block,
                              options.layer_thickness, held);
  };
  LayeredGrid of_lattice = attempt(options, warnings_of_lattice);
  LayeredGrid of_transport = attempt(from_transport, warnings_of_transport);
  const bool valid[2] = {inverted_cells(of_lattice).empty(), inverted_cells(of_transport).empty()};
  const bool transported = valid[0] != valid[1] ? valid[1]
                                                : misfit(of_transport, cells_per_block, surface) <
                                                      misfit(of_lattice, cells_per_block, surface);
  for (const std::string& warning : (transported ? warnings_of_transport : warnings_of_lattice).warnings)
    progress.warn(warning);
  return transported ? of_transport : of_lattice;
}

}  // namespace shellgrid
