# SPDX-License-Identifier: AGPL-3.0-or-later
"""A scene of two samples, a painted mask and scale, and a core of its own, by the real stages up to its shell."""
import json
import os
import re
import subprocess
import sys
import unittest

import numpy

from ply_file import read_ply
from programs import SOURCE, WorkplaceTest, icosphere, record, run, scene, torus, write_json, write_off

PAINT = os.path.join(SOURCE, "assets", "scenes", "paint.py")
BODY = {"absorption": [0.02, 0.03, 0.04], "scattering": [2, 2.2, 2.4]}
SPOT = {"absorption": [0.4, 0.5, 0.5], "scattering": [1.5, 1.5, 1.5]}


class PaintedSceneTest(WorkplaceTest):
    def setUp(self):
        super().setUp()
        # Not where and as large as the scene wants it: sg-prepare moves and scales it, and the paint goes along.
        write_off(self.at("ball.off"), icosphere(4, 3.0, (7, 0, 1)))
        for name, seed in (("a", 1), ("b", 2), ("core", 3)):
            write_json(self.at(name + ".json"), {"type": "spots", "size": [32, 32], "voxel": 0.5, "thickness": 3, "ior": 1.4,
                                                 "seed": seed, "materials": {"body": BODY, "spot": SPOT}})
        self.content = scene("ball.off", object={"mesh": "ball.off", "size": 14, "ior": 1.4}, material={
            "shell": {"sample": ["a.json", "b.json"], "paint": "painted.ply", "thickness": 2, "voxel": 0.5, "scale": 0.9},
            "core": {"sample": "core.json"}})

    def paint(self, mesh, *formulas):
        done = subprocess.run([sys.executable, "-B", PAINT, self.at(mesh), self.at("painted.ply"), *formulas],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)

    def make(self, target, code=0):
        write_json(self.at("scene.json"), self.content)
        done = run("plan", self.at("scene.json"), "-o", self.at("out"))
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        made = subprocess.run(["make", "-C", self.at("out"), target], capture_output=True, text=True,
                              env={**os.environ, "MAKEFLAGS": ""})
        self.assertEqual(made.returncode, code, made.stdout + made.stderr)
        return re.findall(r"sg-(\w+) (?!--stamp)\S+ .*?-o (\S+)", made.stdout), made.stderr

    def test_each_sample_and_scale_goes_where_it_is_painted(self):
        self.paint("ball.off", "sample = z > 0", "scale = 1 + 0.5 * y")
        ran, _ = self.make("shell.vdb")
        self.assertEqual(sorted(output for _, output in ran), sorted([
            "surface.ply", "distance.vdb", "sample.vdb", "sample-2.vdb", "core-sample.vdb", "textons.vdb", "synthesized.ply",
            "shell.vdb"]))
        vertices, _ = read_ply(self.at("out", "synthesized.ply"))
        far = numpy.abs(vertices["z"]) > 2.5  # the border is found by synthesis, within some texels of .5 mm
        self.assertTrue(((vertices["sample"] == 1) == (vertices["z"] > 0))[far].all())
        self.assertLess(abs(vertices["scale"] - 0.9 * (1 + 0.5 * vertices["y"] / 7)).max(), 0.02)
        self.assertTrue(record(self.at("out", "synthesized.ply"))["results"]["paint"]["moved"])
        core = record(self.at("out", "shell.vdb"))["results"]["core"]
        self.assertEqual(core["kind"], "solid")
        self.assertGreater(core["voxels"], 1000)
        self.assertEqual(self.make("shell.vdb")[0], [])
        # Another mask: the samples stay.
        self.paint("ball.off", "sample = x > 0", "scale = 1 + 0.5 * y")
        self.assertEqual([output for _, output in self.make("shell.vdb")[0]], ["synthesized.ply", "shell.vdb"])
        # The paint of another object: one line, and nothing that Make would trust.
        write_off(self.at("torus.off"), torus(4.0, 1.5))
        self.paint("torus.off", "sample = x > 0")
        _, complaint = self.make("shell.vdb", 2)
        self.assertIn("is not painted on this surface", complaint)
        self.assertFalse(os.path.exists(self.at("out", ".done", "synthesize")))

    def test_a_sample_of_any_name_finds_its_files(self):
        """Make calls it by a link in another folder."""
        for folder in ("first $(x)", "second"):
            os.mkdir(self.at(folder))
            values = bytes(range(120)) * 32 if folder == "second" else bytes(3840)
            with open(self.at(folder, "volume.raw"), "wb") as file:
                file.write(values)
            write_json(self.at(folder, "a sample.json"), {
                "type": "volume", "file": "volume.raw", "raw": {"size": [24, 32, 5]}, "spacing": 0.5, "mirror": True,
                "classes": [{"value": 0, "material": BODY}, {"value": 120, "material": SPOT}]})
        self.content["material"]["shell"]["sample"] = [os.path.join(folder, "a sample.json") for folder in ("first $(x)", "second")]
        self.content["material"]["core"] = "bottom-layer"
        self.paint("ball.off", "sample = z > 0")
        self.make("textons.vdb")
        spread = [max(record(self.at("out", name))["results"]["class_shares"]) for name in ("sample.vdb", "sample-2.vdb")]
        self.assertEqual(spread[0], 1)
        self.assertLess(spread[1], 1)

    def test_the_shipped_scene_is_planned(self):
        with open(os.path.join(SOURCE, "assets", "scenes", "painted-bunny.json")) as file:
            content = json.loads("".join(line for line in file if not line.startswith("//")))
        content["object"]["mesh"] = "ball.off"
        shell = content["material"]["shell"]
        shell["sample"] = [os.path.join(SOURCE, "assets", "scenes", path) for path in shell["sample"]]
        shell["paint"] = "painted.ply"
        self.paint("ball.off", "sample = y < 0.1 + 0.2 * sin(5 * x + 2 * z)", "scale = 1.1 - 0.4 * y")
        write_json(self.at("scene.json"), content)
        done = run("plan", self.at("scene.json"), "-o", self.at("out"), "--why")
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        self.assertRegex(done.stdout, r"sample-2 +run +the shell is filled with this sample where 1 is painted")


if __name__ == "__main__":
    unittest.main()
