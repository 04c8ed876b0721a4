// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <vector>

#include "meshing/core/image.h"

namespace shellgrid {

enum class ToneCurve {
  filmic,  // a rational fit of the ACES film curve [Narkowicz2015]
  linear   // clipped at 1
};

// The exposure, in stops, that puts the 98th percentile of the luminance of the object (A > 0.5, or of all pixels where
// there is none) at 69 % of display white through the filmic curve. 0 for a black picture.
double automatic_exposure(const Image& image);

// The R G B layers as display bytes: scaled by 2^exposure, through the curve, sRGB encoded, with an ordered dither of
// one level against banding. Returns width·height·3 bytes, row 0 on top.
std::vector<std::uint8_t> tone_map(const Image& image, double exposure, ToneCurve curve);

}  // namespace shellgrid
