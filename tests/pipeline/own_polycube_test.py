# SPDX-License-Identifier: AGPL-3.0-or-later
"""sg-polycube with a polycube of the user's own, and with a wanted count of cubes; sg-polygrid maps both."""
import json
import os
import struct
import unittest

import numpy

from programs import WorkplaceTest, record, run, torus, write_off

RING = [[i, j, 0] for i in range(3) for j in range(3) if (i, j) != (1, 1)]


def write_mask(path, cubes, edge, origin, tiles=()):
    """An uncompressed OpenVDB file of one float grid: 1 and active at each cube, and in tiles of 8³ from the indices
    `tiles` on, which are multiples of 8. Everything lies in [0, 128)³; the cube (0, 0, 0) has its lower corner at origin."""
    text = lambda s: struct.pack("<I", len(s)) + s.encode()
    bits = lambda flags: numpy.packbits(flags, bitorder="little").tobytes()
    values = lambda array: b"\x06" + array.astype("<f4").tobytes()  # all of them, as they are
    leaf_at = lambda cube: (cube[0] >> 3) << 8 | (cube[1] >> 3) << 4 | cube[2] >> 3
    leaves = {}
    for i, j, k in cubes:
        leaves.setdefault(leaf_at((i, j, k)), numpy.zeros(512, bool))[(i & 7) << 6 | (j & 7) << 3 | k & 7] = True
    children, active = numpy.zeros(4096, bool), numpy.zeros(4096, bool)
    children[list(leaves)] = True
    active[[leaf_at(tile) for tile in tiles]] = True
    first = numpy.arange(32768) == 0
    lower = bits(children) + bits(active) + values(active) + b"".join(bits(leaves[at]) for at in sorted(leaves))
    root = struct.pack("<if2I3i", 1, 0, 0, 1, 0, 0, 0)
    topology = root + bits(first) + bits(first & False) + values(first & False) + lower
    buffers = b"".join(bits(leaves[at]) + values(leaves[at]) for at in sorted(leaves))
    # Samples stand at the middles of cubes.
    place = [x + edge / 2 for x in origin]
    transform = text("UniformScaleTranslateMap") + struct.pack(
        "<18d", *place, *[edge] * 6, *[1 / edge] * 3, *[edge**-2] * 3, *[0.5 / edge] * 3)
    head = b" BDV\0\0\0\0" + struct.pack("<3IB", 224, 10, 0, 1) + b"01234567-89ab-cdef-0123-456789abcdef" + struct.pack("<2I", 0, 1)
    head += text("mask") + text("Tree_float_5_4_3") + text("")
    grid = struct.pack("<2I", 0, 0) + transform + topology
    start = len(head) + 24
    places = struct.pack("<3q", start, start + len(grid), start + len(grid) + len(buffers))
    with open(path, "wb") as file:
        file.write(head + places + grid + buffers)
    return path


class OwnPolycube(WorkplaceTest):
    def setUp(self):
        super().setUp()
        write_off(self.at("surface.off"), torus())
        self.ok("tetrahedralize", self.at("surface.off"), "-o", self.at("tets.hdf"))

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

    def test_a_volume_of_another_program_is_a_mask_of_the_cubes(self):
        points = numpy.array(torus()[0])
        lower, upper = points.min(axis=0), points.max(axis=0)
        edge = float((upper - lower).max()) / 3
        origin = (lower + upper - edge * numpy.array([3, 3, 1])) / 2
        results = self.polycube(write_mask(self.at("ring.vdb"), RING, edge, origin), "--grid", 6)
        self.assertEqual((results["cubes"], results["cells"]), (8, 8 * 6**3))
        self.assertEqual(results["placement"], "file")
        self.assertAlmostEqual(results["spacing"], edge / 6, places=6)
        self.assertEqual((results["genus"], results["object_genus"]), (1, 1))
        self.ok("polygrid", self.at("polycube.hdf"), self.at("surface.off"), "-o", self.at("polygrid.hdf"))
        self.assertEqual(record(self.at("polygrid.hdf"))["results"]["inverted_cells"], 0)
        # The same ring of voxels an eighth as long: in leaves, and as active tiles.
        tiles = [[8 * x for x in cube] for cube in RING]
        voxels = [[i + a, j + b, k + c] for i, j, k in tiles for a in range(8) for b in range(8) for c in range(8)]
        made = [self.polycube(write_mask(self.at("fine.vdb"), *parts, edge / 8, origin, *more), "--grid", 1)
                for parts, more in (((voxels,), ()), (([],), (tiles,)))]
        self.assertEqual(made[0]["cubes"], 8 * 8**3)
        self.assertEqual(made[0], made[1])
        self.refused(3, "the file holds no cubes", write_mask(self.at("none.vdb"), [], edge, origin))

    def test_cubes_times_grid_sets_the_nodes(self):
        results = self.polycube("--cubes", 60, "--grid", 4)
        self.assertEqual(results["grid"], 4)
        self.assertLess(abs(results["cubes"] / 60 - 1), 0.1)
        self.assertEqual(results["cells"], results["cubes"] * 64)

    def test_what_cannot_be_a_polycube_of_the_object_is_refused(self):
        ring = self.write("ring.json", RING)
        self.refused(3, "apart", self.write("apart.json", [[0, 0, 0], [2, 0, 0]]))
        self.refused(3, "without --origin and --edge", ring, "--origin", "90,0,0", "--place", "box")
        column = self.write("column.json", [[0, 0, k] for k in range(9)])
        self.refused(3, "even over its bounding box", column, "--place", "box")
        self.refused(3, "not aligned", self.at("surface.off"))
        self.refused(3, "missing.json", self.at("missing.json"))
        self.refused(3, "does not say where", ring, "--place", "file")
        self.refused(2, "--place", "--place", "box")
        self.refused(2, "--cubes", ring, "--cubes", 8)
        self.refused(2, "leave out", "--nodes", 1000, "--cubes", 8, "--grid", 4)


if __name__ == "__main__":
    unittest.main()
