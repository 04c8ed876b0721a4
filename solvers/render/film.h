// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <vector>

#include "meshing/core/image.h"
#include "meshing/core/progress.h"
#include "meshing/core/vec.h"

namespace shellgrid {

// What one camera ray brings home. Radiances in W mm⁻² sr⁻¹.
struct FilmSample {
  bool hit = false;            // the object, not what is behind it
  Rgb exitance = Rgb::Zero();  // diffuse light that leaves the object
  Rgb specular = Rgb::Zero();  // mirror light from the object
  Rgb backdrop = Rgb::Zero();  // what is seen beside the object
  double depth = 0;            // along the viewing axis, mm
  Vec3 normal = Vec3::Zero();  // shading normal, unit
};

// Samples of a picture, spread by a tent filter of one pixel's radius: samples are placed in proportion to
// the filter, so each belongs to one pixel only and sums are the same at any thread count.
// Source: filter importance sampling [Ernst2006].
class Film {
 public:
  struct Settings {
    int samples_per_pixel = 16;  // at most; 4 where nothing varies
    double contrast = 0.03;      // Michelson contrast in a 3×3 neighbourhood above which a pixel gets them all
    std::uint64_t seed = 0;
  };
  struct Statistics {
    std::int64_t samples = 0;          // taken
    std::int64_t samples_skipped = 0;  // of width·height·samples_per_pixel
    std::int64_t refined_pixels = 0;
  };

  Film(int width, int height, const Settings& settings);

  // Takes samples: first 4 in each pixel, then the rest where the 3×3 neighbourhood shows an edge of the object or a
  // contrast above the threshold. `sample(x, y)` gets picture coordinates and is called from several threads.
  Statistics expose(const std::function<FilmSample(double x, double y)>& sample, Progress& progress = no_progress());

  // The layers R G B A, exitance.R/G/B, specular.R/G/B, depth.Z (mean over the samples that hit, 0 where none does),
  // normal.X/Y/Z (unit, 0 where nothing is hit). R G B is exitance plus specular plus backdrop.
  Image develop() const;

  // Where sample `sample_index` of a pixel lies: a scrambled (0,2)-sequence warped to the filter.
  static Vec2 position(int pixel_x, int pixel_y, std::uint64_t pixel_key, int sample_index);

 private:
  struct Pixel {
    Rgb exitance = Rgb::Zero(), specular = Rgb::Zero(), backdrop = Rgb::Zero();
    Vec3f normal = Vec3f::Zero();
    double depth = 0;
    int hits = 0, count = 0;
    float low = 0, high = 0;  // luminance
  };
  void take(int pixel_x, int pixel_y, int first, int last, const std::function<FilmSample(double x, double y)>& sample);
  bool varies(int pixel_x, int pixel_y, float floor_luminance) const;

  int width_, height_;
  Settings settings_;
  std::vector<Pixel> pixels_;
};

}  // namespace shellgrid
