// SPDX-License-Identifier: AGPL-3.0-or-later
// Vectors of 64 bytes, 16-bit numbers to store couplings in, and memory for streams.
#pragma once
#if defined(__F16C__) || defined(__AVX512F__)
#include <immintrin.h>
#endif
#ifdef __linux__
#include <sys/mman.h>
#endif

#include <bit>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <new>

namespace shellgrid {

// IEEE half precision and the upper half of single precision, as bits.
struct Half {
  std::uint16_t bits;
};
struct UpperHalf {
  std::uint16_t bits;
};

// Round to nearest even; numbers beyond the range become the greatest finite ones.
inline Half to_half(float value) {
  const std::uint32_t all = std::bit_cast<std::uint32_t>(value);
  const auto sign = static_cast<std::uint16_t>((all >> 16) & 0x8000u);
  const std::uint32_t magnitude = all & 0x7fffffffu;
  if (magnitude >= 0x477ff000u) return {static_cast<std::uint16_t>(sign | 0x7bffu)};
  // The sum's unit in the last place is that of the half: it rounds.
  const std::uint32_t exponent = magnitude >> 23 < 113 ? 113u : magnitude >> 23;
  const float shifter = std::bit_cast<float>((exponent + 13) << 23);
  const float rounded = (std::bit_cast<float>(magnitude) + shifter) - shifter;
  const std::uint32_t bits = std::bit_cast<std::uint32_t>(rounded);
  if (bits >> 23 >= 113) return {static_cast<std::uint16_t>(sign | ((bits - (112u << 23)) >> 13))};
  return {static_cast<std::uint16_t>(sign | static_cast<std::uint32_t>(rounded * 0x1p24f))};
}
inline UpperHalf to_upper_half(float value) {
  const std::uint32_t all = std::bit_cast<std::uint32_t>(value);
  return {static_cast<std::uint16_t>((all + 0x7fffu + ((all >> 16) & 1u)) >> 16)};
}

template <class Real>
struct WideLanes;
template <>
struct WideLanes<float> {
  using Vector = float __attribute__((vector_size(64)));
  using Index = std::int32_t __attribute__((vector_size(64)));
  static constexpr int width = 16;
  static constexpr Index iota = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
};
template <>
struct WideLanes<double> {
  using Vector = double __attribute__((vector_size(64)));
  using Index = std::int64_t __attribute__((vector_size(64)));
  static constexpr int width = 8;
  static constexpr Index iota = {0, 1, 2, 3, 4, 5, 6, 7};
};
using Float16Lanes = WideLanes<float>::Vector;

template <class Vector, class Value>
inline Vector load_lanes(const Value* from) {
  Vector v;
  std::memcpy(&v, from, sizeof v);
  return v;
}
template <class Vector, class Value>
inline void store_lanes(Value* to, const Vector& v) {
  std::memcpy(to, &v, sizeof v);
}

// The first `count` lanes alone.
inline void store_some(float* to, const Float16Lanes& v, int count) {
  if (count >= 16) {
    store_lanes(to, v);
    return;
  }
#if defined(__AVX512F__)
  _mm512_mask_storeu_ps(to, static_cast<__mmask16>((1u << count) - 1), reinterpret_cast<__m512>(v));
#else
  for (int i = 0; i < count; ++i) to[i] = v[i];
#endif
}

// Stored numbers as lanes of Real.
template <class Real>
struct ReadLanes;
template <>
struct ReadLanes<float> {
  static Float16Lanes read(const float* from) { return load_lanes<Float16Lanes>(from); }
  static Float16Lanes read(const Half* from) {
#if defined(__AVX512F__)
    return reinterpret_cast<Float16Lanes>(
        _mm512_maskz_cvtph_ps(0xffff, _mm256_loadu_si256(reinterpret_cast<const __m256i*>(from))));
#elif defined(__F16C__)
    Float16Lanes v;
    for (int k = 0; k < 2; ++k) {
      const __m256 part = _mm256_cvtph_ps(_mm_loadu_si128(reinterpret_cast<const __m128i*>(from) + k));
      std::memcpy(reinterpret_cast<char*>(&v) + 32 * k, &part, 32);
    }
    return v;
#else
    using Short = std::uint16_t __attribute__((vector_size(32)));
    using Word = std::uint32_t __attribute__((vector_size(64)));
    const Word bits = __builtin_convertvector(load_lanes<Short>(from), Word);
    return reinterpret_cast<Float16Lanes>(((bits & 0x7fffu) << 13) | ((bits & 0x8000u) << 16)) * 0x1p112f;
#endif
  }
  static Float16Lanes read(const UpperHalf* from) {
    using Short = std::uint16_t __attribute__((vector_size(32)));
    using Word = std::uint32_t __attribute__((vector_size(64)));
    return reinterpret_cast<Float16Lanes>(__builtin_convertvector(load_lanes<Short>(from), Word) << 16);
  }
};
template <>
struct ReadLanes<double> {
  static WideLanes<double>::Vector read(const float* from) {
    using Eight = float __attribute__((vector_size(32)));
    return __builtin_convertvector(load_lanes<Eight>(from), WideLanes<double>::Vector);
  }
  static WideLanes<double>::Vector read(const Half* from) {
    using Eight = float __attribute__((vector_size(32)));
    const Float16Lanes both = ReadLanes<float>::read(from);
    Eight low;
    std::memcpy(&low, &both, sizeof low);
    return __builtin_convertvector(low, WideLanes<double>::Vector);
  }
};

// Zeroed memory with room to read past both ends; large ones on large pages, where the system has them.
template <class Value>
class StreamBuffer {
 public:
  static constexpr std::size_t margin = 128;

  StreamBuffer() = default;
  explicit StreamBuffer(std::size_t size) : size_(size) {
    constexpr std::size_t page = std::size_t{1} << 21;
    const std::size_t bytes = (size + 2 * margin) * sizeof(Value);
    const std::size_t alignment = bytes >= page ? page : 64;
    const std::size_t whole = (bytes + alignment - 1) / alignment * alignment;
    memory_.reset(static_cast<Value*>(std::aligned_alloc(alignment, whole)));
    if (!memory_) throw std::bad_alloc();
#ifdef __linux__
    if (alignment == page) madvise(memory_.get(), whole, MADV_HUGEPAGE);
#endif
    std::memset(static_cast<void*>(memory_.get()), 0, whole);
  }
  Value* data() { return memory_.get() + margin; }
  const Value* data() const { return memory_.get() + margin; }
  std::size_t size() const { return size_; }
  std::size_t bytes() const { return memory_ ? (size_ + 2 * margin) * sizeof(Value) : 0; }
  explicit operator bool() const { return memory_ != nullptr; }

 private:
  struct Free {
    void operator()(Value* memory) const { std::free(memory); }
  };
  std::unique_ptr<Value[], Free> memory_;
  std::size_t size_ = 0;
};

}  // namespace shellgrid
