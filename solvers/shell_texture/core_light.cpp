// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/core_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"

namespace shellgrid {

namespace {

// Of the thickness: from this distance to the surface on there is a core, and from this one on all of it.
constexpr double ended = 0.7, gone_whole = 0.9;
constexpr int thin_places = 16;  // looked at between two sides
constexpr double least_share =
    0.2;  // of the shell's light, that diffusion must send down for a scale to mean something

}  // namespace

std::vector<float> core_areas(const TexturedFrames& frames, double thickness) {
  const TriangleMesh& mesh = frames.mesh;
  const auto below = [&](int v) -> Vec3 { return mesh.vertex(v) - thickness * frames.normals.row(v).transpose(); };
  std::vector<float> areas(static_cast<std::size_t>(mesh.vertex_count()), 0.0f);
  const auto area = [](const Vec3& a, const Vec3& b, const Vec3& c) -> Vec3 { return (b - a).cross(c - a) / 2; };
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 above = area(mesh.corner(f, 0), mesh.corner(f, 1), mesh.corner(f, 2));
    const auto point = [&](int k) { return below(mesh.faces(f, k)); };
    const double size = above.norm(), under = size > 0 ? area(point(0), point(1), point(2)).dot(above) / size : 0;
    for (int k = 0; k < 3; ++k) areas[mesh.faces(f, k)] += static_cast<float>(std::max(0.0, under) / 3);
  }
  return areas;
}

CoreSurface bare_core(const TexturedFrames& frames, double thickness, const VertexBuckets* pieces) {
  const TriangleMesh& mesh = frames.mesh;
  if (!(thickness >= 0)) throw InputError("a shell's thickness is not negative");
  const auto below = [&](int v) -> Vec3 { return mesh.vertex(v) - thickness * frames.normals.row(v).transpose(); };
  const std::vector<float> areas = core_areas(frames, thickness);
  const std::size_t n = pieces ? static_cast<std::size_t>(pieces->count()) : areas.size();
  CoreSurface surface;
  surface.points.resize(n);
  surface.areas.assign(n, 0.0f);
  surface.power.assign(n, Rgb::Zero());
  surface.shell_reflection.assign(n, Rgb::Zero());
  surface.presence.assign(n, 1.0f);
  const ClosestPointQuery query(mesh);
  parallel_for(
      n,
      [&](std::size_t i) {
        const int own = static_cast<int>(i);
        const std::vector<int>& members = pieces ? (*pieces)[own].members : std::vector<int>{own};
        Vec3 point = Vec3::Zero(), plain = Vec3::Zero();
        double whole = 0;
        for (const int v : members) {
          const auto size = static_cast<double>(areas[v]);
          point += size * below(v);
          plain += below(v);
          whole += size;
        }
        const auto count = static_cast<double>(members.size());
        point = whole > 0 && count > 1 ? Vec3(point / whole) : Vec3(plain / count);
        surface.points[i] = point.cast<float>();
        // Where the shell is thicker than half the object, or than its radius of curvature, points come out near the
        // surface again: there is no core.
        float there = 1;
        if (thickness > 0) {
          const double depth = (query.nearest(point, thickness).point - point).norm() / thickness;
          there = static_cast<float>(std::clamp((depth - ended) / (gone_whole - ended), 0.0, 1.0));
        }
        surface.presence[i] = there;
        surface.areas[i] = static_cast<float>(whole) * there;
      },
      64);
  return surface;
}

CoreSurface core_surface(const TexturedFrames& frames, const SpreadLight& light, const ShellTextureLookup& texture,
                         const std::vector<Vec2f>& coordinates, double thickness, const VertexBuckets* pieces,
                         const ShellCurvature* curvature) {
  const TriangleMesh& mesh = frames.mesh;
  if (coordinates.size() != static_cast<std::size_t>(mesh.vertex_count()))
    throw InputError("the surface's texture coordinates do not have its size");
  CoreSurface surface = bare_core(frames, thickness, pieces);
  const std::vector<float> areas = core_areas(frames, thickness);
  parallel_for(
      surface.points.size(),
      [&](std::size_t i) {
        const int own = static_cast<int>(i);
        const std::vector<int>& members = pieces ? (*pieces)[own].members : std::vector<int>{own};
        const PreparedLight prepared = texture.prepare(light.at_bottom(vertex_in_middle(mesh, members)));
        Rgb reflection = Rgb::Zero();
        for (const int v : members) {
          const Vec2f& at = coordinates[v];
          Rgb down = texture.below(at.x(), at.y(), prepared).array().max(0);
          Rgb back = texture.below_of_back_light(at.x(), at.y()).array().max(0);
          if (curvature) {
            down *= curvature->below(v);
            back = (1 - (1 - back) * curvature->loss(v)).max(0);
          }
          surface.power[i] += surface.presence[i] * areas[v] * down;
          reflection += back.min(1);
        }
        surface.shell_reflection[i] = reflection / static_cast<float>(members.size());
      },
      64);
  return surface;
}

namespace {

// Means of pieces about one, at points within it.
class PieceMean {
 public:
  PieceMean(const VertexBuckets& pieces, const std::vector<Rgb>& values, int own)
      : pieces_(pieces), values_(values), own_(own), radius_(1.5 * pieces.edge()) {
    const VertexBuckets::Bucket& bucket = pieces[own];
    pieces.visit_about(bucket.middle, 3, [&](int other) {
      if (pieces[other].facing.dot(bucket.facing) > 0 &&
          (pieces[other].middle - bucket.middle).norm() < radius_ + bucket.radius)
        about_.push_back(other);
    });
  }
  Rgb at(const Vec3& point) const {
    Rgb sum = Rgb::Zero();
    double weights = 0;
    for (const int other : about_) {
      const double far = (pieces_[other].middle - point).squaredNorm() / (radius_ * radius_);
      if (far >= 1) continue;
      const double weight = pieces_[other].area * (1 - far) * (1 - far);
      sum += static_cast<float>(weight) * values_[other];
      weights += weight;
    }
    return weights > 0 ? Rgb(sum / static_cast<float>(weights)) : values_[own_];
  }

 private:
  const VertexBuckets& pieces_;
  const std::vector<Rgb>& values_;
  int own_;
  double radius_;
  std::vector<int> about_;
};

}  // namespace

std::vector<Rgb> at_vertices(const TexturedFrames& frames, const VertexBuckets& pieces,
                             const std::vector<Rgb>& values) {
  std::vector<Rgb> result(static_cast<std::size_t>(frames.mesh.vertex_count()));
  parallel_for(
      values.size(),
      [&](std::size_t i) {
        const PieceMean mean(pieces, values, static_cast<int>(i));
        for (const int v : pieces[static_cast<int>(i)].members) result[v] = mean.at(frames.mesh.vertex(v));
      },
      64);
  return result;
}

std::vector<Rgb> at_pieces(const VertexBuckets& pieces, const VertexBuckets& finer, const std::vector<Rgb>& values) {
  std::vector<Rgb> result(static_cast<std::size_t>(finer.count()));
  parallel_for(
      result.size(),
      [&](std::size_t i) {
        const VertexBuckets::Bucket& bucket = finer[static_cast<int>(i)];
        result[i] = PieceMean(pieces, values, pieces.of_vertex(bucket.members.front())).at(bucket.middle);
      },
      64);
  return result;
}

CoreSurface merged(const CoreSurface& surface, const VertexBuckets& pieces, const VertexBuckets& larger) {
  const auto n = static_cast<std::size_t>(larger.count());
  CoreSurface result;
  result.points.assign(n, Vec3f::Zero());
  result.areas.assign(n, 0.0f);
  result.power.assign(n, Rgb::Zero());
  if (!surface.shell_reflection.empty()) result.shell_reflection.assign(n, Rgb::Zero());
  std::vector<float> weights(n, 0.0f);
  for (std::size_t i = 0; i < surface.points.size(); ++i) {
    const VertexBuckets::Bucket& piece = pieces[static_cast<int>(i)];
    const int to = larger.of_vertex(piece.members.front());
    const float weight = surface.areas[i] + 1e-6f * static_cast<float>(piece.area);
    weights[to] += weight;
    result.points[to] += weight * surface.points[i];
    result.areas[to] += surface.areas[i];
    result.power[to] += surface.power[i];
    if (!surface.shell_reflection.empty()) result.shell_reflection[to] += weight * surface.shell_reflection[i];
  }
  // A larger piece may have lost all of its smaller ones to its neighbours.
  for (std::size_t i = 0; i < n; ++i) {
    if (weights[i] > 0) {
      result.points[i] /= weights[i];
      if (!surface.shell_reflection.empty())
        result.shell_reflection[i] = (result.shell_reflection[i] / weights[i]).min(1);
    } else {
      result.points[i] = larger[static_cast<int>(i)].middle.cast<float>();
    }
  }
  return result;
}

CoreDiffusion core_from_fluence(const TexturedFrames& frames, const CoreSurface& surface, double thickness,
                                const FluenceField& fluence, const Rgb& diffusion_coefficient) {
  const std::size_t n = surface.points.size();
  if (static_cast<std::size_t>(frames.mesh.vertex_count()) != n || surface.power.size() != n ||
      surface.areas.size() != n || surface.shell_reflection.size() != n)
    throw InputError("the core's surface does not have the mesh's size");
  const ClosestPointQuery query(frames.mesh);
  CoreDiffusion core;
  core.exitance.resize(n);
  core.irradiance.resize(n);
  parallel_for(
      n,
      [&](std::size_t i) {
        const int v = static_cast<int>(i);
        const Vec3 normal = frames.normals.row(v).transpose(), above = frames.mesh.vertex(v);
        Vec3 point = surface.points[i].cast<double>();
        if (!surface.presence.empty() && surface.presence[i] < 1) {
          // The place on the way down that is farthest from the surface.
          double deepest = 0;
          for (int k = 1; k <= thin_places; ++k) {
            const Vec3 place = above - thickness * k / thin_places * normal;
            const double depth = std::sqrt(query.nearest(place, thickness).squared_distance);
            if (std::isfinite(depth) && depth > deepest) {
              deepest = depth;
              point = place;
            }
          }
        }
        const FluenceField::Value value = fluence.at(point);
        for (int c = 0; c < 3; ++c) {
          const auto phi = static_cast<double>(value.fluence[c]);
          const double current = static_cast<double>(diffusion_coefficient[c]) / 2 * value.gradient.row(c).dot(normal);
          core.exitance[i][c] = static_cast<float>(std::max(0.0, phi / 4 - current));
          core.irradiance[i][c] = static_cast<float>(std::max(0.0, phi / 4 + current));
        }
      },
      64);
  for (int c = 0; c < 3; ++c) {
    double down = 0, diffuse = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const auto area = static_cast<double>(surface.areas[i]);
      down += static_cast<double>(surface.power[i][c]);
      diffuse +=
          area * static_cast<double>(core.irradiance[i][c] - surface.shell_reflection[i][c] * core.exitance[i][c]);
    }
    if (down > 0 && diffuse > least_share * down) core.scale[c] = down / diffuse;
    for (std::size_t i = 0; i < n; ++i) {
      core.exitance[i][c] *= static_cast<float>(core.scale[c]);
      core.irradiance[i][c] *= static_cast<float>(core.scale[c]);
    }
  }
  return core;
}

void spread_over_edges(const CoreSurface& surface, double reach, std::vector<Rgb>& exitance) {
  std::vector<int> present;
  for (std::size_t i = 0; i < surface.presence.size(); ++i)
    if (surface.presence[i] >= 1) present.push_back(static_cast<int>(i));
  if (present.empty() || present.size() == surface.presence.size()) return;
  VertexMatrix points(static_cast<Eigen::Index>(present.size()), 3);
  for (std::size_t k = 0; k < present.size(); ++k)
    points.row(static_cast<Eigen::Index>(k)) = surface.points[present[k]].cast<double>().transpose();
  const NearestVertexQuery query(points);
  const std::vector<Rgb> before = exitance;
  parallel_for(
      surface.presence.size(),
      [&](std::size_t i) {
        if (surface.presence[i] >= 1) return;
        const Vec3 point = surface.points[i].cast<double>();
        const int nearest = present[query.nearest(point)];
        const double distance = (surface.points[nearest].cast<double>() - point).norm();
        if (distance > reach) return;
        exitance[i] = surface.presence[i] * before[i] + (1 - surface.presence[i]) * before[nearest];
      },
      64);
}

}  // namespace shellgrid
