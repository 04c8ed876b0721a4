# SPDX-License-Identifier: AGPL-3.0-or-later
"""Pictures of balls, cubes and tori by the shell texture function, by how it knows the object's shape, beside light
paths. SG_LONG=1: larger pictures, more sizes and indices."""
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


LAMP = {**EVEN, "zenith": [0.1] * 3, "horizon": [0.1] * 3, "ground": [0.1] * 3, "lamps":
        [{"direction": [1, 0.5, 0.3], "half_angle": 20, "softness": 0.2, "radiance": [8, 8, 8]}]}
WAYS = {"body": [], "bends": ["--shape", "bends"], "flat": ["--flat"], "returns left out": ["--no-interreflection"]}


class BentShell(unittest.TestCase):
    def errors(self, name, shape, size, ior, lights, ways, eye=(10, 2, 0), fov=7, thickness=2.4, voxel=0.4):
        """Relative root mean square errors and those of all light by channel, of each way."""
        with tempfile.TemporaryDirectory(prefix="sg-test-") as folder:
            study = Study(folder, say=lambda line: None)
            mesh = study.at("shape.off")
            programs.write_off(mesh, shape)
            body = {"absorption": [0.001, 0.02, 0.1], "scattering": [2.5, 2.5, 2.5]}
            sample = study.write("body", "sample.json",
                                 {"type": "layers", "size": [8, 8], "voxel": voxel, "thickness": thickness, "ior": ior,
                                  "layers": [{"material": body, "thickness": thickness}]})
            side = 60 if LONG else 30
            scene = study.make("body", stf_scenes.scene(mesh, size, sample, thickness, voxel,
                                                        stf_scenes.camera([size * x for x in eye], fov, side, side),
                                                        lights, ior, error=0.01, samples=4), "image.exr")
            truth = scene.truth(160)
            told = {}
            for way in ways:
                core, record = scene.core(way.replace(" ", "-"), *WAYS[way])
                picture, _ = scene.picture(way.replace(" ", "-"), *(flag for flag in WAYS[way] if flag == "--flat"), core=core)
                seen = truth.inside & (picture["A"] >= 1)
                bias = colours(picture)[seen].mean(0) / truth.mean[seen].mean(0) - 1
                told[way] = truth.judge(picture)["error"], bias
                self.assertEqual("body" in record, way in ("body", "returns left out"))
                print("%s, %g mm, index %g, %s, %s: error %.1f %%, all light %s %%" %
                      (name, size, ior, "even light" if lights == [EVEN] else "a lamp", way, 100 * told[way][0],
                       " ".join("%+.1f" % (100 * b) for b in bias)))
            return told

    def test_balls(self):
        ball = programs.icosphere(4)
        cases = [(14, 1.5, [EVEN]), (20, 1.3, [LAMP])]
        if LONG:
            cases += [(14, 1.0, [EVEN]), (40, 1.5, [EVEN]), (14, 1.5, [LAMP])]
        for size, ior, lights in cases:
            told = self.errors("ball", ball, size, ior, lights, ["body", "bends", "flat"])
            flat, flat_bias = told["flat"]
            for way in ("body", "bends"):
                error, bias = told[way]
                if lights == [EVEN]:
                    self.assertLess(error, 0.5 * flat + 0.01, (way, size, ior))
                    self.assertLess(abs(bias).max(), 0.05, (way, size, ior))
                else:
                    self.assertLess(abs(bias).sum(), abs(flat_bias).sum(), (way, size, ior))
                    self.assertLess(abs(bias).max(), 0.07, (way, size, ior))
            if lights != [EVEN]:
                self.assertLess(told["body"][0], told["bends"][0], (size, ior))

    def test_edges(self):
        for size, ior, lights in [(14, 1.3, [EVEN])] + [(20, 1.5, [LAMP])] * LONG:
            told = self.errors("cube", programs.box((1, 1, 1)), size, ior, lights, ["body", "bends", "flat"], (5, 4, 6), 11)
            self.assertLess(told["body"][0], (0.5 if lights == [EVEN] else 0.85) * told["bends"][0], (size, ior))

    def test_light_that_falls_on_the_object_again(self):
        for size, ior, lights in [(24, 1.3, [EVEN])] + [(40, 1.5, [EVEN])] * LONG:
            told = self.errors("torus", stf_scenes.torus(), size, ior, lights, ["body", "returns left out"], (3, 6, 15), 4)
            self.assertLess(told["body"][0], 0.8 * told["returns left out"][0], (size, ior))
            self.assertLess(abs(told["body"][1]).max(), 0.05, (size, ior))


if __name__ == "__main__":
    unittest.main()
