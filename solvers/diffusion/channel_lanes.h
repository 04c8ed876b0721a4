// SPDX-License-Identifier: AGPL-3.0-or-later
// Red, green and blue side by side in the lanes of one register; the fourth lane is idle.
#pragma once
#include <algorithm>
#include <cmath>

#include "meshing/core/vec.h"

namespace shellgrid {

using Float4 = float __attribute__((vector_size(16)));
using Double4 = double __attribute__((vector_size(32)));

inline Double4 to_double(Float4 a) { return __builtin_convertvector(a, Double4); }
inline Float4 to_float(Double4 a) { return __builtin_convertvector(a, Float4); }
inline Float4 to_lanes(const Rgb& c) { return Float4{c[0], c[1], c[2], 0}; }
inline Rgb to_rgb(Double4 a) { return {static_cast<float>(a[0]), static_cast<float>(a[1]), static_cast<float>(a[2])}; }
inline Float4 absolute(Float4 a) { return a < 0 ? -a : a; }

// a / b where b is not 0, else 0.
inline Double4 safe_quotient(Double4 a, Double4 b) {
  Double4 q;
  for (int c = 0; c < 4; ++c) q[c] = b[c] != 0 ? a[c] / b[c] : 0.0;
  return q;
}

}  // namespace shellgrid
