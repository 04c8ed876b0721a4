# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws grid_benchmark's table: gnuplot -e "csv='…'; picture='…'" grid.gnuplot
set terminal pngcairo size 900,600
set output picture
set datafile separator ","
set style data histograms
set style histogram clustered gap 1
set style fill solid 0.8 border -1
set yrange [0:]
set bmargin 4
set ylabel "nanoseconds a look-up (median)"
set title "Look-ups in one distance field, bunny at L/256, one thread"
set key top left
plot for [grid in "two-level OpenVDB NanoVDB"] \
  sprintf("< grep ',%s,' '%s'", grid, csv) using 6:xtic(sprintf("%s\n%s", strcol(1), strcol(2))) title grid
