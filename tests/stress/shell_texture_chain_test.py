# SPDX-License-Identifier: AGPL-3.0-or-later
"""Matter, lights and cameras at the ends of what they may be, through a picture by the shell texture function: a right
result or one line that says why not. SG_LONG=1: more extinctions."""
import json
import math
import os
import subprocess
import unittest

from programs import WorkplaceTest, icosphere, record, run, scene, write_json, write_off

LONG = "SG_LONG" in os.environ
EVEN = {"type": "environment", "up": [0, 1, 0], "zenith": [1, 1, 1], "horizon": [1, 1, 1], "ground": [1, 1, 1]}


def matter(absorption, scattering, anisotropy=0):
    return {"absorption": absorption, "scattering": scattering, "anisotropy": anisotropy}


class ShellTextureChain(WorkplaceTest):
    def setUp(self):
        super().setUp()
        write_off(self.at("ball.off"), icosphere(3, 10.0))

    def plan(self, material, ior=1.3, sample=None, **changes):
        write_json(self.at("sample.json"), sample or
                   {"type": "layers", "size": [6, 6], "voxel": 0.6, "thickness": 3, "ior": ior,
                    "layers": [{"material": material, "thickness": 3}]})
        content = {"object": {"mesh": "ball.off", "size": 20, "ior": ior},
                   "material": {"shell": {"sample": "sample.json", "thickness": 3, "voxel": 0.6}, "core": "bottom-layer"},
                   "lights": [EVEN],
                   "method": {"type": "shell-texture-function", "irradiance_error": 0.1, "samples_per_pixel": 1}, **changes}
        write_json(self.at("scene.json"), scene(**content))
        return run("plan", self.at("scene.json"), "-o", self.at("out"))

    def picture(self, *arguments, **changes):
        """Mean radiance of the object over the picture, per channel; even light of radiance 1 behind it."""
        planned = self.plan(*arguments, **changes)
        self.assertEqual(planned.returncode, 0, planned.stderr)
        made = subprocess.run(["make", "-C", self.at("out"), "image.exr"], capture_output=True, text=True,
                              env={**os.environ, "MAKEFLAGS": ""})
        self.assertEqual(made.returncode, 0, made.stdout + made.stderr)
        channels = json.loads(self.ok("describe", "--json", self.at("out", "image.exr")).stdout)["channels"]
        for name, values in channels.items():
            for figure in ("least", "greatest", "mean"):
                self.assertTrue(math.isfinite(values[figure]), (name, values))
        for name in ("core.ply", "image.exr", "stf.vdb"):
            with open(self.at("out", name) + ".json") as file:
                self.assertNotRegex(file.read(), "NaN|[Ii]nf[,\\s]")
        covered = channels["A"]["mean"]
        behind = 1 if changes.get("lights", [EVEN]) == [EVEN] else 0
        for c in "RGB":
            self.assertGreaterEqual(channels[c]["least"], 0)
        return [(channels[c]["mean"] - behind * (1 - covered)) / covered for c in "RGB"]

    def refused(self, done, *parts):
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertEqual(len(done.stderr.strip().splitlines()), 1, done.stderr)
        for part in parts:
            self.assertIn(part, done.stderr)

    def test_white_matter_of_any_density_disappears_in_even_light(self):
        for scattering in (0.5, 2, 20, 1e4) if LONG else (2, 1e4):
            for ior in (1, 1.5) if LONG else (1,):
                # Voxels are of more than a free path. Through thousands of them next to nothing comes to the core and
                # back: white light falls from voxel to voxel as if the core were dark.
                error, off = (0.1, 0.08) if scattering < 100 else (0.04, 0.25)
                method = {"type": "shell-texture-function", "irradiance_error": error, "samples_per_pixel": 1}
                for value in self.picture(matter(0, scattering), ior=ior, method=method):
                    self.assertAlmostEqual(value, 1, delta=off, msg=(scattering, ior))

    def test_matter_that_only_absorbs_mirrors_alone(self):
        for absorption in (0.5, 1e4):
            shown = self.picture(matter(absorption, 0), ior=1.3)
            # The mean Fresnel reflectance over a disc in even light, by its rings.
            def reflectance(cosine):
                sine = math.sqrt(1 - cosine * cosine) / 1.3
                inner = math.sqrt(1 - sine * sine)
                a, b = (cosine - 1.3 * inner) / (cosine + 1.3 * inner), (1.3 * cosine - inner) / (1.3 * cosine + inner)
                return (a * a + b * b) / 2
            n = 2000
            mirrored = sum(reflectance(math.sqrt((k + 0.5) / n)) for k in range(n)) / n
            for value in shown:
                self.assertAlmostEqual(value, mirrored, delta=0.02, msg=absorption)

    def test_matter_of_next_to_no_density_is_told_or_refused(self):
        planned = self.plan(matter(0.00002, 0.00008))
        self.assertEqual(planned.returncode, 0, planned.stderr)
        self.assertIn("mean free path", planned.stderr)
        for value in self.picture(matter(0.00002, 0.00008)):
            self.assertTrue(0 <= value <= 1.05, value)

    def test_voxels_wider_than_light_reaches_are_told(self):
        self.assertIn("diffuse mean free paths", self.plan(matter(2, 40)).stderr)
        self.assertNotIn("diffuse mean free paths", self.plan(matter(0.02, 2)).stderr)

    def test_light_from_below_and_from_nowhere(self):
        body = matter(0.02, 2)
        above = self.picture(body, lights=[{"type": "directional", "direction": [0, 0, -1], "irradiance": [1, 1, 1]}])
        below = self.picture(body, lights=[{"type": "directional", "direction": [0, 0, 1], "irradiance": [1, 1, 1]}])
        self.assertGreater(above[1], 20 * below[1])
        self.assertGreater(below[1], 0)
        self.assertEqual(self.picture(body, lights=[]), [0, 0, 0])

    def test_cameras_in_the_shell_and_samples_of_nothing_are_refused(self):
        body = matter(0.02, 2)
        self.refused(self.plan(body, camera={"position": [0, 0, 9], "look_at": [0, 0, 0], "up": [0, 1, 0], "fov": 20,
                                             "resolution": [32, 32]}), "camera", "inside")
        with open(self.at("nothing.raw"), "wb") as file:
            file.write(bytes(8 * 8 * 5))
        nothing = {"type": "volume", "file": "nothing.raw", "raw": {"size": [8, 8, 5]}, "spacing": 0.6, "opacity": [[0, 0], [255, 1]],
                   "classes": [{"value": 0, "material": body}, {"value": 255, "material": body}]}
        write_json(self.at("nothing.json"), nothing)
        done = run("sample", self.at("nothing.json"), "-o", self.at("sample.vdb"))
        if done.returncode == 0:
            done = run("irradiance", self.at("sample.vdb"), "-o", self.at("stf.vdb"))
        self.refused(done)

    def test_few_voxels_and_bumps_without_ground(self):
        shown = self.picture(matter(0, 2), sample={
            "type": "layers", "size": [4, 4], "voxel": 0.6, "thickness": 0.6, "ior": 1.3,
            "layers": [{"material": matter(0, 2), "thickness": 1}]})
        for value in shown:
            self.assertAlmostEqual(value, 1, delta=0.06)


if __name__ == "__main__":
    unittest.main()
