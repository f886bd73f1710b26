// When a call is tried again.
#include "graspd/retry.hpp"

#include <algorithm>
#include <cmath>

namespace graspd {

std::optional<std::chrono::nanoseconds> RetryPolicy::wait(const Error& error, int attempt, double jitter) const {
  using std::chrono::duration_cast;
  using std::chrono::nanoseconds;
  if (attempt >= attempts) return std::nullopt;
  if (error.code == grpc::StatusCode::RESOURCE_EXHAUSTED && error.retry_after) {
    // Everybody who was refused comes back: a little later each, not all at once.
    return duration_cast<nanoseconds>(*error.retry_after * (1.0 + 0.5 * jitter));
  }
  if (error.code == grpc::StatusCode::UNAVAILABLE) {
    const double doubled = static_cast<double>(first_backoff.count()) * std::exp2(std::min(attempt - 1, 16));
    const double milliseconds = std::min(doubled, static_cast<double>(longest_backoff.count())) * (0.5 + 0.5 * jitter);
    const auto backoff = duration_cast<nanoseconds>(std::chrono::duration<double, std::milli>(milliseconds));
    return std::max(backoff, error.retry_after.value_or(nanoseconds(0)));
  }
  return std::nullopt;
}

}  // namespace graspd
