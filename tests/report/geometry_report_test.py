# SPDX-License-Identifier: AGPL-3.0-or-later
"""The geometry report in short: small meshes made in code, one of them dirty, one hopeless, and stages that misbehave."""
import csv
import os
import subprocess
import sys
import unittest

from programs import BIN, SLOWNESS, WorkplaceTest, icosphere, torus, write_off

HERE = os.path.dirname(os.path.abspath(__file__))


class GeometryReport(WorkplaceTest):
    def report(self, *arguments, programs=BIN):
        done = subprocess.run([sys.executable, "-B", os.path.join(HERE, "geometry_report.py"), self.at("in"), "-o",
                               self.at("out"), *map(str, arguments)], capture_output=True, text=True,
                              env={**os.environ, "SG_BIN": programs})
        self.assertEqual(done.stderr, "")
        with open(self.at("out", "report.csv")) as file:
            return done, {row["mesh"]: row for row in csv.DictReader(file)}

    def test_tells_of_each_mesh_what_became_of_it(self):
        os.mkdir(self.at("in"))
        write_off(self.at("in", "ring.off"), torus())
        vertices, faces = icosphere(2)
        # Open, one triangle twice, one of no area, and a stray vertex.
        write_off(self.at("in", "dirty.off"), (vertices + [(9, 9, 9)], faces[1:] + [faces[5], (7, 7, 8)]))
        write_off(self.at("in", "hollow.off"), ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], []))
        limits = ["--gibibytes", 6] if SLOWNESS == 1 else ["--gibibytes", 1 << 20]  # A sanitizer's shadow is vast.
        done, rows = self.report("--nodes", 3000, "--seconds", 120 * SLOWNESS, *limits)
        self.assertEqual(done.returncode, 0, done.stdout)
        self.assertEqual(set(rows), {"ring", "dirty", "hollow"})
        ring, dirty, hollow = rows["ring"], rows["dirty"], rows["hollow"]
        self.assertEqual((ring["closed"], ring["accepted"], ring["genus"], ring["inverted"]), ("yes", "yes", "1/1", "0"))
        self.assertTrue(ring["verdict"].startswith("valid"), ring)
        self.assertGreater(float(ring["jacobian mean"]), 0.75)
        self.assertLess(float(ring["coverage p99"]), 1)
        self.assertNotIn("uncovered", ring["verdict"])
        for stage in ["prepare", "distance", "tetrahedralize", "polycube", "polygrid"]:
            self.assertGreater(float(ring[stage + " cpu s"]), 0)
            self.assertGreater(float(ring[stage + " MiB"]), 5)
        self.assertEqual((dirty["closed"], dirty["accepted"], dirty["genus"]), ("no", "yes, close holes", "0/0"))
        # No repair makes a surface of points.
        self.assertEqual((hollow["verdict"], hollow["inverted"]), ("refused", ""))
        self.assertRegex(hollow["message"], "^sg-prepare: error: .*no faces")
        with open(self.at("out", "contact-1.png"), "rb") as file:
            self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")
        with open(self.at("out", "report.md")) as file:
            self.assertEqual(sum(line.startswith(("| ring |", "| dirty |", "| hollow |")) for line in file), 3)

        # What is known is not done again: the programs could not do it.
        for name in ["dirty", "hollow"]:
            os.remove(self.at("in", name + ".off"))
        grid = self.at("out", "meshes", "ring", "findings.json")
        before = os.stat(grid).st_mtime_ns
        self.report("--nodes", 3000, "--seconds", 120 * SLOWNESS, *limits)
        self.assertEqual(os.stat(grid).st_mtime_ns, before)

    def test_a_stage_that_crashes_hangs_or_takes_too_much_fails_the_report(self):
        os.mkdir(self.at("in")), os.mkdir(self.at("bin"))
        write_off(self.at("in", "ball.off"), icosphere(1))
        for stage in ["describe", "distance", "tetrahedralize", "polycube", "polygrid"]:
            os.symlink(os.path.join(BIN, "sg-" + stage), self.at("bin", "sg-" + stage))
        for fault, fate in [("kill -SEGV $$", "crash"), ("sleep 100", "time"), ("echo left >&2; exit 1", "exit 1"),
                            ("head -c 400M /dev/zero | tail > /dev/null; exit 3", "memory"),
                            ("echo one >&2; echo two >&2; exit 3", "2 lines")]:
            with open(self.at("bin", "sg-prepare"), "w") as file:
                file.write("#!/bin/sh\n%s\n" % fault)
            os.chmod(self.at("bin", "sg-prepare"), 0o755)
            # The description of the mesh is a program of ours, and slow under sanitizers.
            done, rows = self.report("--seconds", 3 * SLOWNESS, "--gibibytes", 0.25 if SLOWNESS == 1 else 1 << 20,
                                     programs=self.at("bin"))
            if fate == "memory" and SLOWNESS > 1:
                continue
            self.assertEqual(done.returncode, 1, done.stdout)
            self.assertIn("FAILED", rows["ball"]["verdict"])
            self.assertIn("sg-prepare: " + fate, rows["ball"]["verdict"])


if __name__ == "__main__":
    unittest.main()
