// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/layered_diffusion.h"

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/distance/distance_field.h"
#include "solvers/diffusion/channel_lanes.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {

namespace {

constexpr int most_iterations = 1000;
constexpr int plane_steps = 16;
constexpr double least_reduced = 1e-6;  // mm⁻¹
constexpr float least_volume = 0.1f;    // of a cell
constexpr double smooth = 0.7;          // cosine between normals of one smooth surface

// Integrals of the layers' coefficients down to a depth.
class DepthIntegrals {
 public:
  explicit DepthIntegrals(const LayeredMatter& matter) : matter_(matter) {
    Coefficients sum;
    for (const ShellLayer& layer : matter.layers) {
      upper_.push_back(sum);
      sum = sum + coefficients(layer) * matter.layer_thickness;
    }
    upper_.push_back(sum);
  }
  // Means between two depths, mm.
  void means(double from, double to, Rgb& reduced, Rgb& absorption) const {
    const Coefficients a = at(from), b = at(to);
    reduced = ((b.reduced - a.reduced) / (to - from)).cast<float>();
    absorption = ((b.absorption - a.absorption) / (to - from)).cast<float>();
  }

 private:
  struct Coefficients {
    Eigen::Array3d reduced = Eigen::Array3d::Zero(), absorption = Eigen::Array3d::Zero();
    Coefficients operator+(const Coefficients& o) const { return {reduced + o.reduced, absorption + o.absorption}; }
    Coefficients operator*(double s) const { return {reduced * s, absorption * s}; }
  };
  static Coefficients coefficients(const ShellLayer& layer) {
    return {layer.reduced.cast<double>().max(least_reduced), layer.absorption.cast<double>().max(0)};
  }
  Coefficients at(double depth) const {
    const auto layer = static_cast<std::size_t>(
        std::clamp(depth / matter_.layer_thickness, 0.0, static_cast<double>(matter_.layers.size())));
    const double rest = depth - static_cast<double>(layer) * matter_.layer_thickness;
    return upper_[layer] + coefficients(layer < matter_.layers.size() ? matter_.layers[layer] : matter_.core) * rest;
  }
  const LayeredMatter& matter_;
  std::vector<Coefficients> upper_;
};

// What flows into a half-space of that matter through its plane, of φ_e = 1, as a grid along its axes has it. first: of
// the spacing, from the plane to the first cell's middle.
Rgb plane_flow(const DepthIntegrals& integrals, const LayeredMatter& matter, double spacing, double first) {
  const auto h = static_cast<float>(spacing);
  const auto layer = [&](int cell, Rgb& reduced, Rgb& absorption) {
    const double depth = (first + cell) * spacing;
    integrals.means(std::max(0.0, depth - spacing / 2), depth + spacing / 2, reduced, absorption);
  };
  Rgb reduced, absorption, below_reduced, below_absorption;
  const int cells =
      static_cast<int>(std::ceil(matter.layer_thickness * static_cast<double>(matter.layers.size()) / spacing)) + 1;
  layer(cells, below_reduced, below_absorption);
  // Flow into a cell for a fluence of 1 in its middle, from below upwards. In the core φ falls by the same ratio from
  // cell to cell.
  const Rgb half = 1.5f * h * h * below_absorption * below_reduced;
  const Rgb falls = 1 + half - (half * (2 + half)).sqrt();
  Rgb into = (1 - falls) / (3 * h * below_reduced) + below_absorption * h;
  for (int cell = cells - 1; cell >= 0; --cell) {
    layer(cell, reduced, absorption);
    const Rgb between = 1 / (1.5f * h * (reduced + below_reduced));
    const auto filled = static_cast<float>(cell == 0 ? 0.5 + first : 1);
    into = absorption * (h * filled) + between * into / (between + into);
    below_reduced = reduced;
  }
  const Rgb top = 1 / (static_cast<float>(2 * diffuse_fresnel(matter.ior).boundary_factor) +
                       3 * static_cast<float>(first) * h * reduced);
  return top * into / (top + into);
}

// What flows in over what such a grid has, by `first` in so many steps from 0 to 1.
std::vector<Rgb> plane_mendings(const DepthIntegrals& integrals, const LayeredMatter& matter, double spacing) {
  constexpr double fine = 32;
  const Rgb exact = plane_flow(integrals, matter, spacing / fine, 0.5);
  std::vector<Rgb> result;
  for (int step = 0; step <= plane_steps; ++step) {
    const Rgb flow = plane_flow(integrals, matter, spacing, static_cast<double>(step) / plane_steps);
    result.emplace_back((flow > 0).select(exact / flow.max(1e-30f), 1.0f));
  }
  return result;
}

}  // namespace

LayeredDiffusion::LayeredDiffusion(const TriangleMesh& mesh, const LayeredMatter& matter, double spacing)
    : spacing_(spacing) {
  if (matter.layers.empty() || !(matter.layer_thickness > 0) || !(spacing > 0))
    throw InputError("layered matter has layers, and a grid a spacing above 0");
  const Vec3 size = (mesh.vertices.colwise().maxCoeff() - mesh.vertices.colwise().minCoeff()).transpose();
  DistanceStatistics statistics;
  const DistanceField field = compute_distance_field(
      mesh, {spacing, size.minCoeff() / 2 + 2 * spacing, 2 * spacing, SignRule::closed}, statistics);
  const TwoLevelGrid<float>& distance = field.distance;
  constexpr int leaf_size = TwoLevelGrid<float>::leaf_size;
  // Points on the surface lie outside, all of them.
  const auto smallest = static_cast<float>(1e-4 * spacing);
  // Cells by leaves: first of each, then within it by offset.
  const auto leaves = static_cast<std::size_t>(distance.leaf_count());
  std::vector<std::int32_t> indices(leaves * leaf_size, -1);
  std::vector<Vec3i> places;
  std::vector<float> depths;
  for (std::size_t leaf = 0; leaf < leaves; ++leaf) {
    const Vec3i corner = 8 * distance.leaf_coordinate(static_cast<int>(leaf));
    const float* values = distance.leaf_values(static_cast<int>(leaf));
    for (int offset = 0; offset < leaf_size; ++offset) {
      if (!(values[offset] < -smallest)) continue;
      indices[leaf * leaf_size + offset] = static_cast<std::int32_t>(places.size());
      places.push_back(corner + Vec3i(offset >> 6, offset >> 3 & 7, offset & 7));
      depths.push_back(-values[offset]);
    }
  }
  const std::size_t n = places.size();
  const auto index_of = [&](const Vec3i& at) -> std::int32_t {
    const int leaf = distance.find_leaf(TwoLevelGrid<float>::leaf_of(at.x(), at.y(), at.z()));
    return leaf < 0 ? -1
                    : indices[static_cast<std::size_t>(leaf) * leaf_size +
                              TwoLevelGrid<float>::offset_of(at.x(), at.y(), at.z())];
  };
  const DepthIntegrals integrals(matter);
  std::vector<Lanes> reduced(n);
  absorption_.resize(n);
  diagonal_.assign(n, Lanes{});
  for (int axis = 0; axis < 3; ++axis) {
    conductances_[axis].assign(n, Lanes{});
    before_[axis].assign(n, -1);
    after_[axis].assign(n, -1);
  }
  const auto volume = static_cast<float>(spacing * spacing * spacing);
  parallel_for(n, [&](std::size_t i) {
    Rgb scattered, absorbed;
    const auto depth = static_cast<double>(depths[i]);
    integrals.means(std::max(0.0, depth - spacing / 2), depth + spacing / 2, scattered, absorbed);
    reduced[i] = to_lanes(scattered);
    absorption_[i] = to_lanes(absorbed * volume);
    for (int axis = 0; axis < 3; ++axis) {
      before_[axis][i] = index_of(places[i] - Vec3i::Unit(axis));
      after_[axis][i] = index_of(places[i] + Vec3i::Unit(axis));
    }
  });
  const float factor = static_cast<float>(diffuse_fresnel(matter.ior).boundary_factor);
  const auto h = static_cast<float>(spacing);
  std::vector<float> filled(n, 1.0f);
  const std::vector<Rgb> mendings = plane_mendings(integrals, matter, spacing);
  for (std::size_t i = 0; i < n; ++i)
    for (int axis = 0; axis < 3; ++axis) {
      if (const std::int32_t next = after_[axis][i]; next >= 0) {
        const Lanes between = h / (1.5f * (reduced[i] + reduced[next]) + Lanes{0, 0, 0, 1});
        conductances_[axis][i] = between;
        diagonal_[i] += between;
        diagonal_[next] += between;
      }
      for (int side = -1; side <= 1; side += 2) {
        if ((side < 0 ? before_ : after_)[axis][i] >= 0) continue;
        const Vec3i outside = places[i] + side * Vec3i::Unit(axis);
        const auto to_surface = [&](const Vec3i& at) -> Vec3 {
          return field.nearest_point.value(at.x(), at.y(), at.z()).cast<double>() - field.frame.to_world(at);
        };
        const std::int32_t vertex = field.nearest_vertex.value(outside.x(), outside.y(), outside.z());
        if (vertex < 0) continue;
        const Vec3 back = to_surface(outside), out = to_surface(places[i]);
        const double far = back.norm();
        // On the surface itself any normal will do that looks outwards: the axis. Where both points look at the same
        // smooth piece of surface the normal between them is its mean.
        Vec3 normal = far > static_cast<double>(smallest) ? Vec3(-back / far) : side * Vec3::Unit(axis);
        if (const Vec3 inner = out.normalized(); inner.dot(normal) > smooth) normal = (normal + inner).normalized();
        const double along = std::abs(normal[axis]);
        const double way = std::clamp(along * spacing - far, 0.0, spacing);  // from the cell's middle to the plane
        const double share = along > 0 ? std::clamp(way / (along * spacing), 0.0, 1.0) : 0.5;
        const float area = static_cast<float>(along) * h * h;
        Face face{static_cast<int>(i), vertex, area, {}, {}};
        const double step = share * plane_steps;
        const auto lower = static_cast<std::size_t>(std::min(static_cast<int>(step), plane_steps - 1));
        const float part = static_cast<float>(step) - static_cast<float>(lower);
        face.mending = to_lanes((1 - part) * mendings[lower] + part * mendings[lower + 1]);
        face.conductance = area / (2 * factor + 3 * static_cast<float>(way) * reduced[i] + Lanes{0, 0, 0, 1});
        diagonal_[i] += face.conductance;
        filled[i] += static_cast<float>((share - 0.5) * along * along);
        faces_.push_back(face);
      }
    }
  parallel_for(n, [&](std::size_t i) {
    absorption_[i] *= std::max(least_volume, filled[i]);
    diagonal_[i] += absorption_[i];
    diagonal_[i][3] = 1;
  });
}

LayeredDiffusion::Flow LayeredDiffusion::flow(const std::vector<int>& piece_of_vertex, const std::vector<Rgb>& about,
                                              double tolerance) const {
  const std::size_t n = absorption_.size();
  std::vector<Lanes> residual(n, Lanes{}), direction(n), image(n), fluence(n, Lanes{});
  for (const Face& face : faces_)
    residual[face.cell] += face.conductance * to_lanes(about[piece_of_vertex[face.vertex]]);
  const auto dot = [&](const std::vector<Lanes>& a, const std::vector<Lanes>& b) {
    return parallel_sum(n, Double4{}, [&](std::size_t i) { return to_double(a[i] * b[i]); });
  };
  const auto apply = [&](const std::vector<Lanes>& x, std::vector<Lanes>& y) {
    parallel_for(
        n,
        [&](std::size_t i) {
          Lanes sum = diagonal_[i] * x[i];
          for (int axis = 0; axis < 3; ++axis) {
            if (const std::int32_t next = after_[axis][i]; next >= 0) sum -= conductances_[axis][i] * x[next];
            if (const std::int32_t last = before_[axis][i]; last >= 0) sum -= conductances_[axis][last] * x[last];
          }
          y[i] = sum;
        },
        4096);
  };
  const auto preconditioned = [&](std::size_t i) { return residual[i] / diagonal_[i]; };
  const auto residual_square = [&] {
    return parallel_sum(n, Double4{}, [&](std::size_t i) { return to_double(residual[i] * preconditioned(i)); });
  };
  Double4 square = residual_square();
  const Double4 enough = square * (tolerance * tolerance);
  parallel_for(n, [&](std::size_t i) { direction[i] = preconditioned(i); });
  Flow flow;
  const auto done = [&] {
    for (int c = 0; c < 3; ++c)
      if (square[c] > enough[c]) return false;
    return true;
  };
  for (; !done() && flow.iterations < most_iterations; ++flow.iterations) {
    apply(direction, image);
    const Lanes step = to_float(safe_quotient(square, dot(direction, image)));
    parallel_for(
        n,
        [&](std::size_t i) {
          fluence[i] += step * direction[i];
          residual[i] -= step * image[i];
        },
        4096);
    const Double4 next = residual_square();
    const Lanes keep = to_float(safe_quotient(next, square));
    square = next;
    parallel_for(
        n, [&](std::size_t i) { direction[i] = preconditioned(i) + keep * direction[i]; }, 4096);
  }
  flow.inward.assign(about.size(), Rgb::Zero());
  flow.areas.assign(about.size(), 0.0f);
  for (const Face& face : faces_) {
    const int piece = piece_of_vertex[face.vertex];
    const Lanes in = face.mending * face.conductance * (to_lanes(about[piece]) - fluence[face.cell]);
    flow.inward[piece] += Rgb(in[0], in[1], in[2]);
    flow.areas[piece] += face.area;
  }
  for (std::size_t p = 0; p < about.size(); ++p)
    if (flow.areas[p] > 0) flow.inward[p] /= flow.areas[p];
  return flow;
}

}  // namespace shellgrid
