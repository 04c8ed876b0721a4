// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/periodic_slab.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <queue>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/shell/voxel_boundary.h"

namespace shellgrid {
namespace {

constexpr int margin = 8;                // voxels about the tile that the surface is made of beside its own
constexpr double rounding = 1e-5;        // of places on the surface, voxels, and of weights of its corners
constexpr double beside_surface = 1e-3;  // voxels
constexpr int rays_per_voxel = 12;       // along x and y, to weigh voxels

Float4 lanes(const Vec3f& v) { return Float4{v.x(), v.y(), v.z(), 0}; }

void check(const BaseVolume& v) {
  const std::size_t n = v.voxel_count();
  if (n == 0 || v.extinction.size() != n || v.albedo.size() != n || v.anisotropy.size() != n || v.free.size() != n)
    throw InputError("base volume: its arrays do not have its size");
  if (!(v.voxel > 0) || !std::isfinite(v.voxel)) throw InputError("base volume: its voxels must have a size above 0");
  if (!(v.ior >= 1) || !std::isfinite(v.ior)) throw InputError("base volume: the refractive index must be at least 1");
  if (!v.surface_ior.empty() && v.surface_ior.size() != n)
    throw InputError("base volume: its arrays do not have its size");
  for (const float ior : v.surface_ior)
    if (ior != 0 && !(ior >= 1 && std::isfinite(ior)))
      throw InputError("base volume: the refractive indices of the surface must be at least 1");
  bool any = false;
  for (std::size_t k = 0; k < n; ++k) {
    if (v.free[k]) continue;
    any = true;
    for (int c = 0; c < 3; ++c)
      if (!(v.extinction[k][c] >= 0) || !std::isfinite(v.extinction[k][c]) || !(v.albedo[k][c] >= 0) ||
          !(v.albedo[k][c] <= 1) || !(std::abs(v.anisotropy[k][c]) < 1))
        throw InputError("base volume: a voxel holds coefficients that no matter has");
  }
  if (!any) throw InputError("base volume: all of it is free space");
}

// z = 0, facing upwards.
TriangleMesh plane(double width, double height) {
  TriangleMesh mesh;
  mesh.vertices.resize(4, 3);
  mesh.vertices << 0, 0, 0, width, 0, 0, width, height, 0, 0, height, 0;
  mesh.faces.resize(2, 3);
  mesh.faces << 0, 2, 1, 0, 3, 2;
  return mesh;
}

int wrapped(int i, int n) { return ((i % n) + n) % n; }

// Of each voxel the nearest one of those told, by steps to neighbours; −1 where there are none.
std::vector<std::int32_t> nearest_of(const BaseVolume& volume, const std::vector<char>& told) {
  const Vec3i& size = volume.size;
  std::vector<std::int32_t> from(told.size(), -1);
  std::queue<std::int32_t> front;
  for (std::size_t k = 0; k < told.size(); ++k)
    if (told[k]) {
      from[k] = static_cast<std::int32_t>(k);
      front.push(static_cast<std::int32_t>(k));
    }
  while (!front.empty()) {
    const std::int32_t k = front.front();
    front.pop();
    const int x = k % size.x(), y = k / size.x() % size.y(), z = k / (size.x() * size.y());
    for (int axis = 0; axis < 3; ++axis)
      for (int step = -1; step <= 1; step += 2) {
        Vec3i at(x, y, z);
        at[axis] += step;
        if (at.z() < 0 || at.z() >= size.z()) continue;
        const std::size_t other = volume.index(wrapped(at.x(), size.x()), wrapped(at.y(), size.y()), at.z());
        if (from[other] >= 0) continue;
        from[other] = from[k];
        front.push(static_cast<std::int32_t>(other));
      }
  }
  return from;
}

}  // namespace

PeriodicSlab::PeriodicSlab(const BaseVolume& volume) : size_(volume.size), voxel_(volume.voxel), ior_(volume.ior) {
  check(volume);
  width_[0] = size_.x() * voxel_;
  width_[1] = size_.y() * voxel_;
  depth_ = size_.z() * voxel_;
  const std::size_t n = volume.voxel_count();
  matter_.resize(n);
  // Free voxels take the matter of the nearest one that has some, by steps to neighbours: the surface cuts through
  // them.
  std::vector<char> has_matter(n);
  for (std::size_t k = 0; k < n; ++k) {
    has_matter[k] = volume.free[k] == 0;
    if (volume.free[k]) flat_ = false;
  }
  const std::vector<std::int32_t> from = nearest_of(volume, has_matter);
  for (std::size_t k = 0; k < n; ++k)
    matter_[k] = {lanes(volume.extinction[from[k]]), lanes(volume.albedo[from[k]]), lanes(volume.anisotropy[from[k]])};

  const std::size_t texels = static_cast<std::size_t>(size_.x()) * size_.y();
  for (std::size_t k = n - texels; k < n; ++k) bottom_free_.push_back(volume.free[k] != 0);
  spread_indices(volume);
  if (flat_) {
    share_.assign(n, 1.0f);
    sort_surface(plane(width_[0], width_[1]));
    leaps_ = SlabLeaps(size_, voxel_, matter_, std::vector<char>(n, 1));
    return;
  }
  std::vector<Vec3i> voxels;
  int lowest_free = 0;
  for (int x = -margin; x < size_.x() + margin; ++x)
    for (int y = -margin; y < size_.y() + margin; ++y)
      for (int z = 0; z < size_.z() + 3; ++z) {
        const int inside = std::min(z, size_.z() - 1);
        if (volume.free[volume.index(wrapped(x, size_.x()), wrapped(y, size_.y()), inside)]) {
          if (z < size_.z()) lowest_free = std::max(lowest_free, z + 1);
          continue;
        }
        voxels.emplace_back(x, y, z);
      }
  const GridFrame frame{Vec3::Constant(0.5 * voxel_), voxel_};
  boundary_ = voxel_boundary(frame, voxels);
  sort_surface(boundary_);
  surface_ = std::make_unique<TransportSurface>(boundary_, TriangleMesh());
  lowest_surface_ = (lowest_free + 1) * voxel_;
  top_ = -voxel_;
  weigh_voxels();
  // The surface is nowhere farther than a voxel from the free ones.
  std::vector<char> whole(n, 1);
  for (std::size_t k = 0; k < n; ++k) {
    const int z = static_cast<int>(k / texels), y = static_cast<int>(k / size_.x()) % size_.y(),
              x = static_cast<int>(k) % size_.x();
    for (int dz = -1; dz <= 1; ++dz)
      for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx)
          if (z + dz < 0 || volume.free[volume.index(wrapped(x + dx, size_.x()), wrapped(y + dy, size_.y()),
                                                     std::min(z + dz, size_.z() - 1))])
            whole[k] = 0;
  }
  leaps_ = SlabLeaps(size_, voxel_, matter_, whole);
}

void PeriodicSlab::sort_surface(const TriangleMesh& boundary) {
  std::vector<Facet> facets;
  std::vector<std::pair<std::uint32_t, std::uint32_t>> pairs;  // of voxels and facets
  for (int f = 0; f < boundary.face_count(); ++f) {
    const Vec3 a = boundary.corner(f, 0), b = boundary.corner(f, 1), c = boundary.corner(f, 2);
    const Vec3 area = (b - a).cross(c - a);
    if (!(area.norm() > 0)) continue;
    const Vec3 normal = area.normalized();
    const auto form = [&](const Vec3& along, const Vec3& zero) {
      return Facet::Form{along.x(), along.y(), along.z(), -along.dot(zero)};
    };
    const Vec3 of_b = (c - a).cross(normal) / area.norm(), of_c = normal.cross(b - a) / area.norm();
    facets.push_back({form(normal, a), {form(of_b, a), form(of_c, a)}});
    Vec3i first, last;
    for (int axis = 0; axis < 3; ++axis) {
      const double least = std::min({a[axis], b[axis], c[axis]}), most = std::max({a[axis], b[axis], c[axis]});
      first[axis] = std::max(0, static_cast<int>(std::floor(least / voxel_ - beside_surface)));
      last[axis] = std::min(size_[axis] - 1, static_cast<int>(std::floor(most / voxel_ + beside_surface)));
    }
    last.z() = std::max(last.z(), 0);
    for (int z = first.z(); z <= last.z(); ++z)
      for (int y = first.y(); y <= last.y(); ++y)
        for (int x = first.x(); x <= last.x(); ++x)
          pairs.emplace_back(static_cast<std::uint32_t>((z * size_.y() + y) * size_.x() + x),
                             static_cast<std::uint32_t>(facets.size() - 1));
  }
  std::sort(pairs.begin(), pairs.end());
  first_facet_.assign(matter_.size() + 1, 0);
  for (const auto& [voxel, facet] : pairs) {
    ++first_facet_[voxel + 1];
    facets_.push_back(facets[facet]);
  }
  for (std::size_t v = 0; v < matter_.size(); ++v) first_facet_[v + 1] += first_facet_[v];
}

bool PeriodicSlab::leave_within(std::size_t voxel_index, const Vec3& point, const Vec3& direction, double begin,
                                double limit, double& distance, Vec3& normal) const {
  const double first = begin - rounding * voxel_;
  double nearest = limit + rounding * voxel_;
  bool met = false;
  for (std::uint32_t k = first_facet_[voxel_index]; k < first_facet_[voxel_index + 1]; ++k) {
    const Facet& f = facets_[k];
    const double cosine = f.plane.along(direction), below = -f.plane.at(point);
    if (!(cosine > 0 && below >= first * cosine && below <= nearest * cosine)) continue;
    const double t = below / cosine;
    const Vec3 place = point + t * direction;
    const double b = f.weight[0].at(place), c = f.weight[1].at(place);
    if (!(b >= -rounding && c >= -rounding && b + c <= 1 + rounding)) continue;
    nearest = t;
    normal = Vec3(f.plane.x, f.plane.y, f.plane.z);
    met = true;
  }
  if (met) distance = std::max(0.0, nearest);
  return met;
}

void PeriodicSlab::spread_indices(const BaseVolume& volume) {
  std::vector<char> told(volume.surface_ior.size());
  bool several = false;
  for (std::size_t k = 0; k < told.size(); ++k) {
    told[k] = volume.surface_ior[k] > 0;
    several = several || (told[k] && std::abs(static_cast<double>(volume.surface_ior[k]) - ior_) > 1e-6);
  }
  if (!several) return;
  const std::vector<std::int32_t> from = nearest_of(volume, told);
  for (const std::int32_t k : from) iors_.push_back(volume.surface_ior[static_cast<std::size_t>(k)]);
}

double PeriodicSlab::ior(const Vec3& point, const Vec3& normal) const {
  if (iors_.empty()) return ior_;
  const Vec3 inside = (point - 0.5 * voxel_ * normal) / voxel_;
  const int x = wrapped(static_cast<int>(std::floor(inside.x())), size_.x());
  const int y = wrapped(static_cast<int>(std::floor(inside.y())), size_.y());
  const int z = std::clamp(static_cast<int>(std::floor(inside.z())), 0, size_.z() - 1);
  return static_cast<double>(iors_[(static_cast<std::size_t>(z) * size_.y() + y) * size_.x() + x]);
}

std::size_t PeriodicSlab::texel_at(const Vec3& point) const {
  const int x = std::clamp(static_cast<int>(point.x() / voxel_), 0, size_.x() - 1);
  const int y = std::clamp(static_cast<int>(point.y() / voxel_), 0, size_.y() - 1);
  return static_cast<std::size_t>(y) * size_.x() + x;
}

bool PeriodicSlab::is_matter_at_bottom(double x, double y) const { return !bottom_free_[texel_at(Vec3(x, y, 0))]; }

bool PeriodicSlab::meet_surface(const Vec3& point, const Vec3& direction, double limit, bool in_matter,
                                double& distance, Vec3& normal) const {
  if (flat_) {
    if (in_matter ? direction.z() >= 0 : direction.z() <= 0) return false;
    distance = std::max(0.0, -point.z() / direction.z());
    normal = Vec3(0, 0, -1);
    return distance <= limit;
  }
  // Deep in the matter no surface is near.
  if (in_matter) {
    const double end = point.z() + std::min(limit, 1e30) * direction.z();
    if (point.z() > lowest_surface_ && end > lowest_surface_) return false;
  }
  Crossing crossing;
  if (!surface_->next(point, direction, limit, {in_matter, false}, crossing)) return false;
  distance = crossing.distance;
  normal = crossing.normal;
  return true;
}

// By rays straight down: how long each is in the matter of each voxel that it meets.
void PeriodicSlab::weigh_voxels() {
  share_.assign(matter_.size(), 0.0f);
  const double step = voxel_ / rays_per_voxel, begin = top_ - voxel_;
  parallel_for(
      static_cast<std::size_t>(size_.x()) * size_.y(),
      [&](std::size_t column) {
        const int x = static_cast<int>(column) % size_.x(), y = static_cast<int>(column) / size_.x();
        std::vector<double> length(size_.z(), 0.0);
        for (int ray = 0; ray < rays_per_voxel * rays_per_voxel; ++ray) {
          Vec3 point(x * voxel_ + (ray % rays_per_voxel + 0.5) * step, y * voxel_ + (ray / rays_per_voxel + 0.5) * step,
                     begin);
          bool inside = false;
          while (point.z() < depth_) {
            double distance = 0;
            Vec3 normal;
            const double limit = depth_ - point.z();
            const bool met = meet_surface(point, Vec3(0, 0, 1), limit, inside, distance, normal);
            const double end = met ? point.z() + distance : depth_;
            if (inside)
              for (int z = std::max(0, static_cast<int>(point.z() / voxel_)); z < size_.z() && z * voxel_ < end; ++z)
                length[z] += std::max(0.0, std::min(end, (z + 1) * voxel_) - std::max(point.z(), z * voxel_));
            if (!met) break;
            point.z() = end;
            inside = !inside;
          }
        }
        for (int z = 0; z < size_.z(); ++z)
          share_[(static_cast<std::size_t>(z) * size_.y() + y) * size_.x() + x] =
              static_cast<float>(length[z] / (voxel_ * rays_per_voxel * rays_per_voxel));
      },
      64);
}

}  // namespace shellgrid
