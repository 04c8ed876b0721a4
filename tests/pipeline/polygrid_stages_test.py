# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-tetrahedralize, sg-polycube, sg-polygrid from outside."""
import os
import unittest

import h5py
import numpy

from programs import WorkplaceTest, box, icosphere, record, run, torus, workplace, write_off

GEOMETRY = ["tets.hdf", "polycube.hdf", "polygrid.hdf", "polycube.view.ply", "polygrid.view.ply"]


def read_bytes(path):
    with open(path, "rb") as file:
        return file.read()


class PolygridStages(WorkplaceTest):
    def chain(self, mesh, nodes=6000, threads=None, folder=None):
        folder = folder or self.folder
        at = lambda name: os.path.join(folder, name)
        more = ["--threads", threads] if threads else []
        write_off(at("surface.off"), mesh)
        self.ok("tetrahedralize", at("surface.off"), "-o", at("tets.hdf"), *more)
        self.ok("polycube", at("tets.hdf"), "-o", at("polycube.hdf"), "--nodes", nodes, "--cubes", nodes // 8, *more)
        self.ok("polygrid", at("polycube.hdf"), at("surface.off"), "-o", at("polygrid.hdf"), *more)

    def refused(self, code, words, program, *arguments):
        process = run(program, *arguments)
        self.assertEqual(process.returncode, code, process.stderr)
        self.assertEqual(process.stderr.count("\n"), 1, process.stderr)
        self.assertIn(words, process.stderr)
        output = arguments[arguments.index("-o") + 1]
        self.assertFalse(os.path.exists(output))

    def test_a_torus_becomes_a_valid_grid_of_its_genus(self):
        self.chain(torus())
        tets, polycube, grid = (record(self.at(name))["results"] for name in GEOMETRY[:3])
        self.assertEqual((tets["genus"], polycube["object_genus"], polycube["genus"], grid["genus"]), (1, 1, 1, 1))
        self.assertLess(abs(tets["volume_error"]), 1e-9)
        self.assertEqual(grid["inverted_cells"], 0)
        self.assertGreater(grid["scaled_jacobian"]["min"], 0)
        self.assertGreater(grid["scaled_jacobian"]["mean"], 0.8)
        self.assertLess(abs(grid["nodes"] / 6000 - 1), 0.35)
        with h5py.File(self.at("polygrid.hdf")) as file:
            group = file["VTKHDF"]
            points = group["Points"][:]
            cells = group["Connectivity"][:].reshape(-1, 8)
            twins = group["PointData/outer_twin"][:]
        # Every corner's Jacobian, from the file alone; corners of a VTK hexahedron and their three neighbours.
        for corner, (a, b, c) in enumerate([(1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2),
                                            (6, 4, 3)]):
            base = points[cells[:, corner]]
            edges = [points[cells[:, k]] - base for k in (a, b, c)]
            self.assertGreater(numpy.einsum("ij,ij->i", numpy.cross(edges[0], edges[1]), edges[2]).min(), 0)
        outer = twins >= 0
        self.assertEqual(len(set(twins[outer])), outer.sum())
        # On the torus: |(√(x² + y²) − 2, z)| = 0.8, up to its facets.
        radius = numpy.hypot(numpy.hypot(points[outer, 0], points[outer, 1]) - 2, points[outer, 2])
        self.assertLess(numpy.abs(radius - 0.8).max(), 0.03)

    def test_the_hierarchy_in_the_file_holds_the_means_of_children(self):
        self.chain(torus())
        with h5py.File(self.at("polygrid.hdf")) as file:
            fine = file["VTKHDF/FieldData/graph_interior"][:]
            lattice = file["VTKHDF/CellData/cell_lattice"][:][:len(fine)]
            self.assertGreaterEqual(len(file["hierarchy"]), 3)
            for level in range(1, 1 + len(file["hierarchy"])):
                group = file["hierarchy/%d" % level]
                parent, coarse = group["parent"][:], group["interior"][:]
                self.assertEqual(len(parent), len(fine))
                children = numpy.bincount(parent, minlength=len(coarse))
                self.assertGreaterEqual(children.min(), 1)
                if level == 1:
                    self.assertLessEqual(children.max(), 8)
                    # On the lattice a ring is cut by few windows into two parts.
                    windows = len(numpy.unique(lattice // 2, axis=0))
                    self.assertLessEqual(windows, len(coarse))
                    self.assertLess(len(coarse), 1.1 * windows)
                mean = numpy.stack([numpy.bincount(parent, fine[:, k]) for k in range(3)], 1) / children[:, None]
                self.assertLess(numpy.abs(mean - coarse).max(), 1e-9)
                self.assertTrue((group["lattice"][:][parent] == lattice // 2).all())
                self.assertTrue(numpy.isfinite(group["weights"][:]).all())
                fine, lattice = coarse, group["lattice"][:]
        self.ok("describe", self.at("polygrid.hdf"), "--level", 2, "-o", self.at("level2.ply"))
        self.assertGreater(os.path.getsize(self.at("level2.ply")), 1000)
        self.refused(3, "there is no level 60", "describe", self.at("polygrid.hdf"), "--level", 60, "-o",
                     self.at("level60.ply"))

    def test_same_bytes_twice_and_at_other_thread_counts(self):
        with workplace() as other:
            self.chain(icosphere(2), nodes=3000, threads=1)
            self.chain(icosphere(2), nodes=3000, threads=2, folder=other)
            for name in GEOMETRY:
                self.assertEqual(read_bytes(self.at(name)), read_bytes(os.path.join(other, name)), name)

    def test_a_flat_box_keeps_its_sharp_edges(self):
        self.chain(box((8.0, 6.0, 1.0)))
        results = record(self.at("polygrid.hdf"))["results"]
        self.assertEqual(results["inverted_cells"], 0)
        with h5py.File(self.at("polygrid.hdf")) as file:
            points = file["VTKHDF/Points"][:]
        self.assertLess(numpy.abs(points.max(0) - (8, 6, 1)).max(), 0.1)
        self.assertLess(numpy.abs(points.min(0)).max(), 0.1)

    def test_an_open_surface_is_refused(self):
        vertices, faces = icosphere(1)
        write_off(self.at("open.off"), (vertices, faces[:-1]))
        self.refused(3, "open.off", "tetrahedralize", self.at("open.off"), "-o", self.at("tets.hdf"))

    def test_a_surface_that_crosses_itself_is_refused_without_a_crash(self):
        vertices, faces = box()
        crossed = [tuple(p) for p in vertices]
        crossed[6] = (0.4, 0.3, -0.5)
        write_off(self.at("crossed.off"), (crossed, faces))
        self.refused(3, "does not cross itself", "tetrahedralize", self.at("crossed.off"), "-o",
                     self.at("tets.hdf"))

    def test_foreign_and_broken_files_are_refused(self):
        self.chain(icosphere(2), nodes=3000)
        with open(self.at("empty.hdf"), "w"):
            pass
        whole = read_bytes(self.at("polycube.hdf"))
        with open(self.at("cut.hdf"), "wb") as file:
            file.write(whole[:len(whole) // 2])
        for bad in ("empty.hdf", "cut.hdf", "missing.hdf", "surface.off"):
            self.refused(3, bad, "polycube", self.at(bad), "-o", self.at("out.hdf"))
            self.refused(3, bad, "polygrid", self.at(bad), self.at("surface.off"), "-o", self.at("out.hdf"))
        self.refused(3, "tets.hdf", "polygrid", self.at("tets.hdf"), self.at("surface.off"), "-o", self.at("out.hdf"))
        self.refused(3, "polycube.hdf", "polycube", self.at("polycube.hdf"), "-o", self.at("out.hdf"))

    def test_the_polycube_of_another_object_is_refused(self):
        self.chain(icosphere(2), nodes=3000)
        write_off(self.at("far.off"), icosphere(2, centre=(50, 0, 0)))
        self.refused(3, "overlap", "polygrid", self.at("polycube.hdf"), self.at("far.off"), "-o", self.at("out.hdf"))

    def test_options_out_of_range_are_usage_errors(self):
        for arguments in (["--nodes", "-5"], ["--nodes", "nan"], ["--grid", "100000"]):
            self.refused(2, "--", "polycube", self.at("tets.hdf"), "-o", self.at("out.hdf"), *arguments)


if __name__ == "__main__":
    unittest.main()
