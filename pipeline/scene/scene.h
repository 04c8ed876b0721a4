// SPDX-License-Identifier: AGPL-3.0-or-later
// The scene file: what is shown, of what, under which light, from where, by which method.
#pragma once
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "meshing/core/material.h"
#include "meshing/surface/direction_field.h"
#include "solvers/render/camera.h"
#include "solvers/render/floor.h"
#include "solvers/render/lights.h"

namespace shellgrid {

struct SceneObject {
  std::string mesh;  // path, resolved against the scene file's folder
  double size = 80;  // longest edge of its bounding box, mm; 0 keeps the file's units as mm
  double ior = 1.5;  // refractive index inside over outside, ≥ 1
  bool close_holes = false;
};

struct ShellMaterial {
  std::vector<std::string> samples;          // paths of the samples' descriptions or .vdb
  std::string paint;                         // path of a painted mesh: which sample, directions, scale; empty: none
  double thickness = 4;                      // mm
  double voxel = 0.4;                        // d_0, mm
  double scale = 1;                          // how much larger than they are the samples appear along the surface
  std::string symmetry = "auto";             // turns after which the samples look alike, or "1", "2", "4"
  std::string synthesis = "coherence";       // or "textons", the paper's sweep
  std::string coordinates = "interpolated";  // or "nearest"
  Vec3 direction = Vec3(0, 1, 0);            // the samples' x runs this way where the surface allows
  std::vector<DirectionConstraint> orient;   // where it must run otherwise; points in the scene's frame
};

struct BottomLayerCore {};  // the mean of the sample's bottom layer
// What the shell's own matter says of it: "interpolated" or "mean-value", its bottom layer continued smoothly on the
// solver's grid or as voxels; or "solid", its sample or one of its own as a solid.
struct ContinuedCore {
  std::string kind;
  std::string sample = {};  // path of the solid's own description or .vdb; empty: the shell's
};
struct OpaqueMaterial {
  Rgb reflectance = Rgb::Constant(0.5f);  // diffuse, 0 … 1
};

struct SceneMaterial {
  std::optional<ShellMaterial> shell;                           // absent: homogeneous or opaque
  std::variant<BottomLayerCore, ContinuedCore, Material> core;  // below the shell, or the homogeneous object
  std::optional<OpaqueMaterial> opaque;                         // excludes shell and core
};

struct SceneMethod {
  std::string type = "polygrid-diffusion";  // or "shell-texture-function" or "path-tracing"
  double nodes = 1e5;                       // of the polygrid
  double tolerance = 0.005;                 // relative error of the exitance
  std::string operator_name = "elements";   // or "paper"
  std::string source = "boundary";          // or "first-collision"
  double paths = 1e7;                       // of light, where the reference follows them
  double irradiance_error = 0.05;           // of the shell texture function
  std::string core = "dipole";              // below it; or "paper", "polygrid" or "none"
  int samples_per_pixel = 16;
};

// Sections that a stage does not need may be missing from its slice of the scene, and so may the paths of the mesh and
// the sample (they are empty then).
struct Scene {
  std::string path;  // of the file itself
  std::optional<SceneObject> object;
  std::optional<SceneMaterial> material;
  std::vector<Light> lights;
  std::optional<Camera> camera;
  std::optional<double> exposure;  // of the PNG, stops; absent: automatic
  std::optional<Rgb> background;   // behind everything, W mm⁻² sr⁻¹; absent: the environment
  std::optional<Floor> floor;      // under the object
  SceneMethod method;
};

// Reads and checks a scene (JSON, comments allowed). Paths in it become relative to the working folder.
// Throws: InputError for what is not JSON, an unknown key (named with its place and the nearest known
// key), a wrong type, a value out of range, a missing file.
Scene read_scene(const std::string& path);

}  // namespace shellgrid
