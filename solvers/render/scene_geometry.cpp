// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/scene_geometry.h"

#include <embree3/rtcore.h>
#include <fmt/format.h>
#include <new>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

// Embree computes in float: it gets the mesh centred and scaled to a box of longest edge one.
struct SceneGeometry::Impl {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  Vec3 centre = Vec3::Zero();
  double scale = 1;   // mm per unit of Embree's space
  TriangleMesh mesh;  // to refine hits in double precision

  ~Impl() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  RTCRay ray(const Vec3& origin, const Vec3& direction, double distance) const {
    const Vec3f o = ((origin - centre) / scale).cast<float>();
    const Vec3f d = direction.cast<float>();
    RTCRay r{};
    r.org_x = o.x(), r.org_y = o.y(), r.org_z = o.z();
    r.dir_x = d.x(), r.dir_y = d.y(), r.dir_z = d.z();
    r.tnear = static_cast<float>(relative_offset);
    r.tfar = static_cast<float>(distance / scale);
    r.mask = static_cast<unsigned>(-1);
    return r;
  }

  static constexpr double relative_offset = 2e-5;
};

SceneGeometry::SceneGeometry(const TriangleMesh& mesh) : impl_(std::make_unique<Impl>()) {
  if (mesh.face_count() == 0 || mesh.vertex_count() == 0) throw InputError("the surface has no faces");
  if (!mesh.vertices.allFinite()) throw InputError("the surface has coordinates that are not finite");
  const Vec3 lower = mesh.vertices.colwise().minCoeff().transpose();
  const Vec3 upper = mesh.vertices.colwise().maxCoeff().transpose();
  impl_->mesh = mesh;
  impl_->centre = 0.5 * (lower + upper);
  impl_->scale = (upper - lower).maxCoeff();
  if (!(impl_->scale > 0)) throw InputError("the surface is a single point");

  // Embree builds with denormal numbers flushed to zero. Where its build is the process's first parallel work, all
  // later work on TBB inherits that, and results depend on what ran before; so something else goes first.
  parallel_for(
      64, [](std::size_t) {}, 1);
  impl_->device = rtcNewDevice(nullptr);
  if (!impl_->device) {
    // Embree starts in any surroundings but those without memory for its threads.
    const RTCError error = rtcGetDeviceError(nullptr);
    if (error == RTC_ERROR_OUT_OF_MEMORY || error == RTC_ERROR_UNKNOWN) throw std::bad_alloc();
    throw InternalError(fmt::format("Embree gives no device: error {}", static_cast<int>(error)));
  }
  impl_->scene = rtcNewScene(impl_->device);
  rtcSetSceneFlags(impl_->scene, RTC_SCENE_FLAG_ROBUST);
  RTCGeometry geometry = rtcNewGeometry(impl_->device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                               3 * sizeof(float), mesh.vertex_count()));
  auto* faces = static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                               3 * sizeof(unsigned), mesh.face_count()));
  if (!vertices || !faces) throw InternalError("Embree gives no buffers");
  for (int v = 0; v < mesh.vertex_count(); ++v)
    for (int k = 0; k < 3; ++k)
      vertices[3 * v + k] = static_cast<float>((mesh.vertices(v, k) - impl_->centre[k]) / impl_->scale);
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) faces[3 * f + k] = static_cast<unsigned>(mesh.faces(f, k));
  rtcSetGeometryMask(geometry, static_cast<unsigned>(-1));
  rtcCommitGeometry(geometry);
  rtcAttachGeometry(impl_->scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(impl_->scene);
  if (rtcGetDeviceError(impl_->device) != RTC_ERROR_NONE) throw InternalError("Embree could not build its hierarchy");
}

SceneGeometry::~SceneGeometry() = default;
SceneGeometry::SceneGeometry(SceneGeometry&&) noexcept = default;
SceneGeometry& SceneGeometry::operator=(SceneGeometry&&) noexcept = default;

double SceneGeometry::offset() const { return Impl::relative_offset * impl_->scale; }

bool SceneGeometry::occluded(const Vec3& origin, const Vec3& direction, double distance) const {
  RTCRay ray = impl_->ray(origin, direction, distance);
  if (!(ray.tfar > ray.tnear)) return false;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcOccluded1(impl_->scene, &context, &ray);
  return ray.tfar < 0;
}

std::optional<SceneGeometry::Hit> SceneGeometry::intersect(const Vec3& origin, const Vec3& direction) const {
  RTCRayHit query{};
  query.ray = impl_->ray(origin, direction, std::numeric_limits<double>::infinity());
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.primID = RTC_INVALID_GEOMETRY_ID;
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  rtcIntersect1(impl_->scene, &context, &query);
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
