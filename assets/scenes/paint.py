#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Paints a mesh by formulas: what sg-synthesize and a scene's material.shell.paint read.

    paint.py mesh.off|mesh.obj painted.ply 'sample = y > 0.2 * sin(9 * x)' 'scale = 1 - 0.4 * y'

Each formula is Python over x, y, z: the place in the mesh's box, whose longest edge runs from -1 to 1, as sg-prepare
centres it. What the vertices have depends on the mesh's own triangles: paint a fine one."""
import math
import sys


def read_mesh(path):
    """Points and triangles of an .off or .obj file; polygons are fanned."""
    lines = [line.split("#")[0].split() for line in open(path)]
    if path.endswith(".obj"):
        points = [tuple(map(float, line[1:4])) for line in lines if line[:1] == ["v"]]
        # Indices count from 1, negative ones from the last point.
        polygons = [[int(corner.split("/")[0]) for corner in line[1:]] for line in lines if line[:1] == ["f"]]
        polygons = [[i - 1 if i > 0 else len(points) + i for i in polygon] for polygon in polygons]
    else:
        words = [word for line in lines for word in line]
        if words[:1] != ["OFF"]:
            sys.exit(path + ": expected an .off or .obj file")
        count, faces, at = int(words[1]), int(words[2]), 4
        numbers = [float(word) for word in words[at:at + 3 * count]]
        points, polygons, at = list(zip(*[iter(numbers)] * 3)), [], at + 3 * count
        for _ in range(faces):
            corners = int(words[at])
            polygons.append([int(word) for word in words[at + 1:at + 1 + corners]])
            at += 1 + corners
    return points, [(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)]


def paint(points, formulas):
    """For each point the values of 'NAME = FORMULA'."""
    lower, upper = ([extreme(p[k] for p in points) for k in range(3)] for extreme in (min, max))
    half = max(b - a for a, b in zip(lower, upper)) / 2
    code = [compile(formula.partition("=")[2].strip(), formula, "eval") for formula in formulas]
    for p in points:
        place = dict(zip("xyz", ((v - (a + b) / 2) / half for v, a, b in zip(p, lower, upper))))
        yield [float(eval(c, vars(math).copy(), place)) for c in code]


def main(mesh, painted, *formulas):
    points, faces = read_mesh(mesh)
    names = [formula.partition("=")[0].strip() for formula in formulas]
    with open(painted, "w") as file:
        file.write("ply\nformat ascii 1.0\nelement vertex %d\n" % len(points))
        file.writelines("property float %s\n" % name for name in ["x", "y", "z"] + names)
        file.write("element face %d\nproperty list uchar int vertex_indices\nend_header\n" % len(faces))
        for point, values in zip(points, paint(points, formulas)):
            file.write(" ".join("%g" % value for value in [*point, *values]) + "\n")
        file.writelines("3 %d %d %d\n" % face for face in faces)


if __name__ == "__main__":
    if len(sys.argv) < 4 or not all("=" in formula for formula in sys.argv[3:]):
        sys.exit(__doc__)
    main(*sys.argv[1:])
