// The client: one connection, one deadline for each call.
#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include <grpcpp/channel.h>
#include <grpcpp/security/credentials.h>

#include "graspd/error.hpp"
#include "graspd/frame.hpp"
#include "graspd/retry.hpp"
#include "graspd/v1/hand_service.grpc.pb.h"
#include "graspd/v1/info_service.grpc.pb.h"
#include "graspd/v1/planner_service.grpc.pb.h"

namespace graspd {

/// How a client connects and how long it waits.
struct Config {
  /// `host:port`.
  std::string address = "127.0.0.1:50051";
  /// Deadline of every call, all its attempts together.
  std::chrono::milliseconds timeout{10000};
  /// How long to wait for a server that is starting.
  std::chrono::milliseconds connect_timeout{5000};
  /// What is repeated.
  RetryPolicy retry{};
  /// How the connection is secured; null means not at all.
  std::shared_ptr<grpc::ChannelCredentials> credentials;
};

/// What a stream tells: true to go on, false to end the work.
using OnEvent = std::function<bool(const v1::StreamGraspsResponse&)>;

/// A connection to a server. Thread-safe. Every method throws `Error`.
class Client {
 public:
  /// Connects; waits for a server that is starting, and refuses one that does not fit this client.
  explicit Client(Config config = {});

  /// What the server said about itself when the connection was made.
  const v1::GetServerInfoResponse& server() const { return server_; }

  /// Plans grasps of one hand. No grasp is no error: `no_grasp` of the answer says why.
  v1::PlanGraspsResponse plan(const v1::PlanGraspsRequest& request) const;
  /// The same for one frame and one hand, for example "leap".
  v1::PlanGraspsResponse plan(const v1::DepthFrame& frame, const std::string& hand) const;

  /// Plans grasps of one hand and tells each better set as it is found; returns the last. The work ends when `on_event`
  /// returns false: then the answer is what was told last.
  v1::PlanGraspsResponse stream(const v1::PlanGraspsRequest& request, const OnEvent& on_event) const;

  /// Plans grasps of several hands in one scene: one result for each task, as they are ready.
  std::vector<v1::HandTaskResult> plan_hands(const v1::PlanMultiHandRequest& request) const;

  /// All hands of the server, in the order of their names.
  std::vector<v1::Hand> hands() const;

 private:
  void call(const std::function<grpc::Status(grpc::ClientContext&)>& attempt) const;

  Config config_;
  std::shared_ptr<grpc::Channel> channel_;
  std::unique_ptr<v1::PlannerService::Stub> planner_;
  std::unique_ptr<v1::HandService::Stub> hands_;
  std::unique_ptr<v1::InfoService::Stub> info_;
  v1::GetServerInfoResponse server_;
};

/// Throws `Error` (FAILED_PRECONDITION, VERSION_MISMATCH) unless a client of version `client` fits a server of version
/// `server`: a server ignores fields that it does not know, so a client must not be newer, and while the major version is
/// 0 the minor versions are equal.
void check_version(const std::string& client, const std::string& server);

}  // namespace graspd
