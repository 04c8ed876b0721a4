# SPDX-License-Identifier: AGPL-3.0-or-later
# gnuplot -e "csv='diffusion.csv'; picture='diffusion.png'" diffusion.gnuplot
set terminal pngcairo size 900,600
set output picture
set datafile separator ","
set logscale xy
set format "10^{%L}"
set xlabel "assembly, set-up and solve, R, G and B, seconds (medians)"
set ylabel "relative algebraic error of the exitance"
set title "Diffusion on a polygrid: seconds against error"
set key outside right
methods = "'multigrid' 'CG + incomplete Cholesky' 'CG + Jacobi' 'hypre BoomerAMG + CG' 'CHOLMOD' 'paper relaxation'"
plot for [i=1:words(methods)] csv skip 1 using ((strcol(1) eq word(methods, i) && $2 > 10000) ? $3 + $4 + $5 : 1/0):6 \
  with points pointtype 4 + i pointsize 1.6 title word(methods, i)
