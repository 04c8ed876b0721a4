// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "meshing/core/image.h"

namespace shellgrid {

// Reads every channel of a scan-line OpenEXR file as float. Throws: InputError.
Image read_exr(const std::string& path);
// Writes float channels, ZIP compressed, same image same bytes; written atomically.
void write_exr(const std::string& path, const Image& image);

// Writes 8-bit sRGB PNG, rgb = width·height·3 bytes, row 0 on top; written atomically.
void write_png(const std::string& path, int width, int height, const std::vector<std::uint8_t>& rgb);
// Reads a PNG's code values as they are, over their largest: one channel Y, 0 … 1, from 8 or 16 bits; of colours the
// luminance. Throws: InputError.
Image read_grey_png(const std::string& path);
// Reads an 8-bit PNG as linear R, G, B channels (sRGB decoded). Throws: InputError.
Image read_png(const std::string& path);

}  // namespace shellgrid
