// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/spread_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

constexpr double counted_share = 0.97;  // of a kernel's light
constexpr int cells_a_radius = 4;
constexpr int reach = cells_a_radius + 1;
constexpr double apart = 0.8;   // buckets farther off than so many cells count as wholes
constexpr double sudden = 0.1;  // of the brightest: a difference within a cell that may be a shadow's

// Kernels of light that enters evenly on a square of that edge, about as on a disc: by the distance to its middle.
IrradianceKernels spread_out(const IrradianceKernels& kernel, double edge) {
  constexpr int across = 8;
  IrradianceKernels result = kernel;
  for (int row = 0; row < kernel.count() * kernel.bands(); ++row)
    for (int ring = 0; ring < kernel.rings; ++ring) {
      const double distance = (ring + 0.5) * kernel.ring;
      Vec3f sum = Vec3f::Zero();
      for (int x = 0; x < across; ++x)
        for (int y = 0; y < across; ++y)
          sum +=
              kernel.value(row / kernel.bands(), row % kernel.bands(),
                           std::hypot(distance + ((x + 0.5) / across - 0.5) * edge, ((y + 0.5) / across - 0.5) * edge));
      result.values[static_cast<std::size_t>(row) * kernel.rings + ring] = sum / (across * across);
    }
  return result;
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
  radius_ = kernels.radius(counted_share);
  edge_ = radius_ / cells_a_radius;
  areas_ = vertex_areas(mesh);
  whole_kernels_ = spread_out(kernels, edge_);
  buckets_ = VertexBuckets(incident.frames(), areas_, edge_);
  const auto count = static_cast<std::size_t>(buckets_.count());
  kernel_areas_.resize(count);
  parallel_for(count, [&](std::size_t b) {
    std::vector<float> areas(kernels.count(), 0.0f);
    for (const int v : buckets_[static_cast<int>(b)].members) areas[kernel_of(v)] += areas_[v];
    for (int k = 0; k < kernels.count(); ++k)
      if (areas[k] > 0) kernel_areas_[b].emplace_back(k, areas[k]);
  });
  means_.known = std::vector<std::atomic<const Entry*>>(count);
  about_.known = std::vector<std::atomic<const std::vector<int>*>>(count);
  even_ = std::vector<std::atomic<std::uint8_t>>(count);
  even_about_ = std::vector<std::atomic<std::uint8_t>>(count);
  spreads_.known = std::vector<std::atomic<const std::vector<std::vector<DirectionWeight>>*>>(n);
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

int SpreadLight::kernel_of(int vertex) const {
  const auto wrapped = [](float place, int n) {
    const int i = static_cast<int>(std::floor(place)) % n;
    return i < 0 ? i + n : i;
  };
  const Vec2f& at = coordinates_[vertex];
  return kernels_
      .of_texel[static_cast<std::size_t>(wrapped(at.y(), sample_.y())) * sample_.x() + wrapped(at.x(), sample_.x())];
}

const std::vector<int>& SpreadLight::about(int index) const {
  return about_.get(index, [&] {
    const VertexBuckets::Bucket& bucket = buckets_[index];
    std::vector<int> list;
    buckets_.visit_about(bucket.middle, reach, [&](int other) {
      if ((buckets_[other].middle - bucket.middle).norm() - buckets_[other].radius - bucket.radius <= radius_)
        list.push_back(other);
    });
    return list;
  });
}

bool SpreadLight::is_even(int index) const {
  if (const std::uint8_t known = even_[index].load(std::memory_order_relaxed)) return known == 2;
  const VertexBuckets::Bucket& bucket = buckets_[index];
  const Vec3f own = mean_of(index).irradiance;
  Vec3f brightest = own;
  const int bands = kernels_.bands();
  std::vector<Vec3f> sums(bands, Vec3f::Zero()), lights(bands, Vec3f::Zero());
  for (const int other : about(index)) {
    const VertexBuckets::Bucket& about = buckets_[other];
    if (!(about.facing.dot(bucket.facing) > 0)) continue;
    const double distance = (about.middle - bucket.middle).norm();
    if (distance - about.radius > radius_) continue;
    const Vec3f light = mean_of(other).irradiance;
    brightest = brightest.cwiseMax(light);
    for (int band = 0; band < bands; ++band) {
      Vec3f weight = Vec3f::Zero();
      for (const auto& [kernel, area] : kernel_areas_[other])
        weight += area * whole_kernels_.value(kernel, band, distance);
      sums[band] += weight;
      lights[band] += weight.cwiseProduct(light);
    }
  }
  bool even = true;
  const auto differ = [&](const Vec3f& light, double share) {
    return ((light - own).array().abs() > static_cast<float>(share) * brightest.array()).any();
  };
  for (int band = 0; band < bands && even; ++band)
    even = !differ((sums[band].array() > 0).select(lights[band].array() / sums[band].array().max(1e-30f), own.array()),
                   0.8 * unevenness);
  for (std::size_t k = 0; k < bucket.members.size() && even; ++k)
    even = !differ(entry(bucket.members[k]).irradiance, sudden);
  even_[index].store(even ? 2 : 1, std::memory_order_relaxed);
  return even;
}

bool SpreadLight::is_even_about(int index) const {
  if (const std::uint8_t known = even_about_[index].load(std::memory_order_relaxed)) return known == 2;
  bool even = true;
  buckets_.visit_about(buckets_[index].middle, 1, [&](int other) {
    even = even && (!(buckets_[other].facing.dot(buckets_[index].facing) > 0) || is_even(other));
  });
  even_about_[index].store(even ? 2 : 1, std::memory_order_relaxed);
  return even;
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
  if (is_even_about(buckets_.of_vertex(vertex))) return {};
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
  for (const int index : about(buckets_.of_vertex(vertex))) {
    const VertexBuckets::Bucket& bucket = buckets_[index];
    if (!(bucket.facing.dot(normal) > 0)) continue;
    const double distance = (bucket.middle - point).norm();
    if (distance - bucket.radius > radius_) continue;
    if (distance > apart * edge_ + bucket.radius) {
      for (const auto& [kernel, area] : kernel_areas_[index])
        parts.push_back({&mean_of(index), &whole_kernels_, kernel, distance, area});
      continue;
    }
    for (const int v : bucket.members) {
      parts.push_back({&entry(v), &kernels_, kernel_of(v), (frames.mesh.vertex(v) - point).norm(), areas_[v]});
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
