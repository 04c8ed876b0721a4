// SPDX-License-Identifier: AGPL-3.0-or-later
#include "solvers/render/mesh_preview.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace shellgrid {
namespace {

constexpr int supersampling = 2;

// Screen x to the right, y downwards, z towards the viewer; pixels.
struct View {
  Mat3 rotation;
  Vec3 centre;
  double scale;
  int width, height;

  Vec3 project(const Vec3& point) const {
    const Vec3 turned = rotation * (point - centre) * scale;
    return {turned.x() + 0.5 * width, 0.5 * height - turned.y(), turned.z()};
  }
};

View fit_view(const VertexMatrix& vertices, int width, int height) {
  const Vec3 backward = Vec3(0.45, 0.35, 1).normalized(), right = Vec3(0, 1, 0).cross(backward).normalized();
  View view{Mat3(), Vec3::Zero(), 1, width, height};
  view.rotation << right.transpose(), backward.cross(right).transpose(), backward.transpose();
  Vec3 least = Vec3::Constant(std::numeric_limits<double>::max()), most = -least;
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    const Vec3 turned = view.rotation * vertices.row(v).transpose();
    if (!turned.allFinite()) continue;
    least = least.cwiseMin(turned);
    most = most.cwiseMax(turned);
  }
  if (!(least.array() <= most.array()).all()) return view;
  view.centre = view.rotation.transpose() * (0.5 * (least + most));
  const Vec3 extent = (most - least).cwiseMax(1e-12 * (1 + most.norm()));
  view.scale = 0.92 * std::min(width / extent.x(), height / extent.y());
  return view;
}

// A perceptual ramp from dark blue through green to yellow.
Rgb ramp(double t) {
  static const std::array<Rgb, 5> colours = {Rgb(0.27f, 0.00f, 0.33f), Rgb(0.23f, 0.32f, 0.55f),
                                             Rgb(0.13f, 0.57f, 0.55f), Rgb(0.37f, 0.79f, 0.38f),
                                             Rgb(0.99f, 0.91f, 0.14f)};
  const double place = std::clamp(t, 0.0, 1.0) * 4;
  const int i = std::min(3, static_cast<int>(place));
  const float f = static_cast<float>(place - i);
  return (1 - f) * colours[i] + f * colours[i + 1];
}

std::vector<Rgb> vertex_colours(const AttributedMesh& mesh, MeshPreview& preview) {
  const std::size_t count = static_cast<std::size_t>(mesh.mesh.vertex_count());
  std::vector<Rgb> colours(count, Rgb::Constant(0.85f));
  const auto* red = mesh.find("red");
  const auto* green = mesh.find("green");
  const auto* blue = mesh.find("blue");
  if (red && green && blue) {
    for (std::size_t v = 0; v < count; ++v) colours[v] = Rgb((*red)[v], (*green)[v], (*blue)[v]) / 255;
    return colours;
  }
  const auto* quality = mesh.find("quality");
  if (!quality) return colours;
  double least = std::numeric_limits<double>::max(), most = -least;
  for (const float value : *quality)
    if (std::isfinite(value)) least = std::min<double>(least, value), most = std::max<double>(most, value);
  if (least > most) return colours;
  for (std::size_t v = 0; v < count; ++v)
    if (std::isfinite((*quality)[v])) colours[v] = ramp(most > least ? ((*quality)[v] - least) / (most - least) : 0.5);
  preview.least_quality = least;
  preview.most_quality = most;
  preview.coloured_by_quality = true;
  return colours;
}

class Canvas {
 public:
  Canvas(int width, int height)
      : width_(width),
        height_(height),
        depth_(static_cast<std::size_t>(width) * height, -std::numeric_limits<float>::max()),
        colour_(depth_.size(), Rgb::Ones()) {}

  void triangle(const std::array<Vec3, 3>& p, const std::array<Rgb, 3>& colours, float shade) {
    const double area = (p[1].x() - p[0].x()) * (p[2].y() - p[0].y()) - (p[2].x() - p[0].x()) * (p[1].y() - p[0].y());
    if (!(std::abs(area) > 1e-12)) return;
    const auto [left, right] = std::minmax({p[0].x(), p[1].x(), p[2].x()});
    const auto [top, bottom] = std::minmax({p[0].y(), p[1].y(), p[2].y()});
    for (int y = std::max(0, static_cast<int>(std::ceil(top - 0.5))); y < height_ && y + 0.5 <= bottom; ++y)
      for (int x = std::max(0, static_cast<int>(std::ceil(left - 0.5))); x < width_ && x + 0.5 <= right; ++x) {
        std::array<double, 3> weight;
        for (int k = 0; k < 3; ++k) {
          const Vec3 &a = p[(k + 1) % 3], &b = p[(k + 2) % 3];
          weight[k] = ((a.x() - x - 0.5) * (b.y() - y - 0.5) - (b.x() - x - 0.5) * (a.y() - y - 0.5)) / area;
        }
        if (weight[0] < 0 || weight[1] < 0 || weight[2] < 0) continue;
        Rgb colour = Rgb::Zero();
        double depth = 0;
        for (int k = 0; k < 3; ++k) depth += weight[k] * p[k].z(), colour += static_cast<float>(weight[k]) * colours[k];
        put(x, y, depth, shade * colour);
      }
  }

  void square(const Vec3& centre, double side, const Rgb& colour) {
    const int left = static_cast<int>(std::floor(centre.x() - side / 2 + 0.5));
    const int top = static_cast<int>(std::floor(centre.y() - side / 2 + 0.5));
    const int size = std::max(1, static_cast<int>(side + 0.5));
    for (int y = std::max(0, top); y < std::min(height_, top + size); ++y)
      for (int x = std::max(0, left); x < std::min(width_, left + size); ++x) put(x, y, centre.z(), colour);
  }

  void resolve(MeshPreview& preview) const {
    preview.rgb.reserve(static_cast<std::size_t>(preview.width) * preview.height * 3);
    for (int y = 0; y < preview.height; ++y)
      for (int x = 0; x < preview.width; ++x) {
        Rgb sum = Rgb::Zero();
        for (int j = 0; j < supersampling; ++j)
          for (int i = 0; i < supersampling; ++i)
            sum += colour_[static_cast<std::size_t>(y * supersampling + j) * width_ + x * supersampling + i];
        const Rgb mean = sum / static_cast<float>(supersampling * supersampling);
        for (int k = 0; k < 3; ++k)
          preview.rgb.push_back(static_cast<std::uint8_t>(std::clamp(255 * mean[k] + 0.5f, 0.0f, 255.0f)));
      }
  }

 private:
  void put(int x, int y, double depth, const Rgb& colour) {
    const std::size_t pixel = static_cast<std::size_t>(y) * width_ + x;
    if (static_cast<float>(depth) <= depth_[pixel]) return;
    depth_[pixel] = static_cast<float>(depth);
    colour_[pixel] = colour;
  }

  int width_, height_;
  std::vector<float> depth_;
  std::vector<Rgb> colour_;
};

}  // namespace

MeshPreview draw_mesh(const AttributedMesh& attributed, int width, int height) {
  MeshPreview preview;
  preview.width = width;
  preview.height = height;
  const TriangleMesh& mesh = attributed.mesh;
  const std::vector<Rgb> colours = vertex_colours(attributed, preview);
  const int wide = width * supersampling, high = height * supersampling;
  const View view = fit_view(mesh.vertices, wide, high);
  const Vec3 light = Vec3(-0.4, 0.5, 1).normalized();
  Canvas canvas(wide, high);
  for (int f = 0; f < mesh.face_count(); ++f) {
    std::array<Vec3, 3> corners;
    std::array<Rgb, 3> corner_colours;
    for (int k = 0; k < 3; ++k) {
      corners[k] = view.project(mesh.corner(f, k));
      corner_colours[k] = colours[mesh.faces(f, k)];
    }
    if (!(corners[0].allFinite() && corners[1].allFinite() && corners[2].allFinite())) continue;
    const Vec3 normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalized();
    // Screen y points down, so the normal's y is reversed, and its z with it.
    const double facing = std::abs(Vec3(normal.x(), -normal.y(), normal.z()).dot(light));
    canvas.triangle(corners, corner_colours, static_cast<float>(0.35 + 0.65 * facing));
  }
  if (mesh.face_count() == 0 && mesh.vertex_count() > 0) {
    // As wide as points would lie apart if they were spread over half the picture.
    const double apart = std::sqrt(0.5 * wide * high / mesh.vertex_count());
    const double side = std::clamp(0.8 * apart, 2.0, 12.0);
    for (int v = 0; v < mesh.vertex_count(); ++v) {
      const Vec3 place = view.project(mesh.vertex(v));
      if (place.allFinite())
        canvas.square(place, side, static_cast<float>(std::clamp(0.75 + place.z() / high, 0.4, 1.0)) * colours[v]);
    }
  }
  canvas.resolve(preview);
  return preview;
}

}  // namespace shellgrid
