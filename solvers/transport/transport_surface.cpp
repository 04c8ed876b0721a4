// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/transport/transport_surface.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "solvers/render/embree_scene.h"

namespace shellgrid {
namespace {

constexpr double relative_tolerance = 3e-7;

// Where a mesh's numbers are: they stay there when it is moved.
struct Shape {
  const double* vertices = nullptr;
  const std::int32_t* faces = nullptr;
  Vec3 corner(unsigned face, int k) const {
    return Eigen::Map<const Vec3>(vertices +
                                  3 * static_cast<std::size_t>(faces[3 * static_cast<std::size_t>(face) + k]));
  }
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

struct TransportSurface::Impl {
  EmbreeScene embree;
  double radius = 0;
  Shape shapes[2];

  explicit Impl(const TriangleMesh& outer) : embree(outer) {}

  void attach(const TriangleMesh& mesh, unsigned id) {
    embree.attach(mesh, id, keep_crossings);
    for (int v = 0; v < mesh.vertex_count(); ++v) radius = std::max(radius, (mesh.vertex(v) - embree.centre()).norm());
    static_assert(VertexMatrix::IsRowMajor && FaceMatrix::IsRowMajor);
    shapes[id] = {mesh.vertices.data(), mesh.faces.data()};
  }
};

TransportSurface::TransportSurface(const TriangleMesh& outer, const TriangleMesh& free_space)
    : impl_(std::make_unique<Impl>(outer)) {
  impl_->attach(outer, 0);
  if (free_space.face_count() > 0) impl_->attach(free_space, 1);
  impl_->embree.commit();
}

TransportSurface::~TransportSurface() = default;
TransportSurface::TransportSurface(TransportSurface&&) noexcept = default;
TransportSurface& TransportSurface::operator=(TransportSurface&&) noexcept = default;

const Vec3& TransportSurface::centre() const { return impl_->embree.centre(); }
double TransportSurface::radius() const { return impl_->radius; }
double TransportSurface::tolerance() const { return relative_tolerance * impl_->embree.scale(); }

bool TransportSurface::next(const Vec3& origin, const Vec3& direction, double limit, const std::array<bool, 2>& inside,
                            Crossing& crossing, bool before) const {
  const Impl& impl = *impl_;
  const Vec3 start =
      (origin - impl.embree.centre()) / impl.embree.scale() - (before ? 1 : -1) * relative_tolerance * direction;
  RTCRayHit query;
  query.ray.org_x = static_cast<float>(start.x());
  query.ray.org_y = static_cast<float>(start.y());
  query.ray.org_z = static_cast<float>(start.z());
  query.ray.dir_x = static_cast<float>(direction.x());
  query.ray.dir_y = static_cast<float>(direction.y());
  query.ray.dir_z = static_cast<float>(direction.z());
  query.ray.time = 0;
  query.ray.tnear = 0;
  query.ray.tfar = static_cast<float>(limit / impl.embree.scale() + (before ? 1 : -1) * relative_tolerance);
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
  rtcIntersect1(impl.embree.scene(), &context.base, &query);
  if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;

  crossing.surface = static_cast<SurfaceKind>(query.hit.geomID);
  crossing.face_index = static_cast<int>(query.hit.primID);
  const double u = std::clamp(static_cast<double>(query.hit.u), 0.0, 1.0);
  const double v = std::clamp(static_cast<double>(query.hit.v), 0.0, 1.0 - u);
  crossing.barycentric = Vec3(1 - u - v, u, v);
  const Shape& shape = impl.shapes[query.hit.geomID];
  const Vec3 a = shape.corner(query.hit.primID, 0), ab = shape.corner(query.hit.primID, 1) - a,
             ac = shape.corner(query.hit.primID, 2) - a, area = ab.cross(ac);
  const double length = area.norm();
  crossing.point = a + u * ab + v * ac;
  crossing.normal = length > 0 ? Vec3(area / length) : Vec3::Zero();
  crossing.distance = std::max(0.0, (crossing.point - origin).dot(direction));
  return true;
}

}  // namespace shellgrid
