# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws distance_benchmark's table: gnuplot -e "csv='…'; picture='…'" distance.gnuplot
set terminal pngcairo size 900,600
set output picture
set datafile separator ","
set logscale xy
set format y "10^{%L}"
set xlabel "seconds (median)"
set ylabel "root mean square error of the distance, voxels"
set title "Narrow-band distance, bunny, L/128 and L/256, ±3 and ±10 voxels"
set key outside right
methods = "'ours' 'OpenVDB' 'OpenVDB plain'"
plot for [i=1:3] for [n=1:2] csv skip 1 using ((strcol(1) eq word(methods, i) && $4 == n) ? $6 : NaN):9 \
  with points pointtype (n == 1 ? 6 : 7) pointsize 1.6 linecolor i title sprintf("%s, %d thread%s", word(methods, i), n, n > 1 ? "s" : "")
