# SPDX-License-Identifier: AGPL-3.0-or-later
"""Every .ply of a scene opens in MeshLab as what it is, every .hdf reads as a VTKHDF unstructured grid."""
import os
import re
import shutil
import subprocess
import sys
import unittest

import h5py
import numpy as np

import programs
from ply_file import read_ply

STATISTICS = """<!DOCTYPE FilterScript>
<FilterScript>
 <filter name="Compute Topological Measures"/>
 <filter name="Per Vertex Quality Stat"/>
</FilterScript>
"""
CLOSED = {"surface.ply", "synthesized.ply", "exitance.ply"}
WITH_QUALITY = {"synthesized.ply", "exitance.ply"}
CELL_CORNERS = {10: 4, 12: 8, 9: 4, 5: 3, 1: 1}  # VTK's tetrahedron, hexahedron, quadrilateral, triangle, vertex


def open_in_meshlab(path, folder):
    """What headless MeshLab prints about a file, and the file it writes again."""
    script, again = os.path.join(folder, "statistics.mlx"), os.path.join(folder, "again.ply")
    with open(script, "w") as file:
        file.write(STATISTICS)
    done = subprocess.run(["xvfb-run", "-a", "meshlabserver", "-i", path, "-o", again, "-m", "vc", "vq", "-s", script],
                          capture_output=True, text=True, errors="replace", timeout=300, cwd=folder,
                          env={**os.environ, "XDG_RUNTIME_DIR": folder})
    return done, done.stdout + done.stderr


@unittest.skipUnless(shutil.which("xvfb-run") and shutil.which("meshlabserver"), "MeshLab is not installed")
class MeshLabReadsEveryView(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.workplace = programs.workplace()
        folder = cls.workplace.name
        programs.write_off(os.path.join(folder, "ball.off"), programs.icosphere(4, 10.0))
        sample = os.path.join(programs.SOURCE, "assets", "samples", "marble.json")
        programs.write_json(os.path.join(folder, "scene.json"),
                            programs.scene(object={"mesh": "ball.off", "size": 24, "ior": 1.5},
                                           material={"shell": {"sample": sample, "thickness": 4, "voxel": 0.6}}))
        cls.out = os.path.join(folder, "out")
        planned = programs.run("plan", os.path.join(folder, "scene.json"), "-o", cls.out)
        if planned.returncode != 0:
            raise AssertionError(planned.stderr)
        alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
        made = subprocess.run(["make", "-C", cls.out], capture_output=True, text=True, timeout=900 * programs.SLOWNESS,
                              env=alone)
        if made.returncode != 0:
            raise AssertionError(made.stdout + made.stderr)
        cls.plys = sorted(name for name in os.listdir(cls.out) if name.endswith(".ply"))
        cls.hdfs = sorted(name for name in os.listdir(cls.out) if name.endswith(".hdf"))

    @classmethod
    def tearDownClass(cls):
        cls.workplace.cleanup()

    def test_every_kind_of_artefact_is_there(self):
        self.assertLessEqual(CLOSED | {"distance.view.ply", "sample.view.ply", "textons.view.ply", "shell.view.ply",
                                       "polycube.view.ply", "polygrid.view.ply"}, set(self.plys))
        self.assertLessEqual({"tets.hdf", "polycube.hdf", "polygrid.hdf", "fluence.hdf"}, set(self.hdfs))

    def test_every_ply_opens_with_its_vertices_faces_and_quality(self):
        for name in self.plys:
            with self.subTest(name), programs.workplace() as folder:
                path = os.path.join(self.out, name)
                vertices, faces = read_ply(path)
                self.assertGreater(len(vertices), 0)
                done, text = open_in_meshlab(path, folder)
                self.assertEqual(done.returncode, 0, text)
                loaded = re.search(r"loaded has (\d+) vn (\d+) fn", text)
                self.assertIsNotNone(loaded, text)
                self.assertEqual((int(loaded[1]), int(loaded[2])), (len(vertices), len(faces)))
                if "quality" in vertices.dtype.names:
                    seen = re.search(r"Min (\S+) Max (\S+)", text)
                    self.assertIsNotNone(seen, text)
                    low, high = float(vertices["quality"].min()), float(vertices["quality"].max())
                    self.assertTrue(np.isfinite([low, high]).all())
                    self.assertAlmostEqual(float(seen[1]), low, delta=2e-6 + 1e-6 * abs(low))
                    self.assertAlmostEqual(float(seen[2]), high, delta=2e-6 + 1e-6 * abs(high))

    def test_surfaces_are_closed_two_manifolds_with_the_spheres_genus(self):
        for name in sorted(CLOSED):
            with self.subTest(name), programs.workplace() as folder:
                _, text = open_in_meshlab(os.path.join(self.out, name), folder)
                self.assertIn("Mesh is two-manifold", text)
                self.assertRegex(text, r"Boundary Edges 0\b")
                self.assertRegex(text, r"Unreferenced Vertices 0\b")
                self.assertRegex(text, r"Genus is 0\b")
                self.assertRegex(text, r"composed by 1 connected")

    def test_fields_for_meshlab_vary(self):
        for name in sorted(WITH_QUALITY):
            with self.subTest(name):
                vertices, _ = read_ply(os.path.join(self.out, name))
                for field in ("quality", "red", "green", "blue"):
                    self.assertIn(field, vertices.dtype.names)
                self.assertGreater(vertices["quality"].max(), vertices["quality"].min())
                self.assertGreater(len(np.unique(vertices[["red", "green", "blue"]])), 10)

    def test_a_broken_ply_is_noticed(self):
        # What this test relies on: MeshLab does say so when a mesh is open or is no mesh.
        with programs.workplace() as folder:
            vertices, faces = programs.icosphere(1)
            programs.write_ply(os.path.join(folder, "open.ply"), (vertices, faces[1:]))
            _, text = open_in_meshlab(os.path.join(folder, "open.ply"), folder)
            self.assertRegex(text, r"Boundary Edges 3\b")
            with open(os.path.join(folder, "bad.ply"), "w") as file:
                file.write("ply\nnonsense\n")
            done, _ = open_in_meshlab(os.path.join(folder, "bad.ply"), folder)
            self.assertNotEqual(done.returncode, 0)

    def test_every_hdf_is_a_static_unstructured_grid(self):
        for name in self.hdfs:
            with self.subTest(name), h5py.File(os.path.join(self.out, name), "r") as file:
                grid = file["VTKHDF"]
                kind = grid.attrs["Type"]
                self.assertEqual(kind.decode() if isinstance(kind, bytes) else kind, "UnstructuredGrid")
                self.assertEqual(list(grid.attrs["Version"]), [1, 0])
                points, cells = int(grid["NumberOfPoints"][0]), int(grid["NumberOfCells"][0])
                self.assertGreater(cells, 0)
                self.assertEqual(grid["Points"].shape, (points, 3))
                self.assertTrue(np.isfinite(grid["Points"][:]).all())
                offsets, connectivity, types = grid["Offsets"][:], grid["Connectivity"][:], grid["Types"][:]
                self.assertEqual(len(types), cells)
                self.assertEqual(len(offsets), cells + 1)
                self.assertEqual(offsets[0], 0)
                self.assertEqual(offsets[-1], len(connectivity))
                self.assertEqual(int(grid["NumberOfConnectivityIds"][0]), len(connectivity))
                self.assertTrue(((connectivity >= 0) & (connectivity < points)).all())
                corners = np.diff(offsets)
                for cell_type in np.unique(types):
                    self.assertIn(int(cell_type), CELL_CORNERS)
                    self.assertTrue((corners[types == cell_type] == CELL_CORNERS[int(cell_type)]).all())
                for section, count in (("PointData", points), ("CellData", cells)):
                    for field in grid.get(section, {}):
                        values = grid[section][field][:]
                        self.assertEqual(len(values), count, field)
                        if values.dtype.kind == "f":
                            self.assertTrue(np.isfinite(values).all(), field)


if __name__ == "__main__":
    unittest.main(argv=sys.argv)
