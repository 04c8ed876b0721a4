# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws shell_texture_benchmark's table: gnuplot -e "csv='…'; picture='…'" shell_texture.gnuplot
set terminal pngcairo size 1000,600
set output picture
set datafile separator ","
set logscale x
set logscale y2
set xlabel "size: single precision over compressed, times"
set ylabel "PSNR, dB, of the 99.9th percentiles"
set y2label "looking up a voxel, ns"
set y2tics
set ytics nomirror
set title "Shell texture functions compressed, one thread"
set key outside bottom horizontal
array codecs[2] = ["vector quantisation", "principal components"]
plot for [i = 1:2] sprintf("< grep '^%s,' '%s'", codecs[i], csv) using 4:5 with linespoints pt 7 lc i title codecs[i].": PSNR", \
  for [i = 1:2] sprintf("< grep '^%s,' '%s'", codecs[i], csv) using 4:7 axes x1y2 with linespoints pt 6 dt 2 lc i title codecs[i].": any voxel", \
  for [i = 1:2] sprintf("< grep '^%s,' '%s'", codecs[i], csv) using 4:8 axes x1y2 with linespoints pt 4 dt 3 lc i title codecs[i].": next voxel"
