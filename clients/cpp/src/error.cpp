// Errors from the status of a call.
#include "graspd/error.hpp"

#include "error_details.pb.h"

namespace graspd {

namespace {

std::string said(const grpc::Status& status) {
  return status.error_message().empty() ? "code " + std::to_string(status.error_code()) : status.error_message();
}

}  // namespace

Error::Error(grpc::StatusCode code_, std::string reason_, const std::string& message)
    : std::runtime_error(message), code(code_), reason(std::move(reason_)) {}

Error::Error(const grpc::Status& status) : std::runtime_error(said(status)), code(status.error_code()) {
  google::rpc::Status packed;
  // Details of something between client and server may be of any kind; code and message are all there is then.
  if (packed.ParseFromString(status.error_details())) {
    for (const auto& detail : packed.details()) {
      google::rpc::ErrorInfo info;
      google::rpc::BadRequest bad;
      google::rpc::RetryInfo retry;
      if (detail.UnpackTo(&info)) {
        reason = info.reason();
        metadata.insert(info.metadata().begin(), info.metadata().end());
      } else if (detail.UnpackTo(&bad)) {
        for (const auto& v : bad.field_violations()) violations.push_back({v.field(), v.description()});
      } else if (detail.UnpackTo(&retry)) {
        const auto& delay = retry.retry_delay();
        retry_after = std::chrono::seconds(delay.seconds()) + std::chrono::nanoseconds(delay.nanos());
      }
    }
  }
  // The timer on this side: the server's own answer has a reason.
  if (code == grpc::StatusCode::DEADLINE_EXCEEDED && reason.empty()) reason = "DEADLINE_EXCEEDED";
}

}  // namespace graspd
