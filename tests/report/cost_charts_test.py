# SPDX-License-Identifier: AGPL-3.0-or-later
"""Slopes of cost against count."""
import os
import sys
import unittest

sys.path.append(os.path.dirname(os.path.abspath(__file__)))
from cost_charts import slope


class Slopes(unittest.TestCase):
    def test_is_the_exponent_of_a_power(self):
        rows = [{"count": count, "seconds": 3e-4 * count**1.5, "level": 7} for count in (1e4, 2e4, 7e4, 1e6)]
        self.assertAlmostEqual(slope(rows, "seconds"), 1.5)
        self.assertAlmostEqual(slope(rows, "level"), 0)


if __name__ == "__main__":
    unittest.main()
