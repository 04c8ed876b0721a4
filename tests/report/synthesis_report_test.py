# SPDX-License-Identifier: AGPL-3.0-or-later
"""The synthesis report in short: one sample on one small mesh and on a shape made in code; a stage that fails."""
import csv
import os
import subprocess
import sys
import unittest

from programs import BIN, WorkplaceTest, icosphere, write_json, write_off

HERE = os.path.dirname(os.path.abspath(__file__))
BODY = {"absorption": [0.02, 0.03, 0.04], "scattering": [2, 2.2, 2.4]}
VEIN = {"absorption": [0.4, 0.5, 0.5], "scattering": [1.5, 1.5, 1.5]}


class SynthesisReport(WorkplaceTest):
    def report(self, *arguments):
        done = subprocess.run([sys.executable, "-B", os.path.join(HERE, "synthesis_report.py"), self.at("ball.off"), "-o",
                               self.at("out"), "--samples", self.at("spots.json"), "--voxel", "1",
                               *map(str, arguments)], capture_output=True, text=True, env={**os.environ, "SG_BIN": BIN})
        self.assertEqual(done.stderr, "")
        with open(self.at("out", "report.csv")) as file:
            return done, {(row["mesh"], row["way"]): row for row in csv.DictReader(file)}

    def test_tells_and_shows_both_ways(self):
        write_off(self.at("ball.off"), icosphere(3))
        write_json(self.at("spots.json"), {"type": "spots", "size": [32, 32], "voxel": 1, "thickness": 4, "count": 12,
                                           "radius": 2.5, "materials": {"body": BODY, "spot": VEIN}})
        done, rows = self.report("--meshes", "ball", "genus3", "--size", 30)
        self.assertEqual(done.returncode, 0, done.stdout)
        self.assertEqual(set(rows), {(mesh, way) for mesh in ("ball", "genus3") for way in ("default", "paper")})
        for row in rows.values():
            self.assertEqual(row["failure"], "")
            self.assertLess(float(row["E 5"]), 0.7 * float(row["E 5 random"]))
            self.assertLess(float(row["E 5 tiling"]), float(row["E 5 random"]))
            for column in ("E 5", "texton chi2", "coherence", "patch entropy", "texel entropy", "autocorrelation error", "synthesize s",
                           "synthesize MiB", "textons s", "shell s"):
                self.assertGreater(float(row[column]), 0, column)
        self.assertEqual(rows["ball", "paper"]["shell changed"], "0.0000")
        self.assertGreater(float(rows["ball", "default"]["shell changed"]), 0.2)
        for name in ("sheet-spots.png", "sample-spots.png"):
            with open(self.at("out", name), "rb") as file:
                self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")
        with open(self.at("out", "report.html")) as file:
            page = file.read()
        for part in ("sheet-spots.png", "genus3", "paper", "texton chi2"):
            self.assertIn(part, page)
        with open(self.at("out", "report.md")) as file:
            self.assertIn("| ball | default |", file.read())

        # What is known is not done again.
        kept = self.at("out", "work", "spots.ball.findings.json")
        before = os.stat(kept).st_mtime_ns
        self.report("--meshes", "ball", "genus3", "--size", 30)
        self.assertEqual(os.stat(kept).st_mtime_ns, before)

    def test_a_shape_stands_for_what_is_not_there_and_failures_are_told(self):
        write_off(self.at("ball.off"), icosphere(3))
        write_json(self.at("spots.json"), {"type": "spots", "size": [16, 16], "voxel": 1, "thickness": 2, "count": 3,
                                           "radius": 2.5, "materials": {"body": BODY, "spot": VEIN}})
        missing = subprocess.run([sys.executable, "-B", os.path.join(HERE, "synthesis_report.py"), "-o", self.at("out"),
                                  "--meshes", "nobody"], capture_output=True, text=True, env={**os.environ, "SG_BIN": BIN})
        self.assertEqual((missing.returncode, missing.stderr), (1, "synthesis_report.py: no mesh is named nobody\n"))
        done, rows = self.report("--meshes", "spot", "--size", 20)
        self.assertEqual(done.returncode, 0, done.stdout)
        self.assertIn(("pillow", "default"), rows)
        write_json(self.at("spots.json"), {"type": "spots", "size": [16, 16]})
        done, rows = self.report("--meshes", "spot", "--size", 20)
        self.assertEqual(done.returncode, 1)
        self.assertIn("sg-sample: refused", list(rows.values())[0]["failure"])

    def test_crossing_shapes_are_wrapped_and_unreadable_ones_left_out(self):
        vertices, faces = icosphere(3)
        other, _ = icosphere(3, centre=(0.7, 0.3, 0.2))
        write_off(self.at("ball.off"), (list(vertices) + list(other), list(faces) + [[len(vertices) + v for v in f] for f in faces]))
        write_json(self.at("spots.json"), {"type": "spots", "size": [16, 16], "voxel": 1, "thickness": 2, "count": 3,
                                           "radius": 2.5, "materials": {"body": BODY, "spot": VEIN}})
        done, rows = self.report("--meshes", "ball", "spot", "--size", 20)
        self.assertEqual(done.returncode, 0, done.stdout)
        self.assertIn("ball        is wrapped anew at 1 %: sg-prepare: refused", done.stdout)
        self.assertEqual({mesh for mesh, _ in rows}, {"ball", "pillow"})
        with open(self.at("ball.off"), "w") as file:
            file.write("OFF\n3 1 0\n0 0\n")
        done, rows = self.report("--meshes", "ball", "spot", "--size", 20)
        self.assertEqual(done.returncode, 1, done.stdout)
        self.assertEqual({mesh for mesh, _ in rows}, {"pillow"})


if __name__ == "__main__":
    unittest.main()
