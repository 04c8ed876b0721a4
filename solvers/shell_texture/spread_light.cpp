// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/spread_light.h"

#ifdef __AVX512F__
#include <immintrin.h>
#endif

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstring>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"

namespace shellgrid {

namespace {

constexpr double counted_share = 0.97;  // of a kernel's light
constexpr int cells_a_radius = 4;
constexpr int reach = cells_a_radius + 1;
constexpr std::size_t usual_parts = 160;
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
  const IrradianceKernels whole = spread_out(kernels, edge_);
  within_ = {BandKernels(kernels, 0, kernels.bottom()), BandKernels(whole, 0, kernels.bottom())};
  bottom_ = {BandKernels(kernels, kernels.bottom(), kernels.bands()),
             BandKernels(whole, kernels.bottom(), kernels.bands())};
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

using Lanes = BandKernels::Lanes;

// A colour four times.
Lanes four_times(const Float4& colour) {
#ifdef __AVX512F__
  return reinterpret_cast<Lanes>(_mm512_broadcast_f32x4(reinterpret_cast<__m128>(colour)));
#else
  const float r = colour[0], g = colour[1], b = colour[2];
  const Lanes wide = {r, g, b, 0, r, g, b, 0, r, g, b, 0, r, g, b, 0};
  return wide;
#endif
}
Lanes four_times(const Vec3f& v) { return four_times(to_lanes(v.array())); }
Lanes four_times(const DirectionWeight& one) {
  static_assert(sizeof(DirectionWeight) == sizeof(Float4) && offsetof(DirectionWeight, weight) == sizeof(float));
  Float4 number_and_colour;
  std::memcpy(&number_and_colour, &one, sizeof one);
  return four_times(__builtin_shufflevector(number_and_colour, Float4{}, 1, 2, 3, 4));
}
// Of one of the four.
Vec3f colour(const Lanes& wide, int k) { return {wide[4 * k], wide[4 * k + 1], wide[4 * k + 2]}; }

// Lists of light summed by direction, each by so many weights, four in a register.
class LightSums {
 public:
  // Afresh, in the memory of those before.
  void begin(int directions, int sums) {
    wide_ = (sums + 3) / 4;
    weights_.assign(wide_, Lanes{});
    sums_.assign(static_cast<std::size_t>(directions) * wide_, Lanes{});
  }
  void add(const Lanes* weights, const std::vector<DirectionWeight>& light) {
    for (int w = 0; w < wide_; ++w) weights_[w] += weights[w];
    for (const DirectionWeight& one : light) {
      const Lanes all = four_times(one);
      Lanes* sum = sums_.data() + static_cast<std::size_t>(one.direction) * wide_;
      for (int w = 0; w < wide_; ++w) sum[w] += weights[w] * all;
    }
  }
  // Whether anything was added with a weight.
  bool any(int sum) const { return (weight(sum).array() > 0).any(); }
  std::vector<DirectionWeight> mean(int sum) const {
    const Vec3f over = weight(sum);
    const auto at = [&](int d) { return colour(sums_[static_cast<std::size_t>(d) * wide_ + sum / 4], sum % 4); };
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

 private:
  Vec3f weight(int sum) const { return colour(weights_[sum / 4], sum % 4); }

  int wide_ = 0;
  std::vector<Lanes> weights_, sums_;
};

// Kept by each thread: allocated anew for every place, aligned memory among lists that stay leaves gaps.
LightSums& kept_sums(int directions, int sums) {
  thread_local LightSums kept;
  kept.begin(directions, sums);
  return kept;
}
std::vector<Lanes>& kept_weights() {
  thread_local std::vector<Lanes> kept;
  kept.clear();
  return kept;
}

}  // namespace

BandKernels::BandKernels(const IrradianceKernels& kernels, int first_band, int end_band)
    : bands_(end_band - first_band), rings_(kernels.rings), per_ring_(1 / kernels.ring) {
  values_.assign(static_cast<std::size_t>(kernels.count()) * (rings_ + 1) * wide(), Lanes{});
  for (int kernel = 0; kernel < kernels.count(); ++kernel)
    for (int ring = 0; ring < rings_; ++ring)
      for (int band = 0; band < bands_; ++band) {
        const Vec3f& value =
            kernels.values[(static_cast<std::size_t>(kernel) * kernels.bands() + first_band + band) * rings_ + ring];
        Lanes& to = values_[(static_cast<std::size_t>(kernel) * (rings_ + 1) + ring) * wide() + band / 4];
        for (int c = 0; c < 3; ++c) to[4 * (band % 4) + c] = value[c];
      }
}

void BandKernels::add(int kernel, double distance, float area, Lanes* sums) const {
  const double place = std::max(0.0, distance * per_ring_ - 0.5);
  if (place >= rings_) return;
  const int ring = static_cast<int>(place), count = wide();
  const float second = area * static_cast<float>(place - ring), first = area - second;
  const Lanes* row = values_.data() + (static_cast<std::size_t>(kernel) * (rings_ + 1) + ring) * count;
  for (int w = 0; w < count; ++w) sums[w] += first * row[w] + second * row[count + w];
}

const SpreadLight::Entry& SpreadLight::mean_of(int bucket) const {
  return means_.get(bucket, [&] {
    for (const int v : buckets_[bucket].members) entry(v);
    LightSums& sum = kept_sums(incident_.directions().count(), 1);
    Entry made;
    for (const int v : buckets_[bucket].members) {
      const Entry& own = entry(v);
      const Lanes area = four_times(Vec3f::Constant(areas_[v]));
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
  const int inner = within_.whole.wide(), wide = inner + bottom_.whole.wide();
  std::vector<Lanes> sums(wide, Lanes{}), lights(wide, Lanes{}), weights(wide);
  for (const int other : about(index)) {
    const VertexBuckets::Bucket& about = buckets_[other];
    if (!(about.facing.dot(bucket.facing) > 0)) continue;
    const double distance = (about.middle - bucket.middle).norm();
    if (distance - about.radius > radius_) continue;
    const Vec3f light = mean_of(other).irradiance;
    brightest = brightest.cwiseMax(light);
    std::fill(weights.begin(), weights.end(), Lanes{});
    for (const auto& [kernel, area] : kernel_areas_[other]) {
      within_.whole.add(kernel, distance, area, weights.data());
      bottom_.whole.add(kernel, distance, area, weights.data() + inner);
    }
    const Lanes all = four_times(light);
    for (int w = 0; w < wide; ++w) {
      sums[w] += weights[w];
      lights[w] += weights[w] * all;
    }
  }
  bool even = true;
  const auto differ = [&](const Vec3f& light, double share) {
    return ((light - own).array().abs() > static_cast<float>(share) * brightest.array()).any();
  };
  for (int k = 0; k < 4 * wide && even; ++k) {
    const Vec3f sum = colour(sums[k / 4], k % 4), light = colour(lights[k / 4], k % 4);
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
  return worked_out(vertex, within_);
}

std::vector<DirectionWeight> SpreadLight::at_bottom(int vertex) const {
  if (kernels_.empty()) return at(vertex);
  auto spread = worked_out(vertex, bottom_);
  return spread.empty() ? at(vertex) : std::move(spread.front());
}

std::vector<std::vector<DirectionWeight>> SpreadLight::worked_out(int vertex, const Reach& reach) const {
  if (is_even_about(buckets_.of_vertex(vertex))) return {};
  const TexturedFrames& frames = incident_.frames();
  const Vec3 point = frames.mesh.vertex(vertex), normal = frames.normals.row(vertex).transpose();
  const int bands = reach.point.bands(), wide = reach.point.wide();
  std::vector<const Entry*> parts;
  parts.reserve(usual_parts);
  const Entry& own = entry(vertex);
  struct Part {
    int bucket, vertex;  // vertex −1: all of the bucket
    double distance;
  };
  std::vector<Part> places;
  places.reserve(usual_parts);
  for (const int index : about(buckets_.of_vertex(vertex))) {
    const VertexBuckets::Bucket& bucket = buckets_[index];
    if (!(bucket.facing.dot(normal) > 0)) continue;
    const double distance = (bucket.middle - point).norm();
    if (distance - bucket.radius > radius_) continue;
    if (distance > apart * edge_ + bucket.radius) {
      parts.push_back(&mean_of(index));
      places.push_back({index, -1, distance});
      continue;
    }
    for (const int v : bucket.members) {
      parts.push_back(&entry(v));
      places.push_back({index, v, (frames.mesh.vertex(v) - point).norm()});
    }
  }
  Vec3f brightest = own.irradiance;
  for (const Entry* part : parts) brightest = brightest.cwiseMax(part->irradiance);
  if (!(brightest.array() > 0).any()) return {};
  const Vec3f bound = static_cast<float>(unevenness) * brightest;
  bool even = true;
  for (const Entry* part : parts)
    even = even && !((part->irradiance - own.irradiance).array().abs() > bound.array()).any();
  if (even) return {};
  std::vector<Lanes>& weights = kept_weights();  // of each part, by bands
  weights.resize(parts.size() * wide, Lanes{});
  for (std::size_t p = 0; p < places.size(); ++p) {
    const Part& part = places[p];
    Lanes* const to = weights.data() + p * wide;
    if (part.vertex >= 0)
      reach.point.add(kernel_of(part.vertex), part.distance, areas_[part.vertex], to);
    else
      for (const auto& [kernel, area] : kernel_areas_[part.bucket]) reach.whole.add(kernel, part.distance, area, to);
  }
  even = true;
  for (int w = 0; w < wide && even; ++w) {
    Lanes sum{}, light{};
    for (std::size_t p = 0; p < parts.size(); ++p) {
      sum += weights[p * wide + w];
      light += weights[p * wide + w] * four_times(parts[p]->irradiance);
    }
    for (int k = 0; k < 16; ++k)
      if (k % 4 < 3 && sum[k] > 0 && std::abs(light[k] / sum[k] - own.irradiance[k % 4]) > bound[k % 4]) even = false;
  }
  if (even) return {};
  LightSums& sums = kept_sums(incident_.directions().count(), bands);
  for (std::size_t p = 0; p < parts.size(); ++p) sums.add(weights.data() + p * wide, parts[p]->light);
  std::vector<std::vector<DirectionWeight>> result;
  result.reserve(static_cast<std::size_t>(bands));
  for (int k = 0; k < bands; ++k) result.push_back(sums.any(k) ? sums.mean(k) : own.light);
  ++spread_vertices_;
  return result;
}

}  // namespace shellgrid
