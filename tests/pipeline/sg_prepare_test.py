# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-prepare from outside: good runs, bad meshes, same bytes."""
import math
import os
import random
import unittest

import ply_file
import programs


def read_ply(path):
    """Vertices and triangles as tuples."""
    vertices, faces = ply_file.read_ply(path)
    return [(row["x"], row["y"], row["z"]) for row in vertices], [tuple(face) for face in faces.tolist()]


def is_closed(faces):
    edges = set()
    for a, b, c in faces:
        for edge in ((a, b), (b, c), (c, a)):
            if edge in edges:
                return False
            edges.add(edge)
    return all((b, a) in edges for a, b in edges)


def volume(mesh):
    vertices, faces = mesh
    total = 0.0
    for f in faces:
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = (vertices[v] for v in f)
        total += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    return total / 6


def joined(*meshes):
    vertices, faces = [], []
    for v, f in meshes:
        faces += [tuple(len(vertices) + i for i in t) for t in f]
        vertices += v
    return vertices, faces


class Prepare(unittest.TestCase):
    def setUp(self):
        place = programs.workplace()
        self.addCleanup(place.cleanup)
        self.folder = place.name

    def path(self, name):
        return os.path.join(self.folder, name)

    def prepare(self, mesh, *options, name="in.off"):
        programs.write_off(self.path(name), mesh)
        return programs.run("prepare", self.path(name), "-o", self.path("out.ply"), *options)

    def refused(self, mesh, message, *options):
        done = self.prepare(mesh, *options)
        self.assertEqual(done.returncode, 3, done.stderr)
        self.assertTrue(done.stderr.startswith("sg-prepare: error: "), done.stderr)
        self.assertEqual(done.stderr.count("\n"), 1, done.stderr)
        self.assertIn("in.off", done.stderr)
        self.assertIn(message, done.stderr)
        self.assertEqual(sorted(os.listdir(self.folder)), ["in.off"])

    def test_retiles_a_torus_to_size_and_spacing(self):
        done = self.prepare(programs.torus(), "--size", 30, "--spacing", 0.5)
        self.assertEqual(done.returncode, 0, done.stderr)
        vertices, faces = read_ply(self.path("out.ply"))
        self.assertTrue(is_closed(faces))
        self.assertEqual(len(vertices) - len(faces) // 2, 0)  # genus 1
        for axis in range(3):
            self.assertAlmostEqual(max(p[axis] for p in vertices), -min(p[axis] for p in vertices), 9)
        self.assertAlmostEqual(max(max(p[a] for p in vertices) - min(p[a] for p in vertices) for a in range(3)), 30, 9)
        lengths = [math.dist(vertices[f[k]], vertices[f[(k + 1) % 3]]) for f in faces for k in range(3)]
        mean = sum(lengths) / len(lengths)
        self.assertAlmostEqual(mean, 0.5, delta=0.015)
        results = programs.record(self.path("out.ply"))["results"]
        self.assertAlmostEqual(results["edge_mean_mm"], mean, 9)
        self.assertEqual(results["genus"], 1)
        self.assertEqual(results["vertices"], len(vertices))
        self.assertAlmostEqual(results["volume_mm3"], volume((vertices, faces)), 6)
        self.assertLess(results["hausdorff_from_input_voxels"], 0.5)
        self.assertLess(results["hausdorff_to_input_voxels"], 0.5)

    def test_turns_an_inside_out_sphere(self):
        vertices, faces = programs.icosphere(3)
        done = self.prepare((vertices, [(a, c, b) for a, b, c in faces]), "--no-retile")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertGreater(volume(read_ply(self.path("out.ply"))), 4)
        self.assertEqual(programs.record(self.path("out.ply"))["results"]["turned_faces"], len(faces))

    def test_makes_faces_agree_and_drops_doubled_ones(self):
        vertices, faces = programs.icosphere(3)
        shuffled = random.Random(1)
        mixed = [f if shuffled.random() < 0.7 else (f[0], f[2], f[1]) for f in faces] + faces[:5] + [(0, 0, 1)]
        done = self.prepare((vertices + [(9, 9, 9)], mixed), "--no-retile")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertAlmostEqual(volume(read_ply(self.path("out.ply"))), volume((vertices, faces)), 6)
        results = programs.record(self.path("out.ply"))["results"]
        self.assertEqual(results["dropped_faces"], 6)
        self.assertEqual(results["unreferenced_vertices"], 1)

    def test_refuses_an_open_mesh_and_closes_it_on_request(self):
        vertices, faces = programs.icosphere(3)
        self.refused((vertices, faces[4:]), "boundary edges, first at (")
        done = self.prepare((vertices, faces[4:]), "--close-holes", "--size", 20, "--spacing", 0.6)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue(is_closed(read_ply(self.path("out.ply"))[1]))

    def test_rewraps_what_it_refuses(self):
        ball = programs.icosphere(3)
        crossing = joined(programs.icosphere(3, centre=(0.7, 0, 0)), (ball[0], ball[1][40:]))
        self.refused(crossing, "try --close-holes or --rewrap")
        done = self.prepare(crossing, "--size", 20, "--spacing", 0.8, "--rewrap", "4%")
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertTrue(is_closed(read_ply(self.path("out.ply"))[1]))
        results = programs.record(self.path("out.ply"))["results"]
        self.assertAlmostEqual(results["rewrap_resolution_mm"], 0.8, delta=0.02)
        self.assertLess(results["rewrap_to_input_mm"], 0.8)
        self.assertEqual((results["rewrap_dropped_components"], results["rewrap_dropped_volume"]), (0, 0))
        with open(self.path("out.ply"), "rb") as file:
            first = file.read()
        self.prepare(crossing, "--size", 20, "--spacing", 0.8, "--rewrap", "4%", "--threads", 1)
        with open(self.path("out.ply"), "rb") as file:
            self.assertEqual(first, file.read())

    def test_refuses_a_rewrap_that_is_no_resolution(self):
        for text in ("much", "-1", "2cm", "0"):
            done = self.prepare(programs.icosphere(2), "--rewrap", text)
            self.assertEqual(done.returncode, 2, done.stderr)
        self.refused(programs.icosphere(2), "resolution", "--rewrap", "200%")

    def test_refuses_two_components(self):
        self.refused(joined(programs.icosphere(2), programs.icosphere(2, centre=(5, 0, 0))), "2 components, the second at (")

    def test_refuses_a_self_intersecting_mesh(self):
        vertices, faces = programs.icosphere(3)
        vertices[0] = tuple(-1.5 * x for x in vertices[0])
        self.refused((vertices, faces), "of triangles intersect, first at (")

    def test_refuses_a_flat_mesh(self):
        self.refused(programs.box((2, 2, 0)), "flat")

    def test_refuses_a_non_manifold_edge(self):
        vertices = [(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 1, 0), (-1, 0, 0), (-1, -1, 0)]
        faces = [(0, 2, 1), (1, 2, 3), (0, 1, 3), (0, 3, 2), (0, 4, 1), (1, 4, 5), (0, 1, 5), (0, 5, 4)]
        self.refused((vertices, faces), "1 non-manifold edge, first at (0, 0, 0.5)")

    def test_refuses_an_empty_mesh(self):
        self.refused(([], []), "")

    def test_refuses_a_spacing_that_is_no_length(self):
        done = self.prepare(programs.icosphere(2), "--spacing", -1)
        self.assertEqual(done.returncode, 2, done.stderr)

    def test_refuses_a_spacing_larger_than_the_object(self):
        self.refused(programs.icosphere(2), "too coarse", "--spacing", 5)

    def test_gives_the_same_bytes_at_one_and_two_threads(self):
        programs.write_off(self.path("in.off"), programs.torus())
        outputs = []
        for threads in (1, 2, 2):
            done = programs.run("prepare", self.path("in.off"), "-o", self.path("out.ply"), "--size", 30, "--spacing", 0.6,
                                "--threads", threads)
            self.assertEqual(done.returncode, 0, done.stderr)
            with open(self.path("out.ply"), "rb") as file:
                outputs.append(file.read())
            os.remove(self.path("out.ply"))
        self.assertEqual(outputs[0], outputs[1])
        self.assertEqual(outputs[1], outputs[2])


if __name__ == "__main__":
    unittest.main()
