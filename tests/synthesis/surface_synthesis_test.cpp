// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/surface_synthesis.h"

#include <gtest/gtest.h>
#include <oneapi/tbb/global_control.h>

#include <cmath>
#include <numeric>
#include <set>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/surface/retile.h"
#include "synthesis/synthesis_quality.h"
#include "tests/synthesis/synthesis_shapes.h"

namespace shellgrid {
namespace {

TextonSet marble_textons(int size) {
  TextonOptions options;
  options.texton_count = 40;
  return make_textons(make_procedural_sample(testing::marble(size)), options);
}

TEST(TextonSet, CandidatesKeepTheirDistanceAndComeInOrder) {
  TextonOptions options;
  options.texton_count = 20;
  const TextonSet set = make_textons(make_procedural_sample(testing::marble(32)), options);
  ASSERT_EQ(set.levels.size(), 3u);
  const auto distance = [&](std::size_t l, int a, int b) {
    float sum = 0;
    for (int d = 0; d < TextonSet::dimension; ++d) {
      const float step = set.levels[l].appearance[a * 8 + d] - set.levels[l].appearance[b * 8 + d];
      sum += step * step;
    }
    return sum;
  };
  const auto apart = [](int a, int b) {
    int dx = std::abs(a % 32 - b % 32), dy = std::abs(a / 32 - b / 32);
    dx = std::min(dx, 32 - dx), dy = std::min(dy, 32 - dy);
    return dx * dx + dy * dy;
  };
  for (std::size_t l = 0; l < set.levels.size(); ++l)
    for (int t = 0; t < set.texel_count(); ++t) {
      const std::int32_t* candidates = &set.levels[l].candidates[static_cast<std::size_t>(t) * set.candidate_count];
      for (int k = 0; k < set.candidate_count; ++k) {
        ASSERT_GE(apart(t, candidates[k]), 25);
        if (k > 0) {
          ASSERT_LE(distance(l, t, candidates[k - 1]), distance(l, t, candidates[k]) * 1.0001f);
          ASSERT_GE(apart(candidates[k - 1], candidates[k]), 25);
        }
      }
    }
  // At the finest level the first candidate is the best of all that are far enough, by exhaustion.
  for (int t : {0, 77, 500}) {
    float best = 1e30f;
    for (int u = 0; u < set.texel_count(); ++u)
      if (apart(t, u) >= 25) best = std::min(best, distance(0, t, u));
    EXPECT_NEAR(distance(0, t, set.levels[0].candidates[static_cast<std::size_t>(t) * set.candidate_count]), best,
                1e-5);
  }
}

TEST(TextonSet, QuantisedAppearanceTakesAsManyValuesAsThereAreTextons) {
  TextonOptions options;
  options.texton_count = 12;
  options.quantize = true;
  const TextonSet set = make_textons(make_procedural_sample(testing::marble(32)), options);
  std::set<std::vector<float>> values;
  for (int t = 0; t < set.texel_count(); ++t)
    values.insert({&set.levels[0].appearance[t * 8], &set.levels[0].appearance[t * 8] + 8});
  EXPECT_EQ(values.size(), 12u);
  EXPECT_EQ(set.texton_count, 12);
}

TEST(TextonSet, RefusesASampleWithoutRoomForCandidates) {
  TextonOptions options;
  options.candidate_count = 8;
  EXPECT_THROW(make_textons(make_procedural_sample(testing::layers(4)), options), InputError);
}

TEST(SurfaceSynthesis, ShowsTheSampleFarBetterThanChance) {
  const TextonSet textons = marble_textons(64);
  const SurfaceTexture texture = synthesize_surface(testing::torus(8, 3, 125, 47), textons, {});
  const SynthesisQuality quality = measure_synthesis(texture, textons);
  EXPECT_LT(quality.tiling, quality.random / 3);
  EXPECT_LT(quality.window_distance, quality.random / 3);
  EXPECT_GT(quality.coherence, 0.6);
  EXPECT_GT(quality.texel_entropy, 0.7);
  ASSERT_EQ(quality.wider.size(), 2u);
  for (const WindowDistance& w : quality.wider) {
    EXPECT_LT(w.tiling, w.random / 2) << w.places << " " << w.step;
    EXPECT_LT(w.synthesized, w.random) << w.places << " " << w.step;  // wide ones hold several patches
  }
  EXPECT_LT(quality.wider[0].synthesized, quality.wider[0].random / 2);
  EXPECT_LT(quality.texton_chi_squared, 0.3);
  EXPECT_LT(quality.autocorrelation_error, 0.2);
  for (const Vec2f& c : texture.coordinate) {
    EXPECT_TRUE(c.x() >= 0 && c.x() < 64 && c.y() >= 0 && c.y() < 64) << c.transpose();
  }
}

TEST(SurfaceSynthesis, ContinuesOnePatchOverAPlaneWhenThatIsPossible) {
  // A grid whose vertices stand exactly a texel apart can copy the sample verbatim.
  const TextonSet textons = marble_textons(64);
  SynthesisOptions options;
  options.final_passes = 8;
  options.direction = Vec3(1, 0, 0);
  const SurfaceTexture texture = synthesize_surface(testing::patch(48, 0.4), textons, options);
  const SynthesisQuality quality = measure_synthesis(texture, textons);
  EXPECT_LT(quality.window_distance, 0.2 * quality.random);
  EXPECT_GT(quality.coherence, 0.85);
}

TEST(SurfaceSynthesis, AConstantSampleLooksTheSameEverywhere) {
  SampleDefinition definition = testing::layers(32);
  definition.pattern = LayersPattern{{{testing::marble_body(), 1}}, 0, 1};
  TextonOptions options;
  const TextonSet textons = make_textons(make_procedural_sample(definition), options);
  EXPECT_EQ(textons.texton_count, 1);
  const SurfaceTexture texture = synthesize_surface(testing::sphere(6, 5), textons, {});
  const SynthesisQuality quality = measure_synthesis(texture, textons);
  EXPECT_EQ(quality.window_distance, 0);
}

// Each figure must see its own fault.
TEST(SynthesisQuality, SeesDisorderMonotonyAndCopies) {
  const TextonSet textons = marble_textons(64);
  SurfaceTexture texture = synthesize_surface(testing::torus(8, 3, 125, 47), textons, {});
  const SynthesisQuality good = measure_synthesis(texture, textons);
  const std::vector<Vec2f> coordinate = texture.coordinate;
  for (std::size_t v = 0; v < coordinate.size(); ++v)
    texture.coordinate[v] =
        Vec2f(static_cast<float>(64 * to_unit(hash64(1, v))), static_cast<float>(64 * to_unit(hash64(2, v))));
  const SynthesisQuality disorder = measure_synthesis(texture, textons);
  EXPECT_GT(disorder.window_distance, 3 * good.window_distance);
  EXPECT_NEAR(disorder.window_distance, disorder.random, 0.2 * disorder.random);
  EXPECT_GT(disorder.autocorrelation_error, 2 * good.autocorrelation_error);
  EXPECT_LT(disorder.texton_chi_squared, 0.05);
  EXPECT_GT(disorder.patch_entropy, 0.9);
  // One corner of the sample again and again.
  for (std::size_t v = 0; v < coordinate.size(); ++v)
    texture.coordinate[v] = Vec2f(std::fmod(coordinate[v].x(), 8.0f), std::fmod(coordinate[v].y(), 8.0f));
  const SynthesisQuality monotony = measure_synthesis(texture, textons);
  EXPECT_GT(monotony.texton_chi_squared, 3 * good.texton_chi_squared);
  EXPECT_LT(monotony.texel_entropy, good.texel_entropy - 0.1);
}

TEST(SurfaceSynthesis, SameAtAnyThreadCountAndAnotherForAnotherSeed) {
  const TextonSet textons = marble_textons(32);
  const TriangleMesh mesh = testing::torus(6, 2.4, 95, 38);
  const auto run = [&](int threads, std::uint64_t seed) {
    const oneapi::tbb::global_control limit(oneapi::tbb::global_control::max_allowed_parallelism, threads);
    SynthesisOptions options;
    options.seed = seed;
    return synthesize_surface(mesh, textons, options).coordinate;
  };
  const std::vector<Vec2f> first = run(1, 5);
  EXPECT_TRUE(first == run(3, 5));
  EXPECT_FALSE(first == run(1, 6));
}

// Candidates lose little to looking at every texel, with as many rounds of windows: over samples and seeds no more than
// a twentieth. Of larger samples of few kinds of windows (spots of 96×96 texels) they lose more, which
// synthesis_cost_benchmark prints.
TEST(SurfaceSynthesis, IsAsNearToTheSampleAsExhaustiveSearch) {
  const TriangleMesh mesh = testing::torus(4.4, 1.9, 70, 30);
  std::vector<int> all(mesh.vertex_count());
  std::iota(all.begin(), all.end(), 0);
  double own = 0, exhaustive = 0;
  for (const SampleDefinition& definition : {testing::cells(48), testing::spots(48), testing::wood(48)}) {
    TextonOptions textons_options;
    textons_options.texton_count = 40;
    const TextonSet textons = make_textons(make_procedural_sample(definition), textons_options);
    SynthesisOptions options;
    const auto distance = [&] {
      const std::vector<double> d = window_distances(synthesize_surface(mesh, textons, options), textons, all);
      return std::accumulate(d.begin(), d.end(), 0.0) / static_cast<double>(d.size());
    };
    const int seeds = 6;
    for (int seed = 0; seed < seeds; ++seed) {
      options.seed = static_cast<std::uint64_t>(seed);
      options.method = SynthesisMethod::coherence;
      own += distance();
      options.method = SynthesisMethod::exhaustive;
      exhaustive += distance();
    }
  }
  EXPECT_LT(own, 1.05 * exhaustive);
}

// Where a sweep ends, an atlas is cut or levels meet, windows would be less like the sample's. Planes cut the surface
// in closed loops; along them windows are as near to the sample's as anywhere, within 10 % beyond the scatter of the
// seeds.
TEST(SurfaceSynthesis, NoClosedLoopIsASeam) {
  TextonOptions textons_options;
  textons_options.texton_count = 40;
  const TextonSet textons = make_textons(make_procedural_sample(testing::cells(32)), textons_options);
  RetileOptions tiles;
  tiles.spacing = 0.4;
  const TriangleMesh mesh = retile_surface(testing::torus(7, 3.2, 120, 60), tiles);
  std::vector<int> all(mesh.vertex_count());
  std::iota(all.begin(), all.end(), 0);
  std::vector<std::vector<int>> loops;
  RandomStream random(4);
  for (int loop = 0; loop < 24; ++loop) {
    Vec3 normal = Vec3::Unit(loop % 3);
    if (loop >= 12) normal = Vec3(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5).normalized();
    const Eigen::VectorXd height = mesh.vertices * normal;
    const double at = height.minCoeff() + (0.2 + 0.6 * random.next()) * (height.maxCoeff() - height.minCoeff());
    loops.emplace_back();
    for (int v : all)
      if (std::abs(height[v] - at) < 0.8) loops.back().push_back(v);
    ASSERT_GT(loops.back().size(), 100u);
  }
  // Per loop and seed the mean distance over that of the whole surface. `seam`: along the first loop texels are drawn.
  const auto worst_excess = [&](bool seam) {
    const int seeds = seam ? 4 : 12;
    Eigen::ArrayXXd ratios(static_cast<Eigen::Index>(loops.size()), seeds);
    for (int seed = 0; seed < seeds; ++seed) {
      SynthesisOptions options;
      options.seed = static_cast<std::uint64_t>(seed);
      SurfaceTexture texture = synthesize_surface(mesh, textons, options);
      if (seam)
        for (int v : loops[0])
          if (v % 4 == 0) texture.coordinate[v] = texture.coordinate[hash64(3, v) % texture.coordinate.size()];
      const std::vector<double> distance = window_distances(texture, textons, all);
      const double mean = std::accumulate(distance.begin(), distance.end(), 0.0) / mesh.vertex_count();
      for (std::size_t l = 0; l < loops.size(); ++l) {
        double along = 0;
        for (int v : loops[l]) along += distance[v];
        ratios(static_cast<Eigen::Index>(l), seed) = along / static_cast<double>(loops[l].size()) / mean;
      }
    }
    double worst = 0, typical = 0;
    for (Eigen::Index l = 0; l < ratios.rows(); ++l) {
      const double mean = ratios.row(l).mean();
      const double scatter = std::sqrt((ratios.row(l) - mean).square().sum() / (seeds - 1) / seeds);
      worst = std::max(worst, std::abs(mean - 1) - 2 * scatter);
      typical += std::abs(mean - 1) / static_cast<double>(ratios.rows());
    }
    EXPECT_TRUE(seam || typical < 0.06) << typical;
    return worst;
  };
  EXPECT_LT(worst_excess(false), 0.1);
  EXPECT_GT(worst_excess(true), 0.1);
}

// What is used too often costs, so more of the sample is seen, at hardly any price.
TEST(SurfaceSynthesis, EvennessShowsMoreOfTheSample) {
  double entropy[2] = {0, 0}, distance[2] = {0, 0};
  for (const SampleDefinition& definition : {testing::marble(64), testing::cells(64)}) {
    TextonOptions textons_options;
    textons_options.texton_count = 40;
    const TextonSet textons = make_textons(make_procedural_sample(definition), textons_options);
    constexpr int seeds = 4;
    for (int run = 0; run < 2 * seeds; ++run) {
      const int even = run % 2;
      SynthesisOptions options;
      options.seed = static_cast<std::uint64_t>(run / 2);
      if (!even) options.evenness = options.final_evenness = 0;
      const SurfaceTexture texture = synthesize_surface(testing::torus(7, 2.8, 110, 44), textons, options);
      const SynthesisQuality quality = measure_synthesis(texture, textons, {.windows = 1024});
      entropy[even] += quality.texel_entropy / (2 * seeds);
      distance[even] += quality.window_distance / (2 * seeds);
    }
  }
  EXPECT_GT(entropy[1], entropy[0] + 0.006);
  EXPECT_LT(distance[1], 1.1 * distance[0]);
}

TEST(SurfaceSynthesis, WorkGrowsLinearlyWithTheVertices) {
  const TextonSet textons = marble_textons(64);
  const auto per_vertex = [&](double size, int around, int across) {
    const SurfaceTexture texture = synthesize_surface(testing::torus(size, 0.4 * size, around, across), textons, {});
    return static_cast<double>(texture.comparisons) / static_cast<double>(texture.coordinate.size());
  };
  const double few = per_vertex(5, 79, 31), many = per_vertex(20, 314, 126);
  EXPECT_LT(many, 1.1 * few);
  EXPECT_GT(many, 0.5 * few);
}

TEST(SurfaceSynthesis, SymmetricSamplesHaveMilderSingularities) {
  TextonOptions textons_options;
  textons_options.texton_count = 40;
  const MaterialSample sample = make_procedural_sample(testing::cells(48));
  for (int symmetry : {1, 2, 4}) {
    textons_options.symmetry = symmetry;
    const TextonSet textons = make_textons(sample, textons_options);
    const SurfaceTexture texture = synthesize_surface(testing::sphere(9, 5), textons, {});
    double sum = 0;
    for (const Singularity& s : texture.singularities) {
      EXPECT_NEAR(std::abs(s.index), 1.0 / symmetry, 1e-12);
      sum += s.index;
    }
    EXPECT_NEAR(sum, 2, 1e-9);
    const SynthesisQuality quality = measure_synthesis(texture, textons);
    EXPECT_LT(quality.window_distance, quality.random / 2) << symmetry;
    EXPECT_GT(quality.coherence, 0.5) << symmetry;
    // Where neighbours continue each other, also across the turns of the field, their directions agree.
    const TriangleMesh& mesh = texture.surface.mesh;
    int continued = 0, agreeing = 0;
    for (int f = 0; f < mesh.face_count(); ++f) {
      const int a = mesh.faces(f, 0), b = mesh.faces(f, 1);
      const double length = (mesh.vertex(a) - mesh.vertex(b)).norm() / textons.voxel;
      const Vec2f step = textons.layers.difference(0, texture.coordinate[a], texture.coordinate[b]);
      if (std::abs(step.norm() - length) > 0.1) continue;
      ++continued;
      agreeing += texture.surface.directions.row(a).dot(texture.surface.directions.row(b)) > 0.7;
    }
    EXPECT_GT(continued, mesh.face_count() / 5);
    EXPECT_GT(agreeing, 0.97 * continued) << symmetry;
  }
}

TEST(SurfaceSynthesis, SamplesKeepToTheirAreasAndMeetInTheBorder) {
  const MaterialSample first = make_procedural_sample(testing::spots(40)),
                       second = make_procedural_sample(testing::cells(48));
  TextonOptions textons_options;
  textons_options.texton_count = 40;
  const TextonSet textons = make_textons({&first, &second}, textons_options);
  const TriangleMesh mesh = testing::torus(8, 3, 125, 47);
  SynthesisOptions options;
  EXPECT_THROW(synthesize_surface(mesh, textons, options), InputError);
  for (int v = 0; v < mesh.vertex_count(); ++v) options.paint.sample.push_back(mesh.vertex(v).x() > 0);
  const SurfaceTexture texture = synthesize_surface(mesh, textons, options);
  int crossed = 0;
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const SampleLayer& layer = textons.layers[texture.sample[v]];
    ASSERT_TRUE(texture.coordinate[v].x() < layer.width && texture.coordinate[v].y() < layer.height);
    if (texture.sample[v] == options.paint.sample[v]) continue;
    ++crossed;
    EXPECT_LT(std::abs(mesh.vertex(v).x()), options.blend_width * textons.voxel);
  }
  EXPECT_GT(crossed, 0);
  const SynthesisQuality quality = measure_synthesis(texture, textons);
  EXPECT_LT(quality.window_distance, quality.random / 2);
  // Small areas keep their middles: a disc of 6 texels' radius.
  const std::vector<std::int32_t> halves = options.paint.sample;
  const Vec3 middle = mesh.vertex(0);
  for (int v = 0; v < mesh.vertex_count(); ++v)
    options.paint.sample[v] = (mesh.vertex(v) - middle).norm() < 6 * textons.voxel;
  EXPECT_EQ(synthesize_surface(mesh, textons, options).sample[0], 1);
  options.paint.sample = halves;
  // Without a border to blend in, the areas are the user's exactly.
  options.blend_width = 0;
  EXPECT_TRUE(synthesize_surface(mesh, textons, options).sample == options.paint.sample);
  options.paint.sample[7] = 2;
  EXPECT_THROW(synthesize_surface(mesh, textons, options), InputError);
}

// A stripe three texels wide lies wholly within reach of the other sample, yet stays where it is deepest.
TEST(SurfaceSynthesis, NarrowPaintedAreasKeepTheirMiddlesAndLossesAreTold) {
  class Listener : public Progress {
   public:
    void warn(const std::string& message) override { warnings.push_back(message); }
    std::vector<std::string> warnings;
  };
  const MaterialSample first = make_procedural_sample(testing::cells(48)),
                       second = make_procedural_sample(testing::spots(40));
  TextonOptions textons_options;
  textons_options.texton_count = 40;
  const TextonSet textons = make_textons({&first, &second}, textons_options);
  const TriangleMesh mesh = testing::patch(60, textons.voxel);
  SynthesisOptions options;
  const auto paint_stripe = [&](int texels) {
    options.paint.sample.clear();
    for (int v = 0; v < mesh.vertex_count(); ++v) options.paint.sample.push_back(2 * std::abs(v % 61 - 30) < texels);
  };
  paint_stripe(5);
  Listener narrow;
  SurfaceTexture texture = synthesize_surface(mesh, textons, options, narrow);
  for (int y = 0; y <= 60; ++y) EXPECT_EQ(texture.sample[61 * y + 30], 1) << y;
  ASSERT_EQ(narrow.warnings.size(), 1u);
  EXPECT_NE(narrow.warnings[0].find("1 painted area is"), std::string::npos) << narrow.warnings[0];
  EXPECT_NE(narrow.warnings[0].find("8 texels"), std::string::npos) << narrow.warnings[0];
  paint_stripe(21);
  Listener wide;
  synthesize_surface(mesh, textons, options, wide);
  EXPECT_TRUE(wide.warnings.empty());
  paint_stripe(5);
  options.blend_width = 0;
  Listener exact;
  texture = synthesize_surface(mesh, textons, options, exact);
  EXPECT_TRUE(texture.sample == options.paint.sample);
  EXPECT_TRUE(exact.warnings.empty());
}

TEST(SurfaceSynthesis, ScaleAndDirectionsFollowThePaint) {
  const TextonSet textons = marble_textons(48);
  const TriangleMesh mesh = testing::patch(60, 0.4);
  SynthesisOptions options;
  options.direction = Vec3(1, 0, 0);
  const auto texels_along_x = [&](double from, double to) {
    const SurfaceTexture texture = synthesize_surface(mesh, textons, options);
    double sum = 0, count = 0;
    for (int v = 0; v + 1 < mesh.vertex_count(); ++v) {
      if (mesh.vertex(v).x() < from || mesh.vertex(v).x() > to || texture.coherence[v] < 0.9f) continue;
      const Vec2f step = textons.layers.difference(0, texture.coordinate[v + 1], texture.coordinate[v]);
      if (step.norm() > 4) continue;
      sum += step.x(), count += 1;
    }
    return sum / std::max(1.0, count);
  };
  EXPECT_NEAR(texels_along_x(1, 23), 1, 0.1);
  options.paint.scale.assign(mesh.vertex_count(), 2.0f);
  EXPECT_NEAR(texels_along_x(1, 23), 0.5, 0.1);
  for (int v = 0; v < mesh.vertex_count(); ++v) options.paint.scale[v] = mesh.vertex(v).x() < 12 ? 1.0f : 1.5f;
  EXPECT_NEAR(texels_along_x(14, 23), 1 / 1.5, 0.12);
  options.paint.scale.clear();
  // Painted on two strips; what is not painted follows.
  options.paint.direction.assign(mesh.vertex_count(), Vec3f::Zero());
  for (int v = 0; v < mesh.vertex_count(); ++v)
    if (mesh.vertex(v).x() < 2)
      options.paint.direction[v] = Vec3f(0, 3, 0);
    else if (mesh.vertex(v).x() > 22)
      options.paint.direction[v] = Vec3f(-1, 1, 5);  // its part along the surface counts
  const SurfaceTexture texture = synthesize_surface(mesh, textons, options);
  for (int v = 0; v < mesh.vertex_count(); ++v) {
    const Vec3 d = texture.surface.directions.row(v).transpose();
    if (mesh.vertex(v).x() < 2) EXPECT_GT(d.y(), 0.999);
    if (mesh.vertex(v).x() > 22) EXPECT_LT(d.x(), -0.7);
    if (mesh.vertex(v).x() > 10 && mesh.vertex(v).x() < 14) EXPECT_GT(d.dot(Vec3(-0.38, 0.92, 0)), 0.9);
  }
}

TEST(SurfaceSynthesis, RefusesAMeshTooCoarseForTheSample) {
  EXPECT_THROW(synthesize_surface(testing::sphere(20, 3), marble_textons(32), {}), InputError);
  EXPECT_THROW(synthesize_surface(TriangleMesh{VertexMatrix(0, 3), FaceMatrix(0, 3)}, marble_textons(32), {}),
               InputError);
}

}  // namespace
}  // namespace shellgrid
