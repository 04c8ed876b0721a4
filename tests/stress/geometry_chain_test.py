# SPDX-License-Identifier: AGPL-3.0-or-later
"""Shapes at the ends of what a mesh may be, from a file to their polygrid: valid and of the right genus each.
SG_LONG=1: more nodes, and a sphere of a million triangles."""
import math
import os
import sys
import unittest

import h5py
import numpy

from programs import BIN, SLOWNESS, SOURCE, WorkplaceTest, box, icosphere, record, torus, write_off

sys.path.append(os.path.join(SOURCE, "tests", "report"))
import grid_check
from limited_process import run_limited

LONG = "SG_LONG" in os.environ
NODES = 1e5 if LONG else 6000


def ring_tube(centres, across, radius, closed):
    """A tube of `across` sides around a polyline: rings of vertices, joined up, or capped by fans of needles."""
    count = len(centres)
    around = numpy.roll(centres, -1, 0) - numpy.roll(centres, 1, 0)
    if not closed:
        around[0], around[-1] = centres[1] - centres[0], centres[-1] - centres[-2]
    vertices, side = [], numpy.array([0.3, 0.5, 0.8])
    for centre, tangent in zip(centres, around / numpy.linalg.norm(around, axis=1)[:, None]):
        side = side - tangent * (side @ tangent)
        side /= numpy.linalg.norm(side)
        other = numpy.cross(tangent, side)
        angles = 2 * math.pi * numpy.arange(across) / across
        vertices += [tuple(centre + radius * (math.cos(a) * side + math.sin(a) * other)) for a in angles]
    first = numpy.array(vertices[:across])
    # Rings of a closed curve are joined where the transported side comes back turned by some steps.
    turn = 0
    if closed:
        closing = numpy.array(vertices[-across:])
        turn = min(range(across), key=lambda k: numpy.abs(numpy.roll(first, -k, 0) - closing).sum())
    faces = []
    for i in range(count if closed else count - 1):
        shift = turn if i == count - 1 else 0
        for j in range(across):
            a, b = i * across + j, i * across + (j + 1) % across
            c, d = (((i + 1) % count) * across + (k + shift) % across for k in (j, j + 1))
            faces += [(a, b, d), (a, d, c)]
    if not closed:
        low, high = len(vertices), len(vertices) + 1
        vertices += [tuple(centres[0]), tuple(centres[-1])]
        faces += [(low, (j + 1) % across, j) for j in range(across)]
        last = (count - 1) * across
        faces += [(high, last + j, last + (j + 1) % across) for j in range(across)]
    return vertices, faces


def knot(p=2, q=3, steps=240, across=12):
    t = 2 * math.pi * numpy.arange(steps) / steps
    r = 2 + numpy.cos(q * t)
    return ring_tube(numpy.stack([r * numpy.cos(p * t), r * numpy.sin(p * t), -numpy.sin(q * t)], axis=1), across, 0.42, True)


def hairpin(length, thickness, gap, depth):
    """Two plates, `gap` apart, joined at one end: an extruded letter U of 16 vertices."""
    half, inner = gap / 2 + thickness, gap / 2
    outline = [(0, -half), (length, -half), (length, half), (0, half), (0, inner), (length - thickness, inner),
               (length - thickness, -inner), (0, -inner)]
    vertices = [(x, y, z) for z in (0, depth) for x, y in outline]
    # The two plates and the bow between them.
    flat = [(0, 1, 6), (0, 6, 7), (1, 2, 5), (1, 5, 6), (2, 3, 4), (2, 4, 5)]
    faces = [(c, b, a) for a, b, c in flat] + [(a + 8, b + 8, c + 8) for a, b, c in flat]
    for i in range(8):
        j = (i + 1) % 8
        faces += [(i, j, j + 8), (i, j + 8, i + 8)]
    return vertices, faces


class GeometryChain(WorkplaceTest):
    def stage(self, name, *arguments):
        # Under sanitizers addresses are no measure of memory.
        ended = run_limited([os.path.join(BIN, "sg-" + name), "-q", *arguments], 120 * SLOWNESS,
                            6 if SLOWNESS == 1 else 1 << 20)
        self.assertEqual(ended.fate, "ok", "sg-%s: %s" % (name, ended.line))

    def chain(self, mesh, genus, size=80, spacing=1.0, nodes=NODES):
        """Takes a mesh through the stages and returns the polygrid's record."""
        write_off(self.at("mesh.off"), mesh)
        self.stage("prepare", self.at("mesh.off"), "-o", self.at("surface.ply"), "--size", size, "--spacing", spacing)
        self.stage("distance", self.at("surface.ply"), "-o", self.at("distance.vdb"), "--voxel", 2 * spacing, "--inside",
                   4 * spacing, "--outside", 4 * spacing)
        self.stage("tetrahedralize", self.at("surface.ply"), "-o", self.at("tets.hdf"))
        self.stage("polycube", self.at("tets.hdf"), "-o", self.at("polycube.hdf"), "--nodes", nodes)
        self.stage("polygrid", self.at("polycube.hdf"), self.at("surface.ply"), "-o", self.at("polygrid.hdf"))
        grid = record(self.at("polygrid.hdf"))["results"]
        seen = grid_check.check(self.at("polygrid.hdf"))
        self.assertEqual((grid["inverted_cells"], seen["inverted_corners"], seen["open_edges"]), (0, 0, False))
        self.assertEqual((grid["genus"], seen["genus"]), (genus, genus))
        self.assertEqual(record(self.at("polycube.hdf"))["results"]["object_genus"], genus)
        self.assertLess(abs(grid["nodes"] / nodes - 1), 0.5)
        return grid

    def points_and_cells(self):
        with h5py.File(self.at("polygrid.hdf")) as file:
            return file["VTKHDF/Points"][:], file["VTKHDF/Connectivity"][:].reshape(-1, 8)

    def test_needles_at_the_tips_of_a_cone_and_along_a_prism(self):
        sides = 1000
        ring = [(math.cos(2 * math.pi * k / sides), math.sin(2 * math.pi * k / sides), 0) for k in range(sides)]
        cone = ring + [(0, 0, 1.5), (0, 0, -1.5)], [f for k in range(sides) for f in
                                                   ((k, (k + 1) % sides, sides), ((k + 1) % sides, k, sides + 1))]
        self.chain(cone, 0, spacing=2)
        line = numpy.array([(0, 0, 0), (3.0, 1, 0)])
        grid = self.chain(ring_tube(line, 600, 1.0, False), 0, spacing=2)
        self.assertLess(grid["coverage"]["p99"], 1)

    def test_sheets_a_tenth_of_a_cell_apart_do_not_merge(self):
        depth, thickness, length = 40.0, 8.0, 80.0
        spacing = (depth * (2 * length - thickness) * thickness / (0.78 * NODES)) ** (1 / 3)
        gap = 0.1 * spacing
        grid = self.chain(hairpin(length, thickness, gap, depth), 0, size=0, spacing=spacing / 2)
        self.assertGreater(gap, 0.05 * grid["spacing"])
        self.assertLess(gap, 0.2 * grid["spacing"])
        # Where the plates face each other, no cell reaches from one into the other.
        points, cells = self.points_and_cells()
        corners = points[cells]
        apart = corners[:, :, 0].max(axis=1) < length / 2 - thickness - grid["spacing"]
        across = (corners[apart, :, 1].min(axis=1) < -gap / 2) & (corners[apart, :, 1].max(axis=1) > gap / 2)
        self.assertGreater(apart.sum(), 100)
        self.assertEqual(across.sum(), 0)

    def test_a_rod_a_hundred_times_as_long_as_thick(self):
        grid = self.chain(box((100.0, 1.0, 1.0)), 0, spacing=0.2)
        points, _ = self.points_and_cells()
        # To both ends.
        self.assertGreater(numpy.ptp(points[:, 0]), 80 - 2 * grid["spacing"])

    def test_a_torus_knot(self):
        grid = self.chain(knot(), 1)
        self.assertLess(grid["coverage"]["p99"], 1)

    def test_a_sphere_of_many_triangles(self):
        grid = self.chain(icosphere(8 if LONG else 6), 0, spacing=0.5 if LONG else 1)
        self.assertLess(grid["coverage"]["max"], 1)
        self.assertEqual(grid["boundary_distance"]["points_off_surface"], 0)

    def test_a_cube_of_twelve_triangles(self):
        grid = self.chain(box(), 0, spacing=1.5)
        self.assertGreater(grid["scaled_jacobian"]["mean"], 0.9)
        points, _ = self.points_and_cells()
        # The corners are there, up to the rounding of a cell.
        self.assertGreater(numpy.abs(points).min(axis=1).max(), 40 - 0.5 * grid["spacing"])

    def test_sizes_from_a_thousandth_to_a_million(self):
        grids = [self.chain(torus(), 1, size=size, spacing=size / 60, nodes=4000) for size in (1e-3, 80, 1e6)]
        for grid in grids:
            # The same grid up to rounding.
            self.assertLess(abs(grid["nodes"] / grids[1]["nodes"] - 1), 0.02)
            self.assertLess(abs(grid["scaled_jacobian"]["mean"] - grids[1]["scaled_jacobian"]["mean"]), 0.01)
            self.assertLess(grid["boundary_distance"]["max"], 0.05)


if __name__ == "__main__":
    unittest.main()
