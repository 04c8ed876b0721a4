// SPDX-License-Identifier: AGPL-3.0-or-later
// A shell's matter by depth alone, and diffuse light in it between planes or spheres.
#pragma once
#include <vector>

#include "meshing/shell/shell_volume.h"

namespace shellgrid {

// One layer of a shell: the means of its matter, by channel.
struct ShellLayer {
  Rgb extinction = Rgb::Zero();  // σ_t, mm⁻¹
  Rgb reduced = Rgb::Zero();     // σ_t'
  Rgb absorption = Rgb::Zero();  // σ_a
};
// Of the shell's matter by depth, a voxel each; a layer without matter is as the one below it. Throws: InputError where
// there is no matter at all.
std::vector<ShellLayer> shell_layers(const ShellVolume& shell);

// One channel of a shell, flat or bent, above a core that gives nothing back.
class ShellColumn {
 public:
  struct Light {
    std::vector<double> beams, fluence, back;  // means of the layers: of even light's beams, of what they scatter, and
                                               // of diffuse light of unit exitance from below
    double below = 0;                          // what passes down of even light, per area there
    double lost = 0;                           // of diffuse light from below what does not return
    // Of diffuse light of fluence 1 about, that is of a quarter on each side of the surface: what flows in through the
    // top, and, of that, what passes down. Of the unit exitance from below, what flows out through the top.
    double entering = 0, through = 0, rising = 0;
  };

  // voxel: a layer's thickness, mm; ior: inside over outside. white: as if it did not absorb.
  ShellColumn(const std::vector<ShellLayer>& layers, int channel, double voxel, double ior, bool white = false);

  // curvature: of the surface, 1/mm.
  Light light(double curvature) const;

 private:
  struct Cell {
    double height, extinction, reduced, absorption;
  };

  double ior_, factor_ = 1;
  std::vector<int> counts_;  // of each layer's cells
  std::vector<Cell> cells_;
};

}  // namespace shellgrid
