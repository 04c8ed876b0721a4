// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/body_shape.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "meshing/core/parallel.h"
#include "meshing/surface/repair.h"
#include "solvers/scattering/fresnel.h"
#include "solvers/shell_texture/core_light.h"
#include "solvers/shell_texture/layered_diffusion.h"

namespace shellgrid {

namespace {

constexpr double cells_per_path = 3;  // of the diffuse mean free path, where so many cells are allowed
constexpr double coarsest = 0.75;     // of the diffuse mean free path: a coarser grid does not follow the light
constexpr double cells_per_thickness = 3;
constexpr double piece_of_thickness = 0.5, piece_of_cells = 2;
constexpr int views = 96;        // of a piece, to find what it sees of others
constexpr int most_returns = 3;  // of light that leaves and falls on the object again
constexpr float faint = 2e-3f;   // share of all light that is not followed further
constexpr float least_ratio = 0.25f, greatest_ratio = 4, dark = 1e-3f;  // the last of the mean

// What diffuse light does in a flat shell, and beside the half-space below it.
struct FlatShell {
  Rgb entering = Rgb::Zero(), through = Rgb::Zero(), rising = Rgb::Zero(), returned = Rgb::Zero(),
      half_space = Rgb::Zero();
  FlatShell(const LayeredMatter& matter) {
    for (int c = 0; c < 3; ++c) {
      const ShellColumn::Light light = ShellColumn(matter.layers, c, matter.layer_thickness, matter.ior).light(0);
      entering[c] = static_cast<float>(light.entering);
      through[c] = static_cast<float>(light.through);
      rising[c] = static_cast<float>(light.rising);
      returned[c] = static_cast<float>(std::clamp(1 - light.lost, 0.0, 1.0));
      const double slope = 2 * std::sqrt(static_cast<double>(matter.core.absorption[c] / (3 * matter.core.reduced[c])));
      half_space[c] = static_cast<float>(std::max(0.0, (1 - slope) / (1 + slope)));
    }
  }
};

// The shortest way that diffuse light goes, mm.
double diffuse_path(const LayeredMatter& matter) {
  double least = std::numeric_limits<double>::infinity();
  const auto look = [&](const ShellLayer& layer) {
    for (int c = 0; c < 3; ++c) {
      const double square = 3 * static_cast<double>(layer.absorption[c]) * static_cast<double>(layer.reduced[c]);
      if (square > 0) least = std::min(least, 1 / std::sqrt(square));
    }
  };
  for (const ShellLayer& layer : matter.layers) look(layer);
  look(matter.core);
  return least;
}

// What pieces of the surface see of each other: of all that a piece sees, by the cosine, the share of each.
class SeenPieces {
 public:
  SeenPieces(const TexturedFrames& frames, const SceneGeometry& geometry, const VertexBuckets& pieces)
      : seen_(static_cast<std::size_t>(pieces.count())) {
    std::vector<Vec3> spiral;
    for (int k = 0; k < views; ++k) {
      const double square = (k + 0.5) / views, turn = k * golden_angle, sine = std::sqrt(square);
      spiral.emplace_back(sine * std::cos(turn), sine * std::sin(turn), std::sqrt(1 - square));
    }
    parallel_for(
        seen_.size(),
        [&](std::size_t i) {
          const int vertex = vertex_in_middle(frames.mesh, pieces[static_cast<int>(i)].members);
          const Mat3 frame = frames.frame(vertex);
          const Vec3 origin = frames.mesh.vertex(vertex) + geometry.offset() * frame.row(2).transpose();
          for (const Vec3& direction : spiral) {
            const Vec3 towards = frame.transpose() * direction;
            const std::optional<SceneGeometry::Hit> hit = geometry.intersect(origin, towards);
            if (!hit || hit->normal.dot(towards) >= 0) continue;
            int corner = 0;
            hit->barycentric.maxCoeff(&corner);
            seen_[i].push_back(pieces.of_vertex(frames.mesh.faces(hit->face_index, corner)));
          }
        },
        16);
  }
  bool any() const {
    return std::any_of(seen_.begin(), seen_.end(), [](const std::vector<int>& one) { return !one.empty(); });
  }
  std::vector<Rgb> gathered(const std::vector<Rgb>& values) const {
    std::vector<Rgb> result(seen_.size(), Rgb::Zero());
    parallel_for(seen_.size(), [&](std::size_t i) {
      for (const int other : seen_[i]) result[i] += values[other] / views;
    });
    return result;
  }

 private:
  static constexpr double golden_angle = 2.399963229728653;
  std::vector<std::vector<int>> seen_;  // of each piece, once a view
};

// Diffuse light that brings in as much as the scene's, φ_e; and that of the light about, as the shell's kernels have
// it.
struct PieceLight {
  std::vector<Rgb> about, spread;
};
// band: of the kernels, or −1: none. Without kernels pictures know nothing of uneven light, and even light tells the
// shape alone.
PieceLight piece_light(const TexturedFrames& frames, const VertexBuckets& pieces, const SpreadLight& light,
                       const LightDirections& directions, double ior, int band) {
  const auto n = static_cast<std::size_t>(pieces.count());
  PieceLight result{std::vector<Rgb>(n, Rgb::Ones()), std::vector<Rgb>(n, Rgb::Ones())};
  if (band < 0) return result;
  parallel_for(
      n,
      [&](std::size_t i) {
        const int v = vertex_in_middle(frames.mesh, pieces[static_cast<int>(i)].members);
        Rgb through = Rgb::Zero(), whole = Rgb::Zero();
        for (const DirectionWeight& one : light.at(v)) {
          const double cosine = directions.direction(one.direction).z();
          const Rgb irradiance = one.weight.array() * static_cast<float>(cosine);
          whole += irradiance;
          through += irradiance * static_cast<float>(fresnel_transmittance(cosine, ior));
        }
        result.about[i] = through;
        const Rgb share = (whole > 0).select(through / whole.max(1e-30f), 1.0f);
        const SpreadLight::Bands bands = light.spread(v);
        result.spread[i] = bands.strength.empty() ? through : Rgb(bands.strength[band].array() * share);
      },
      16);
  return result;
}

// What leaves of light φ_e that falls on the pieces, in the same measure: φ_e − (2C + 2) J, J flowing in.
using Leaving = std::function<std::vector<Rgb>(const std::vector<Rgb>&)>;

// The same with light that falls on the object again. transmitted: share of diffuse light that the surface lets in.
std::vector<Rgb> with_returns(const Leaving& leaving, const std::vector<Rgb>& about, const SeenPieces* seen,
                              float transmitted) {
  std::vector<Rgb> sum = leaving(about), last = sum;
  const auto brightest = [](const std::vector<Rgb>& values) {
    Rgb most = Rgb::Zero();
    for (const Rgb& one : values) most = most.max(one);
    return most;
  };
  if (!seen || !seen->any()) return sum;
  for (int k = 0; k < most_returns; ++k) {
    std::vector<Rgb> falling = seen->gathered(last);
    for (Rgb& one : falling) one *= transmitted;
    if ((brightest(falling) <= faint * brightest(sum)).all()) break;
    last = leaving(falling);
    for (std::size_t i = 0; i < sum.size(); ++i) sum[i] += last[i];
  }
  return sum;
}

}  // namespace

BodyShape body_shape(const TexturedFrames& frames, const SceneGeometry& geometry, const ShellVolume& shell, double ior,
                     const SpreadLight& light, const LightDirections& directions, const FlatCore& core,
                     const BodyShapeOptions& options) {
  LayeredMatter matter;
  matter.layers = shell_layers(shell);
  matter.layer_thickness = shell.thickness / static_cast<double>(matter.layers.size());
  matter.core = {shell.core.extinction, shell.core.reduced_extinction(), shell.core.absorption()};
  matter.ior = ior;
  BodyShape shape;
  const double path = diffuse_path(matter), coarse = std::cbrt(enclosed_volume(frames.mesh) / options.most_cells);
  shape.spacing = std::max(coarse, std::min(shell.thickness / cells_per_thickness, path / cells_per_path));
  shape.whole = options.diffusion && shape.spacing <= coarsest * path;
  const double seen_depth =
      std::min(0.99 * shell.thickness, static_cast<double>((1 / matter.layers.front().reduced.max(1e-6f)).mean()));
  const int band = light.band_of(static_cast<int>(seen_depth / shell.frame.voxel));
  const bool returns = options.returns && band >= 0;
  if (!shape.whole && !returns) return shape;

  const VertexBuckets pieces(frames, vertex_areas(frames.mesh),
                             std::max(piece_of_thickness * shell.thickness, piece_of_cells * shape.spacing));
  const auto n = static_cast<std::size_t>(pieces.count());
  std::optional<SeenPieces> seen;
  if (returns) seen.emplace(frames, geometry, pieces);
  if (!shape.whole && !seen->any()) return shape;
  const PieceLight lit = piece_light(frames, pieces, light, directions, ior, band);
  const FlatShell flat(matter);
  const DiffuseFresnel fresnel = diffuse_fresnel(ior);
  const auto leaves = static_cast<float>(2 * fresnel.boundary_factor + 2),
             transmitted = static_cast<float>(fresnel.exit_normalization);
  const Rgb core_returns = flat.half_space / (1 - flat.half_space * flat.returned).max(1e-6f);

  std::vector<Rgb> together, apart(n);
  std::vector<char> known(n, 1);
  if (shape.whole) {
    CoreSurface below = bare_core(frames, shell.thickness, &pieces);
    for (std::size_t i = 0; i < n; ++i) {
      below.power[i] = below.areas[i] * flat.through * lit.spread[i];
      below.shell_reflection[i] = flat.returned;
    }
    const std::vector<Rgb> exitance = core.exitance(below);
    const Rgb dipole_returns = core.total / (1 - core.total * flat.returned).max(1e-6f);
    for (std::size_t i = 0; i < n; ++i) {
      const Rgb from_core = (dipole_returns > 0).select(exitance[i] * core_returns / dipole_returns.max(1e-30f), 0.0f);
      apart[i] = (lit.spread[i] * (1 - leaves * flat.entering) + leaves * flat.rising * from_core).max(0);
    }
    const LayeredDiffusion body(frames.mesh, matter, shape.spacing);
    shape.cells = body.cells();
    std::vector<int> piece_of_vertex(static_cast<std::size_t>(frames.mesh.vertex_count()));
    for (std::size_t v = 0; v < piece_of_vertex.size(); ++v) piece_of_vertex[v] = pieces.of_vertex(static_cast<int>(v));
    const Leaving leaving = [&](const std::vector<Rgb>& about) {
      const LayeredDiffusion::Flow flow = body.flow(piece_of_vertex, about);
      shape.iterations += flow.iterations;
      std::vector<Rgb> result(n);
      for (std::size_t i = 0; i < n; ++i) {
        known[i] = flow.areas[i] > 0;
        result[i] = (about[i] - leaves * flow.inward[i]).max(0);
      }
      return result;
    };
    together = with_returns(leaving, lit.about, seen ? &*seen : nullptr, transmitted);
  } else {
    // As a plane each returns its own.
    const Rgb plane = (1 - leaves * (flat.entering - flat.rising * flat.through * core_returns)).max(0).min(1);
    const Leaving leaving = [&](const std::vector<Rgb>& about) {
      std::vector<Rgb> result(n);
      for (std::size_t i = 0; i < n; ++i) result[i] = plane * about[i];
      return result;
    };
    apart = leaving(lit.spread);
    together = with_returns(leaving, lit.spread, &*seen, transmitted);
  }
  Rgb mean = Rgb::Zero();
  double area = 0;
  for (std::size_t i = 0; i < n; ++i) {
    mean += static_cast<float>(pieces[static_cast<int>(i)].area) * apart[i];
    area += pieces[static_cast<int>(i)].area;
  }
  mean = dark * mean / static_cast<float>(std::max(1e-30, area)) + 1e-30f;
  std::vector<Rgb> ratios(n, Rgb::Ones());
  for (std::size_t i = 0; i < n; ++i)
    if (known[i]) ratios[i] = ((together[i] + mean) / (apart[i] + mean)).max(least_ratio).min(greatest_ratio);
  shape.ratios = at_vertices(frames, pieces, ratios);
  return shape;
}

}  // namespace shellgrid
