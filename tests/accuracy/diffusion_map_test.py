# SPDX-License-Identifier: AGPL-3.0-or-later
"""The map of diffusion's errors in short: how it judges, and that diffusion errs against transport as much as is expected."""
import csv
import os
import subprocess
import sys
import unittest

import numpy

sys.path.append(os.path.dirname(os.path.abspath(__file__)))
import diffusion_map
from programs import WorkplaceTest


class Judgement(unittest.TestCase):
    def test_noise_is_taken_off_the_error(self):
        random = numpy.random.default_rng(5)
        truth = 1 + random.random(4000)
        noise = numpy.full(4000, 0.2)
        found = diffusion_map.judge(numpy.ones(4000), truth + noise * random.standard_normal(4000), noise, 1.05 * truth,
                                    1.05 * truth, 4)
        self.assertAlmostEqual(found["error"], 0.05, delta=4 * found["uncertainty"])
        self.assertLess(found["uncertainty"], 0.02)
        self.assertAlmostEqual(found["noise"], 0.2 / numpy.sqrt((truth**2).mean()), delta=0.005)
        self.assertAlmostEqual(found["bias"], 0.05, delta=0.01)

    def test_the_grids_share_is_a_third_of_what_halving_its_cells_changes(self):
        truth = numpy.ones(10)
        found = diffusion_map.judge(truth, truth, 0 * truth, 1.04 * truth, 1.01 * truth, 4)
        self.assertAlmostEqual(found["discretisation"], 0.01)
        self.assertAlmostEqual(found["error"], 0.01)


class Map(WorkplaceTest):
    def test_of_a_sphere(self):
        script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "diffusion_map.py")
        # The whole map has a command of its own.
        environment = {name: value for name, value in os.environ.items() if name != "SG_LONG"}
        done = subprocess.run([sys.executable, "-B", script, "-o", self.at("map")], capture_output=True, text=True,
                              env=environment)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        with open(self.at("map", "map.csv")) as file:
            rows = {(row["source"], float(row["thickness"]), float(row["albedo"])): row for row in csv.DictReader(file)}
        self.assertEqual(len(rows), 24)
        self.assertEqual(rows["boundary", 30, 0.5]["error"], "")  # refused: more would be absorbed than enters
        of = lambda source, thickness, albedo: float(rows[source, thickness, albedo]["error"])
        self.assertLess(of("first-collision", 30, 0.999), 0.04)
        self.assertLess(of("first-collision", 30, 0.999), of("boundary", 30, 0.999))
        self.assertGreater(of("first-collision", 3, 0.999), 0.08)
        self.assertGreater(of("boundary", 30, 0.8), 0.1)
        # What the rule expects is the worst of three shapes on finer grids.
        for row in rows.values():
            if not row["error"] or not row["discretisation"]:  # refused, or the coarser grid was
                continue
            error, expected, around = (float(row[name]) for name in ("error", "expected", "uncertainty"))
            self.assertLess(error, 1.2 * expected + 3 * around + 2 * float(row["discretisation"]), row)
            self.assertGreater(error + 3 * around, 0.3 * expected - float(row["discretisation"]), row)
        for name in ("map.png", "map.md"):
            self.assertGreater(os.path.getsize(self.at("map", name)), 300)


if __name__ == "__main__":
    unittest.main()
