# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws synthesis_benchmark's table: gnuplot -e "csv='…'; picture='…'" synthesis.gnuplot
set terminal pngcairo size 900,600
set output picture
set datafile separator ","
set logscale x
set offsets graph 0.05, graph 0.05, graph 0, graph 0.05
set yrange [0:]
set xlabel "seconds of synthesis (median)"
set ylabel "distance to the nearest window of the sample over variance"
names = system(sprintf("tail -n +2 '%s' | cut -d, -f1 | tr ' ' '-'", csv))
stats csv skip 1 using 7 nooutput
set title sprintf("Synthesis on a torus: seconds against likeness; texels drawn at random have %.2f", STATS_mean)
set key outside right
plot for [i=1:words(names)] csv skip 1 using ($0 == i - 1 ? $4 : NaN):6 with points pointtype 3 + i pointsize 1.6 title word(names, i), \
  '' skip 1 using 4:8 with lines linecolor black title "tiling"
