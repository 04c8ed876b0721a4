# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws render_benchmark's table: gnuplot -e "csv='…'; picture='…'" render.gnuplot
set terminal pngcairo size 800,600
set output picture
set datafile separator ","
set logscale xy
set xlabel "seconds"
set ylabel "RMSE against 256 samples a pixel"
set title "Rendering: samples everywhere and where the picture varies"
plot for [kind in "everywhere adaptive"] csv using (strcol(1) eq kind ? $3 : NaN):5 skip 1 with linespoints title kind
