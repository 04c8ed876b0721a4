# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws cost_charts.py's table: csv, and for each axis and measure the list of curves as 'stage measure slope'.
set datafile separator ","
set logscale xy
set key left top reverse Left
set grid
set offsets graph 0.03, graph 0.03, graph 0.05, graph 0.05
stage(curve) = word(curve, 1)
title_of(curve) = sprintf("sg-%s, slope %s", word(curve, 1), word(curve, 3))
set multiplot layout 2,2 title "Time and memory of the geometry stages"
do for [against in "nodes voxels"] {
  set xlabel against eq "nodes" ? "nodes" : "voxels along the object"
  curves = value(against . "_time")
  set ylabel "seconds of processor time"
  plot for [curve in curves] csv skip 1 using (strcol(1) eq against && strcol(2) eq stage(curve) ? $3 : NaN):5 \
    with linespoints pointtype 7 title title_of(curve)
  curves = value(against . "_memory")
  set ylabel "peak memory, MiB"
  plot for [curve in curves] csv skip 1 using (strcol(1) eq against && strcol(2) eq stage(curve) ? $3 : NaN):6 \
    with linespoints pointtype 7 title title_of(curve)
}
unset multiplot
