# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws diffusion_cost_benchmark's table: gnuplot -e "csv='…'; picture='…'" diffusion_cost.gnuplot
set terminal pngcairo size 900,600 font "sans,12"
set output picture
set datafile separator ","
set logscale x
set format x "10^{%L}"
set yrange [0:*]
set grid back linetype 1 linecolor rgb "#dddddd"
set xlabel "points of the polygrid"
set ylabel "core nanoseconds a point, R, G and B"
set title "Cost against nodes: bunny (lines), ball (dashed)"
set key outside right
steps = "'set-up' 'one cold cycle' 'one warm cycle' 'adaptive set-up' 'adaptive cold' 'adaptive warm'"
columns = "4 5 6 8 9 10"
of(ball) = sprintf("< awk -F, 'NR > 1 && ($1 ~ /^ball/) == %d' '%s'", ball, csv)
plot for [k = 1:6] of(0) using 2:(column(int(word(columns, k)))) with linespoints lw 2 pt 7 lc k title word(steps, k), \
  for [k = 1:6] of(1) using 2:(column(int(word(columns, k)))) with linespoints lw 2 pt 6 dt 2 lc k notitle
