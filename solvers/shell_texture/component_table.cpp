// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/component_table.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "solvers/shell_texture/number_lists.h"
#include "solvers/shell_texture/step_coding.h"

namespace shellgrid {
namespace {

constexpr int most_components = 160;
constexpr int fine_components = 40;  // whose parts are kept in two bytes
constexpr double bits_worth = 0.15;  // squared steps of error that a bit must save
constexpr float rounding = 0.36f;    // steps are taken rather too small: zeros are cheap
constexpr std::size_t chunk = 2048;
constexpr int search_rounds = 14;

using Matrix = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

// Row u holds the cosine of frequency u at the eight places.
const std::array<float, 64>& cosines() {
  static const std::array<float, 64> table = [] {
    std::array<float, 64> t{};
    for (int u = 0; u < 8; ++u)
      for (int x = 0; x < 8; ++x)
        t[8 * u + x] =
            static_cast<float>(std::sqrt((u == 0 ? 1 : 2) / 8.0) * std::cos((2 * x + 1) * u * std::numbers::pi / 16));
    return t;
  }();
  return table;
}

void transform(const float* in, float* out, bool back) {
  const auto& c = cosines();
  float half[64];
  for (int y = 0; y < 8; ++y)
    for (int u = 0; u < 8; ++u) {
      float sum = 0;
      for (int x = 0; x < 8; ++x) sum += (back ? c[8 * x + u] : c[8 * u + x]) * in[8 * y + x];
      half[8 * y + u] = sum;
    }
  for (int v = 0; v < 8; ++v)
    for (int u = 0; u < 8; ++u) {
      float sum = 0;
      for (int y = 0; y < 8; ++y) sum += (back ? c[8 * y + v] : c[8 * v + y]) * half[8 * y + u];
      out[8 * v + u] = sum;
    }
}

// How blocks' shifts are coded, for whoever reads the file: of so many components, in so many bits, by so many classes.
std::vector<std::uint8_t> shift_code() { return {shift_group, shift_bits, shift_step, no_shift}; }

}  // namespace

std::vector<float> find_peaks(const VectorField& field) {
  const int kinds = *std::max_element(field.kind.begin(), field.kind.end()) + 1;
  std::vector<float> peaks(static_cast<std::size_t>(kinds), std::numeric_limits<float>::min());
  parallel_for(
      static_cast<std::size_t>(kinds),
      [&](std::size_t k) {
        std::vector<float> values;
        for (std::size_t d = 0; d < field.kind.size(); ++d) {
          if (field.kind[d] != static_cast<int>(k)) continue;
          for (std::size_t p = 0; p < field.filled.size(); ++p)
            if (field.filled[p]) values.push_back(std::abs(field.value(p, static_cast<int>(d))));
        }
        if (values.empty()) return;
        const auto at = values.begin() + static_cast<std::ptrdiff_t>(0.999 * static_cast<double>(values.size() - 1));
        std::nth_element(values.begin(), at, values.end());
        peaks[k] = std::max(peaks[k], *at);
      },
      1);
  return peaks;
}

// What does not depend on the step.
struct ComponentTable::Plan {
  std::vector<float> transformed;  // blocks × components × 64
  std::vector<char> block_filled;
  double left_out = 0;              // squares that no component holds
  double count = 0;                 // values
  std::vector<std::uint64_t> mask;  // of each block: its places that are filled
  std::vector<double> energy;       // of each component, over filled places
  int components = 0;
  // Of the last step tried.
  double error = 0;
};

ComponentTable ComponentTable::compress(const VectorField& field, const CodecGoal& goal) {
  ComponentTable t;
  t.size_ = field.size;
  t.filled_ = field.filled;
  t.dimensions_ = static_cast<int>(field.kind.size());
  t.blocks_x_ = (t.size_.x() + edge - 1) / edge;
  t.blocks_y_ = (t.size_.y() + edge - 1) / edge;
  const std::vector<float> peaks = find_peaks(field);
  for (const int kind : field.kind) t.peaks_.push_back(peaks[kind]);
  const auto d = static_cast<Eigen::Index>(t.dimensions_);

  std::vector<std::size_t> places;
  std::vector<std::int32_t> row_of(field.filled.size(), -1);
  for (std::size_t p = 0; p < field.filled.size(); ++p)
    if (field.filled[p]) {
      row_of[p] = static_cast<std::int32_t>(places.size());
      places.push_back(p);
    }
  if (places.empty()) throw InputError("shell texture function: no voxel holds matter");
  const auto n = static_cast<Eigen::Index>(places.size());
  Matrix rows(n, d);
  parallel_for(places.size(), [&](std::size_t r) {
    for (int k = 0; k < t.dimensions_; ++k)
      rows(static_cast<Eigen::Index>(r), k) = field.value(places[r], k) / t.peaks_[k];
  });
  const std::size_t chunks = (places.size() + chunk - 1) / chunk;
  const auto rows_of = [&](std::size_t c) {
    const auto first = static_cast<Eigen::Index>(c * chunk);
    return rows.middleRows(first, std::min<Eigen::Index>(chunk, n - first));
  };
  Eigen::RowVectorXd mean = Eigen::RowVectorXd::Zero(d);
  for (std::size_t c = 0; c < chunks; ++c) mean += rows_of(c).cast<double>().colwise().sum();
  mean /= static_cast<double>(n);
  const Eigen::RowVectorXf rounded_mean = mean.cast<float>();
  parallel_for(
      chunks, [&](std::size_t c) { rows_of(c).rowwise() -= rounded_mean; }, 1);
  // Fixed groups of chunks, so that the sums are the same at any thread count.
  constexpr std::size_t groups = 8;
  std::vector<Eigen::MatrixXd> partial(groups, Eigen::MatrixXd::Zero(d, d));
  parallel_for(
      groups,
      [&](std::size_t g) {
        for (std::size_t c = g; c < chunks; c += groups)
          partial[g] += (rows_of(c).transpose() * rows_of(c)).eval().cast<double>();
      },
      1);
  for (std::size_t g = 1; g < groups; ++g) partial[0] += partial[g];
  // Dimensions that do nothing would stall the iteration.
  partial[0].diagonal().array() += 1e-12 * partial[0].trace() / static_cast<double>(d) + 1e-300;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(partial[0]);
  if (solver.info() != Eigen::Success) throw NumericalError("shell texture function: no principal components found");

  Plan plan;
  plan.components = std::min(t.dimensions_, most_components);
  plan.count = static_cast<double>(n) * static_cast<double>(d);
  for (Eigen::Index k = 0; k < d - plan.components; ++k) plan.left_out += std::max(0.0, solver.eigenvalues()[k]);
  Eigen::MatrixXf basis(d, plan.components);
  for (int k = 0; k < plan.components; ++k) {
    Eigen::VectorXd axis = solver.eigenvectors().col(d - 1 - k);
    Eigen::Index largest;
    axis.cwiseAbs().maxCoeff(&largest);
    if (axis[largest] < 0) axis = -axis;
    // In whole steps, as it will be stored.
    const double unit = axis.cwiseAbs().maxCoeff() / (k < fine_components ? 2000 : 120);
    t.basis_unit_.push_back(static_cast<float>(unit));
    for (Eigen::Index i = 0; i < d; ++i) {
      const auto step = static_cast<std::int16_t>(std::lround(axis[i] / unit));
      t.basis_steps_.push_back(step);
      basis(i, k) = static_cast<float>(step) * t.basis_unit_[k];
    }
  }
  Matrix coefficients(n, plan.components);
  parallel_for(
      chunks,
      [&](std::size_t c) {
        const auto first = static_cast<Eigen::Index>(c * chunk);
        coefficients.middleRows(first, rows_of(c).rows()).noalias() = rows_of(c) * basis;
      },
      1);
  for (Eigen::Index k = 0; k < d; ++k) t.mean_.push_back(rounded_mean[k]);

  const auto blocks = static_cast<std::size_t>(t.block_count());
  plan.transformed.assign(blocks * plan.components * block_places, 0.0f);
  plan.block_filled.assign(blocks, 0);
  plan.mask.assign(blocks, 0);
  parallel_for(
      blocks,
      [&](std::size_t b) {
        const int bx = static_cast<int>(b) % t.blocks_x_, by = static_cast<int>(b) / t.blocks_x_ % t.blocks_y_,
                  z = static_cast<int>(b) / (t.blocks_x_ * t.blocks_y_);
        std::int32_t row[block_places];
        int filled = 0;
        for (int k = 0; k < block_places; ++k) {
          const int x = bx * edge + k % edge, y = by * edge + k / edge;
          row[k] = x < t.size_.x() && y < t.size_.y()
                       ? row_of[(static_cast<std::size_t>(z) * t.size_.y() + y) * t.size_.x() + x]
                       : -1;
          filled += row[k] >= 0;
          if (row[k] >= 0) plan.mask[b] |= std::uint64_t{1} << k;
        }
        if (filled == 0) return;
        plan.block_filled[b] = 1;
        for (int c = 0; c < plan.components; ++c) {
          float in[block_places], sum = 0;
          for (int k = 0; k < block_places; ++k) sum += row[k] >= 0 ? coefficients(row[k], c) : 0.0f;
          for (int k = 0; k < block_places; ++k)
            in[k] = row[k] >= 0 ? coefficients(row[k], c) : sum / static_cast<float>(filled);
          transform(in, plan.transformed.data() + (b * plan.components + c) * block_places, false);
        }
      },
      4);
  plan.energy.assign(static_cast<std::size_t>(plan.components), 0.0);
  parallel_for(
      plan.energy.size(),
      [&](std::size_t c) {
        for (Eigen::Index r = 0; r < n; ++r) {
          const auto value = static_cast<double>(coefficients(r, static_cast<Eigen::Index>(c)));
          plan.energy[c] += value * value;
        }
      },
      1);
  coefficients.resize(0, 0);
  rows.resize(0, 0);

  // Steps rise until the goal is met.
  const double raw = plan.count * 4;
  double low = 1e-6, high = 4;
  const auto meets = [&](double step) {
    t.encode(plan, static_cast<float>(step));
    if (goal.ratio > 0) return raw / static_cast<double>(t.bytes()) < goal.ratio;  // not small enough yet
    const double noise = (plan.error + plan.left_out) / plan.count;
    return -10 * std::log10(std::max(noise, 1e-30)) > goal.psnr;  // nearer than asked for
  };
  for (int round = 0; round < search_rounds; ++round) {
    const double middle = std::sqrt(low * high);
    (meets(middle) ? low : high) = middle;
  }
  t.encode(plan, static_cast<float>(goal.ratio > 0 ? high : low));
  t.basis_steps_.resize(static_cast<std::size_t>(t.components_) * t.dimensions_);
  t.basis_unit_.resize(static_cast<std::size_t>(t.components_));
  t.set_tables();
  return t;
}

void ComponentTable::encode(Plan& plan, float step) {
  step_ = step;
  const auto blocks = static_cast<std::size_t>(block_count());
  const int all = plan.components;
  // How widely each place's steps are spread over the blocks.
  std::vector<double> magnitude(static_cast<std::size_t>(all) * block_places, 0.0);
  std::vector<double> errors(static_cast<std::size_t>(all), 0.0);
  const std::vector<double>& energy = plan.energy;
  const float inverse = 1 / step;
  const auto quantised = [&](float value) {
    const float steps = std::min(std::abs(value) * inverse + rounding, 8e6f);
    const int magnitude_of = static_cast<int>(steps);
    return value < 0 ? -magnitude_of : magnitude_of;
  };
  std::size_t filled_blocks = 0;
  for (const char f : plan.block_filled) filled_blocks += f != 0;
  parallel_for(
      static_cast<std::size_t>(all),
      [&](std::size_t c) {
        for (std::size_t b = 0; b < blocks; ++b) {
          if (!plan.block_filled[b]) continue;
          const float* from = plan.transformed.data() + (b * all + c) * block_places;
          float miss[block_places], back[block_places];
          for (int k = 0; k < block_places; ++k) {
            const int q = quantised(from[k]);
            magnitude[c * block_places + k] += std::abs(q);
            miss[k] = from[k] - static_cast<float>(q) * step;
          }
          // Only what is filled counts.
          transform(miss, back, true);
          for (int k = 0; k < block_places; ++k)
            if (plan.mask[b] >> k & 1) errors[c] += static_cast<double>(back[k]) * static_cast<double>(back[k]);
        }
      },
      1);
  double error = 0;
  std::vector<double> gain(static_cast<std::size_t>(all), 0.0);
  components_ = 1;
  spread_.clear();
  for (int c = 0; c < all; ++c) {
    error += errors[c];
    double bits = 8.0 * ((c < fine_components ? 2.0 : 1.0) * dimensions_ + 4 + block_places);
    for (int k = 0; k < block_places; ++k) {
      const double mean =
          magnitude[static_cast<std::size_t>(c) * block_places + k] / static_cast<double>(filled_blocks);
      spread_.push_back(spread_of(mean));
      // Of a geometric magnitude and a sign.
      if (mean > 0)
        bits += static_cast<double>(filled_blocks) *
                ((1 + mean) * std::log2(1 + mean) - mean * std::log2(mean) + std::min(1.0, mean));
    }
    gain[c] = energy[c] - errors[c] - bits_worth * static_cast<double>(step) * static_cast<double>(step) * bits;
  }
  // Up to the component that is still worth its bits; what lies beyond is left out.
  double sum = 0, best = 0;
  for (int c = 0; c < all; ++c) {
    sum += gain[c];
    if (sum > best) best = sum, components_ = c + 1;
  }
  for (int c = components_; c < all; ++c) error += energy[c] - errors[c];
  plan.error = error;
  spread_.resize(static_cast<std::size_t>(components_) * block_places);
  tables_ = step_tables();
  const std::vector<std::vector<float>> lengths = symbol_lengths(tables_);
  std::vector<std::vector<std::uint8_t>> bytes(blocks);
  parallel_for(
      blocks,
      [&](std::size_t b) {
        if (!plan.block_filled[b]) return;
        const auto step_at = [&](int c, int k) {
          return quantised(plan.transformed[(b * all + c) * block_places + k]);
        };
        std::vector<int> shift;  // that makes each group shortest
        for (int first = 0; first < components_; first += shift_group) {
          float length[shifts] = {};
          for (int c = first; c < std::min(components_, first + shift_group); ++c)
            for (int k = 0; k < block_places; ++k) {
              const std::uint8_t spread = spread_[static_cast<std::size_t>(c) * block_places + k];
              if (spread == 0) continue;
              const std::uint32_t symbol = symbol_of(step_at(c, k));
              for (int s = 0; s < shifts; ++s) length[s] += lengths[shifted(spread, s)][symbol];
            }
          shift.push_back(static_cast<int>(std::min_element(length, length + shifts) - length));
        }
        SymbolEncoder encoder;
        for (int c = components_ - 1; c >= 0; --c) {
          for (int k = block_places - 1; k >= 0; --k) {
            const std::uint8_t spread = spread_[static_cast<std::size_t>(c) * block_places + k];
            if (spread == 0) continue;
            put_step(encoder, tables_[shifted(spread, shift[c / shift_group])], step_at(c, k));
          }
          if (c % shift_group == 0) encoder.put_bits(static_cast<std::uint32_t>(shift[c / shift_group]), shift_bits);
        }
        bytes[b] = encoder.finish();
      },
      4);
  offset_.assign(1, 0);
  stream_.clear();
  for (const auto& block : bytes) {
    stream_.insert(stream_.end(), block.begin(), block.end());
    offset_.push_back(static_cast<std::uint32_t>(stream_.size()));
  }
}

// From steps and peaks to the values' own units.
void ComponentTable::set_tables() {
  tables_ = step_tables();
  basis_.resize(basis_steps_.size());
  for (int c = 0; c < components_; ++c)
    for (int k = 0; k < dimensions_; ++k) {
      const std::size_t at = static_cast<std::size_t>(c) * dimensions_ + k;
      basis_[at] = static_cast<float>(basis_steps_[at]) * basis_unit_[c] * peaks_[k];
    }
  for (int k = 0; k < dimensions_; ++k) mean_[k] *= peaks_[k];
}

std::size_t ComponentTable::bytes() const {
  const auto components = static_cast<std::size_t>(components_), dimensions = static_cast<std::size_t>(dimensions_);
  const std::size_t fine = std::min<std::size_t>(components, fine_components);
  return stream_.size() + 4 * offset_.size() + (components + fine) * dimensions + 4 * components + spread_.size() +
         4 * mean_.size() + filled_.size() / 8;
}

int ComponentTable::block_of(std::size_t place) const {
  const auto p = static_cast<int>(place);
  const int x = p % size_.x(), y = p / size_.x() % size_.y(), z = p / (size_.x() * size_.y());
  return (z * blocks_y_ + y / edge) * blocks_x_ + x / edge;
}

int ComponentTable::place_in_block(std::size_t place) const {
  const auto p = static_cast<int>(place);
  return p / size_.x() % size_.y() % edge * edge + p % size_.x() % edge;
}

void ComponentTable::unpack(int block, std::vector<float>& coefficients) const {
  coefficients.assign(static_cast<std::size_t>(block_places) * components_, 0.0f);
  if (offset_[block] == offset_[block + 1]) return;
  SymbolDecoder decoder(stream_.data() + offset_[block], stream_.data() + offset_[block + 1]);
  int shift = no_shift;
  for (int c = 0; c < components_; ++c) {
    float steps[block_places], out[block_places];
    bool any = false;
    if (c % shift_group == 0) shift = static_cast<int>(decoder.take_bits(shift_bits));
    for (int k = 0; k < block_places; ++k) {
      const std::uint8_t spread = spread_[static_cast<std::size_t>(c) * block_places + k];
      steps[k] = 0;
      if (spread == 0) continue;
      const int q = take_step(decoder, tables_[shifted(spread, shift)]);
      steps[k] = static_cast<float>(q) * step_;
      any = any || q != 0;
    }
    if (!any) continue;
    transform(steps, out, true);
    for (int k = 0; k < block_places; ++k) coefficients[static_cast<std::size_t>(k) * components_ + c] = out[k];
  }
}

void ComponentTable::save(NumberArchive& archive, const std::string& name) const {
  archive.counts[name + " sizes"] = {static_cast<std::uint64_t>(size_.x()),   static_cast<std::uint64_t>(size_.y()),
                                     static_cast<std::uint64_t>(size_.z()),   static_cast<std::uint64_t>(dimensions_),
                                     static_cast<std::uint64_t>(components_), stream_.size()};
  put_list(archive, name + " shift", shift_code());
  std::vector<float> mean = mean_;
  for (int k = 0; k < dimensions_; ++k) mean[k] /= peaks_[k];
  put_list(archive, name + " mean", mean);
  put_list(archive, name + " peaks", peaks_);
  std::vector<std::int16_t> fine;
  std::vector<std::int8_t> coarse;
  for (std::size_t k = 0; k < basis_steps_.size(); ++k)
    if (k < static_cast<std::size_t>(fine_components) * dimensions_)
      fine.push_back(basis_steps_[k]);
    else
      coarse.push_back(static_cast<std::int8_t>(basis_steps_[k]));
  put_list(archive, name + " basis", fine);
  put_list(archive, name + " coarse basis", coarse);
  put_list(archive, name + " basis unit", basis_unit_);
  put_list(archive, name + " spread", spread_);
  put_list(archive, name + " offset", offset_);
  put_list(archive, name + " stream", stream_);
  put_list(archive, name + " filled", packed_bits(filled_));
  archive.numbers[name + " step"] = {static_cast<double>(step_)};
}

ComponentTable ComponentTable::restore(const NumberArchive& archive, const std::string& name, const std::string& path) {
  ComponentTable t;
  const std::vector<std::uint64_t> sizes = take_sizes(archive, name + " sizes", 6, path);
  const auto step = archive.numbers.find(name + " step");
  if (step == archive.numbers.end() || step->second.size() != 1) fail_lists(path);
  for (int axis = 0; axis < 3; ++axis) t.size_[axis] = static_cast<int>(sizes[axis]);
  t.dimensions_ = static_cast<int>(sizes[3]);
  t.components_ = static_cast<int>(sizes[4]);
  if (t.dimensions_ < 1 || t.components_ < 1) fail_lists(path);
  if (take_list<std::uint8_t>(archive, name + " shift", shift_code().size(), path) != shift_code()) fail_lists(path);
  t.step_ = static_cast<float>(step->second[0]);
  t.blocks_x_ = (t.size_.x() + edge - 1) / edge;
  t.blocks_y_ = (t.size_.y() + edge - 1) / edge;
  const auto dimensions = static_cast<std::size_t>(t.dimensions_), components = static_cast<std::size_t>(t.components_);
  const auto places = static_cast<std::size_t>(t.size_.x()) * t.size_.y() * t.size_.z();
  t.mean_ = take_list<float>(archive, name + " mean", dimensions, path);
  t.peaks_ = take_list<float>(archive, name + " peaks", dimensions, path);
  const std::size_t fine = std::min<std::size_t>(components, fine_components);
  t.basis_steps_ = take_list<std::int16_t>(archive, name + " basis", dimensions * fine, path);
  const std::vector<std::int8_t> coarse =
      take_list<std::int8_t>(archive, name + " coarse basis", dimensions * (components - fine), path);
  t.basis_steps_.insert(t.basis_steps_.end(), coarse.begin(), coarse.end());
  t.basis_unit_ = take_list<float>(archive, name + " basis unit", components, path);
  t.spread_ = take_list<std::uint8_t>(archive, name + " spread", components * block_places, path);
  t.offset_ = take_list<std::uint32_t>(archive, name + " offset", static_cast<std::size_t>(t.block_count()) + 1, path);
  t.stream_ = take_list<std::uint8_t>(archive, name + " stream", sizes[5], path);
  t.filled_ = unpacked_bits(take_list<std::uint8_t>(archive, name + " filled", (places + 7) / 8, path), places);
  for (const std::uint8_t spread : t.spread_)
    if (spread >= spreads) fail_lists(path);
  check_offsets(t.offset_, t.stream_.size(), path);
  t.set_tables();
  return t;
}

}  // namespace shellgrid
