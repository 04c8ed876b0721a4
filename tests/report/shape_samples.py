# SPDX-License-Identifier: AGPL-3.0-or-later
"""Shapes made in code, for reports where no other meshes are at hand: vertices (n×3) and outward triangles (m×3)."""
import numpy


def sphere(times=5):
    """An octahedron split, on the unit sphere."""
    points = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    faces = [(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)]
    points = [numpy.array(p, float) for p in points]
    for _ in range(times):
        middle, finer = {}, []

        def split(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(points)
                between = points[a] + points[b]
                points.append(between / numpy.linalg.norm(between))
            return middle[key]

        for a, b, c in faces:
            ab, bc, ca = split(a, b), split(b, c), split(c, a)
            finer += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = finer
    return numpy.array(points), numpy.array(faces)


def bulged(directions, heights, widths):
    """A ball with a smooth bump in each direction."""
    points, faces = sphere()
    directions = numpy.array(directions, float)
    directions /= numpy.linalg.norm(directions, axis=1)[:, None]
    radius = 1 + (numpy.exp((points @ directions.T - 1) / numpy.array(widths)) * numpy.array(heights)).sum(axis=1)
    return points * radius[:, None], faces


def pear():
    return bulged([(0, 1, 0.2), (0.4, 1, 0.1), (-0.5, 0.9, -0.2), (1, -0.6, 0.5), (-1, -0.4, 0.3)],
                  [0.5, 0.35, 0.3, 0.4, 0.35], [0.08, 0.02, 0.025, 0.15, 0.1])


def star():
    """A body with five limbs."""
    return bulged([(1, 0.6, 0), (-1, 0.6, 0), (0.6, -1, 0.1), (-0.6, -1, -0.1), (0, 1, 0.1)], [1.4, 1.4, 1.3, 1.3, 0.7],
                  [0.03, 0.03, 0.04, 0.04, 0.05])


def pillow():
    points, faces = sphere()
    flat = points * numpy.array([1.3, 0.55, 0.9])
    return flat * (1 + 0.12 * numpy.cos(3 * points[:, :1]) * numpy.sin(4 * points[:, 2:])), faces


def blocks(filled, smooth=True):
    """The boundary of a set of cubes, a boolean array, smoothed or not; no two may touch in an edge or a corner alone."""
    padded = numpy.pad(filled, 1)
    number, points, faces = {}, [], []

    def vertex(place):
        if place not in number:
            number[place] = len(points)
            points.append(place)
        return number[place]

    for axis in range(3):
        u, v = numpy.eye(3, dtype=int)[(axis + 1) % 3], numpy.eye(3, dtype=int)[(axis + 2) % 3]
        for side in (0, 1):
            outward = numpy.zeros(3, int)
            outward[axis] = 2 * side - 1
            other = numpy.roll(padded, -outward[axis], axis)
            for cube in numpy.argwhere(padded & ~other):
                corner = cube + (side * numpy.eye(3, dtype=int)[axis])
                quad = [vertex(tuple(corner + p)) for p in (0 * u, u, u + v, v)]
                quad = quad if side else quad[::-1]
                faces += [(quad[0], quad[1], quad[2]), (quad[0], quad[2], quad[3])]
    points, faces = numpy.array(points, float), numpy.array(faces)
    if not smooth:
        return points, faces
    pairs = numpy.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    degree = numpy.bincount(pairs[:, 0], minlength=len(points))[:, None]
    for step in range(60):  # [Taubin1995], between its pairs of steps some that only smooth
        mean = numpy.zeros_like(points)
        numpy.add.at(mean, pairs[:, 0], points[pairs[:, 1]])
        points = points + (-0.52 if step % 3 == 2 else 0.5) * (mean / degree - points)
    return points, faces


def three_holes():
    """A plate with three holes in a row, bent: genus 3."""
    x, y, z = numpy.mgrid[0:79, 0:31, 0:13]
    filled = ((x - 39) / 39.5) ** 4 + ((y - 15) / 15.5) ** 4 + ((z - 6) / 6.8) ** 6 < 1
    for middle in (15, 39, 63):
        filled[(x - middle) ** 2 + (y - 15) ** 2 < 55] = False
    points, faces = blocks(filled)
    points -= points.mean(axis=0)
    points[:, 2] += 0.01 * points[:, 0] ** 2
    return points, faces


def write_off(path, points, faces):
    with open(path, "w") as file:
        file.write("OFF\n%d %d 0\n" % (len(points), len(faces)))
        file.writelines("%.9g %.9g %.9g\n" % tuple(p) for p in points)
        file.writelines("3 %d %d %d\n" % tuple(f) for f in faces)
