# SPDX-License-Identifier: AGPL-3.0-or-later
"""Reading the pictures that the stages write: scan lines of float channels, ZIP compressed."""
import struct
import zlib

import numpy

BLOCK = 16  # scan lines that are compressed together


def read_exr(path):
    """Each channel by its name, rows × columns."""
    with open(path, "rb") as file:
        data = file.read()
    if data[:4] != b"\x76\x2f\x31\x01":
        raise AssertionError(path + " is no EXR file")
    attributes, at = {}, 8
    while data[at]:
        end = data.index(0, at)
        kind = data.index(0, end + 1)
        size = struct.unpack_from("<i", data, kind + 1)[0]
        attributes[data[at:end].decode()] = data[kind + 5:kind + 5 + size]
        at = kind + 5 + size
    if attributes["compression"] != b"\3":
        raise AssertionError(path + " is not ZIP compressed")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    names, listed = [], attributes["channels"]
    while listed[0]:
        name, listed = listed.split(b"\0", 1)
        if struct.unpack_from("<i", listed)[0] != 2:
            raise AssertionError("%s: channel %s is not of floats" % (path, name.decode()))
        names.append(name.decode())
        listed = listed[16:]
    pixels = numpy.empty((height, len(names), width), numpy.float32)
    for (offset,) in struct.iter_unpack("<Q", data[at + 1:at + 1 + 8 * (-(-height // BLOCK))]):
        first, size = struct.unpack_from("<2i", data, offset)
        rows = pixels[first - top:first - top + BLOCK]
        pixels[first - top:first - top + BLOCK] = numpy.frombuffer(
            unpack(data[offset + 8:offset + 8 + size], rows.nbytes), "<f4").reshape(rows.shape)
    return {name: pixels[:, k] for k, name in enumerate(names)}


def unpack(block, size):
    """A block of scan lines: differences of bytes, of which every second one lies in the second half."""
    if len(block) == size:  # kept as it was where compression made it longer
        return block
    deltas = numpy.frombuffer(zlib.decompress(block), numpy.uint8).copy()
    deltas[1:] += 128
    halves = numpy.add.accumulate(deltas, dtype=numpy.uint8)
    middle = (size + 1) // 2
    order = numpy.empty(size, numpy.uint8)
    order[0::2], order[1::2] = halves[:middle], halves[middle:]
    return order.tobytes()
