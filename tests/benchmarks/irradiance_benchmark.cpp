// SPDX-License-Identifier: AGPL-3.0-or-later
// What the shell texture function of a sample costs: knobs over veins, even and forward scattering of the same reduced
// coefficients, 72 directions and light from below, RGB; smoothed, and as the walks tell it (SG_LONG=1: smoothed, a
// sample of 96×96×10, followed to 2 %). Processor seconds of all threads; those to 2 % median relative error are told
// from those of the paths that were followed, as errors fall with the root of their number; smoothed ones fall less
// fast. Prints CSV. irradiance_benchmark [width anisotropy paths-a-texel [seed]]: one sample, for comparisons at equal
// numbers of paths.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>

#include "solvers/shell_texture/irradiance_tracing.h"
#include "tests/support/base_volumes.h"
#include "tests/support/timing.h"

using namespace shellgrid;

namespace {

double processor_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

// When light begins to be followed, after the beams were marched.
class BeginOfPaths : public Progress {
 public:
  void begin(const std::string& task, long) override {
    if (task == "follow light") processor = processor_seconds();
  }
  double processor = 0;
};

void row(int width, float anisotropy, const IrradianceOptions& options) {
  const BaseVolume volume = test::knobs_over_veins(width, anisotropy);
  BeginOfPaths paths;
  IrradianceReport report;
  const double begin = processor_seconds();
  const double seconds = test::seconds_of([&] { trace_irradiance(volume, options, &report, paths); });
  const double end = processor_seconds(), marched = paths.processor - begin, followed = end - paths.processor;
  std::printf("%d,%g,%s,%.0f,%.4f,%.4f,%.1f,%.1f,%.1f,%.1f\n", width, static_cast<double>(anisotropy),
              options.smooth ? "wavelets" : "none", report.paths, report.median_error, report.back_error, seconds,
              marched, followed, marched + followed * std::pow(report.median_error / 0.02, 2));
  std::fflush(stdout);
}

}  // namespace

int main(int arguments, char** argument) {
  std::printf(
      "width,anisotropy,smoothing,paths,median_error,error_from_below,seconds,march_s,paths_s,processor_s_to_2_"
      "percent\n");
  IrradianceOptions options;
  const auto rows = [&](int width, float anisotropy, bool both) {
    for (const bool smooth : {true, false}) {
      options.smooth = smooth;
      if (smooth || both) row(width, anisotropy, options);
    }
  };
  if (arguments > 3) {
    options.paths = std::atof(argument[3]);
    if (arguments > 4) options.seed = std::strtoull(argument[4], nullptr, 10);
    rows(std::atoi(argument[1]), static_cast<float>(std::atof(argument[2])), true);
    return 0;
  }
  options.target_error = test::long_form() ? 0.02 : 0.06;
  for (const float anisotropy : {0.0f, 0.8f}) rows(test::long_form() ? 96 : 32, anisotropy, !test::long_form());
}
