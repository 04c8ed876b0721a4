// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/embree_scene.h"

#include <fmt/format.h>

#include <new>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

EmbreeScene::EmbreeScene(const TriangleMesh& box) {
  if (box.face_count() == 0 || box.vertex_count() == 0) throw InputError("the surface has no faces");
  if (!box.vertices.allFinite()) throw InputError("the surface has coordinates that are not finite");
  const Vec3 lower = box.vertices.colwise().minCoeff().transpose();
  const Vec3 upper = box.vertices.colwise().maxCoeff().transpose();
  centre_ = 0.5 * (lower + upper);
  scale_ = (upper - lower).maxCoeff();
  if (!(scale_ > 0)) throw InputError("the surface is a single point");

  // Embree builds with denormal numbers flushed to zero. Where its build is the process's first parallel work, all
  // later work on TBB inherits that, and results depend on what ran before; so something else goes first.
  parallel_for(
      64, [](std::size_t) {}, 1);
  device_ = rtcNewDevice(nullptr);
  if (!device_) {
    // Embree starts in any surroundings but those without memory for its threads.
    const RTCError error = rtcGetDeviceError(nullptr);
    if (error == RTC_ERROR_OUT_OF_MEMORY || error == RTC_ERROR_UNKNOWN) throw std::bad_alloc();
    throw InternalError(fmt::format("Embree gives no device: error {}", static_cast<int>(error)));
  }
  scene_ = rtcNewScene(device_);
  rtcSetSceneFlags(scene_, RTC_SCENE_FLAG_ROBUST);
}

EmbreeScene::~EmbreeScene() {
  if (scene_) rtcReleaseScene(scene_);
  if (device_) rtcReleaseDevice(device_);
}

void EmbreeScene::attach(const TriangleMesh& mesh, unsigned id, RTCFilterFunctionN filter) {
  if (!mesh.vertices.allFinite()) throw InputError("the surface has coordinates that are not finite");
  RTCGeometry geometry = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                                               3 * sizeof(float), mesh.vertex_count()));
  auto* faces = static_cast<unsigned*>(rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                                               3 * sizeof(unsigned), mesh.face_count()));
  if (!vertices || !faces) {
    rtcReleaseGeometry(geometry);
    throw std::bad_alloc();
  }
  for (int v = 0; v < mesh.vertex_count(); ++v)
    for (int k = 0; k < 3; ++k) vertices[3 * v + k] = static_cast<float>((mesh.vertices(v, k) - centre_[k]) / scale_);
  for (int f = 0; f < mesh.face_count(); ++f)
    for (int k = 0; k < 3; ++k) faces[3 * f + k] = static_cast<unsigned>(mesh.faces(f, k));
  rtcSetGeometryMask(geometry, static_cast<unsigned>(-1));
  if (filter) rtcSetGeometryIntersectFilterFunction(geometry, filter);
  rtcCommitGeometry(geometry);
  rtcAttachGeometryByID(scene_, geometry, id);
  rtcReleaseGeometry(geometry);
}

void EmbreeScene::commit() {
  rtcCommitScene(scene_);
  if (rtcGetDeviceError(device_) != RTC_ERROR_NONE) throw InternalError("Embree could not build its hierarchy");
}

}  // namespace shellgrid
