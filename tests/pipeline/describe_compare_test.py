# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-describe and sg-compare from outside, and VTKHDF files exchanged with h5py."""
import json
import os
import unittest

import h5py
import numpy

import programs


class DescribeAndCompare(unittest.TestCase):
    def setUp(self):
        place = programs.workplace()
        self.addCleanup(place.cleanup)
        self.folder = place.name

    def path(self, name):
        return os.path.join(self.folder, name)

    def describe(self, name):
        done = programs.run("describe", self.path(name), "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        return json.loads(done.stdout)

    def cubes(self, name, **attributes):
        """Two unit cubes as VTKHDF, written by h5py as another program would."""
        with h5py.File(self.path(name), "w") as file:
            root = file.create_group("VTKHDF")
            root.attrs["Version"] = attributes.get("version", (1, 0))
            root.attrs.create("Type", numpy.bytes_(attributes.get("type", "UnstructuredGrid")))
            points = numpy.array([[x, y, z] for x in range(3) for y in (0, 1) for z in (0, 1)], "f4")
            corners = numpy.array([[0, 4, 6, 2, 1, 5, 7, 3]])
            root["Points"] = points
            root["Connectivity"] = attributes.get("connectivity", numpy.concatenate([corners, corners + 4]).ravel())
            root["Offsets"] = attributes.get("offsets", numpy.array([0, 8, 16]))
            root["Types"] = numpy.array([12, 12], "u1")
            for key, value in (("NumberOfPoints", 12), ("NumberOfCells", 2), ("NumberOfConnectivityIds", 16)):
                root[key] = numpy.array([value])
            data = root.create_group("PointData")
            data.create_dataset("heat", data=numpy.linspace(0, 1, 12) * attributes.get("heat", 1), compression="gzip")

    def test_mesh_figures_and_text(self):
        programs.write_off(self.path("torus.off"), programs.torus())
        description = self.describe("torus.off")
        self.assertEqual(description["genus"], 1)
        self.assertEqual(description["euler_characteristic"], 0)
        self.assertTrue(description["closed"])
        done = programs.run("describe", self.path("torus.off"))
        self.assertIn("genus: 1", done.stdout)

    def test_reads_what_h5py_writes(self):
        self.cubes("a.hdf")
        description = self.describe("a.hdf")
        self.assertEqual(description["cells"]["hexahedra"], 2)
        self.assertEqual(description["point_data"]["heat"]["greatest"], 1)

    def test_refuses_grids_that_contradict_themselves(self):
        for name, attributes in {"type.hdf": {"type": "PolyData"}, "index.hdf": {"connectivity": numpy.full(16, 99)},
                                 "offset.hdf": {"offsets": numpy.array([0, 8, 15])}}.items():
            self.cubes(name, **attributes)
            done = programs.run("describe", self.path(name))
            self.assertEqual(done.returncode, 3)
            self.assertIn(name, done.stderr)
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)

    def test_h5py_reads_what_is_written(self):
        programs.write_off(self.path("ball.off"), programs.icosphere(2, radius=10))
        done = programs.run("tetrahedralize", self.path("ball.off"), "-o", self.path("tets.hdf"))
        self.assertEqual(done.returncode, 0, done.stderr)
        with h5py.File(self.path("tets.hdf"), "r") as file:
            root = file["VTKHDF"]
            self.assertEqual(root.attrs["Type"], b"UnstructuredGrid")
            self.assertFalse(root.attrs.get_id("Type").get_type().is_variable_str())
            self.assertEqual(list(root.attrs["Version"]), [1, 0])
            points, corners = root["Points"][:], root["Connectivity"][:].reshape(-1, 4)
            self.assertEqual(root["NumberOfPoints"][0], len(points))
            self.assertEqual(root["NumberOfCells"][0], len(corners))
            self.assertEqual(root["NumberOfConnectivityIds"][0], corners.size)
            self.assertTrue((root["Types"][:] == 10).all())
            self.assertTrue((numpy.diff(root["Offsets"][:]) == 4).all())
            for group in ("PointData", "CellData", "FieldData"):
                self.assertIn(group, root)
            a, b, c, d = (points[corners[:, k]] for k in range(4))
            volumes = numpy.einsum("ij,ij->i", numpy.cross(b - a, c - a), d - a) / 6
            self.assertTrue((volumes > 0).all())
            self.assertAlmostEqual(volumes.sum() / (4 / 3 * numpy.pi * 1000), 1, delta=0.05)

    def test_comparison_passes_and_fails_by_the_limit(self):
        self.cubes("a.hdf", heat=1.01)
        self.cubes("b.hdf")
        done = programs.run("compare", self.path("a.hdf"), self.path("b.hdf"), "--json")
        self.assertEqual(done.returncode, 0, done.stderr)
        figures = {f["name"]: f for f in json.loads(done.stdout)["figures"]}
        self.assertAlmostEqual(figures["PointData/heat"]["relative"], 0.01, places=9)
        self.assertAlmostEqual(figures["PointData/heat"]["maximum"], 0.01, places=9)
        self.assertEqual(figures["position"]["maximum"], 0)
        limits = {"0.011": 0, "0.009": 4}
        for limit, code in limits.items():
            done = programs.run("compare", self.path("a.hdf"), self.path("b.hdf"), "--fail-above", limit, "-o",
                                self.path("d.ply"))
            self.assertEqual(done.returncode, code, done.stderr)
            self.assertAlmostEqual(self.describe("d.ply")["properties"]["quality"]["greatest"], 0.01, places=6)

    def test_hausdorff_distance_of_two_balls(self):
        programs.write_off(self.path("a.off"), programs.icosphere(3, radius=10))
        programs.write_off(self.path("b.off"), programs.icosphere(4, radius=11))
        done = programs.run("compare", self.path("a.off"), self.path("b.off"), "--json")
        for figure in json.loads(done.stdout)["figures"]:
            self.assertAlmostEqual(figure["maximum"], 1, delta=0.1)
        done = programs.run("compare", self.path("a.off"), self.path("b.off"), "--measure", "maximum", "--fail-above", 0.5)
        self.assertEqual(done.returncode, 4)

    def test_volumes_of_two_kinds_are_not_compared(self):
        with open(self.path("s.json"), "w") as file:
            json.dump({"type": "spots", "size": [16, 16], "materials": {
                "body": {"named": "marble"}, "spot": {"named": "marble"}}}, file)
        for arguments in (["sample", "s.json", "-o", "s.vdb"], ["textons", "s.vdb", "-o", "t.vdb"]):
            done = programs.run(*arguments, cwd=self.folder)
            self.assertEqual(done.returncode, 0, done.stderr)
        done = programs.run("compare", "s.vdb", "t.vdb", cwd=self.folder)
        self.assertEqual((done.returncode, done.stderr.count("\n")), (3, 1), done.stderr)
        self.assertIn("expected two of the same kind", done.stderr)

    def test_bad_input(self):
        open(self.path("empty.vdb"), "w").close()
        programs.write_off(self.path("a.off"), programs.box())
        for arguments in (("describe", "empty.vdb"), ("describe", "none.ply"), ("compare", "a.off", "empty.vdb"),
                          ("compare", "a.off", "none.off"), ("compare", "a.off", "a.off", "-o", "d.png")):
            done = programs.run(*arguments, cwd=self.folder)
            self.assertEqual(done.returncode, 3, (arguments, done.stdout, done.stderr))
            self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertNotIn("d.png", os.listdir(self.folder))


if __name__ == "__main__":
    unittest.main()
