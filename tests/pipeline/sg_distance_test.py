# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-distance from outside: its record against geometry, its view, bad surfaces, same bytes."""
import math
import os
import unittest

import programs


class Distance(unittest.TestCase):
    def setUp(self):
        place = programs.workplace()
        self.addCleanup(place.cleanup)
        self.folder = place.name

    def path(self, name):
        return os.path.join(self.folder, name)

    def distance(self, mesh, *options):
        programs.write_off(self.path("in.off"), mesh)
        return programs.run("distance", self.path("in.off"), "-o", self.path("out.vdb"), *options)

    def test_visits_the_band_of_a_ball_only(self):
        done = self.distance(programs.icosphere(5, radius=10), "--voxel", 0.25, "--inside", 1, "--outside", 0.5)
        self.assertEqual(done.returncode, 0, done.stderr)
        results = programs.record(self.path("out.vdb"))["results"]
        band = 4 / 3 * math.pi * (10.5 ** 3 - 9 ** 3) / 0.25 ** 3
        self.assertAlmostEqual(results["active_samples"] / band, 1, delta=0.01)
        self.assertLess(results["allocated_leaves"], 0.7 * results["possible_leaves"])
        self.assertGreater(results["skipped_share"], 0.3)
        self.assertGreater(results["samples_per_second"], 0)
        self.assertLess(results["isosurface_error_voxels"], 0.1)
        outputs = [os.path.basename(o["path"]) for o in programs.record(self.path("out.vdb"))["outputs"]]
        self.assertEqual(outputs, ["out.vdb", "out.view.ply"])

    def test_view_is_a_closed_surface(self):
        self.assertEqual(self.distance(programs.torus(), "--voxel", 0.1, "--inside", 0.3, "--outside", 0.2).returncode, 0)
        done = programs.run("distance", self.path("out.view.ply"), "-o", self.path("again.vdb"), "--voxel", 0.1)
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_refuses_surfaces_that_bound_nothing(self):
        vertices, faces = programs.icosphere(2)
        for mesh, message in (((vertices, faces[1:]), "3 boundary edges, first at ("),
                              ((vertices, [(a, c, b) for a, b, c in faces]), "look inward"),
                              (([], []), "")):
            done = self.distance(mesh)
            self.assertEqual(done.returncode, 3, done.stderr)
            self.assertTrue(done.stderr.startswith("sg-distance: error: ") and done.stderr.count("\n") == 1, done.stderr)
            self.assertIn(message, done.stderr)
            self.assertEqual(os.listdir(self.folder), ["in.off"])

    def test_takes_gaps_and_crossings_by_winding_number(self):
        vertices, faces = programs.icosphere(3, radius=10)
        pierced = list(vertices)
        pierced[0] = tuple(-1.3 * x for x in pierced[0])
        for mesh in ((vertices, faces[3:]), (pierced, faces)):
            done = self.distance(mesh, "--voxel", 0.5, "--inside", 1, "--outside", 0.5, "--sign", "winding-number")
            self.assertEqual(done.returncode, 0, done.stderr)
            samples = programs.record(self.path("out.vdb"))["results"]["active_samples"]
            ball = 4 / 3 * math.pi * (10.5 ** 3 - 9 ** 3) / 0.5 ** 3
            self.assertAlmostEqual(samples / ball, 1, delta=0.1)
        self.assertEqual(self.distance(mesh, "--sign", "guess").returncode, 2)

    def test_refuses_a_grid_that_fits_nowhere(self):
        done = self.distance(programs.icosphere(2, radius=1000), "--voxel", 1e-3)
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertIn("samples", done.stderr)

    def test_gives_the_same_bytes_at_one_and_two_threads(self):
        outputs = []
        for threads in (1, 2, 2):
            done = self.distance(programs.torus(), "--voxel", 0.1, "--inside", 0.5, "--threads", threads)
            self.assertEqual(done.returncode, 0, done.stderr)
            outputs.append(b"")
            for name in ("out.vdb", "out.view.ply"):
                with open(self.path(name), "rb") as file:
                    outputs[-1] += file.read()
                os.remove(self.path(name))
        self.assertEqual(outputs[0], outputs[1])
        self.assertEqual(outputs[1], outputs[2])


if __name__ == "__main__":
    unittest.main()
