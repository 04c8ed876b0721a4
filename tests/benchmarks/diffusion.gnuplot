# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws diffusion_benchmark's table: gnuplot -e "csv='…'; picture='…'" diffusion.gnuplot
# A column a size: seconds against algebraic error, of the solve alone (the light has changed) and with the set-up (the
# material has). Below: what the discretisations are off by, under a soft light and under the one with shadows, against
# unknowns and against the core seconds of the fastest solve that takes each to an algebraic error of 0.5 %.
sizes = system(sprintf("awk -F, 'NR > 1 && !seen[$1]++ {printf \"%%s \", $1}' '%s'", csv))
columns = words(sizes) > 3 ? words(sizes) : 3
set terminal pngcairo size 520 * columns, 1350 font "sans,12"
set output picture
set datafile separator ","
methods = "'shellgrid cold' 'shellgrid warm' 'shellgrid adaptive' 'shellgrid adaptive warm' 'paper: Jacobi' 'paper: hierarchical' \
'paper: hierarchical adaptive' 'CG + incomplete Cholesky' 'CG + Jacobi' 'hypre BoomerAMG + CG' 'CHOLMOD'"
colours = "0xc00000 0xff7f0e 0xe377c2 0x9467bd 0xa0a0a0 0x707070 0x303030 0x1f77b4 0x17a2b8 0x2ca02c 0x8c564b"
marks = "7 7 7 7 4 6 8 5 9 13 11"
discretisations = "trilinear paper tetrahedra embedded"
discretisation_colours = "0xc00000 0x707070 0x1f77b4 0x2ca02c"
width = 1.0 / columns
at(row, column) = sprintf("set origin %g, %g; set size %g, 0.3333", column * width, 1 - (row + 1) / 3.0, width)
of_method(size, m) = sprintf("< awk -F, '$1 == \"%s\" && $2 == \"%s\" && ($3 == \"trilinear\" || $3 == \"paper\") && $NF == \"\"' '%s'", size, word(methods, m), csv)
# Unknowns, core seconds of the fastest solve, error in the given column.
of_grid(d, column) = sprintf("< awk -F, '$3 == \"%s\" && $2 !~ /adaptive|warm/ && $18 > 0 && $5 == 0.005 {t = $9; if (!($4 in best) || t < best[$4]) best[$4] = t; e[$4] = $%d} END {for (n in best) print n \",\" best[n] \",\" e[n]}' '%s' | sort -g", d, column, csv)

set multiplot
set logscale xy
set grid back linetype 1 linecolor rgb "#dddddd"
unset key
set lmargin 9
set format x "10^{%L}"
set format y "%g"
set ylabel "algebraic error of the exitance"
set yrange [5e-4:0.2]
do for [s = 1:words(sizes)] {
  size = word(sizes, s)
  eval at(0, s - 1)
  set title sprintf("%s nodes, solve alone", size)
  set xlabel "core seconds, R, G and B"
  plot for [m = 1:words(methods)] of_method(size, m) using 9:5 with linespoints lw 2 lc rgb int(word(colours, m)) pt int(word(marks, m)) ps 1.2
  eval at(1, s - 1)
  set title sprintf("%s nodes, set-up and solve", size)
  plot for [m = 1:words(methods)] of_method(size, m) using ($8 + $9):5 with linespoints lw 2 lc rgb int(word(colours, m)) pt int(word(marks, m)) ps 1.2
}
set yrange [*:*]
set ylabel "off the finest polygrid's, relative"
eval at(2, 0)
set title "Discretisation: soft light (lines), shadows (marks)"
set xlabel "unknowns"
plot for [k = 1:words(discretisations)] of_grid(word(discretisations, k), 19) using 1:3 with linespoints lw 2 pt 7 lc rgb int(word(discretisation_colours, k)), \
  for [k = 1:words(discretisations)] of_grid(word(discretisations, k), 18) using 1:3 with points pt 6 ps 1.5 lc rgb int(word(discretisation_colours, k))
eval at(2, 1)
set title "The same, by the fastest solve to 0.5 %"
set xlabel "core seconds, solve alone"
plot for [k = 1:words(discretisations)] of_grid(word(discretisations, k), 19) using 2:3 with linespoints lw 2 pt 7 lc rgb int(word(discretisation_colours, k)), \
  for [k = 1:words(discretisations)] of_grid(word(discretisations, k), 18) using 2:3 with points pt 6 ps 1.5 lc rgb int(word(discretisation_colours, k))
unset logscale
unset tics
unset border
unset grid
unset title
unset xlabel
unset ylabel
set xrange [0:1]
set yrange [0:1]
set key center center spacing 1.2 maxrows 20
set margins 1, 1, 0, 0
eval at(2, 2)
plot for [m = 1:words(methods)] NaN with linespoints lw 2 lc rgb int(word(colours, m)) pt int(word(marks, m)) ps 1.2 title word(methods, m), \
  for [k = 1:words(discretisations)] NaN with lines lw 4 lc rgb int(word(discretisation_colours, k)) title "below: ".word(discretisations, k)
unset multiplot
