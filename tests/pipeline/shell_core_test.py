# SPDX-License-Identifier: AGPL-3.0-or-later
"""Cores of voxels in the later stages: sg-diffuse and sg-reference take them as the matter that they are."""
import unittest

import numpy

from ply_file import read_ply
from programs import WorkplaceTest, icosphere, record, run, scene, write_json, write_off

BODY = {"absorption": [0.02, 0.03, 0.04], "scattering": [1, 1.2, 1.4]}


class ShellCore(WorkplaceTest):
    def setUp(self):
        super().setUp()
        write_off(self.at("ball.off"), icosphere(3, 6.0))
        write_json(self.at("sample.json"), {"type": "layers", "size": [16, 16], "voxel": 0.6, "thickness": 3, "ior": 1.4,
                                            "layers": [{"material": BODY, "thickness": 1}]})
        self.ok("prepare", self.at("ball.off"), "-o", self.at("surface.ply"), "--size", 0, "--spacing", 0.6)
        self.ok("distance", self.at("surface.ply"), "-o", self.at("distance.vdb"), "--voxel", 0.6, "--inside", 3, "--outside",
                1.2)
        self.ok("sample", self.at("sample.json"), "-o", self.at("sample.vdb"))
        self.ok("textons", self.at("sample.vdb"), "-o", self.at("textons.vdb"), "--textons", 4)
        self.ok("synthesize", self.at("surface.ply"), self.at("textons.vdb"), "-o", self.at("synthesized.ply"))
        self.ok("tetrahedralize", self.at("surface.ply"), "-o", self.at("tets.hdf"))
        self.ok("polycube", self.at("tets.hdf"), "-o", self.at("polycube.hdf"), "--nodes", 3000)
        self.ok("polygrid", self.at("polycube.hdf"), self.at("surface.ply"), "-o", self.at("polygrid.hdf"))
        write_json(self.at("scene.json"), scene(
            object={"mesh": "ball.off", "size": 0, "ior": 1.4},
            material={"shell": {"sample": "sample.json", "thickness": 2, "voxel": 0.6}}))

    def exitance(self, core):
        shell = self.at("shell-%s.vdb" % core)
        self.ok("shell", self.at("synthesized.ply"), self.at("distance.vdb"), self.at("sample.vdb"), "-o", shell, "--thickness",
                2, "--core", core)
        self.ok("diffuse", self.at("scene.json"), self.at("polygrid.hdf"), self.at("surface.ply"), shell, "-o",
                self.at("fluence.hdf"), "--exitance", self.at("exitance.ply"))
        self.ok("reference", self.at("scene.json"), self.at("surface.ply"), shell, "-o", self.at("reference.ply"), "--paths",
                20000)
        return [numpy.stack([read_ply(self.at(name))[0]["exitance_" + c] for c in "rgb"], axis=1)
                for name in ("exitance.ply", "reference.ply")]

    def test_one_matter_is_one_object_whatever_the_core(self):
        plain, traced = self.exitance("bottom-layer")
        self.assertGreater(plain.mean(), 0.01)
        for core in ("mean-value", "solid"):
            own, own_traced = self.exitance(core)
            self.assertLess(numpy.abs(own - plain).max(), 1e-4 * plain.max())
            # The same matter, but collisions are found otherwise: to the noise of 20 000 paths.
            self.assertLess(abs(own_traced.mean() / traced.mean() - 1), 0.05)
            self.assertGreater(record(self.at("shell-%s.vdb" % core))["results"]["core"]["voxels"], 500)


if __name__ == "__main__":
    unittest.main()
