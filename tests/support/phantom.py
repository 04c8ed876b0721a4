#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""A simulated tomogram: wax with balls of three densities in it, below a wavy surface, blurred and noisy, as NRRD.

    phantom.py assets/samples/volumes/wax.nrrd
"""
import gzip
import sys

import numpy


def wax(size=(48, 48, 28), seed=5, surface=(3.5, 1.2, 2, 1.5), balls=26, radii=(2.6, 4.6), top=7,
        densities=(140.0, 185.0, 230.0)):
    """Values 0 (air) … 255 by density: air 10, wax 90, balls by turns `densities`. surface: its mean depth, the height of
    its waves, and how many there are along x and y; radii of the balls and least depth of their tops; in voxels."""
    random = numpy.random.RandomState(seed)
    fine = 2
    x, y, z = numpy.meshgrid(*[(numpy.arange(n * fine) + 0.5) / fine for n in size], indexing="ij")
    depth, height, along_x, along_y = surface
    level = depth + height * numpy.sin(2 * numpy.pi * x / size[0] * along_x + 1) * numpy.cos(2 * numpy.pi * y / size[1] * along_y)
    value = numpy.where(z > level, 90.0, 10.0)
    placed = []
    while len(placed) < balls:
        radius = random.uniform(*radii)
        centre = numpy.array([random.uniform(0, size[0]), random.uniform(0, size[1]), random.uniform(top + radius, size[2])])
        if all(numpy.linalg.norm(centre - c) > radius + r + 0.7 for c, r, _ in placed):
            placed.append((centre, radius, densities[len(placed) % len(densities)]))
    for centre, radius, density in placed:
        value[(x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2 < radius ** 2] = density
    value = value.reshape(size[0], fine, size[1], fine, size[2], fine).mean(axis=(1, 3, 5))
    for axis in range(3):
        value = 0.25 * numpy.roll(value, 1, axis) + 0.5 * value + 0.25 * numpy.roll(value, -1, axis) if axis < 2 else \
            numpy.apply_along_axis(lambda v: numpy.convolve(numpy.pad(v, 1, "edge"), [0.25, 0.5, 0.25], "valid"), 2, value)
    return numpy.clip(numpy.rint(value + random.normal(0, 2.0, value.shape)), 0, 255).astype(numpy.uint8)


def write_nrrd(path, values, spacing=(0.5, 0.5, 0.5), encoding="gzip"):
    """values[x, y, z]."""
    header = ("NRRD0004\n# simulated by tests/support/phantom.py\ntype: uint8\ndimension: 3\nsizes: %d %d %d\n"
              "spacings: %g %g %g\nencoding: %s\n\n" % (values.shape + tuple(spacing) + (encoding,)))
    data = values.transpose(2, 1, 0).tobytes()
    with open(path, "wb") as file:
        file.write(header.encode() + (gzip.compress(data, 9, mtime=0) if encoding == "gzip" else data))


if __name__ == "__main__":
    write_nrrd(sys.argv[1], wax())
