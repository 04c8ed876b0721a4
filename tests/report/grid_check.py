# SPDX-License-Identifier: AGPL-3.0-or-later
"""What a polygrid's file alone shows: Jacobians, closedness and genus of its boundary.

    grid_check.py polygrid.hdf      prints them as JSON
"""
import json
import sys

import h5py
import numpy

# Each corner of a VTK hexahedron with its neighbours, right-handed.
CORNERS = [(0, 1, 3, 4), (1, 2, 0, 5), (2, 3, 1, 6), (3, 0, 2, 7), (4, 7, 5, 0), (5, 4, 6, 1), (6, 5, 7, 2), (7, 6, 4, 3)]


def corner_jacobians(points, cells):
    """m×8: the determinant of the three unit edges at each corner of each cell; 1 at a right-angled corner."""
    result = numpy.empty((len(cells), 8))
    for k, (corner, *others) in enumerate(CORNERS):
        edges = [points[cells[:, other]] - points[cells[:, corner]] for other in others]
        lengths = numpy.prod([numpy.linalg.norm(edge, axis=1) for edge in edges], axis=0)
        volume = numpy.einsum("ij,ij->i", numpy.cross(edges[0], edges[1]), edges[2])
        result[:, k] = volume / numpy.maximum(lengths, 1e-300)
    return result


def scaled_jacobians(points, cells):
    """m: the least corner of each cell."""
    return corner_jacobians(points, cells).min(axis=1)


def check(path):
    with h5py.File(path) as file:
        points = file["VTKHDF/Points"][:]
        cells = file["VTKHDF/Connectivity"][:].reshape(-1, 8)
        quads = file["VTKHDF/FieldData/boundary_quads"][:].astype(numpy.int64)
    scaled = scaled_jacobians(points, cells)
    # Each directed edge of a closed oriented surface occurs once, and its opposite once.
    edges = numpy.stack([quads, numpy.roll(quads, -1, axis=1)], axis=2).reshape(-1, 2)
    count = len(points)
    forth, back = edges[:, 0] * count + edges[:, 1], edges[:, 1] * count + edges[:, 0]
    closed = numpy.array_equal(numpy.sort(forth), numpy.sort(back)) and len(numpy.unique(forth)) == len(forth)
    characteristic = len(numpy.unique(quads)) - len(edges) // 2 + len(quads)
    return {"inverted_corners": int((~(scaled > 0)).sum()), "scaled_jacobian_min": float(scaled.min()),
            "scaled_jacobian_mean": float(scaled.mean()), "open_edges": not closed,
            "genus": (2 - characteristic) // 2}


if __name__ == "__main__":
    print(json.dumps(check(sys.argv[1])))
