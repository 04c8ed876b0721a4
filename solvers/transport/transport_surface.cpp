// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/transport_surface.h"

#include <embree3/rtcore.h>
#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <new>
#include <vector>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {
namespace {

constexpr double relative_tolerance = 3e-7;

struct Facet {
  Vec3 a, ab, ac, normal;  // unit, or zero where the face has no area
};

struct Shape {
  std::vector<Facet> facets;
};

// What a query tells the filter.
struct Context {
  RTCIntersectContext base;
  float direction[3];
  bool inside[2];
};

// Keeps hits on faces that the light may cross in its direction.
void keep_crossings(const RTCFilterFunctionNArguments* arguments) {
  const auto* context = reinterpret_cast<const Context*>(arguments->context);
  const unsigned geometry = RTCHitN_geomID(arguments->hit, arguments->N, 0);
  // Counter-clockwise faces have Embree's normal on their outside.
  const float cosine = context->direction[0] * RTCHitN_Ng_x(arguments->hit, arguments->N, 0) +
                       context->direction[1] * RTCHitN_Ng_y(arguments->hit, arguments->N, 0) +
                       context->direction[2] * RTCHitN_Ng_z(arguments->hit, arguments->N, 0);
  if (!(context->inside[geometry] ? cosine > 0 : cosine < 0)) arguments->valid[0] = 0;
}

}  // namespace

// Embree computes in float: it gets the meshes centred and scaled to a box of longest edge one.
struct TransportSurface::Impl {
  RTCDevice device = nullptr;
  RTCScene scene = nullptr;
  Vec3 centre = Vec3::Zero();
  double scale = 1;  // mm per unit of Embree's space
  double radius = 0;
  Shape shapes[2];

  ~Impl() {
    if (scene) rtcReleaseScene(scene);
    if (device) rtcReleaseDevice(device);
  }
  Impl() = default;
  Impl(const Impl&) = delete;
  Impl& operator=(const Impl&) = delete;

  void attach(const TriangleMesh& mesh, unsigned id) {
    Shape& shape = shapes[id];
    RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
    auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                                 3 * sizeof(float), mesh.vertex_count()));
    auto* faces = static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                                 3 * sizeof(unsigned), mesh.face_count()));
    if (!vertices || !faces) throw std::bad_alloc();
    for (int v = 0; v < mesh.vertex_count(); ++v)
      for (int k = 0; k < 3; ++k) vertices[3 * v + k] = static_cast<float>((mesh.vertices(v, k) - centre[k]) / scale);
    shape.facets.reserve(static_cast<std::size_t>(mesh.face_count()));
    for (int f = 0; f < mesh.face_count(); ++f) {
      for (int k = 0; k < 3; ++k) faces[3 * f + k] = static_cast<unsigned>(mesh.faces(f, k));
      const Vec3 a = mesh.corner(f, 0), ab = mesh.corner(f, 1) - a, ac = mesh.corner(f, 2) - a, area = ab.cross(ac);
      const double length = area.norm();
      shape.facets.push_back({a, ab, ac, length > 0 ? Vec3(area / length) : Vec3::Zero()});
    }
    rtcSetGeometryMask(geometry, static_cast<unsigned>(-1));
    rtcSetGeometryIntersectFilterFunction(geometry, keep_crossings);
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene, geometry, id);
    rtcReleaseGeometry(geometry);
  }
};

TransportSurface::TransportSurface(const TriangleMesh& outer, const TriangleMesh& free_space)
    : impl_(std::make_unique<Impl>()) {
  if (outer.face_count() == 0 || outer.vertex_count() == 0) throw InputError("the surface has no faces");
  if (!outer.vertices.allFinite() || !free_space.vertices.allFinite())
    throw InputError("the surface has coordinates that are not finite");
  const Vec3 lower = outer.vertices.colwise().minCoeff().transpose();
  const Vec3 upper = outer.vertices.colwise().maxCoeff().transpose();
  impl_->centre = 0.5 * (lower + upper);
  impl_->scale = (upper - lower).maxCoeff();
  if (!(impl_->scale > 0)) throw InputError("the surface is a single point");
  for (int v = 0; v < outer.vertex_count(); ++v)
    impl_->radius = std::max(impl_->radius, (outer.vertex(v) - impl_->centre).norm());
  for (int v = 0; v < free_space.vertex_count(); ++v)
    impl_->radius = std::max(impl_->radius, (free_space.vertex(v) - impl_->centre).norm());

  // Embree builds with denormal numbers flushed to zero. Where its build is the process's first parallel work, all
  // later work on TBB inherits that; so something else goes first.
  parallel_for(
      64, [](std::size_t) {}, 1);
  impl_->device = rtcNewDevice(nullptr);
  if (!impl_->device) {
    const RTCError error = rtcGetDeviceError(nullptr);
    if (error == RTC_ERROR_OUT_OF_MEMORY || error == RTC_ERROR_UNKNOWN) throw std::bad_alloc();
    throw InternalError(fmt::format("Embree gives no device: error {}", static_cast<int>(error)));
  }
  impl_->scene = rtcNewScene(impl_->device);
  rtcSetSceneFlags(impl_->scene, RTC_SCENE_FLAG_ROBUST);
  impl_->attach(outer, 0);
  if (free_space.face_count() > 0) impl_->attach(free_space, 1);
  rtcCommitScene(impl_->scene);
  if (rtcGetDeviceError(impl_->device) != RTC_ERROR_NONE) throw InternalError("Embree could not build its hierarchy");
}

TransportSurface::~TransportSurface() = default;
TransportSurface::TransportSurface(TransportSurface&&) noexcept = default;
TransportSurface& TransportSurface::operator=(TransportSurface&&) noexcept = default;

const Vec3& TransportSurface::centre() const { return impl_->centre; }
double TransportSurface::radius() const { return impl_->radius; }
double TransportSurface::tolerance() const { return relative_tolerance * impl_->scale; }

bool TransportSurface::next(const Vec3& origin, const Vec3& direction, double limit, const std::array<bool, 2>& inside,
                            Crossing& crossing, bool before) const {
  const Impl& impl = *impl_;
  const Vec3 start = (origin - impl.centre) / impl.scale - (before ? 1 : -1) * relative_tolerance * direction;
  RTCRayHit query;
  query.ray.org_x = static_cast<float>(start.x());
  query.ray.org_y = static_cast<float>(start.y());
  query.ray.org_z = static_cast<float>(start.z());
  query.ray.dir_x = static_cast<float>(direction.x());
  query.ray.dir_y = static_cast<float>(direction.y());
  query.ray.dir_z = static_cast<float>(direction.z());
  query.ray.time = 0;
  query.ray.tnear = 0;
  query.ray.tfar = static_cast<float>(limit / impl.scale + (before ? 1 : -1) * relative_tolerance);
  query.ray.mask = static_cast<unsigned>(-1);
  query.ray.id = 0;
  query.ray.flags = 0;
  query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  query.hit.primID = RTC_INVALID_GEOMETRY_ID;
  query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  Context context;
  rtcInitIntersectContext(&context.base);
  for (int axis = 0; axis < 3; ++axis) context.direction[axis] = static_cast<float>(direction[axis]);
  context.inside[0] = inside[0];
  context.inside[1] = inside[1];
  rtcIntersect1(impl.scene, &context.base, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;

  crossing.surface = static_cast<SurfaceKind>(query.hit.geomID);
  crossing.face_index = static_cast<int>(query.hit.primID);
  const double u = std::clamp(static_cast<double>(query.hit.u), 0.0, 1.0);
  const double v = std::clamp(static_cast<double>(query.hit.v), 0.0, 1.0 - u);
  crossing.barycentric = Vec3(1 - u - v, u, v);
  const Facet& facet = impl.shapes[query.hit.geomID].facets[query.hit.primID];
  crossing.point = facet.a + u * facet.ab + v * facet.ac;
  crossing.normal = facet.normal;
  crossing.distance = std::max(0.0, (crossing.point - origin).dot(direction));
  return true;
}

}  // namespace shellgrid
