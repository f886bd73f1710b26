// What can go wrong: one exception, with what the server says about it.
#pragma once

#include <chrono>
#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include <grpcpp/support/status.h>

namespace graspd {

/// A field of the request that was refused.
struct Violation {
  /// Path of the field, for example `frames[0].intrinsics.fx_px`.
  std::string field;
  /// What was found and what was expected.
  std::string description;
};

/// A call that ended with an error.
class Error : public std::runtime_error {
 public:
  /// From the status of a call, with the details that it carries.
  explicit Error(const grpc::Status& status);
  /// An error of this side.
  Error(grpc::StatusCode code, std::string reason, const std::string& message);

  /// The gRPC code.
  grpc::StatusCode code;
  /// Machine readable, for example `HAND_NOT_FOUND`; empty where it does not come from a graspd server.
  std::string reason;
  /// The refused fields, where the reason is one of a field.
  std::vector<Violation> violations;
  /// When the server asks to come back.
  std::optional<std::chrono::nanoseconds> retry_after;
  /// Further figures, for example `limit_bytes`.
  std::map<std::string, std::string> metadata;
};

}  // namespace graspd
