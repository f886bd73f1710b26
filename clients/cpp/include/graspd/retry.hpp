// When a call is tried again, and after how long.
#pragma once

#include <chrono>
#include <optional>

#include "graspd/error.hpp"

namespace graspd {

/// What is repeated: UNAVAILABLE after an exponential back-off with jitter, and RESOURCE_EXHAUSTED where the server says
/// when to come back; everything within the call's one deadline.
struct RetryPolicy {
  /// Attempts in all; 1 never repeats.
  int attempts = 4;
  /// First back-off; each further one is twice as long.
  std::chrono::milliseconds first_backoff{50};
  /// Longest back-off.
  std::chrono::milliseconds longest_backoff{1000};

  /// How long to wait after attempt `attempt` (the first is 1) failed, or nothing to give up. `jitter` is 0 to 1.
  std::optional<std::chrono::nanoseconds> wait(const Error& error, int attempt, double jitter) const;
};

}  // namespace graspd
