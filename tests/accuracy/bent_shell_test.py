# SPDX-License-Identifier: AGPL-3.0-or-later
"""Pictures of balls by the shell texture function, its shell and core taken as bent and as flat, beside
light paths. SG_LONG=1: larger pictures, more sizes and indices."""
import os
import sys
import tempfile
import unittest

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "report"))
import programs
import stf_scenes
from stf_study import Study, colours

LONG = "SG_LONG" in os.environ
EVEN = {"type": "environment", "zenith": [1, 1, 1], "horizon": [1, 1, 1], "ground": [1, 1, 1]}


class BentShell(unittest.TestCase):
    def errors(self, shape, size, ior, lights, thickness=2.4, voxel=0.4):
        """Relative root mean square errors and those of all light by channel, of the default and of --flat."""
        with tempfile.TemporaryDirectory(prefix="sg-test-") as folder:
            study = Study(folder, say=lambda line: None)
            mesh = study.at("shape.off")
            programs.write_off(mesh, shape)
            body = {"absorption": [0.001, 0.02, 0.1], "scattering": [2.5, 2.5, 2.5]}
            sample = study.write("ball", "sample.json",
                                 {"type": "layers", "size": [8, 8], "voxel": voxel, "thickness": thickness, "ior": ior,
                                  "layers": [{"material": body, "thickness": thickness}]})
            side = 60 if LONG else 30
            scene = study.make("ball", stf_scenes.scene(mesh, size, sample, thickness, voxel,
                                                        stf_scenes.camera((10 * size, 2 * size, 0), 7, side, side),
                                                        lights, ior, error=0.01, samples=4), "image.exr")
            truth = scene.truth(160)
            told = {}
            for name, flags in (("bent", []), ("flat", ["--flat"])):
                core, _ = scene.core(name, *flags)
                picture, _ = scene.picture(name, *flags, core=core)
                seen = truth.inside & (picture["A"] >= 1)
                bias = colours(picture)[seen].mean(0) / truth.mean[seen].mean(0) - 1
                told[name] = truth.judge(picture)["error"], bias
                print("%g mm, index %g, %d lights, %s: error %.1f %%, all light %s %%" %
                      (size, ior, len(lights), name, 100 * told[name][0], " ".join("%+.1f" % (100 * b) for b in bias)))
            return told

    def test_balls(self):
        ball = programs.icosphere(4)
        lamp = {**EVEN, "zenith": [0.1] * 3, "horizon": [0.1] * 3, "ground": [0.1] * 3, "lamps":
                [{"direction": [1, 0.5, 0.3], "half_angle": 20, "softness": 0.2, "radiance": [8, 8, 8]}]}
        cases = [(14, 1.5, [EVEN]), (20, 1.3, [lamp])]
        if LONG:
            cases += [(14, 1.0, [EVEN]), (40, 1.5, [EVEN]), (14, 1.5, [lamp])]
        for size, ior, lights in cases:
            told = self.errors(ball, size, ior, lights)
            (bent, bias), (flat, flat_bias) = told["bent"], told["flat"]
            if lights == [EVEN]:
                self.assertLess(bent, 0.4 * flat + 0.01, (size, ior))
                self.assertLess(abs(bias).max(), 0.04, (size, ior))
            else:  # most of the error is where light goes from the side that it comes from
                self.assertLess(abs(bias).sum(), abs(flat_bias).sum(), (size, ior))
                self.assertLess(abs(bias).max(), 0.07, (size, ior))


if __name__ == "__main__":
    unittest.main()
