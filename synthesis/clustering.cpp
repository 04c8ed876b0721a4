// SPDX-License-Identifier: AGPL-3.0-or-later
#include "synthesis/clustering.h"

#include <algorithm>

#include "meshing/core/parallel.h"
#include "meshing/core/random.h"

namespace shellgrid {

Clusters cluster(const RowMatrixf& rows, int count, int iterations, std::uint64_t seed) {
  const int n = static_cast<int>(rows.rows());
  RandomStream random(seed, 41);
  Clusters result;
  result.labels.assign(n, 0);
  std::vector<float> distance(n, 1e30f);
  std::vector<int> chosen;
  int next = std::min(n - 1, static_cast<int>(random.next() * n));
  while (static_cast<int>(chosen.size()) < std::min(count, n)) {
    chosen.push_back(next);
    parallel_for(
        n, [&](std::size_t i) { distance[i] = std::min(distance[i], (rows.row(i) - rows.row(next)).squaredNorm()); });
    double total = 0;
    for (float d : distance) total += d;
    if (!(total > 0)) break;
    double target = random.next() * total;
    next = n - 1;
    for (int i = 0; i < n; ++i)
      if ((target -= distance[i]) < 0) {
        next = i;
        break;
      }
    if (!(distance[next] > 0))
      next = static_cast<int>(std::max_element(distance.begin(), distance.end()) - distance.begin());
  }
  result.centers.resize(static_cast<Eigen::Index>(chosen.size()), rows.cols());
  for (std::size_t c = 0; c < chosen.size(); ++c) result.centers.row(c) = rows.row(chosen[c]);
  for (int iteration = 0; iteration <= iterations; ++iteration) {
    // Component by component over the centres, so that the loop runs along memory.
    const Eigen::MatrixXf columns = result.centers;
    parallel_chunks(n, 256, [&](std::size_t begin, std::size_t end) {
      Eigen::ArrayXf squared(columns.rows());
      for (std::size_t i = begin; i < end; ++i) {
        squared = (columns.col(0).array() - rows(i, 0)).square();
        for (Eigen::Index d = 1; d < rows.cols(); ++d) squared += (columns.col(d).array() - rows(i, d)).square();
        distance[i] = squared.minCoeff();
        const float* const first = squared.data();
        result.labels[i] = static_cast<std::int32_t>(std::find(first, first + squared.size(), distance[i]) - first);
      }
    });
    if (iteration == iterations) break;
    Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(result.centers.rows(), rows.cols());
    std::vector<int> members(result.centers.rows(), 0);
    for (int i = 0; i < n; ++i) sums.row(result.labels[i]) += rows.row(i).cast<double>(), ++members[result.labels[i]];
    for (Eigen::Index c = 0; c < sums.rows(); ++c)
      if (members[c] > 0) result.centers.row(c) = (sums.row(c) / members[c]).cast<float>();
  }
  const Eigen::RowVectorXd mean = rows.cast<double>().colwise().mean();
  double variance = 0, error = 0;
  for (int i = 0; i < n; ++i) variance += (rows.row(i).cast<double>() - mean).squaredNorm(), error += distance[i];
  result.error = variance > 0 ? error / variance : 0;
  return result;
}

}  // namespace shellgrid
