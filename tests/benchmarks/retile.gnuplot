# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws retile_benchmark's table: gnuplot -e "csv='…'; picture='…'" retile.gnuplot
set terminal pngcairo size 900,600
set output picture
set datafile separator ","
set logscale x
set xlabel "seconds"
set ylabel "edge lengths' deviation over their mean"
set title "Retiling beside CGAL's isotropic remeshing (rounds, spacing in mm)"
set key outside right
plot for [method in "ours CGAL"] csv skip 1 using (strcol(1) eq method ? $4 : NaN):8:(sprintf("%d, %.3g", $2, $3)) \
  with labels point pointtype 7 linecolor (method eq "ours" ? 1 : 2) offset 0,0.8 title method
