# SPDX-License-Identifier: AGPL-3.0-or-later
# Draws transport_benchmark's table: gnuplot -e "csv='…'; picture='…'" transport.gnuplot
set terminal pngcairo size 1000,600
set output picture
set datafile separator ","
set style data histograms
set style fill solid 0.8
set logscale y
set ylabel "paths a second, over delta tracking with one majorant"
set xlabel "extinction a voxel / anisotropy / contrast of the veins"
set title "Light paths through a ball with a veined shell of ten voxels, one thread"
set key top left
array methods[4] = ["global majorant", "leaf majorant", "voxels", "chosen by leaf"]
plot for [i = 1:4] sprintf("< grep ',%s,' '%s'", methods[i], csv) using 6:xtic(sprintf("%s / %s / %s", strcol(1), strcol(2), strcol(3))) title methods[i]
