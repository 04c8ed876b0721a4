// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/scene_geometry.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "solvers/render/embree_scene.h"

namespace shellgrid {

struct SceneGeometry::Impl {
  explicit Impl(const TriangleMesh& surface) : embree(surface), mesh(surface) {
    embree.attach(mesh, 0);
    embree.commit();
  }

  EmbreeScene embree;
  TriangleMesh mesh;  // to refine hits in double precision

  RTCRay ray(const Vec3& origin, const Vec3& direction, double distance) const {
    const Vec3f o = ((origin - embree.centre()) / embree.scale()).cast<float>();
    const Vec3f d = direction.cast<float>();
    RTCRay r{};
    r.org_x = o.x(), r.org_y = o.y(), r.org_z = o.z();
    r.dir_x = d.x(), r.dir_y = d.y(), r.dir_z = d.z();
    r.tnear = static_cast<float>(relative_offset);
    r.tfar = static_cast<float>(distance / embree.scale());
    r.mask = static_cast<unsigned>(-1);
    return r;
  }

  static constexpr double relative_offset = 2e-5;
};

SceneGeometry::SceneGeometry(const TriangleMesh& mesh) : impl_(std::make_unique<Impl>(mesh)) {}
SceneGeometry::~SceneGeometry() = default;
SceneGeometry::SceneGeometry(SceneGeometry&&) noexcept = default;
SceneGeometry& SceneGeometry::operator=(SceneGeometry&&) noexcept = default;

double SceneGeometry::offset() const { return Impl::relative_offset * impl_->embree.scale(); }

bool SceneGeometry::occluded(const Vec3& origin, const Vec3& direction, double distance) const {
  RTCRay ray = impl_->ray(origin, direction, distance);
  if (!(ray.tfar > ray.tnear)) return false;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(impl_->embree.scene(), &context, &ray);
  return ray.tfar < 0;
}

std::uint32_t SceneGeometry::occluded(const Vec3& origin, const Vec3* directions, const double* distances,
                                      int count) const {
  if (count == 1) return occluded(origin, directions[0], distances[0]) ? 1 : 0;
  alignas(32) RTCRay8 rays{};
  alignas(32) int valid[most_rays] = {};
  std::uint32_t sought = 0;
  for (int i = 0; i < count; ++i) {
    const RTCRay ray = impl_->ray(origin, directions[i], distances[i]);
    rays.org_x[i] = ray.org_x, rays.org_y[i] = ray.org_y, rays.org_z[i] = ray.org_z;
    rays.dir_x[i] = ray.dir_x, rays.dir_y[i] = ray.dir_y, rays.dir_z[i] = ray.dir_z;
    rays.tnear[i] = ray.tnear, rays.tfar[i] = ray.tfar, rays.mask[i] = ray.mask;
    if (ray.tfar > ray.tnear) valid[i] = -1, sought |= 1u << i;
  }
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcOccluded8(valid, impl_->embree.scene(), &context, &rays);
  std::uint32_t hidden = 0;
  for (int i = 0; i < count; ++i)
    if (rays.tfar[i] < 0) hidden |= 1u << i;
  return hidden & sought;
}

std::optional<SceneGeometry::Hit> SceneGeometry::intersect(const Vec3& origin, const Vec3& direction) const {
  RTCRayHit query{};
  query.ray = impl_->ray(origin, direction, std::numeric_limits<double>::infinity());
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.primID = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(impl_->embree.scene(), &context, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return std::nullopt;

  Hit hit;
  hit.face_index = static_cast<int>(query.hit.primID);
  const double u = std::clamp(static_cast<double>(query.hit.u), 0.0, 1.0);
  const double v = std::clamp(static_cast<double>(query.hit.v), 0.0, 1.0 - u);
  hit.barycentric = Vec3(1 - u - v, u, v);
  const Vec3 a = impl_->mesh.corner(hit.face_index, 0), b = impl_->mesh.corner(hit.face_index, 1),
             c = impl_->mesh.corner(hit.face_index, 2);
  hit.point = hit.barycentric[0] * a + hit.barycentric[1] * b + hit.barycentric[2] * c;
  hit.distance = (hit.point - origin).dot(direction);
  const Vec3 area = (b - a).cross(c - a);
  const double length = area.norm();
  hit.normal = length > 0 ? Vec3(area / length) : Vec3(-direction);
  return hit;
}

bool SceneGeometry::contains(const Vec3& point) const {
  int inside = 0;
  constexpr int directions = 7;
  for (int i = 0; i < directions; ++i) {
    // Spherical Fibonacci directions.
    const double z = 1 - (2 * i + 1.0) / directions, angle = 2.399963229728653 * i + 0.7, r = std::sqrt(1 - z * z);
    const Vec3 direction(r * std::cos(angle), r * std::sin(angle), z);
    const std::optional<Hit> hit = intersect(point, direction);
    if (hit && hit->normal.dot(direction) > 0) ++inside;
  }
  return 2 * inside > directions;
}

}  // namespace shellgrid
