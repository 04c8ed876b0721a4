# SPDX-License-Identifier: AGPL-3.0-or-later
"""Reading the binary PLY files that the stages write."""
import re

import numpy

TYPES = {"char": "i1", "uchar": "u1", "short": "<i2", "ushort": "<u2", "int": "<i4", "uint": "<u4", "float": "<f4",
         "double": "<f8", "int8": "i1", "uint8": "u1", "int16": "<i2", "uint16": "<u2", "int32": "<i4", "uint32": "<u4",
         "float32": "<f4", "float64": "<f8"}


def read_ply(path):
    """The vertices as a structured array with the file's names, and the triangles, m × 3."""
    with open(path, "rb") as file:
        content = file.read()
    end = content.index(b"end_header\n") + len(b"end_header\n")
    header = content[:end].decode()
    if "format binary_little_endian 1.0" not in header:
        raise AssertionError(path + " is not binary little-endian")
    counts = {name: int(count) for name, count in re.findall(r"element (\w+) (\d+)", header)}
    fields = re.findall(r"property (\w+) (\w+)\n", header.split("element vertex")[1].split("element face")[0])
    vertices = numpy.frombuffer(content, numpy.dtype([(name, TYPES[kind]) for kind, name in fields]), counts["vertex"], end)
    triangle = numpy.dtype([("count", "u1"), ("corners", "<i4", 3)])
    return vertices, numpy.frombuffer(content, triangle, counts.get("face", 0), end + vertices.nbytes)["corners"]


def write_ply(path, vertices, triangles):
    """The same: a structured array, and triangles, m × 3."""
    kinds = {"i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort", "i4": "int", "u4": "uint", "f4": "float", "f8": "double"}
    names = ["property %s %s\n" % (kinds[vertices.dtype[name].str.lstrip("<|")], name) for name in vertices.dtype.names]
    faces = numpy.empty(len(triangles), numpy.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    faces["count"], faces["corners"] = 3, triangles
    with open(path, "wb") as file:
        file.write(("ply\nformat binary_little_endian 1.0\nelement vertex %d\n%selement face %d\n"
                    "property list uchar int vertex_indices\nend_header\n" % (len(vertices), "".join(names), len(faces))).encode())
        file.write(vertices.tobytes())
        file.write(faces.tobytes())
