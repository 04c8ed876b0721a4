// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstddef>
#include <string>
#include <vector>

#include "meshing/core/scalar_volume.h"

namespace shellgrid {

enum class ScalarType { int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32, float64 };

// "uint8", "float", … by the names of NRRD and of C. Throws: InputError that lists the known ones.
ScalarType scalar_type(const std::string& name);
std::size_t value_bytes(ScalarType type);

// What a file without a header leaves open.
struct RawLayout {
  Vec3i size = Vec3i::Zero();
  ScalarType type = ScalarType::uint8;
  bool big_endian = false;
  std::size_t offset = 0;  // bytes before the values
};

// Values one after another, x fastest. The file holds what the layout says or more. Throws: InputError for a file that
// is too short, a size out of range, values that are not finite.
ScalarVolume read_raw_volume(const std::string& path, const RawLayout& layout);

// NRRD of three axes: encodings raw, gzip and text, the data attached or in one file beside it; spacing from `spacings`
// or `space directions`, else 1. Other axes, orders and encodings are refused. Source: [NRRD].
// Throws: InputError as above, and for a malformed header.
ScalarVolume read_nrrd(const std::string& path);

// One PNG a layer, from the lowest z; all of one size. Values are code values over their largest, 0 … 1, of 8 or 16
// bits; of colours the luminance. Throws: InputError.
ScalarVolume read_image_stack(const std::vector<std::string>& paths);

}  // namespace shellgrid
