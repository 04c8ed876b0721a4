// SPDX-License-Identifier: AGPL-3.0-or-later
// Loops on TBB whose results do not depend on the number of threads.
#pragma once
#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/parallel_for.h>
#include <oneapi/tbb/parallel_invoke.h>

#include <algorithm>
#include <cstddef>
#include <exception>
#include <vector>

namespace shellgrid {

// Calls body(i) for i in [0, count), in any order, on all threads. Bodies must write to places of
// their own only: then the result is the same at any thread count.
template <class Body>
void parallel_for(std::size_t count, const Body& body, std::size_t grain = 256) {
  oneapi::tbb::parallel_for(oneapi::tbb::blocked_range<std::size_t>(0, count, grain),
                            [&](const oneapi::tbb::blocked_range<std::size_t>& range) {
                              for (std::size_t i = range.begin(); i != range.end(); ++i) body(i);
                            });
}

// Calls body(begin, end) for consecutive ranges of `chunk` items. The partition depends on `count`
// and `chunk` alone.
template <class Body>
void parallel_chunks(std::size_t count, std::size_t chunk, const Body& body) {
  const std::size_t chunks = (count + chunk - 1) / chunk;
  oneapi::tbb::parallel_for(std::size_t{0}, chunks,
                            [&](std::size_t c) { body(c * chunk, std::min(count, (c + 1) * chunk)); });
}

// Calls all of them, at the same time where there are threads. Throws: what the first one of them that throws throws.
template <class... Task>
void together(const Task&... tasks) {
  std::exception_ptr thrown[sizeof...(Task)];
  std::size_t count = 0;
  const auto held = [](const auto& task, std::exception_ptr& to) {
    return [&] {
      try {
        task();
      } catch (...) {
        to = std::current_exception();
      }
    };
  };
  oneapi::tbb::parallel_invoke(held(tasks, thrown[count++])...);
  for (const std::exception_ptr& one : thrown)
    if (one) std::rethrow_exception(one);
}

// Sum over i of term(i), added in an order that depends on `count` alone: the same bits at any
// thread count.
template <class Value, class Term>
Value parallel_sum(std::size_t count, Value zero, const Term& term, std::size_t chunk = 4096) {
  const std::size_t chunks = (count + chunk - 1) / chunk;
  std::vector<Value> partial(chunks, zero);
  oneapi::tbb::parallel_for(std::size_t{0}, chunks, [&](std::size_t c) {
    Value sum = zero;
    const std::size_t end = std::min(count, (c + 1) * chunk);
    for (std::size_t i = c * chunk; i < end; ++i) sum = sum + term(i);
    partial[c] = sum;
  });
  Value total = zero;
  for (const Value& sum : partial) total = total + sum;
  return total;
}

}  // namespace shellgrid
