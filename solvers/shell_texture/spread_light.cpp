// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/spread_light.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>

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
  point_kernels_ = BandKernels(kernels);
  whole_kernels_ = BandKernels(spread_out(kernels, edge_));
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

Float4 lanes(const Vec3f& v) { return to_lanes(v.array()); }
Vec3f colour(Float4 v) { return {v[0], v[1], v[2]}; }

// Lists of light summed by direction, each by so many weights.
class LightSums {
 public:
  LightSums(int directions, int sums)
      : count_(sums),
        wide_((sums + 3) / 4),
        weights_(wide_, Float16{}),
        sums_(static_cast<std::size_t>(directions) * wide_, Float16{}) {}
  void add(const Float4* weights, const std::vector<DirectionWeight>& light) {
    Float16 own[most_wide];
    for (int w = 0; w < wide_; ++w) {
      Float4 four[4] = {};
      for (int k = 0; k < 4 && 4 * w + k < count_; ++k) four[k] = weights[4 * w + k];
      std::memcpy(&own[w], four, sizeof(Float16));
      weights_[w] += own[w];
    }
    for (const DirectionWeight& one : light) {
      const float r = one.weight[0], g = one.weight[1], b = one.weight[2];
      const Float16 all = {r, g, b, 0, r, g, b, 0, r, g, b, 0, r, g, b, 0};
      Float16* sum = sums_.data() + static_cast<std::size_t>(one.direction) * wide_;
      for (int w = 0; w < wide_; ++w) sum[w] += own[w] * all;
    }
  }
  // Whether anything was added with a weight.
  bool any(int sum) const { return (weight(sum).array() > 0).any(); }
  std::vector<DirectionWeight> mean(int sum) const {
    const Vec3f over = weight(sum);
    const auto at = [&](int d) { return part(sums_[static_cast<std::size_t>(d) * wide_ + sum / 4], sum % 4); };
    const auto directions = static_cast<int>(sums_.size()) / wide_;
    int lit = 0;
    for (int d = 0; d < directions; ++d) lit += (at(d).array() > 0).any();
    std::vector<DirectionWeight> list;
    list.reserve(static_cast<std::size_t>(lit));
    for (int d = 0; d < directions; ++d)
      if ((at(d).array() > 0).any())
        list.push_back({d, (over.array() > 0).select(at(d).array() / over.array().max(1e-30f), 0.0f)});
    return list;
  }
  static constexpr int most_wide = 8;  // of four sums each

 private:
  using Float16 = float __attribute__((vector_size(64)));
  static Vec3f part(const Float16& wide, int k) { return {wide[4 * k], wide[4 * k + 1], wide[4 * k + 2]}; }
  Vec3f weight(int sum) const { return part(weights_[sum / 4], sum % 4); }

  int count_, wide_;
  std::vector<Float16> weights_, sums_;
};

}  // namespace

BandKernels::BandKernels(const IrradianceKernels& kernels)
    : bands_(kernels.bands()), rings_(kernels.rings), per_ring_(1 / kernels.ring) {
  for (int kernel = 0; kernel < kernels.count(); ++kernel)
    for (int ring = 0; ring <= rings_; ++ring)
      for (int band = 0; band < bands_; ++band)
        values_.push_back(
            ring == rings_ ? Float4{}
                           : lanes(kernels.values[(static_cast<std::size_t>(kernel) * bands_ + band) * rings_ + ring]));
}

void BandKernels::add(int kernel, double distance, float area, int first, int end, Float4* sums) const {
  const double place = std::max(0.0, distance * per_ring_ - 0.5);
  if (place >= rings_) return;
  const int ring = static_cast<int>(place);
  const auto t = static_cast<float>(place - ring);
  const Float4* row = values_.data() + (static_cast<std::size_t>(kernel) * (rings_ + 1) + ring) * bands_;
  for (int band = first; band < end; ++band)
    sums[band - first] += area * ((1 - t) * row[band] + t * row[bands_ + band]);
}

const SpreadLight::Entry& SpreadLight::mean_of(int bucket) const {
  return means_.get(bucket, [&] {
    LightSums sum(incident_.directions().count(), 1);
    Entry made;
    for (const int v : buckets_[bucket].members) {
      const Entry& own = entry(v);
      const Float4 area = lanes(Vec3f::Constant(areas_[v]));
      sum.add(&area, own.light);
      if (buckets_[bucket].area > 0)
        made.irradiance += areas_[v] / static_cast<float>(buckets_[bucket].area) * own.irradiance;
    }
    made.light = sum.mean(0);
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
  std::vector<Float4> sums(bands, Float4{}), lights(bands, Float4{}), weights(bands);
  for (const int other : about(index)) {
    const VertexBuckets::Bucket& about = buckets_[other];
    if (!(about.facing.dot(bucket.facing) > 0)) continue;
    const double distance = (about.middle - bucket.middle).norm();
    if (distance - about.radius > radius_) continue;
    const Vec3f light = mean_of(other).irradiance;
    brightest = brightest.cwiseMax(light);
    std::fill(weights.begin(), weights.end(), Float4{});
    for (const auto& [kernel, area] : kernel_areas_[other])
      whole_kernels_.add(kernel, distance, area, 0, bands, weights.data());
    for (int band = 0; band < bands; ++band) {
      sums[band] += weights[band];
      lights[band] += weights[band] * lanes(light);
    }
  }
  bool even = true;
  const auto differ = [&](const Vec3f& light, double share) {
    return ((light - own).array().abs() > static_cast<float>(share) * brightest.array()).any();
  };
  for (int band = 0; band < bands && even; ++band) {
    const Vec3f sum = colour(sums[band]), light = colour(lights[band]);
    even = !differ((sum.array() > 0).select(light.array() / sum.array().max(1e-30f), own.array()), 0.8 * unevenness);
  }
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

std::vector<std::vector<DirectionWeight>> SpreadLight::spread(int vertex) const {
  if (kernels_.empty()) return {};
  return worked_out(vertex, 0, kernels_.bottom());
}

std::vector<DirectionWeight> SpreadLight::at_bottom(int vertex) const {
  if (kernels_.empty()) return at(vertex);
  auto spread = worked_out(vertex, kernels_.bottom(), kernels_.bands());
  return spread.empty() ? at(vertex) : std::move(spread.front());
}

std::vector<std::vector<DirectionWeight>> SpreadLight::worked_out(int vertex, int first_band, int end_band) const {
  if (is_even_about(buckets_.of_vertex(vertex))) return {};
  const TexturedFrames& frames = incident_.frames();
  const Vec3 point = frames.mesh.vertex(vertex), normal = frames.normals.row(vertex).transpose();
  const int bands = end_band - first_band;
  std::vector<const Entry*> parts;
  std::vector<Float4> weights;  // of each part, by bands
  const auto add = [&](const Entry& entry) {
    parts.push_back(&entry);
    weights.resize(weights.size() + bands, Float4{});
    return weights.data() + weights.size() - bands;
  };
  for (const int index : about(buckets_.of_vertex(vertex))) {
    const VertexBuckets::Bucket& bucket = buckets_[index];
    if (!(bucket.facing.dot(normal) > 0)) continue;
    const double distance = (bucket.middle - point).norm();
    if (distance - bucket.radius > radius_) continue;
    if (distance > apart * edge_ + bucket.radius) {
      Float4* const weight = add(mean_of(index));
      for (const auto& [kernel, area] : kernel_areas_[index])
        whole_kernels_.add(kernel, distance, area, first_band, end_band, weight);
      continue;
    }
    for (const int v : bucket.members)
      point_kernels_.add(kernel_of(v), (frames.mesh.vertex(v) - point).norm(), areas_[v], first_band, end_band,
                         add(entry(v)));
  }
  const Entry& own = entry(vertex);
  Vec3f brightest = own.irradiance;
  for (const Entry* part : parts) brightest = brightest.cwiseMax(part->irradiance);
  std::vector<std::vector<DirectionWeight>> result;
  if (!(brightest.array() > 0).any()) return result;
  const Vec3f bound = static_cast<float>(unevenness) * brightest;
  bool even = true;
  for (const Entry* part : parts)
    even = even && !((part->irradiance - own.irradiance).array().abs() > bound.array()).any();
  if (even) return result;
  even = true;
  for (int band = 0; band < bands && even; ++band) {
    Float4 sum{}, light{};
    for (std::size_t p = 0; p < parts.size(); ++p) {
      sum += weights[p * bands + band];
      light += weights[p * bands + band] * lanes(parts[p]->irradiance);
    }
    for (int c = 0; c < 3; ++c)
      if (sum[c] > 0 && std::abs(light[c] / sum[c] - own.irradiance[c]) > bound[c]) even = false;
  }
  if (even) return result;
  constexpr int together = 4 * LightSums::most_wide;
  for (int first = 0; first < bands; first += together) {
    const int count = std::min(together, bands - first);
    LightSums sums(incident_.directions().count(), count);
    for (std::size_t p = 0; p < parts.size(); ++p) sums.add(weights.data() + p * bands + first, parts[p]->light);
    for (int k = 0; k < count; ++k) result.push_back(sums.any(k) ? sums.mean(k) : own.light);
  }
  ++spread_vertices_;
  return result;
}

}  // namespace shellgrid
