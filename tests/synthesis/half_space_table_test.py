# SPDX-License-Identifier: AGPL-3.0-or-later
"""The committed table of half-space reflectances is what sg-reference says."""
import os
import re
import sys
import unittest

sys.path.append(os.path.dirname(os.path.abspath(__file__)))
import half_space_table
from programs import SOURCE


class HalfSpaceTable(unittest.TestCase):
    def test_points_of_the_table_come_again(self):
        half_space_table.BIN = os.environ["SG_BIN"]
        with open(os.path.join(SOURCE, "tests", "synthesis", "half_space_table.inc")) as file:
            rows = [tuple(map(float, re.findall(r"[\d.]+", line))) for line in file if line.startswith("{")]
        self.assertEqual(len(rows), len(half_space_table.ALBEDOS) * len(half_space_table.INDICES))
        chosen = rows if os.environ.get("SG_LONG") else [rows[1], rows[-6]]
        for row in chosen:
            albedo, ior, reflectance, standard_error = row
            value, error = half_space_table.reflectance(albedo, ior, "4e4")
            self.assertLess(abs(value - reflectance), 4.5 * (error ** 2 + standard_error ** 2) ** 0.5, row)


if __name__ == "__main__":
    unittest.main()
