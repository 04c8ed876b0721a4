// SPDX-License-Identifier: AGPL-3.0-or-later
#include "meshing/surface/surface_fit.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/random.h"
#include "meshing/surface/closest_point.h"
#include "tests/support/closed_shapes.h"

namespace shellgrid {
namespace {

// Places below a ball's surface and a few above it, each `off` more or less from it than it should be.
std::vector<PlaceAtDistance> places_about_ball(double radius, double off) {
  RandomStream random(7);
  std::vector<PlaceAtDistance> places;
  for (int k = 0; k < 300; ++k) {
    const Vec3 direction = Vec3(random.next() - 0.5, random.next() - 0.5, random.next() - 0.5).normalized();
    const double depth = 0.3 * radius * random.next() - 0.02 * radius;
    places.push_back({(radius - depth) * direction, std::abs(depth) + off * random.next()});
  }
  return places;
}

double by_all_faces(const std::vector<PlaceAtDistance>& places, const TriangleMesh& mesh, double share) {
  const ClosestPointQuery query(mesh);
  std::vector<double> deviations;
  for (const PlaceAtDistance& place : places)
    deviations.push_back(std::abs(std::sqrt(query.nearest(place.point).squared_distance) - place.distance));
  std::sort(deviations.begin(), deviations.end());
  return deviations[static_cast<std::size_t>(share * static_cast<double>(places.size() - 1))];
}

TEST(DistanceDeviation, IsThatOfAllFacesWhetherTheyFitOrNot) {
  for (const int level : {0, 2, 5}) {
    const TriangleMesh ball = shapes::sphere(10, level);
    for (const double off : {0.0, 0.05, 0.3, 5.0, 40.0})
      for (const double share : {0.0, 0.5, 0.9, 1.0}) {
        const auto places = places_about_ball(10, off);
        const double expected = by_all_faces(places, ball, share);
        EXPECT_NEAR(distance_deviation(places, ball, share), expected, 1e-9 * (1 + expected))
            << level << " " << off << " " << share;
      }
  }
}

TEST(DistanceDeviation, FarPlacesAndNoPlaces) {
  const TriangleMesh ball = shapes::sphere(1, 2);
  EXPECT_EQ(distance_deviation({}, ball, 0.5), 0);
  EXPECT_NEAR(distance_deviation({{Vec3(1000, 0, 0), 0}}, ball, 0.5), 999, 0.1);
  EXPECT_THROW(distance_deviation({{Vec3::Zero(), 0}}, TriangleMesh(), 0.5), InputError);
}

}  // namespace
}  // namespace shellgrid
