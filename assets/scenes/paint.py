#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Paints a mesh by formulas: what sg-synthesize and a scene's material.shell.paint read.

    paint.py mesh.off painted.ply 'sample = y > 0.2 * sin(9 * x)' 'scale = 1 - 0.4 * y'

Each formula is Python over x, y, z: the place in the mesh's box, whose longest edge runs from -1 to 1, as sg-prepare
centres it. What the vertices have depends on the mesh's own triangles: paint a fine one."""
import math
import sys


def read_off(path):
    words = [word for line in open(path) for word in line.split("#")[0].split()]
    assert words[0] == "OFF", path + ": expected an OFF file"
    vertices, faces = int(words[1]), int(words[2])
    numbers = [float(word) for word in words[4:4 + 3 * vertices]]
    corners = words[4 + 3 * vertices:]
    assert corners[0::4] == ["3"] * faces, path + ": expected triangles"
    return list(zip(*[iter(numbers)] * 3)), [corners[4 * f + 1:4 * f + 4] for f in range(faces)]


def paint(points, formulas):
    """For each point the values of 'NAME = FORMULA'."""
    lower, upper = ([extreme(p[k] for p in points) for k in range(3)] for extreme in (min, max))
    half = max(b - a for a, b in zip(lower, upper)) / 2
    code = [compile(formula.partition("=")[2].strip(), formula, "eval") for formula in formulas]
    for p in points:
        place = dict(zip("xyz", ((v - (a + b) / 2) / half for v, a, b in zip(p, lower, upper))))
        yield [float(eval(c, vars(math).copy(), place)) for c in code]


def main(mesh, painted, *formulas):
    points, faces = read_off(mesh)
    names = [formula.partition("=")[0].strip() for formula in formulas]
    with open(painted, "w") as file:
        file.write("ply\nformat ascii 1.0\nelement vertex %d\n" % len(points))
        file.writelines("property float %s\n" % name for name in ["x", "y", "z"] + names)
        file.write("element face %d\nproperty list uchar int vertex_indices\nend_header\n" % len(faces))
        for point, values in zip(points, paint(points, formulas)):
            file.write(" ".join("%g" % value for value in [*point, *values]) + "\n")
        file.writelines("3 %s %s %s\n" % tuple(face) for face in faces)


if __name__ == "__main__":
    if len(sys.argv) < 4 or not all("=" in formula for formula in sys.argv[3:]):
        sys.exit(__doc__)
    main(*sys.argv[1:])
