#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Views of invented materials, for examples of solid synthesis: terrazzo.png looks the same from all sides; sandstone has
a top and a side.

    views.py assets/samples/views
"""
import os
import struct
import sys
import zlib

import numpy


def write_png(path, rgb):
    """rgb[row, column, channel], uint8."""
    height, width, _ = rgb.shape
    lines = b"".join(b"\0" + rgb[row].tobytes() for row in range(height))

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)) +
                   chunk(b"IDAT", zlib.compress(lines, 9)) + chunk(b"IEND", b""))


def noise(random, shape, scales):
    """Smooth noise about 0: random values at coarse points, interpolated, for each scale (rows, columns)."""
    total = numpy.zeros(shape)
    for weight, rows, columns in scales:
        coarse = random.standard_normal((rows + 3, columns + 3))
        v = numpy.linspace(0, rows, shape[0], endpoint=False)[:, None] + 0.5
        u = numpy.linspace(0, columns, shape[1], endpoint=False)[None, :] + 0.5
        i, j = v.astype(int), u.astype(int)
        s, t = v - i, u - j
        s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
        total += weight * ((1 - s) * ((1 - t) * coarse[i, j] + t * coarse[i, j + 1]) +
                           s * ((1 - t) * coarse[i + 1, j] + t * coarse[i + 1, j + 1]))
    return total


def terrazzo(side=128, seed=3):
    """Angular chips of five stones in cement."""
    random = numpy.random.RandomState(seed)
    y, x = numpy.mgrid[0:2 * side, 0:2 * side] / 2.0
    points = random.uniform(-10, side + 10, (260, 2))
    stones = numpy.array([[214, 190, 160], [150, 84, 62], [96, 104, 92], [232, 226, 212], [58, 54, 60]])
    kind = random.choice(5, 260, p=[0.3, 0.2, 0.2, 0.2, 0.1])
    chipped = random.uniform(0.2, 1.5, 260)
    distance = numpy.sqrt((x[..., None] - points[:, 0]) ** 2 + (y[..., None] - points[:, 1]) ** 2)
    order = numpy.argpartition(distance, 2, axis=2)[..., :3]
    near = numpy.sort(numpy.take_along_axis(distance, order, 2), axis=2)
    nearest = numpy.argmin(distance, axis=2)
    cement = (near[..., 1] - near[..., 0] < 2.2 * chipped[nearest]) | (near[..., 0] > 8)
    color = numpy.where(cement[..., None], [176, 170, 158], stones[kind[nearest]]).astype(float)
    color *= (1 + 0.05 * noise(random, cement.shape, [(1, 60, 60), (0.6, 140, 140)]))[..., None]
    return numpy.clip(color.reshape(side, 2, side, 2, 3).mean(axis=(1, 3)), 0, 255).astype(numpy.uint8)


def sandstone(side=128, seed=9):
    """Top: soft blotches and grains. Side: wavy beds of the same colours."""
    views = {}
    for name, scales in (("top", [(1, 6, 6), (0.5, 14, 14)]), ("side", [(1, 26, 2), (0.35, 40, 6)])):
        random = numpy.random.RandomState(seed)
        level = noise(random, (side, side), scales)
        rank = numpy.argsort(numpy.argsort(level, axis=None)).reshape(side, side) / side ** 2
        beds = numpy.array([[122, 70, 44], [178, 116, 70], [206, 158, 104], [226, 196, 150], [236, 216, 184]], float)
        place = rank * 4
        low = numpy.minimum(place.astype(int), 3)
        share = (place - low)[..., None]
        color = beds[low] * (1 - share) + beds[low + 1] * share
        color *= (1 + 0.06 * noise(random, (side, side), [(1, 64, 64)]))[..., None]
        views[name] = numpy.clip(color, 0, 255).astype(numpy.uint8)
    return views


if __name__ == "__main__":
    folder = sys.argv[1]
    write_png(os.path.join(folder, "terrazzo.png"), terrazzo())
    for view, pixels in sandstone().items():
        write_png(os.path.join(folder, "sandstone-%s.png" % view), pixels)
