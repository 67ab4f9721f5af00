// Many runs on threads.
#pragma once

#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>

#include "run/watch.hpp"

namespace lieeuler {

// Calls member(k, stopped) for every k below `count` on `threads` threads. Members share nothing, so results do not
// depend on the threads. The calling thread polls `interrupted` and passes an interruption on by `stopped`. Returns
// whether the run was interrupted; an exception of a member ends all members and is thrown again here.
template <class Member>
bool on_threads(size_t count, int threads, const Interrupted& interrupted, const Member& member) {
  constexpr std::chrono::milliseconds kPeriod{50};
  std::atomic<size_t> next{0};
  std::atomic<bool> stop{false};
  std::exception_ptr failure;
  std::mutex guard;
  std::condition_variable ended;
  int working = threads;
  const Interrupted stopped = [&] { return stop.load(); };
  auto work = [&] {
    std::exception_ptr mine;
    try {
      for (size_t k; !stop && (k = next++) < count;) member(k, stopped);
    } catch (...) {
      mine = std::current_exception();
      stop = true;
    }
    const std::lock_guard lock(guard);
    if (mine && !failure) failure = mine;
    if (--working == 0) ended.notify_one();
  };
  std::vector<std::thread> crew;
  for (int k = 0; k < threads; ++k) crew.emplace_back(work);
  bool asked_to = false;
  try {
    std::unique_lock lock(guard);
    while (!ended.wait_for(lock, kPeriod, [&] { return working == 0; })) {
      lock.unlock();
      if (interrupted()) stop = asked_to = true;
      lock.lock();
    }
  } catch (...) {  // thrown by `interrupted`
    stop = true;
    for (std::thread& thread : crew) thread.join();
    throw;
  }
  for (std::thread& thread : crew) thread.join();
  if (failure) std::rethrow_exception(failure);
  return asked_to;
}

}  // namespace lieeuler
