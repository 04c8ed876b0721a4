// SPDX-License-Identifier: AGPL-3.0-or-later
#pragma once
#include <atomic>
#include <cstddef>
#include <memory>
#include <mutex>
#include <vector>

namespace shellgrid {

// Values by number, each made where it is first asked for, and kept where it is. Threads may share it.
template <class T>
class LazyList {
 public:
  // Anew, with none of them known. Not while others ask.
  void resize(std::size_t count) {
    known_ = std::vector<std::atomic<const T*>>(count);
    owned_.clear();
  }

  // `make` is called without a lock held: of threads that make the same, the first one's is kept.
  template <class Make>
  const T& get(int index, const Make& make) const {
    if (const T* found = known_[index].load(std::memory_order_acquire)) return *found;
    std::unique_ptr<const T> made(new T(make()));
    const std::lock_guard lock(mutex_);
    if (const T* found = known_[index].load(std::memory_order_acquire)) return *found;
    owned_.push_back(std::move(made));
    known_[index].store(owned_.back().get(), std::memory_order_release);
    return *owned_.back();
  }
  std::size_t size() const { return known_.size(); }
  // How many are known. Not while others ask.
  std::size_t made() const { return owned_.size(); }

 private:
  mutable std::vector<std::atomic<const T*>> known_;
  mutable std::vector<std::unique_ptr<const T>> owned_;
  mutable std::mutex mutex_;
};

}  // namespace shellgrid
