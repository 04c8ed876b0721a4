// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/diffusion/beam_source.h"

#include <oneapi/tbb/enumerable_thread_specific.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <utility>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/surface/closest_point.h"
#include "meshing/surface/half_edges.h"
#include "solvers/diffusion/boundary_irradiance.h"
#include "solvers/diffusion/boundary_quad.h"
#include "solvers/diffusion/cell_walk.h"
#include "solvers/diffusion/near_lamps.h"
#include "solvers/render/surface_render.h"
#include "solvers/scattering/fresnel.h"

namespace shellgrid {
namespace {

constexpr double negligible = 1e-3;  // of a beam's power
constexpr int most_steps = 20000, most_bounces = 64;
constexpr double first_depth = 0.15, last_depth = 0.6, depth_growth = 1.2;  // optical, of steps

struct Tally {
  Double4 entering = {}, absorbed = {}, leaving = {}, cut_off_power = {};
  std::int64_t beams = 0, steps = 0, cut_off = 0, lost = 0;
};

// Adds to a few of many points and lists them again.
class SparseSum {
 public:
  void add(std::int32_t point, Double4 value, std::size_t points) {
    if (values_.empty()) values_.assign(points, Double4{}), listed_.assign(points, 0);
    if (!listed_[point]) listed_[point] = 1, touched_.push_back(point);
    values_[point] += value;
  }
  std::vector<std::pair<std::int32_t, Double4>> take() {
    std::vector<std::pair<std::int32_t, Double4>> result;
    result.reserve(touched_.size());
    for (const std::int32_t point : touched_) {
      result.emplace_back(point, values_[point]);
      values_[point] = Double4{};
      listed_[point] = 0;
    }
    touched_.clear();
    return result;
  }

 private:
  std::vector<Double4> values_;
  std::vector<char> listed_;
  std::vector<std::int32_t> touched_;
};

struct Extinction {
  Double4 absorption, total;
};

class BeamTracer {
 public:
  BeamTracer(const Polygrid& polygrid, const CellNeighbours& neighbours, const CellCoefficients& coefficients,
             double ior, SparseSum& sum, Tally& tally)
      : polygrid_(polygrid),
        neighbours_(neighbours),
        coefficients_(coefficients),
        ior_(ior),
        sum_(sum),
        tally_(tally) {}

  void trace(std::int32_t quad, const EnteringBeam& beam) {
    const double s = beam.s, t = beam.t;
    const auto& corners = neighbours_.quad_corners[quad];
    CellPlace place{neighbours_.quad_cell[quad], (1 - s) * (1 - t) * corners[0] + s * (1 - t) * corners[1] +
                                                     s * t * corners[2] + (1 - s) * t * corners[3]};
    Vec3 point = position(place), direction = beam.direction;
    Double4 power = beam.power;
    ++tally_.beams;
    tally_.entering += power;
    scattered_ = absorbed_ = left_ = Double4{};
    double depth = first_depth;
    int bounces = 0;
    for (int step = 0; step < most_steps && bounces <= most_bounces; ++step) {
      if (spent(power, beam.power)) return leave_rest(place, power);
      ++tally_.steps;
      const Extinction here = extinction(place);
      const double strongest = std::max({here.total[0], here.total[1], here.total[2]});
      double length = std::min(depth / strongest, 0.5 * polygrid_.spacing);
      depth = std::min(last_depth, depth * depth_growth);
      CellPlace end = place;
      int face = -1;
      const WalkEnd outcome = walk_to(polygrid_, neighbours_, point + length * direction, end, face);
      CellPlace outside = end;
      if (outcome != WalkEnd::inside) {
        if (outcome == WalkEnd::lost) face = -1;
        length = way_to_surface(point, direction, length, place, end, outside, face);
      }
      deposit(place, end, length, here, power);
      place = end;
      point += length * direction;
      if (outcome == WalkEnd::inside) continue;
      if (face < 0) {
        ++tally_.lost;
        tally_.cut_off_power += power;
        return leave_rest(place, power);
      }
      const Vec3 normal = face_normal(polygrid_, outside, face);
      const double cosine = direction.dot(normal);
      if (neighbours_.quad[outside.cell][face] >= 0) {
        const double reflected = fresnel_reflectance(std::clamp(cosine, 0.0, 1.0), 1 / ior_);
        left_ += (1 - reflected) * power;
        power *= reflected;
      }
      direction = (direction - 2 * std::max(cosine, 0.0) * normal).normalized();
      ++bounces;
    }
    ++tally_.cut_off;
    tally_.cut_off_power += power;
    leave_rest(place, power);
  }

 private:
  Vec3 position(const CellPlace& place) const {
    const TrilinearShape shape(place.reference);
    Vec3 x = Vec3::Zero();
    for (int a = 0; a < 8; ++a) x += shape.value[a] * polygrid_.points.row(polygrid_.cells(place.cell, a)).transpose();
    return x;
  }

  static bool spent(Double4 power, Double4 initial) {
    for (int c = 0; c < 3; ++c)
      if (power[c] > negligible * initial[c]) return false;
    return true;
  }

  // Of the Gauss point nearest in reference coordinates.
  Extinction extinction(const CellPlace& place) const {
    static constexpr int corner_at[2][2][2] = {{{0, 4}, {3, 7}}, {{1, 5}, {2, 6}}};
    const int corner = corner_at[place.reference.x() > 0.5][place.reference.y() > 0.5][place.reference.z() > 0.5];
    const std::size_t at = 8 * static_cast<std::size_t>(place.cell) + corner;
    return {to_double(to_lanes(coefficients_.absorption[at])),
            to_double(to_lanes(coefficients_.reduced_extinction[at]))};
  }

  // How much of a step stays in the grid; `end` becomes the last place there. `outside` and `face`: where the whole
  // step ends, if that is known (face ≥ 0), then where it leaves. Newton's steps to the face, or halvings where they
  // fail.
  double way_to_surface(const Vec3& point, const Vec3& direction, double length, const CellPlace& start, CellPlace& end,
                        CellPlace& outside, int& face) const {
    double inside = 0, beyond = length;
    end = start;
    for (int trial = 0; trial < 24; ++trial) {
      double way = 0.5 * (inside + beyond);
      if (face >= 0 && trial < 8) {
        const double first_order = beyond - way_past_face(polygrid_, outside, face, direction);
        if (first_order > inside && first_order < beyond) way = first_order;
      }
      CellPlace probe = end;
      int left_by = -1;
      const WalkEnd outcome = walk_to(polygrid_, neighbours_, point + way * direction, probe, left_by);
      if (outcome == WalkEnd::inside) {
        inside = way;
        end = probe;
        if (face >= 0 && probe.cell == outside.cell && std::abs(probe.reference[face / 2] - face % 2) < 1e-7) break;
      } else {
        beyond = way;
        if (outcome == WalkEnd::surface) outside = probe, face = left_by;
      }
    }
    return inside;
  }

  void scatter(const CellPlace& place, Double4 power) {
    const TrilinearShape shape(place.reference);
    for (int a = 0; a < 8; ++a)
      sum_.add(polygrid_.cells(place.cell, a), shape.value[a] * power, polygrid_.points.rows());
  }

  // What the step takes from the beam.
  void deposit(const CellPlace& start, const CellPlace& end, double length, const Extinction& here, Double4& power) {
    const Extinction there = extinction(end);
    Double4 at_start = {}, at_end = {};
    for (int c = 0; c < 3; ++c) {
      const double total = 0.5 * (here.total[c] + there.total[c]), depth = total * length;
      const double lost = power[c] * -std::expm1(-depth);
      const double absorbed = lost * (0.5 * (here.absorption[c] + there.absorption[c]) / total);
      // Centroid of e^{−x} over 0 … depth, as a share of the step.
      const double centroid = depth < 1e-3 ? 0.5 - depth / 12 : 1 / depth - 1 / std::expm1(depth);
      const double scattered = lost - absorbed;
      at_end[c] = scattered * centroid;
      at_start[c] = scattered - at_end[c];
      absorbed_[c] += absorbed;
      power[c] -= lost;
    }
    scattered_ += at_start + at_end;
    scatter(start, at_start);
    scatter(end, at_end);
  }

  // The end of a beam: its rest goes the ways that it has gone so far.
  void leave_rest(const CellPlace& place, Double4 power) {
    const Extinction here = extinction(place);
    const Double4 gone = scattered_ + absorbed_ + left_;
    for (int c = 0; c < 3; ++c) {
      const bool known = gone[c] > 0;
      const double absorbed = power[c] * (known ? absorbed_[c] / gone[c] : here.absorption[c] / here.total[c]);
      const double left = known ? power[c] * (left_[c] / gone[c]) : 0;
      absorbed_[c] += absorbed;
      left_[c] += left;
      power[c] = std::max(0.0, power[c] - absorbed - left);
    }
    scatter(place, power);
    tally_.absorbed += absorbed_;
    tally_.leaving += left_;
  }

  const Polygrid& polygrid_;
  const CellNeighbours& neighbours_;
  const CellCoefficients& coefficients_;
  double ior_;
  SparseSum& sum_;
  Tally& tally_;
  Double4 scattered_ = {}, absorbed_ = {}, left_ = {};  // of the beam's power so far
};

// Snell's law; `towards` points to the light.
Vec3 refracted(const Vec3& towards, const Vec3& normal, double cosine, double ior) {
  const double inside = std::sqrt(std::max(0.0, 1 - (1 - cosine * cosine) / (ior * ior)));
  return (-towards / ior + (cosine / ior - inside) * normal).normalized();
}

using BeamsOf = std::function<void(std::int32_t quad, std::vector<EnteringBeam>& list)>;

BeamSource trace(const Polygrid& polygrid, const CellNeighbours& neighbours, const CellCoefficients& coefficients,
                 double ior, const BeamsOf& beams_of) {
  if (!(ior >= 1)) throw InputError("the refractive index must be at least 1");
  const auto quads = static_cast<std::size_t>(polygrid.boundary_quads.rows());
  constexpr std::size_t chunk = 128;
  struct Part {
    std::vector<std::pair<std::int32_t, Double4>> source;
    Tally tally;
  };
  std::vector<Part> parts((quads + chunk - 1) / chunk);
  oneapi::tbb::enumerable_thread_specific<SparseSum> sums;
  parallel_chunks(quads, chunk, [&](std::size_t begin, std::size_t end) {
    Part& part = parts[begin / chunk];
    SparseSum& sum = sums.local();
    BeamTracer tracer(polygrid, neighbours, coefficients, ior, sum, part.tally);
    std::vector<EnteringBeam> list;
    for (std::size_t quad = begin; quad < end; ++quad) {
      list.clear();
      beams_of(static_cast<std::int32_t>(quad), list);
      for (const EnteringBeam& beam : list) tracer.trace(static_cast<std::int32_t>(quad), beam);
    }
    part.source = sum.take();
  });
  BeamSource result;
  result.source.assign(polygrid.points.rows(), Double4{});
  for (const Part& part : parts) {
    for (const auto& [point, power] : part.source) result.source[point] += power;
    result.entering += part.tally.entering;
    result.absorbed += part.tally.absorbed;
    result.leaving += part.tally.leaving;
    result.beams += part.tally.beams;
    result.steps += part.tally.steps;
    result.cut_off += part.tally.cut_off;
    result.lost += part.tally.lost;
    result.cut_off_power += part.tally.cut_off_power;
  }
  return result;
}

// The lights' beams into a quad.
class LightBeams {
 public:
  // How many: of a light of one direction `places` in a quad, 4, 2 or 1; of a light with extent `samples` parts, each
  // with one beam in every `stride`-th quad.
  struct Density {
    int places = 4, samples = 1, stride = 1;
  };

  LightBeams(const Polygrid& polygrid, const TriangleMesh& surface, const SceneGeometry& geometry,
             const std::vector<Light>& lights, double ior)
      : polygrid_(polygrid),
        surface_(surface),
        geometry_(geometry),
        lights_(lights),
        ior_(ior),
        normals_(vertex_normals(surface)),
        query_(surface),
        lift_(shadow_lift(surface, geometry)) {}

  void set_density(const Density& density) {
    density_ = density;
    single_.clear();
    parts_.clear();
    for (const Light& light : lights_)
      for (const SimpleLight& simple : simple_lights({light}, density.samples))
        (has_extent(light) ? parts_ : single_).push_back(simple);
  }
  int parts() const { return static_cast<int>(parts_.size()); }

  void list(std::int32_t quad, std::vector<EnteringBeam>& list) const {
    const double width = quad_width(polygrid_, quad);
    const Vec3 middle = quad_point(polygrid_, quad, 0.5, 0.5).position;
    const auto near = [&](const SimpleLight& light) {
      const std::optional<Vec3> position = lamp_position(light);
      return position && is_coarse(width, (*position - middle).norm());
    };
    for (int place = 0; place < 4; ++place) {
      // Two of the four lie across from each other, and for one the middle is best.
      const bool lit = density_.places == 4 || (density_.places == 2 && (place == 0) == (place == 3));
      enter(quad, place, gauss[place & 1], gauss[place >> 1], lit ? 1.0 / density_.places : 0, near, list);
    }
    if (density_.places == 1) enter(quad, -1, 0.5, 0.5, 1, near, list);
    for (const std::vector<SimpleLight>* lights : {&single_, &parts_})
      for (const SimpleLight& light : *lights)
        if (near(light)) enter_near(quad, width, light, list);
  }

 private:
  static constexpr double gauss[2] = {0.5 - 0.28867513459481288225, 0.5 + 0.28867513459481288225};

  // A place of a quad, and the surface there.
  struct Place {
    double s, t;
    QuadPoint at;
    Vec3 surface, normal;
  };
  Place place_of(std::int32_t quad, double s, double t) const {
    Place place{s, t, quad_point(polygrid_, quad, s, t), Vec3::Zero(), Vec3::Zero()};
    const SurfacePoint nearest = query_.nearest(place.at.position);
    place.surface = nearest.point;
    for (int k = 0; k < 3; ++k)
      place.normal += nearest.barycentric[k] * normals_.row(surface_.faces(nearest.face_index, k)).transpose();
    const double length = place.normal.norm();
    place.normal = length > 0 ? Vec3(place.normal / length) : place.at.normal;
    return place;
  }

  void add(const Place& place, const SimpleLight& light, double area, std::vector<EnteringBeam>& list) const {
    const IncidentBeam incident = incident_beam(light, place.surface);
    const double cosine = place.normal.dot(incident.direction);
    if (!(cosine > 0)) return;
    const Vec3 origin = place.surface + lift_ * place.normal;
    if (geometry_.occluded(origin, incident.direction, incident.distance)) return;
    EnteringBeam beam;
    beam.s = place.s;
    beam.t = place.t;
    beam.direction = refracted(incident.direction, place.normal, cosine, ior_);
    // Where the mesh's normal and the quad's differ much, a beam must still go in.
    if (beam.direction.dot(place.at.normal) > -0.02) beam.direction = -place.at.normal;
    const Double4 irradiance = to_double(to_lanes(incident.irradiance));
    beam.power = irradiance * (area * cosine * fresnel_transmittance(cosine, ior_));
    list.push_back(beam);
  }

  // Of a lamp whose light changes within the quad: from as many places as that takes.
  void enter_near(std::int32_t quad, double width, const SimpleLight& lamp, std::vector<EnteringBeam>& list) const {
    const Vec3 position = *lamp_position(lamp);
    for_lamp_parts(
        width, [&](double s, double t) { return (place_of(quad, s, t).surface - position).norm(); },
        [&](const SquarePart& part) {
          for (const double gs : gauss)
            for (const double gt : gauss) {
              const Place place = place_of(quad, part.s + gs * part.size, part.t + gt * part.size);
              add(place, lamp, 0.25 * part.size * part.size * place.at.area, list);
            }
        });
  }

  // Beams at one place of a quad: of lights of one direction, if it stands for a `share` of the quad, and of those
  // parts of the others that meet the quad there. But of those that are `near`.
  template <class Near>
  void enter(std::int32_t quad, int place, double s, double t, double share, const Near& near,
             std::vector<EnteringBeam>& list) const {
    const Place here = place_of(quad, s, t);
    if (share > 0)
      for (const SimpleLight& light : single_)
        if (!near(light)) add(here, light, share * here.at.area, list);
    const auto turn = static_cast<std::size_t>(quad);
    const auto stride = static_cast<std::size_t>(density_.stride);
    for (std::size_t k = 0; k < parts_.size(); ++k)
      if ((k + turn / stride) % 4 == static_cast<std::size_t>(place) && (k / 4 + turn) % stride == 0 &&
          !near(parts_[k]))
        add(here, parts_[k], density_.stride * here.at.area, list);
  }

  const Polygrid& polygrid_;
  const TriangleMesh& surface_;
  const SceneGeometry& geometry_;
  const std::vector<Light>& lights_;
  const double ior_;
  const VertexMatrix normals_;
  const ClosestPointQuery query_;
  const double lift_;
  Density density_;
  std::vector<SimpleLight> single_, parts_;
};

}  // namespace

BeamSource trace_beams(const Polygrid& polygrid, const CellCoefficients& coefficients, double ior,
                       const BeamsOf& beams_of) {
  return trace(polygrid, CellNeighbours(polygrid), coefficients, ior, beams_of);
}

BeamSource first_collision_source(const Polygrid& polygrid, const CellCoefficients& coefficients,
                                  const TriangleMesh& surface, const SceneGeometry& geometry,
                                  const std::vector<Light>& lights, double ior, int environment_samples,
                                  double most_steps) {
  constexpr double most_beams = 2e6;
  constexpr int least_samples = 16, most_stride = 7, pilot_stride = 61;
  const auto quads = std::max<double>(1, static_cast<double>(polygrid.boundary_quads.rows()));
  const CellNeighbours neighbours(polygrid);
  LightBeams beams(polygrid, surface, geometry, lights, ior);
  LightBeams::Density density;
  density.samples = std::min(environment_samples, std::max(least_samples, static_cast<int>(most_beams / quads)));
  beams.set_density(density);

  // Beams go far where little is in their way. A few of them tell how many may go.
  const BeamSource pilot =
      trace(polygrid, neighbours, coefficients, ior, [&](std::int32_t quad, std::vector<EnteringBeam>& list) {
        if (quad % pilot_stride == 0) beams.list(quad, list);
      });
  const double excess = static_cast<double>(pilot.steps) * pilot_stride / most_steps;
  if (excess > 1) {
    density.places = excess > 2 ? 1 : 2;
    // Odd, because the quads' order has a structure of powers of two.
    density.stride = static_cast<int>(std::min<double>(most_stride, std::ceil(excess))) | 1;
    density.samples = std::max(std::min(least_samples, density.samples),
                               static_cast<int>(density.samples / std::max(1.0, excess / density.stride)));
    beams.set_density(density);
  }
  BeamSource result = trace(polygrid, neighbours, coefficients, ior,
                            [&](std::int32_t quad, std::vector<EnteringBeam>& list) { beams.list(quad, list); });
  result.environment_lights = beams.parts();
  return result;
}

}  // namespace shellgrid
