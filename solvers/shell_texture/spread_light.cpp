// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/spread_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

#include "meshing/core/error.h"

namespace shellgrid {

namespace {

constexpr double counted_share = 0.97;  // of a kernel's light
constexpr int cells_a_radius = 2;
constexpr double apart = 0.8;  // buckets farther off than so many cells count as wholes

std::uint64_t cell_key(const Vec3i& cell) {
  const auto part = [](int i) { return static_cast<std::uint64_t>(i + (1 << 20)) & 0x1fffff; };
  return part(cell.x()) << 42 | part(cell.y()) << 21 | part(cell.z());
}

}  // namespace

IrradianceKernels corrected_by(const IrradianceKernels& kernels, IrradianceCorrection correction) {
  if (correction == IrradianceCorrection::none) return {};
  return correction == IrradianceCorrection::one_kernel ? kernels.merged() : kernels;
}

template <class T>
template <class Make>
const T& SpreadLight::Lazy<T>::get(int index, const Make& make) const {
  if (const T* found = known[index].load(std::memory_order_acquire)) return *found;
  auto made = std::make_unique<const T>(make());
  const std::lock_guard lock(mutex);
  if (const T* found = known[index].load(std::memory_order_acquire)) return *found;
  owned.push_back(std::move(made));
  known[index].store(owned.back().get(), std::memory_order_release);
  return *owned.back();
}

SpreadLight::SpreadLight(const IncidentLight& incident, const IrradianceKernels& kernels, const Vec3i& sample,
                         const std::vector<Vec2f>& coordinates)
    : incident_(incident), kernels_(kernels), sample_(sample), coordinates_(coordinates) {
  const TriangleMesh& mesh = incident.frames().mesh;
  const auto n = static_cast<std::size_t>(mesh.vertex_count());
  entries_.known = std::vector<std::atomic<const Entry*>>(n);
  if (kernels.empty()) return;
  if (coordinates.size() != n) throw InputError("the surface's texture coordinates do not have its size");
  if (!kernels.is_sound(sample)) throw InputError("the irradiance kernels do not fit the sample");
  mean_kernel_ = kernels.merged();
  radius_ = kernels.radius(counted_share);
  edge_ = radius_ / cells_a_radius;
  areas_.assign(n, 0.0f);
  for (int f = 0; f < mesh.face_count(); ++f) {
    const Vec3 a = mesh.corner(f, 0), b = mesh.corner(f, 1), c = mesh.corner(f, 2);
    const auto third = static_cast<float>((b - a).cross(c - a).norm() / 6);
    for (int k = 0; k < 3; ++k) areas_[mesh.faces(f, k)] += third;
  }
  sort_into_buckets();
  means_.known = std::vector<std::atomic<const Entry*>>(buckets_.size());
  spreads_.known = std::vector<std::atomic<const std::vector<std::vector<DirectionWeight>>*>>(n);
}

void SpreadLight::sort_into_buckets() {
  const TexturedFrames& frames = incident_.frames();
  struct Place {
    std::uint64_t cell;
    int side, vertex;
    auto operator<=>(const Place&) const = default;
  };
  std::vector<Place> places;
  for (int v = 0; v < frames.mesh.vertex_count(); ++v) {
    const Vec3i cell = (frames.mesh.vertex(v) / edge_).array().floor().cast<int>();
    const Vec3 normal = frames.normals.row(v).transpose();
    int axis = 0;
    normal.cwiseAbs().maxCoeff(&axis);
    places.push_back({cell_key(cell), 2 * axis + (normal[axis] > 0), v});
  }
  std::sort(places.begin(), places.end());
  for (std::size_t k = 0; k < places.size(); ++k) {
    if (k == 0 || places[k].cell != places[k - 1].cell || places[k].side != places[k - 1].side) {
      cells_.emplace_back(places[k].cell, static_cast<int>(buckets_.size()));
      buckets_.emplace_back();
    }
    buckets_.back().members.push_back(places[k].vertex);
  }
  for (Bucket& bucket : buckets_) {
    for (const int v : bucket.members) {
      const auto area = static_cast<double>(areas_[v]);
      bucket.area += area;
      bucket.middle += area * frames.mesh.vertex(v);
      bucket.facing += area * frames.normals.row(v).transpose();
    }
    bucket.middle = bucket.area > 0 ? Vec3(bucket.middle / bucket.area) : frames.mesh.vertex(bucket.members.front());
    for (const int v : bucket.members)
      bucket.radius = std::max(bucket.radius, (frames.mesh.vertex(v) - bucket.middle).norm());
  }
}

const SpreadLight::Entry& SpreadLight::entry(int vertex) const {
  return entries_.get(vertex, [&] {
    Entry made{incident_.at(vertex), Vec3f::Zero()};
    for (const DirectionWeight& one : made.light)
      made.irradiance += one.weight * static_cast<float>(incident_.directions().direction(one.direction).z());
    return made;
  });
}

const std::vector<DirectionWeight>& SpreadLight::at(int vertex) const { return entry(vertex).light; }

namespace {

// Lists of light summed by direction.
class LightSum {
 public:
  explicit LightSum(int directions) : sums_(directions, Vec3f::Zero()) {}
  void add(const Vec3f& weight, const std::vector<DirectionWeight>& light) {
    for (const DirectionWeight& one : light) sums_[one.direction] += weight.cwiseProduct(one.weight);
    weights_ += weight;
  }
  std::vector<DirectionWeight> mean() const {
    std::vector<DirectionWeight> list;
    for (int d = 0; d < static_cast<int>(sums_.size()); ++d)
      if ((sums_[d].array() > 0).any())
        list.push_back({d, (weights_.array() > 0).select(sums_[d].array() / weights_.array().max(1e-30f), 0.0f)});
    return list;
  }

 private:
  std::vector<Vec3f> sums_;
  Vec3f weights_ = Vec3f::Zero();
};

}  // namespace

const SpreadLight::Entry& SpreadLight::mean_of(int bucket) const {
  return means_.get(bucket, [&] {
    LightSum sum(incident_.directions().count());
    Entry made;
    for (const int v : buckets_[bucket].members) {
      const Entry& own = entry(v);
      sum.add(Vec3f::Constant(areas_[v]), own.light);
      if (buckets_[bucket].area > 0)
        made.irradiance += areas_[v] / static_cast<float>(buckets_[bucket].area) * own.irradiance;
    }
    made.light = sum.mean();
    return made;
  });
}

const std::vector<std::vector<DirectionWeight>>& SpreadLight::spread(int vertex) const {
  static const std::vector<std::vector<DirectionWeight>> none;
  if (kernels_.empty()) return none;
  return spreads_.get(vertex, [&] { return worked_out(vertex, 0); });
}

std::vector<DirectionWeight> SpreadLight::at_bottom(int vertex) const {
  if (kernels_.empty()) return at(vertex);
  auto spread = worked_out(vertex, kernels_.bottom());
  return spread.empty() ? at(vertex) : std::move(spread.front());
}

std::vector<std::vector<DirectionWeight>> SpreadLight::worked_out(int vertex, int first_band) const {
  const TexturedFrames& frames = incident_.frames();
  const Vec3 point = frames.mesh.vertex(vertex), normal = frames.normals.row(vertex).transpose();
  struct Part {
    const Entry* entry;
    const IrradianceKernels* kernels;
    int kernel;
    double distance;
    float area;
  };
  std::vector<Part> parts;
  const Vec3i cell = (point / edge_).array().floor().cast<int>();
  constexpr int reach = cells_a_radius + 1;
  for (int x = -reach; x <= reach; ++x)
    for (int y = -reach; y <= reach; ++y) {
      const std::uint64_t first = cell_key(cell + Vec3i(x, y, -reach)), last = cell_key(cell + Vec3i(x, y, reach));
      for (auto at = std::lower_bound(cells_.begin(), cells_.end(), std::pair(first, 0));
           at != cells_.end() && at->first <= last; ++at) {
        const Bucket& bucket = buckets_[at->second];
        if (!(bucket.facing.dot(normal) > 0)) continue;
        const double distance = (bucket.middle - point).norm();
        if (distance - bucket.radius > radius_) continue;
        if (distance > apart * edge_ + bucket.radius) {
          parts.push_back({&mean_of(at->second), &mean_kernel_, 0, distance, static_cast<float>(bucket.area)});
          continue;
        }
        for (const int v : bucket.members) {
          const auto wrapped = [](float place, int n) {
            const int i = static_cast<int>(std::floor(place)) % n;
            return i < 0 ? i + n : i;
          };
          const std::size_t texel = static_cast<std::size_t>(wrapped(coordinates_[v].y(), sample_.y())) * sample_.x() +
                                    wrapped(coordinates_[v].x(), sample_.x());
          parts.push_back(
              {&entry(v), &kernels_, kernels_.of_texel[texel], (frames.mesh.vertex(v) - point).norm(), areas_[v]});
        }
      }
    }
  const Entry& own = entry(vertex);
  Vec3f brightest = own.irradiance;
  for (const Part& part : parts) brightest = brightest.cwiseMax(part.entry->irradiance);
  std::vector<std::vector<DirectionWeight>> result;
  if (!(brightest.array() > 0).any()) return result;
  const auto differs = [&](const Vec3f& light, int c) {
    return std::abs(light[c] - own.irradiance[c]) > static_cast<float>(unevenness) * brightest[c];
  };
  bool even = true;
  for (const Part& part : parts)
    for (int c = 0; c < 3; ++c) even = even && !differs(part.entry->irradiance, c);
  if (even) return result;
  even = true;
  const int bands = kernels_.bands();
  std::vector<Vec3f> weights(parts.size() * bands);
  for (int band = first_band; band < bands; ++band) {
    Vec3f sum = Vec3f::Zero(), light = Vec3f::Zero();
    for (std::size_t p = 0; p < parts.size(); ++p) {
      const Vec3f weight = parts[p].area * parts[p].kernels->value(parts[p].kernel, band, parts[p].distance);
      weights[p * bands + band] = weight;
      sum += weight;
      light += weight.cwiseProduct(parts[p].entry->irradiance);
    }
    for (int c = 0; c < 3; ++c)
      if (sum[c] > 0 && differs(light / sum[c], c)) even = false;
  }
  if (even) return result;
  for (int band = first_band; band < bands; ++band) {
    LightSum sum(incident_.directions().count());
    bool any = false;
    for (std::size_t p = 0; p < parts.size(); ++p) {
      const Vec3f& weight = weights[p * bands + band];
      if (!(weight.array() > 0).any()) continue;
      sum.add(weight, parts[p].entry->light);
      any = true;
    }
    result.push_back(any ? sum.mean() : own.light);
  }
  ++spread_vertices_;
  return result;
}

}  // namespace shellgrid
