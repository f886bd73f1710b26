// Calls: deadlines, retries, connecting.
#include "graspd/client.hpp"

#include <random>
#include <thread>

#include <grpcpp/client_context.h>
#include <grpcpp/create_channel.h>
#include <grpcpp/support/channel_arguments.h>

namespace graspd {

namespace {

using Clock = std::chrono::system_clock;

constexpr int kLargestAnswer = 64 << 20;
constexpr std::chrono::milliseconds kConnectPause{50};

double jitter() {
  thread_local std::mt19937_64 random{std::random_device{}()};
  return std::uniform_real_distribution<double>(0.0, 1.0)(random);
}

std::shared_ptr<grpc::Channel> channel(const Config& config) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(kLargestAnswer);
  arguments.SetMaxSendMessageSize(-1);
  // What is repeated, and when, is for the retry policy alone.
  arguments.SetInt(GRPC_ARG_ENABLE_RETRIES, 0);
  // A server that comes back is found again within the back-off of the retry policy.
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, 50);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, 1000);
  // Despite its name this is how long one attempt to connect may take, with TLS.
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, 1000);
  // Planners stand beside robots; a proxy of the environment does not lead to them.
  arguments.SetInt(GRPC_ARG_ENABLE_HTTP_PROXY, 0);
  const auto credentials = config.credentials ? config.credentials : grpc::InsecureChannelCredentials();
  return grpc::CreateCustomChannel(config.address, credentials, arguments);
}

Error protocol(const std::string& what) { return Error(grpc::StatusCode::INTERNAL, "PROTOCOL", what); }

}  // namespace

Client::Client(Config config)
    : config_(std::move(config)),
      channel_(channel(config_)),
      planner_(v1::PlannerService::NewStub(channel_)),
      hands_(v1::HandService::NewStub(channel_)),
      info_(v1::InfoService::NewStub(channel_)) {
  const auto deadline = Clock::now() + config_.connect_timeout;
  for (;;) {
    grpc::ClientContext context;
    context.set_deadline(deadline);
    const grpc::Status status = info_->GetServerInfo(&context, v1::GetServerInfoRequest(), &server_);
    if (status.ok()) break;
    if (status.error_code() == grpc::StatusCode::UNIMPLEMENTED) check_version(GRASPD_VERSION, "");
    if (status.error_code() != grpc::StatusCode::UNAVAILABLE || Clock::now() + kConnectPause >= deadline) {
      throw Error(status.error_code(), "CONNECT", "cannot connect to " + config_.address + ": " + status.error_message());
    }
    std::this_thread::sleep_for(kConnectPause);
  }
  check_version(GRASPD_VERSION, server_.version());
}

void Client::call(const std::function<grpc::Status(grpc::ClientContext&)>& attempt) const {
  const auto deadline = Clock::now() + config_.timeout;
  for (int made = 1;; ++made) {
    grpc::ClientContext context;
    context.set_deadline(deadline);
    const grpc::Status status = attempt(context);
    if (status.ok()) return;
    const Error error(status);
    const auto wait = config_.retry.wait(error, made, jitter());
    if (!wait || Clock::now() + *wait >= deadline) throw error;
    std::this_thread::sleep_for(*wait);
  }
}

v1::PlanGraspsResponse Client::plan(const v1::PlanGraspsRequest& request) const {
  v1::PlanGraspsResponse answer;
  call([&](grpc::ClientContext& context) { return planner_->PlanGrasps(&context, request, &answer); });
  return answer;
}

v1::PlanGraspsResponse Client::plan(const v1::DepthFrame& frame, const std::string& hand) const {
  v1::PlanGraspsRequest request;
  request.set_hand("hands/" + hand);
  *request.add_frames() = frame;
  return plan(request);
}

v1::PlanGraspsResponse Client::stream(const v1::PlanGraspsRequest& request, const OnEvent& on_event) const {
  v1::StreamGraspsRequest wrapped;
  *wrapped.mutable_plan() = request;
  v1::PlanGraspsResponse last;
  call([&](grpc::ClientContext& context) {
    const auto messages = planner_->StreamGrasps(&context, wrapped);
    bool begun = false, finished = false, ended = false;
    v1::StreamGraspsResponse event;
    while (messages->Read(&event)) {
      begun = true;
      if (event.has_improved()) last = event.improved();
      if (event.has_finished()) last = event.finished();
      finished = finished || event.has_finished();
      if (!on_event(event)) {
        ended = true;
        context.TryCancel();
        break;
      }
    }
    const grpc::Status status = messages->Finish();
    if (ended) return grpc::Status::OK;
    // A stream that has begun is not repeated.
    if (begun && !status.ok()) throw Error(status);
    if (status.ok() && !finished) throw protocol("a stream that ended without its last message");
    return status;
  });
  return last;
}

std::vector<v1::HandTaskResult> Client::plan_hands(const v1::PlanMultiHandRequest& request) const {
  std::vector<v1::HandTaskResult> results;
  call([&](grpc::ClientContext& context) {
    const auto messages = planner_->PlanMultiHand(&context, request);
    v1::PlanMultiHandResponse message;
    while (messages->Read(&message)) {
      if (message.has_result()) results.push_back(message.result());
    }
    const grpc::Status status = messages->Finish();
    if (!results.empty() && !status.ok()) throw Error(status);
    return status;
  });
  return results;
}

std::vector<v1::Hand> Client::hands() const {
  std::vector<v1::Hand> found;
  v1::ListHandsRequest request;
  do {
    v1::ListHandsResponse page;
    call([&](grpc::ClientContext& context) { return hands_->ListHands(&context, request, &page); });
    found.insert(found.end(), page.hands().begin(), page.hands().end());
    request.set_page_token(page.next_page_token());
  } while (!request.page_token().empty());
  return found;
}

}  // namespace graspd
