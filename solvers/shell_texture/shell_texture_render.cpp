// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/shell_texture_render.h"

#include <oneapi/tbb/enumerable_thread_specific.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/half_edges.h"
#include "solvers/render/picture_stage.h"
#include "solvers/shell_texture/shell_light.h"
#include "solvers/transport/dielectric.h"

namespace shellgrid {

namespace {

constexpr float pi = std::numbers::pi_v<float>;
constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double faint = 4e-3;      // light that counts less for the picture than that is let go
constexpr float opaque_depth = 5;   // behind so much matter all is taken as it is there
constexpr int most_crossings = 64;  // of surfaces without matter between them
constexpr std::int32_t free_space_kind = 0;

// ∫₀^length e^{−optical s / length} ds, `through` being e^{−optical}.
Rgb within(const Rgb& optical, const Rgb& through, float length) {
  return (optical.abs() > 1e-3f).select((1 - through) / (optical / length), length * (1 - optical / 2));
}

struct Sight {
  Vec3 point, direction;
  std::array<bool, 2> inside = {};
  bool in_matter() const { return inside[0] && !inside[1]; }
};

// What one ray sees, in two layers.
struct Seen {
  Rgb scattered = Rgb::Zero(), mirrored = Rgb::Zero();
};

class ShellPicture {
 public:
  ShellPicture(const ShellTextureScene& scene, const PictureStage& stage, const VertexMatrix& free_space_normals,
               const ShellLight& light, const ShellTextureSettings& settings)
      : scene_(scene),
        stage_(stage),
        light_(light),
        settings_(settings),
        normals_{&scene.frames.normals, &free_space_normals},
        readers_([&light] { return ShellLight::Reader(light); }) {}

  // The meeting with a surface that has nothing before it: for objects without free space.
  Crossing entrance(Sight& sight, const SceneGeometry::Hit& hit, Vec3& normal) const {
    Crossing crossing{SurfaceKind::outer, hit.face_index, hit.barycentric, hit.distance, hit.point, hit.normal};
    sight.inside[0] = true;
    sight.point = hit.point;
    normal = shading_normal(crossing, sight.direction);
    return crossing;
  }

  // The first meeting with matter along a ray of sight from outside; false where it passes by.
  bool first_meeting(Sight& sight, Crossing& crossing, Vec3& normal) const {
    for (int n = 0; n < most_crossings; ++n) {
      if (!next(sight, infinite, crossing)) return false;
      const bool before = sight.in_matter();
      const int surface = static_cast<int>(crossing.surface);
      sight.inside[surface] = !sight.inside[surface];
      sight.point = crossing.point;
      if (sight.in_matter() != before) {
        normal = shading_normal(crossing, sight.direction);
        return true;
      }
      if (!sight.inside[0] && !sight.inside[1] && before) return false;
    }
    return false;
  }

  // Light towards where a ray came from that meets matter from outside: `sight` is at the surface, already inside.
  Seen at_surface(const Sight& sight, const Crossing& crossing, const Vec3& normal, int mirrors, double weight) const {
    const double ior = scene_.object.ior();
    const double cosine = std::clamp(-normal.dot(sight.direction), 0.0, 1.0);
    const BoundaryMeeting meeting = meet_boundary(cosine, ior);
    Seen seen;
    const double mirror_weight = weight * meeting.reflectance;
    if (mirror_weight > faint && mirrors > 0) {
      Vec3 direction = mirrored(sight.direction, normal, cosine);
      const Vec3 face = towards(crossing.normal, sight.direction);
      if (!(direction.dot(face) > 0)) direction = mirrored(sight.direction, face, -face.dot(sight.direction));
      Sight out{sight.point, direction, sight.inside};
      out.inside[static_cast<int>(crossing.surface)] = !out.inside[static_cast<int>(crossing.surface)];
      ++stage_.mirror_rays;
      const Seen image = outside(out, mirrors - 1, mirror_weight);
      seen.mirrored = static_cast<float>(meeting.reflectance) * (image.scattered + image.mirrored);
    } else if (mirror_weight > 0) {
      seen.mirrored =
          static_cast<float>(meeting.reflectance) * far(sight.point, mirrored(sight.direction, normal, cosine));
    }
    const double passing = 1 - meeting.reflectance;
    if (passing * weight > faint || weight == 1) {
      Sight in = sight;
      if (ior != 1) in.direction = refracted(sight.direction, normal, cosine, meeting.cosine_beyond, ior);
      const Rgb radiance = inside(in, mirrors, weight * passing);
      seen.scattered = radiance * static_cast<float>(passing / (ior * ior));
    }
    return seen;
  }

  // The radiance that comes against a ray of sight which is outside of matter.
  Seen outside(Sight sight, int mirrors, double weight) const {
    Crossing crossing;
    Vec3 normal;
    const Vec3 origin = sight.point;
    if (first_meeting(sight, crossing, normal)) return at_surface(sight, crossing, normal, mirrors, weight);
    Seen seen;
    seen.mirrored = far(origin, sight.direction);
    if (stage_.floor && settings_.outside_light)
      if (const std::optional<double> distance = stage_.floor->intersect(origin, sight.direction)) {
        const Vec3 point = origin + *distance * sight.direction;
        const auto opacity = static_cast<float>(stage_.floor->opacity(point));
        seen.mirrored = seen.mirrored * (1 - opacity) + stage_.floor->radiance(point) * opacity;
      }
    return seen;
  }

  // The same within matter: what it scatters towards the ray, and what shines through it.
  Rgb inside(const Sight& sight, int mirrors, double weight) const {
    ++marches_;
    ShellLight::Reader& reader = readers_.local();
    const ShellVolume& shell = scene_.shell;
    Crossing crossing;
    const bool ends = next(sight, infinite, crossing);
    const double end = ends ? crossing.distance : infinite;
    const Vec3 start = shell.frame.to_index(sight.point);  // voxel (i, j, k) is the cube about that
    const double per_mm = 1 / shell.frame.voxel;
    Vec3i at;
    Vec3 next_side, interval;
    Vec3i step;
    for (int a = 0; a < 3; ++a) {
      at[a] = static_cast<int>(std::floor(start[a] + 0.5));
      const double d = sight.direction[a] * per_mm;
      step[a] = d > 0 ? 1 : -1;
      interval[a] = d != 0 ? std::abs(1 / d) : infinite;
      next_side[a] = d != 0 ? (at[a] + (d > 0 ? 0.5 : -0.5) - start[a]) / d : infinite;
    }
    Rgb sum = Rgb::Zero(), left = Rgb::Ones();
    double t = 0;
    std::int64_t steps = 0;
    Vec3 last = Vec3::Zero();  // place that was looked at
    float depth = -1;          // of the last voxel, in voxels; none yet
    bool in_core = false;
    while (t < end) {
      int axis = 0;
      if (next_side[1] < next_side[axis]) axis = 1;
      if (next_side[2] < next_side[axis]) axis = 2;
      const double leave = std::min(end, next_side[axis]);
      Vec3i voxel = at;
      if (!matter_near(voxel, depth)) {
        in_core = true;
        break;
      }
      depth = shell.texture_coordinate.value(voxel.x(), voxel.y(), voxel.z()).z();
      const auto length = static_cast<float>(std::max(0.0, leave - t));
      if (length > 0) {
        const Rgb true_extinction = shell.extinction.value(voxel.x(), voxel.y(), voxel.z()).array();
        Rgb extinction = true_extinction;
        Rgb scattering = extinction * shell.albedo.value(voxel.x(), voxel.y(), voxel.z()).array();
        Vec3f anisotropy = shell.anisotropy.value(voxel.x(), voxel.y(), voxel.z());
        if (settings_.similarity) {
          extinction -= scattering * anisotropy.array();
          scattering *= 1 - anisotropy.array();
          anisotropy.setZero();
        }
        const Rgb optical = extinction * length, through = (-optical).exp();
        const Rgb weighed = within(optical, through, length);
        // Where the field is linear its value in the middle of what scatters, rather than of the way, is exact.
        const float mean = optical.mean();
        const float middle = mean > 1e-3f ? length * (1 / mean - std::exp(-mean) / (1 - std::exp(-mean))) : length / 2;
        const Vec3 first = start + t * per_mm * sight.direction,
                   place = first + static_cast<double>(middle) * per_mm * sight.direction;
        Rgb growth;
        const Rgb beams = reader.beams(voxel, first, sight.direction, anisotropy, true_extinction, growth);
        const Rgb faded = (growth - extinction) * length;
        const Rgb scattered =
            weighed * reader.multiple(place) / (4 * pi) + beams * within(-faded, faded.min(60.0f).exp(), length);
        sum += left * scattering * scattered;
        left *= through;
        last = place;
        ++steps;
        // What lies beyond shines as this does.
        if (left.maxCoeff() < std::exp(-opaque_depth)) {
          sum += (optical > 1e-4f).select(left * scattering * scattered / (1 - through).max(1e-6f), 0.0f);
          left.setZero();
          break;
        }
      }
      t = leave;
      at[axis] += step[axis];
      next_side[axis] += interval[axis];
    }
    march_steps_ += steps;
    const float rest = left.maxCoeff();
    if (in_core) {
      const int vertex = settings_.unscattered_core && steps > 0 && light_.has_core() ? reader.vertex(last) : -1;
      if (vertex >= 0) sum += left * light_.core_exitance(vertex, sight.point + t * sight.direction) / pi;
      return sum;
    }
    if (ends && t >= end && static_cast<double>(rest) * weight > faint && mirrors > 0)
      sum += left * beyond(sight, crossing, mirrors - 1, weight * static_cast<double>(rest));
    return sum;
  }

  std::int64_t marches() const { return marches_; }
  std::int64_t march_steps() const { return march_steps_; }

 private:
  bool next(const Sight& sight, double limit, Crossing& crossing) const {
    return scene_.object.surface().next(sight.point, sight.direction, limit, sight.inside, crossing);
  }

  Rgb far(const Vec3& origin, const Vec3& direction) const {
    return settings_.outside_light ? stage_.far(origin, direction) : Rgb(Rgb::Zero());
  }

  static Vec3 towards(const Vec3& normal, const Vec3& direction) {
    return normal.dot(direction) > 0 ? Vec3(-normal) : normal;
  }

  // Against the ray; the face's where the interpolated one looks away.
  Vec3 shading_normal(const Crossing& crossing, const Vec3& direction) const {
    const int surface = static_cast<int>(crossing.surface);
    const TriangleMesh& mesh = surface == 0 ? scene_.object.mesh() : scene_.object.free_space();
    const Vec3 face = towards(crossing.normal, direction);
    Vec3 normal = Vec3::Zero();
    for (int k = 0; k < 3; ++k)
      normal += crossing.barycentric[k] * normals_[surface]->row(mesh.faces(crossing.face_index, k)).transpose();
    const double length = normal.norm();
    if (!(length > 1e-6)) return face;
    normal /= length;
    if (normal.dot(crossing.normal) * face.dot(crossing.normal) < 0) normal = -normal;
    return normal.dot(direction) < 0 ? normal : face;
  }

  // From within matter at its end.
  Rgb beyond(const Sight& sight, const Crossing& crossing, int mirrors, double weight) const {
    const double ior = scene_.object.ior();
    const Vec3 normal = shading_normal(crossing, sight.direction);
    const double cosine = std::clamp(-normal.dot(sight.direction), 0.0, 1.0);
    const BoundaryMeeting meeting = meet_boundary(cosine, 1 / ior);
    Rgb sum = Rgb::Zero();
    const double passing = 1 - meeting.reflectance;
    if (passing * weight > faint) {
      Sight out{crossing.point, sight.direction, sight.inside};
      if (ior != 1) out.direction = refracted(sight.direction, normal, cosine, meeting.cosine_beyond, 1 / ior);
      out.inside[static_cast<int>(crossing.surface)] = !out.inside[static_cast<int>(crossing.surface)];
      const Seen seen = outside(out, mirrors, weight * passing);
      sum += (seen.scattered + seen.mirrored) * static_cast<float>(passing * ior * ior);
    }
    if (meeting.reflectance * weight > faint && mirrors > 0) {
      const Sight back{crossing.point, mirrored(sight.direction, normal, cosine), sight.inside};
      sum += inside(back, mirrors - 1, weight * meeting.reflectance) * static_cast<float>(meeting.reflectance);
    }
    return sum;
  }

  // Moves to a voxel of matter: the one asked for, or, near the surface, its neighbour. False in the core.
  bool matter_near(Vec3i& voxel, float depth_before) const {
    const ShellVolume& shell = scene_.shell;
    const auto matter = [&](const Vec3i& v) {
      const auto& grid = shell.kind;
      const int leaf_index = grid.find_leaf(TwoLevelGrid<std::int32_t>::leaf_of(v.x(), v.y(), v.z()));
      if (leaf_index < 0) return false;
      const int offset = TwoLevelGrid<std::int32_t>::offset_of(v.x(), v.y(), v.z());
      if (!TwoLevelGrid<std::int32_t>::mask_test(grid.leaf_mask(leaf_index), offset)) return false;
      const std::int32_t kind = grid.leaf_values(leaf_index)[offset];
      return kind != free_space_kind && kind != core_voxel_kind;
    };
    if (matter(voxel)) return true;
    // Below the shell's deepest voxels the core begins.
    if (depth_before >= 0 && static_cast<double>(depth_before) > shell.thickness / shell.frame.voxel - 1.5)
      return false;
    const Vec3i from = voxel;
    int nearest = std::numeric_limits<int>::max();
    for (int x = -1; x <= 1; ++x)
      for (int y = -1; y <= 1; ++y)
        for (int z = -1; z <= 1; ++z) {
          const Vec3i other = from + Vec3i(x, y, z);
          const int distance = x * x + y * y + z * z;
          if (distance < nearest && matter(other)) {
            nearest = distance;
            voxel = other;
          }
        }
    return nearest < std::numeric_limits<int>::max();
  }

  const ShellTextureScene& scene_;
  const PictureStage& stage_;
  const ShellLight& light_;
  const ShellTextureSettings& settings_;
  const VertexMatrix* normals_[2];  // by SurfaceKind
  mutable oneapi::tbb::enumerable_thread_specific<ShellLight::Reader> readers_;
  mutable std::atomic<std::int64_t> marches_{0}, march_steps_{0};
};

}  // namespace

RenderedImage render_shell_texture(const ShellTextureScene& scene, const std::vector<Light>& lights,
                                   const Camera& camera, const ShellTextureSettings& settings,
                                   ShellTextureStatistics* statistics, Progress& progress) {
  const TriangleMesh& free_space = scene.object.free_space();
  const bool has_free_space = free_space.face_count() > 0;
  std::optional<PictureStage> made_stage;
  VertexMatrix free_space_normals;
  together([&] { made_stage.emplace(scene.frames.mesh, scene.frames.normals, lights, camera, settings.render); },
           [&] {
             if (has_free_space) free_space_normals = vertex_normals(free_space);
           });
  PictureStage& stage = *made_stage;
  for (const Light& light : lights)
    if (const std::optional<Vec3> place = light_position(light); place && stage.geometry.contains(*place))
      throw InputError("lights: a light stands inside the object");
  for (const Rgb& value : scene.core)
    if (!value.isFinite().all() || (value < 0).any()) throw InputError("the core's exitance is negative or not finite");
  const IncidentLight incident(scene.frames, stage.geometry, lights, scene.texture.directions(),
                               settings.render.environment_samples);
  const IrradianceKernels kernels = corrected_by(scene.texture.kernels(), settings.correction);
  const SpreadLight spread(incident, kernels, scene.texture.size(), scene.coordinates,
                           kernels.empty() ? std::vector<Vec3f>() : band_responses(scene.texture, false));
  const ShellLight light(scene.shell, scene.frames, spread, scene.texture, scene.core,
                         {settings.outside_light, settings.core_light}, scene.curvature, scene.shape);
  const ShellPicture picture(scene, stage, free_space_normals, light, settings);
  const auto from_camera = [&](const Vec3& origin, const Vec3& direction) {
    LightPath path{PathRandom(0, 0)};
    path.point = origin;
    scene.object.begin(path);
    return Sight{origin, direction, path.inside};
  };
  const Sight camera_sight = from_camera(stage.rays.origin(), Vec3(0, 0, 1));
  auto shade = [&](const PictureStage::Hit& hit, const Vec3& direction, FilmSample& sample, const auto& backdrop) {
    Sight sight{stage.rays.origin(), direction, camera_sight.inside};
    Crossing crossing;
    Vec3 normal;
    if (!has_free_space && hit.normal.dot(direction) < 0) {
      crossing = picture.entrance(sight, hit, normal);
    } else if (!picture.first_meeting(sight, crossing, normal)) {
      sample.hit = false;
      if (settings.outside_light) sample.backdrop = backdrop(stage.rays.origin(), direction);
      return;
    }
    sample.depth = (crossing.point - stage.rays.origin()).dot(stage.rays.axis());
    sample.normal = normal;
    const Seen seen = picture.at_surface(sight, crossing, normal, settings.mirrors, 1);
    sample.exitance = seen.scattered;
    sample.specular = seen.mirrored;
  };
  auto glimpse = [&](const PictureStage::Hit& hit, const Vec3& direction) -> Rgb {
    const Vec3 origin = hit.point - hit.distance * direction;
    Sight sight{origin, direction, {}};
    const Seen seen = picture.outside(sight, 0, 1);
    return seen.scattered + seen.mirrored;
  };
  if (settings.render.floor)
    stage.floor.emplace(
        *settings.render.floor, scene.frames.mesh, stage.geometry, stage.up, lights,
        settings.render.environment_samples,
        [&](const PictureStage::Hit& hit) -> Rgb {
          // As bright as seen from straight above, evenly in all directions.
          Sight sight{hit.point + stage.geometry.offset() * hit.normal, -hit.normal, {}};
          return picture.outside(sight, 0, 1).scattered * pi;
        },
        progress);
  RenderedImage result = expose(stage, camera, shade, glimpse, progress);
  if (statistics) {
    statistics->render = result.statistics;
    statistics->marches = picture.marches();
    statistics->march_steps = picture.march_steps();
    const ShellLight::Counts counts = light.counts();
    statistics->voxels_lit = counts.voxels;
    statistics->leaves_lit = counts.leaves;
    statistics->leaves_skipped = scene.shell.texture_coordinate.leaf_count() - counts.leaves;
    statistics->vertices_lit = counts.vertices;
    statistics->vertices_corrected = spread.spread_vertices();
    statistics->shadow_rays = incident.statistics().shadow_rays;
    statistics->shadow_rays_skipped = incident.statistics().shadow_rays_skipped;
    statistics->shadow_rays_shared = incident.statistics().shadow_rays_shared;
  }
  return result;
}

}  // namespace shellgrid
