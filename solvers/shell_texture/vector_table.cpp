// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/vector_table.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "solvers/shell_texture/number_lists.h"

namespace shellgrid {
namespace {

constexpr std::size_t most_samples = 32768;
constexpr int most_words = 2048, iterations = 6;
constexpr std::size_t chunk = 512;
using Word = VectorTable::Word;

// Words by dimension, for a search in step.
struct Codebook {
  std::array<std::vector<float>, VectorTable::dimensions> by_dimension;

  explicit Codebook(const std::vector<Word>& words) {
    for (int d = 0; d < VectorTable::dimensions; ++d)
      for (const Word& word : words) by_dimension[d].push_back(word[d]);
  }
  int nearest(const Word& v, std::vector<float>& distance) const {
    const std::size_t n = by_dimension[0].size();
    distance.assign(n, 0.0f);
    for (int d = 0; d < VectorTable::dimensions; ++d) {
      const float* words = by_dimension[d].data();
      const float at = v[d];
      for (std::size_t k = 0; k < n; ++k) distance[k] += (words[k] - at) * (words[k] - at);
    }
    return static_cast<int>(std::min_element(distance.begin(), distance.end()) - distance.begin());
  }
};

// Numbers of the nearest words, and the sum of the squared distances.
double assign(const std::vector<Word>& samples, const std::vector<Word>& words, std::vector<std::uint16_t>& number) {
  const Codebook book(words);
  number.resize(samples.size());
  const std::size_t chunks = (samples.size() + chunk - 1) / chunk;
  std::vector<double> partial(chunks, 0.0);
  parallel_for(
      chunks,
      [&](std::size_t c) {
        std::vector<float> distance;
        for (std::size_t k = c * chunk; k < std::min(samples.size(), (c + 1) * chunk); ++k) {
          const int at = book.nearest(samples[k], distance);
          number[k] = static_cast<std::uint16_t>(at);
          partial[c] += static_cast<double>(distance[at]);
        }
      },
      4);
  double sum = 0;
  for (const double p : partial) sum += p;
  return sum;
}

double bits_of(const std::vector<std::uint16_t>& numbers, std::size_t words) {
  std::vector<double> count(words, 0.0);
  for (const std::uint16_t k : numbers) count[k] += 1;
  double bits = 0;
  for (const double c : count)
    if (c > 0) bits -= c / static_cast<double>(numbers.size()) * std::log2(c / static_cast<double>(numbers.size()));
  return bits;
}

// Moves each word to the mean of its own; one without any to a part of the most used one's.
void improve(const std::vector<Word>& samples, std::vector<Word>& words) {
  std::vector<std::uint16_t> number;
  for (int round = 0; round < iterations; ++round) {
    assign(samples, words, number);
    std::vector<std::array<double, VectorTable::dimensions>> sum(words.size(), {0, 0, 0, 0, 0, 0});
    std::vector<std::size_t> count(words.size(), 0);
    for (std::size_t k = 0; k < samples.size(); ++k) {
      ++count[number[k]];
      for (int d = 0; d < VectorTable::dimensions; ++d) sum[number[k]][d] += static_cast<double>(samples[k][d]);
    }
    const auto fullest = static_cast<std::size_t>(std::max_element(count.begin(), count.end()) - count.begin());
    for (std::size_t w = 0; w < words.size(); ++w)
      for (int d = 0; d < VectorTable::dimensions; ++d)
        words[w][d] = count[w] > 0 ? static_cast<float>(sum[w][d] / static_cast<double>(count[w]))
                                   : words[fullest][d] * (1 + 1e-3f * static_cast<float>(1 + w % 7));
  }
}

}  // namespace

template <class Visit>
void VectorTable::visit_block(int block, const Visit& visit) const {
  const int across = (size_.x() + 7) / 8, down = (size_.y() + 7) / 8;
  const int bx = block % across, by = block / across % down, z = block / (across * down);
  for (int k = 0; k < ComponentTable::block_places; ++k) {
    const int x = 8 * bx + k % 8, y = 8 * by + k / 8;
    if (x >= size_.x() || y >= size_.y()) continue;
    const std::size_t place = (static_cast<std::size_t>(z) * size_.y() + y) * size_.x() + x;
    if (filled_[place]) visit(k, place);
  }
}

VectorTable VectorTable::compress(const VectorField& field, const CodecGoal& goal) {
  VectorTable t;
  t.size_ = field.size;
  t.filled_ = field.filled;
  t.vectors_ = static_cast<int>(field.kind.size()) / dimensions;
  std::vector<float> peaks = find_peaks(field);
  std::vector<std::size_t> places;
  for (std::size_t p = 0; p < field.filled.size(); ++p)
    if (field.filled[p]) places.push_back(p);
  if (places.empty()) throw InputError("shell texture function: no voxel holds matter");
  const auto vector_at = [&](std::size_t place, int k) {
    Word v;
    for (int d = 0; d < dimensions; ++d) v[d] = field.value(place, k * dimensions + d) / peaks[d];
    return v;
  };
  const std::size_t all = places.size() * static_cast<std::size_t>(t.vectors_);
  std::vector<Word> samples;
  for (std::size_t k = 0; k < std::min(all, most_samples); ++k) {
    const std::size_t pick = all <= most_samples ? k : hash64(0x7671, k) % all;
    samples.push_back(vector_at(places[pick / t.vectors_], static_cast<int>(pick % t.vectors_)));
  }
  // The codebook doubles, each word split along its own direction, until the goal is met or passed.
  std::vector<Word> words(1, Word{0, 0, 0, 0, 0, 0}), kept;
  improve(samples, words);
  std::vector<std::uint16_t> numbers;
  for (;;) {
    const double error = assign(samples, words, numbers);
    const double bits = bits_of(numbers, words.size());
    const double side = static_cast<double>(words.size() * sizeof(Word) * 8) / static_cast<double>(all);
    const double ratio = dimensions * 32 / (bits + side + 1e-3);
    const double noise = error / (static_cast<double>(samples.size()) * dimensions);
    if (goal.ratio > 0 && ratio < goal.ratio && !kept.empty()) break;
    kept = words;
    if (goal.ratio <= 0 && -10 * std::log10(std::max(noise, 1e-30)) >= goal.psnr) break;
    if (words.size() >= most_words || words.size() >= samples.size()) break;
    for (std::size_t k = 0, count = words.size(); k < count; ++k) {
      Word other = words[k];
      for (int d = 0; d < dimensions; ++d) {
        const auto sign = to_unit(hash64(words.size(), k, d)) < 0.5 ? 1.0f : -1.0f;
        const float step = sign * (0.01f * std::abs(other[d]) + 1e-4f);
        words[k][d] += step;
        other[d] -= step;
      }
      words.push_back(other);
    }
    improve(samples, words);
  }
  t.words_ = kept;

  const Codebook book(kept);
  const int blocks = t.block_count();
  std::vector<std::vector<std::uint16_t>> in_block(static_cast<std::size_t>(blocks));
  parallel_for(
      in_block.size(),
      [&](std::size_t b) {
        std::vector<float> distance;
        t.visit_block(static_cast<int>(b), [&](int, std::size_t place) {
          for (int k = 0; k < t.vectors_; ++k)
            in_block[b].push_back(static_cast<std::uint16_t>(book.nearest(vector_at(place, k), distance)));
        });
      },
      1);
  std::vector<std::uint64_t> count(kept.size(), 0);
  for (const auto& numbers_of : in_block)
    for (const std::uint16_t k : numbers_of) ++count[k];
  t.table_ = SymbolTable::from_weights(count);
  t.offset_.assign(1, 0);
  for (const auto& numbers_of : in_block) {
    SymbolEncoder encoder;
    for (auto at = numbers_of.rbegin(); at != numbers_of.rend(); ++at) encoder.put(t.table_, *at);
    const std::vector<std::uint8_t> bytes = encoder.finish();
    t.stream_.insert(t.stream_.end(), bytes.begin(), bytes.end());
    t.offset_.push_back(static_cast<std::uint32_t>(t.stream_.size()));
  }
  for (Word& word : t.words_)
    for (int d = 0; d < dimensions; ++d) word[d] *= peaks[d];
  return t;
}

std::size_t VectorTable::bytes() const {
  return stream_.size() + 4 * offset_.size() + words_.size() * (sizeof(Word) + 2) + filled_.size() / 8;
}

void VectorTable::unpack(int block, std::vector<std::uint16_t>& numbers) const {
  numbers.assign(static_cast<std::size_t>(ComponentTable::block_places) * vectors_, 0);
  SymbolDecoder decoder(stream_.data() + offset_[block], stream_.data() + offset_[block + 1]);
  visit_block(block, [&](int k, std::size_t) {
    for (int v = 0; v < vectors_; ++v)
      numbers[static_cast<std::size_t>(k) * vectors_ + v] = static_cast<std::uint16_t>(decoder.take(table_));
  });
}

void VectorTable::save(NumberArchive& archive, const std::string& name) const {
  archive.counts[name + " sizes"] = {static_cast<std::uint64_t>(size_.x()),
                                     static_cast<std::uint64_t>(size_.y()),
                                     static_cast<std::uint64_t>(size_.z()),
                                     static_cast<std::uint64_t>(vectors_),
                                     words_.size(),
                                     stream_.size()};
  std::vector<std::uint16_t> frequency;
  for (std::size_t k = 0; k < words_.size(); ++k)
    frequency.push_back(static_cast<std::uint16_t>(table_.frequency(static_cast<std::uint32_t>(k))));
  put_list(archive, name + " words", words_);
  put_list(archive, name + " frequency", frequency);
  put_list(archive, name + " offset", offset_);
  put_list(archive, name + " stream", stream_);
  put_list(archive, name + " filled", packed_bits(filled_));
}

VectorTable VectorTable::restore(const NumberArchive& archive, const std::string& name, const std::string& path) {
  VectorTable t;
  const std::vector<std::uint64_t> sizes = take_sizes(archive, name + " sizes", 6, path);
  for (int axis = 0; axis < 3; ++axis) t.size_[axis] = static_cast<int>(sizes[axis]);
  t.vectors_ = static_cast<int>(sizes[3]);
  const auto places = static_cast<std::size_t>(t.size_.x()) * t.size_.y() * t.size_.z();
  if (t.vectors_ < 1 || sizes[4] < 1 || sizes[4] > SymbolTable::whole) fail_lists(path);
  t.words_ = take_list<Word>(archive, name + " words", sizes[4], path);
  t.table_ = SymbolTable::from_frequencies(take_list<std::uint16_t>(archive, name + " frequency", sizes[4], path));
  t.offset_ = take_list<std::uint32_t>(archive, name + " offset", static_cast<std::size_t>(t.block_count()) + 1, path);
  t.stream_ = take_list<std::uint8_t>(archive, name + " stream", sizes[5], path);
  t.filled_ = unpacked_bits(take_list<std::uint8_t>(archive, name + " filled", (places + 7) / 8, path), places);
  check_offsets(t.offset_, t.stream_.size(), path);
  return t;
}

}  // namespace shellgrid
