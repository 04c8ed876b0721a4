// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/textured_mesh.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "meshing/core/error.h"
#include "meshing/core/parallel.h"
#include "meshing/core/random.h"
#include "meshing/formats/vdb_file.h"
#include "meshing/surface/half_edges.h"
#include "synthesis/albedo.h"
#include "synthesis/half_space_reflectance.h"

namespace shellgrid {
namespace {

// Fills `red green blue quality` (appended in that order) from color(i) and quality(i).
template <class Color, class Quality>
void add_colors(AttributedMesh& mesh, const Color& color, const Quality& quality) {
  const std::size_t n = mesh.mesh.vertex_count();
  VertexProperty channels[4] = {{"red", {}}, {"green", {}}, {"blue", {}}, {"quality", {}}};
  for (VertexProperty& channel : channels) channel.values.resize(n);
  parallel_for(n, [&](std::size_t i) {
    const Vec3f rgb = color(static_cast<int>(i));
    for (int c = 0; c < 3; ++c) channels[c].values[i] = rgb[c];
    channels[3].values[i] = quality(static_cast<int>(i));
  });
  for (VertexProperty& channel : channels) mesh.properties.push_back(std::move(channel));
}

}  // namespace

AttributedMesh attach_texture(const SurfaceTexture& texture, const TextonSet& textons) {
  AttributedMesh result;
  result.mesh = texture.surface.mesh;
  const int n = result.mesh.vertex_count();
  const auto add = [&](const std::string& name, const auto& value) {
    VertexProperty property{name, std::vector<float>(n)};
    for (int v = 0; v < n; ++v) property.values[v] = static_cast<float>(value(v));
    result.properties.push_back(std::move(property));
  };
  add("texture_u", [&](int v) { return texture.coordinate[v].x(); });
  add("texture_v", [&](int v) { return texture.coordinate[v].y(); });
  add("direction_x", [&](int v) { return texture.surface.directions(v, 0); });
  add("direction_y", [&](int v) { return texture.surface.directions(v, 1); });
  add("direction_z", [&](int v) { return texture.surface.directions(v, 2); });
  const SampleLayers& layers = textons.layers;
  add("s", [&](int v) { return texture.coordinate[v].x() / layers[texture.sample[v]].width; });
  add("t", [&](int v) { return texture.coordinate[v].y() / layers[texture.sample[v]].height; });
  if (!texture.surface.scale.empty()) add("scale", [&](int v) { return texture.surface.scale[v]; });
  if (layers.sample_count > 1) add("sample", [&](int v) { return texture.sample[v]; });
  add_colors(
      result,
      [&](int v) {
        return textons.color[layers.texel({texture.sample[v], texture.coordinate[v]})];
      },
      [&](int v) { return texture.coherence[v]; });
  return result;
}

TexturedMesh detach_texture(const AttributedMesh& mesh, const std::string& name) {
  const auto property = [&](const std::string& key) -> const std::vector<float>& {
    const std::vector<float>* values = mesh.find(key);
    if (!values)
      throw InputError(
          fmt::format("{}: the vertices have no property '{}'; expected a mesh as sg-synthesize writes it", name, key));
    for (std::size_t i = 0; i < values->size(); ++i)
      if (!std::isfinite((*values)[i]))
        throw InputError(fmt::format("{}: '{}' of vertex {} is not finite", name, key, i));
    return *values;
  };
  const std::vector<float>&u = property("texture_u"), &v = property("texture_v");
  TexturedMesh result;
  if (mesh.find("sample"))
    for (const float value : property("sample")) {
      if (!(value >= 0 && value < 256 && value == std::floor(value)))
        throw InputError(fmt::format("{}: 'sample' is {} at a vertex; expected a small whole number", name, value));
      result.sample.push_back(static_cast<std::int32_t>(value));
    }
  if (mesh.find("scale"))
    for (const float value : property("scale")) {
      if (!(value >= 1e-3f && value <= 1e3f))
        throw InputError(fmt::format("{}: 'scale' is {} at a vertex; expected 0.001 to 1000", name, value));
      result.scale.push_back(value);
    }
  // s = u/n_x and t = v/n_y tell the size of each sample.
  if (mesh.find("s") && mesh.find("t")) {
    const std::vector<float>*share[2] = {&property("s"), &property("t")}, *texels[2] = {&u, &v};
    const int samples = result.sample.empty() ? 1 : *std::max_element(result.sample.begin(), result.sample.end()) + 1;
    result.sample_sizes.assign(samples, Eigen::Vector2i::Zero());
    std::vector<Vec2f> largest(samples, Vec2f::Constant(0.05f));
    for (std::size_t i = 0; i < u.size(); ++i) {
      const int sample = result.sample_of(static_cast<int>(i));
      for (int axis = 0; axis < 2; ++axis)
        if ((*share[axis])[i] > largest[sample][axis] && (*share[axis])[i] <= 1.001f) {
          largest[sample][axis] = (*share[axis])[i];
          result.sample_sizes[sample][axis] = static_cast<int>(std::lround((*texels[axis])[i] / (*share[axis])[i]));
        }
    }
  }
  const std::vector<float>* direction[3] = {&property("direction_x"), &property("direction_y"),
                                            &property("direction_z")};
  result.mesh = mesh.mesh;
  result.normals = vertex_normals(mesh.mesh);
  const int n = mesh.mesh.vertex_count();
  result.directions.resize(n, 3);
  result.coordinate.resize(n);
  for (int i = 0; i < n; ++i) {
    if (std::abs(u[i]) > 1e6f || std::abs(v[i]) > 1e6f)
      throw InputError(
          fmt::format("{}: texture coordinate ({}, {}) of vertex {} is out of range", name, u[i], v[i], i));
    result.coordinate[i] = Vec2f(u[i], v[i]);
    const Vec3 normal = result.normals.row(i).transpose();
    Vec3 d((*direction[0])[i], (*direction[1])[i], (*direction[2])[i]);
    d -= normal * normal.dot(d);
    if (!(d.norm() > 1e-6))
      throw InputError(fmt::format("{}: the direction of vertex {} is not tangent to the surface", name, i));
    result.directions.row(i) = d.normalized().transpose();
  }
  return result;
}

AttributedMesh view_sample(const MaterialSample& sample) {
  // Negative in material, positive around it, a voxel of margin on each side.
  TwoLevelGrid<float> outside(Vec3i::Constant(-1), (sample.size.array() + 15) / 8 + 1, 0.5f);
  const Vec3i size = sample.size;
  for (int x = -1; x <= size.x(); ++x)
    for (int y = -1; y <= size.y(); ++y)
      for (int z = -1; z <= size.z(); ++z) {
        const bool within = x >= 0 && y >= 0 && z >= 0 && x < size.x() && y < size.y() && z < size.z();
        const bool material = within && sample.kind[sample.index(x, y, z)] != VoxelKind::free_space;
        outside.set(x, y, z, material ? -0.5f : 0.5f);
      }
  AttributedMesh view;
  view.mesh = extract_isosurface(outside, {Vec3::Zero(), sample.voxel}, 0.0);
  const auto voxel_of = [&](int vertex) {
    // The nearest material voxel of the eight around the vertex.
    const Vec3 p = view.mesh.vertex(vertex) / sample.voxel;
    const Vec3i base = p.array().floor().cast<int>();
    std::size_t best = 0;
    double best_distance = 1e300;
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3i at = base + Vec3i(corner & 1, corner >> 1 & 1, corner >> 2);
      if ((at.array() < 0).any() || (at.array() >= size.array()).any()) continue;
      const std::size_t index = sample.index(at.x(), at.y(), at.z());
      const double distance = (at.cast<double>() - p).squaredNorm();
      if (sample.kind[index] != VoxelKind::free_space && distance < best_distance)
        best_distance = distance, best = index;
    }
    return best;
  };
  const ReflectanceInversion half_space(ReflectanceModel::transport, sample.ior);
  add_colors(
      view, [&](int v) { return Vec3f(display_color(half_space.color(sample.material(voxel_of(v)))).matrix()); },
      [&](int v) { return static_cast<float>(view.mesh.vertices(v, 2)); });
  // Drawn with the top up: depth runs downwards.
  for (int v = 0; v < view.mesh.vertex_count(); ++v) view.mesh.vertices(v, 2) = -view.mesh.vertices(v, 2);
  view.mesh.faces.col(1).swap(view.mesh.faces.col(2));
  return view;
}

AttributedMesh view_textons(const TextonSet& textons) {
  AttributedMesh view;
  const int texels = textons.layers.base_texel_count();
  view.mesh.vertices.resize(2 * texels, 3);
  std::vector<Eigen::RowVector3i> faces;
  const auto quad = [&](int a, int b, int c, int d) {
    faces.emplace_back(a, b, c);
    faces.emplace_back(a, c, d);
  };
  double left = 0;
  for (int s = 0; s < textons.layers.sample_count; ++s) {
    const SampleLayer& layer = textons.layers[s];
    const int w = layer.width, h = layer.height;
    const auto top = [&](int x, int y) { return layer.first + y * w + x; };
    const auto bottom = [&](int x, int y) { return texels + layer.first + y * w + x; };
    for (int y = 0; y < h; ++y)
      for (int x = 0; x < w; ++x) {
        view.mesh.vertices.row(top(x, y)) << left + x * textons.voxel, y * textons.voxel, 0;
        view.mesh.vertices.row(bottom(x, y)) << left + x * textons.voxel, y * textons.voxel, -textons.voxel;
      }
    left += (w + 4) * textons.voxel;
    for (int y = 0; y + 1 < h; ++y)
      for (int x = 0; x + 1 < w; ++x) {
        quad(top(x, y), top(x + 1, y), top(x + 1, y + 1), top(x, y + 1));
        quad(bottom(x, y), bottom(x, y + 1), bottom(x + 1, y + 1), bottom(x + 1, y));
      }
    for (int x = 0; x + 1 < w; ++x) {
      quad(bottom(x, 0), bottom(x + 1, 0), top(x + 1, 0), top(x, 0));
      quad(bottom(x + 1, h - 1), bottom(x, h - 1), top(x, h - 1), top(x + 1, h - 1));
    }
    for (int y = 0; y + 1 < h; ++y) {
      quad(bottom(0, y + 1), bottom(0, y), top(0, y), top(0, y + 1));
      quad(bottom(w - 1, y), bottom(w - 1, y + 1), top(w - 1, y + 1), top(w - 1, y));
    }
  }
  view.mesh.faces.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t f = 0; f < faces.size(); ++f) view.mesh.faces.row(static_cast<Eigen::Index>(f)) = faces[f];
  // Three components, each stretched over four standard deviations.
  const std::vector<float>& appearance = textons.levels.front().appearance;
  Vec3f deviation = Vec3f::Zero();
  for (int t = 0; t < texels; ++t)
    for (int c = 0; c < 3; ++c)
      deviation[c] += std::pow(appearance[static_cast<std::size_t>(t) * TextonSet::dimension + c], 2.0f);
  deviation = (deviation / static_cast<float>(texels)).cwiseSqrt().cwiseMax(1e-12f);
  add_colors(
      view,
      [&](int v) {
        const int texel = v % texels;
        Vec3f color;
        for (int c = 0; c < 3; ++c)
          color[c] = v < texels ? 128 + 64 * appearance[static_cast<std::size_t>(texel) * TextonSet::dimension + c] /
                                            deviation[c]
                                : static_cast<float>(255 * to_unit(hash64(textons.textons[texel], c)));
        return color;
      },
      [&](int v) { return static_cast<float>(textons.textons[v % texels]); });
  return view;
}

namespace {

// What is seen from above a vertex.
struct Seen {
  Material material;
  float light = 1;
  bool found = false;  // within the shell's thickness; else the core is shown
};

bool has_relief(const ShellVolume& shell) {
  bool relief = false;
  shell.kind.for_each_active([&](int, int, int, std::int32_t kind) { relief = relief || kind == 0; });
  return relief;
}

// The first voxel with matter below the vertex; where there is relief, darker on slopes and deep down.
Seen look_below(const TexturedMesh& mesh, const ShellVolume& shell, bool relief, int v) {
  const Vec3 normal = mesh.normals.row(v).transpose();
  const double layers = shell.thickness / shell.frame.voxel;
  Seen seen{shell.core};
  for (double depth = 0.75; depth < layers && !seen.found; depth += 0.5) {
    const Vec3 p = shell.frame.to_index(mesh.mesh.vertex(v)) - depth * normal;
    const Vec3i base = p.array().floor().matrix().cast<int>();
    Vec3i at = base;
    double best = 1e300;
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3i near = base + Vec3i(corner & 1, corner >> 1 & 1, corner >> 2);
      const double distance = (near.cast<double>() - p).squaredNorm();
      if (distance < best && shell.extinction.is_active(near.x(), near.y(), near.z())) best = distance, at = near;
    }
    if (best > 1e299 || shell.kind.value(at.x(), at.y(), at.z()) == 0) continue;
    seen.found = true;
    seen.material = {shell.extinction.value(at.x(), at.y(), at.z()).array(),
                     shell.albedo.value(at.x(), at.y(), at.z()).array(),
                     shell.anisotropy.value(at.x(), at.y(), at.z()).array()};
    if (relief) {
      const Vec3 own = shell.normal.value(at.x(), at.y(), at.z()).cast<double>();
      const double slope = own.norm() > 0.5 ? std::max(0.0, own.dot(normal)) : 1;
      seen.light = static_cast<float>((0.35 + 0.65 * slope) * (1 - 0.5 * depth / layers));
    }
  }
  return seen;
}

}  // namespace

AttributedMesh view_shell(const TexturedMesh& mesh, const ShellVolume& shell) {
  AttributedMesh view;
  view.mesh = mesh.mesh;
  const ReflectanceInversion half_space(ReflectanceModel::transport, shell.ior);
  const bool relief = has_relief(shell);
  add_colors(
      view,
      [&](int v) {
        const Seen seen = look_below(mesh, shell, relief, v);
        return Vec3f(display_color(seen.light * half_space.color(seen.material)).matrix());
      },
      [&](int v) { return look_below(mesh, shell, relief, v).material.reduced_extinction()[1]; });
  return view;
}

double share_without_matter(const TexturedMesh& mesh, const ShellVolume& shell) {
  if (!has_relief(shell) || mesh.mesh.vertex_count() == 0) return 0;
  const auto count = static_cast<std::size_t>(mesh.mesh.vertex_count());
  const double bare = parallel_sum(
      count, 0.0, [&](std::size_t v) { return look_below(mesh, shell, true, static_cast<int>(v)).found ? 0.0 : 1.0; });
  return bare / static_cast<double>(count);
}

}  // namespace shellgrid
