# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-polycube with a polycube of the user's own, and with a wanted count of cubes; sg-polygrid maps both."""
import json
import os
import unittest

from programs import record, run, torus, workplace, write_off

RING = [[i, j, 0] for i in range(3) for j in range(3) if (i, j) != (1, 1)]


class OwnPolycube(unittest.TestCase):
    def setUp(self):
        self.holder = workplace()
        self.folder = self.holder.name
        write_off(self.at("surface.off"), torus())
        self.ok("tetrahedralize", self.at("surface.off"), "-o", self.at("tets.hdf"))

    def tearDown(self):
        self.holder.cleanup()

    def at(self, name):
        return os.path.join(self.folder, name)

    def ok(self, program, *arguments):
        process = run(program, *arguments)
        self.assertEqual(process.returncode, 0, process.stderr)
        return process

    def polycube(self, *arguments):
        self.ok("polycube", self.at("tets.hdf"), *arguments, "-o", self.at("polycube.hdf"))
        return record(self.at("polycube.hdf"))["results"]

    def refused(self, code, words, *arguments):
        process = run("polycube", self.at("tets.hdf"), *arguments, "-o", self.at("refused.hdf"))
        self.assertEqual(process.returncode, code, process.stderr)
        self.assertEqual(process.stderr.count("\n"), 1, process.stderr)
        self.assertIn(words, process.stderr)
        self.assertFalse(os.path.exists(self.at("refused.hdf")))

    def write(self, name, value):
        with open(self.at(name), "w") as file:
            json.dump(value, file)
        return self.at(name)

    def test_a_ring_of_eight_cubes_becomes_a_valid_grid_of_a_torus(self):
        results = self.polycube(self.write("ring.json", RING), "--grid", 6)
        self.assertEqual(results["cubes"], 8)
        self.assertEqual(results["grid"], 6)
        self.assertEqual(results["cells"], 8 * 6**3)
        self.assertEqual(results["nodes"], 8 * 6**3 + 32 * 6**2)
        self.assertEqual((results["genus"], results["object_genus"]), (1, 1))
        self.assertEqual(results["placement"], "box")
        self.assertGreater(results["coverage"]["max"], 0)
        self.ok("polygrid", self.at("polycube.hdf"), self.at("surface.off"), "-o", self.at("polygrid.hdf"))
        grid = record(self.at("polygrid.hdf"))["results"]
        self.assertEqual(grid["nodes"], results["nodes"])
        self.assertEqual((grid["genus"], grid["inverted_cells"]), (1, 0))
        self.assertGreater(grid["scaled_jacobian"]["min"], 0)

    def test_a_polycube_of_the_program_and_its_view_come_back_as_they_were(self):
        first = self.polycube("--nodes", 3000)
        os.rename(self.at("polycube.hdf"), self.at("own.hdf"))
        os.rename(self.at("polycube.view.ply"), self.at("own.ply"))
        for own in ("own.hdf", "own.ply"):
            again = self.polycube(self.at(own), "--grid", first["grid"])
            self.assertEqual(again["placement"], "file")
            for key in ("nodes", "cubes", "grid", "genus", "singular_edges", "singular_corners"):
                self.assertEqual(again[key], first[key], key)
            self.assertAlmostEqual(again["spacing"], first["spacing"], places=6)

    def test_cubes_times_grid_sets_the_nodes(self):
        results = self.polycube("--cubes", 60, "--grid", 4)
        self.assertEqual(results["grid"], 4)
        self.assertLess(abs(results["cubes"] / 60 - 1), 0.1)
        self.assertEqual(results["cells"], results["cubes"] * 64)

    def test_what_cannot_be_a_polycube_of_the_object_is_refused(self):
        ring = self.write("ring.json", RING)
        self.refused(3, "apart", self.write("apart.json", [[0, 0, 0], [2, 0, 0]]))
        self.refused(3, "% of the object's volume", ring, "--origin", "90,0,0")
        self.refused(3, "not aligned", self.at("surface.off"))
        self.refused(3, "missing.json", self.at("missing.json"))
        self.refused(3, "does not say where", ring, "--place", "file")
        self.refused(2, "--place", "--place", "box")
        self.refused(2, "--cubes", ring, "--cubes", 8)
        self.refused(2, "leave out", "--nodes", 1000, "--cubes", 8, "--grid", 4)


if __name__ == "__main__":
    unittest.main()
