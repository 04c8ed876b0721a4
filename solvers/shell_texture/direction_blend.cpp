// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/shell_texture/direction_blend.h"

#include <Eigen/Core>
#include <cmath>
#include <cstring>
#include <numbers>

namespace shellgrid {
namespace {

using Numbers = DirectionBlends::Numbers;
using Indices = DirectionBlends::Indices;
constexpr float pi = std::numbers::pi_v<float>;

Numbers all(float value) { return Numbers{} + value; }
Numbers least(const Numbers& a, const Numbers& b) { return a < b ? a : b; }
Numbers greatest(const Numbers& a, const Numbers& b) { return a > b ? a : b; }
Numbers absolute(const Numbers& a) { return a < 0 ? -a : a; }
Numbers square_root(const Numbers& a) {
  Eigen::Array<float, DirectionBlends::lanes, 1> root;
  std::memcpy(root.data(), &a, sizeof a);
  root = root.sqrt().eval();
  Numbers result;
  std::memcpy(&result, root.data(), sizeof result);
  return result;
}
Indices whole(const Numbers& a) { return __builtin_convertvector(a, Indices); }  // towards zero
Numbers numbers(const Indices& a) { return __builtin_convertvector(a, Numbers); }

// atan2 of y ≥ 0, within 2e-7; 0 at the origin. Source: Abramowitz and Stegun, 4.4.49.
Numbers angle_of(const Numbers& y, const Numbers& x) {
  constexpr float a[] = {1,
                         -0.3333314528f,
                         0.1999355085f,
                         -0.1420889944f,
                         0.1065626393f,
                         -0.0752896400f,
                         0.0429096138f,
                         -0.0161657367f,
                         0.0028662257f};
  const Numbers across = absolute(x), greater = greatest(greatest(across, y), all(1e-30f));
  const Numbers ratio = least(across, y) / greater, square = ratio * ratio;
  Numbers sum = all(a[8]);
  for (int k = 7; k >= 0; --k) sum = sum * square + a[k];
  const Numbers first = ratio * sum;
  const Numbers right = y > across ? pi / 2 - first : first;
  return x < 0 ? pi - right : right;
}

}  // namespace

DirectionBlends::DirectionBlends(const LightDirections& table, const Numbers& x, const Numbers& y, const Numbers& z) {
  const int rings = table.rings, turns = table.turns;
  const auto count = static_cast<float>(turns);
  const float step = pi / static_cast<float>(2 * rings);
  const Numbers up = greatest(z, Numbers{});
  const Numbers polar = angle_of(square_root(x * x + y * y), up);
  const Numbers half = angle_of(absolute(y), x) * (count / (2 * pi));
  const Numbers turn = y < 0 ? count - half : half;
  const Numbers place = polar / step - 0.5f;  // ring k at k
  const auto over_zenith = place < 0;
  const Indices floor = whole(greatest(place, Numbers{}));
  const Indices ring = floor < rings ? floor : Indices{} + (rings - 1);
  const Numbers part = place - numbers(ring);
  const auto lowest = ring == rings - 1;
  const Numbers fade = least(up / std::cos((static_cast<float>(rings) - 0.5f) * step), all(1));
  // Ring 0 of this side is half a step from the zenith, that of the other side too.
  const Indices second_ring = over_zenith ? Indices{} : lowest ? ring : ring + 1;
  const Numbers lit = z > 0 ? all(1) : Numbers{};
  const Numbers first = lit * (over_zenith ? 1 + place : lowest ? fade : 1 - part);
  const Numbers second = lit * (over_zenith ? -place : lowest ? Numbers{} : part);
  const Numbers opposite = over_zenith ? turn + 0.5f * count : turn;
  const auto put = [&](int k, const Indices& to, const Numbers& weight, const Numbers& about) {
    const Numbers at = about < count ? about : about - count;
    const Indices before = whole(at), low = before < turns ? before : Indices{} + (turns - 1);
    const Numbers t = at - numbers(low);
    directions[k] = to * turns + low;
    directions[k + 1] = to * turns + (low + 1 < turns ? low + 1 : Indices{});
    weights[k] = weight * (1 - t);
    weights[k + 1] = weight * t;
  };
  put(0, ring, first, turn);
  put(2, second_ring, second, opposite);
}

std::vector<DirectionWeight> blend_directions(const LightDirections& table, const Vec3& to_light) {
  const Vec3f light = to_light.cast<float>();
  const DirectionBlends blend(table, all(light.x()), all(light.y()), all(light.z()));
  std::vector<DirectionWeight> list;
  for (std::size_t k = 0; k < blend.weights.size(); ++k)
    if (blend.weights[k][0] != 0) list.push_back({blend.directions[k][0], Vec3f::Constant(blend.weights[k][0])});
  return list;
}

}  // namespace shellgrid
