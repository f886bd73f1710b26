// The C++ client against a real server at $GRASPD_ADDRESS. Its argument is a file to leave its scene in, as a PGM.
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>

#include "graspd/client.hpp"

namespace {

int passed = 0;
int failed = 0;

void check(bool holds, const char* what, int line) {
  if (holds) {
    ++passed;
    return;
  }
  ++failed;
  std::cerr << "tests/client_test.cpp:" << line << ": " << what << "\n";
}

#define CHECK(holds) check((holds), #holds, __LINE__)

template <typename Body>
graspd::Error refused(const Body& body) {
  try {
    body();
  } catch (const graspd::Error& error) {
    return error;
  }
  return graspd::Error(grpc::StatusCode::OK, "NOT_REFUSED", "");
}

graspd::v1::PlanGraspsRequest question(const std::string& hand, int batch, int iterations) {
  graspd::v1::PlanGraspsRequest request;
  request.set_hand("hands/" + hand);
  *request.add_frames() = graspd::box_on_table();
  auto* options = request.mutable_options();
  options->set_seed(1);
  options->set_batch_size(batch);
  options->mutable_scheme()->set_iteration_count(iterations);
  options->mutable_scheme()->set_penetration_iteration_count(iterations / 4);
  return request;
}

void plans(const graspd::Client& client) {
  CHECK(!client.server().version().empty());
  const auto hands = client.hands();
  CHECK(hands.size() >= 11);

  const auto plan = client.plan(graspd::box_on_table(), "robotiq-2f85");
  CHECK(plan.grasps_size() > 0);
  for (const auto& grasp : plan.grasps()) {
    CHECK(grasp.wrist_pose().frame_id() == "camera");
    for (const auto& contact : grasp.contacts()) {
      // On the box: 4 x 7 cm, its top 0.42 m and the table 0.50 m below the camera; a voxel and a half of room.
      const auto& p = contact.point();
      CHECK(std::abs(p.x()) < 0.0275 && std::abs(p.y()) < 0.0425 && p.z() > 0.4125 && p.z() < 0.5075);
    }
  }

  std::vector<std::string> told;
  const auto last = client.stream(question("robotiq-2f85", 48, 200), [&](const graspd::v1::StreamGraspsResponse& event) {
    told.push_back(event.has_accepted() ? "accepted" : event.has_finished() ? "finished" : "improved");
    return true;
  });
  CHECK(told.size() >= 2 && told.front() == "accepted" && told.back() == "finished");
  CHECK(last.grasps_size() > 0);

  graspd::v1::PlanMultiHandRequest several;
  *several.add_frames() = graspd::box_on_table();
  for (const char* hand : {"leap", "panda"}) {
    auto* task = several.add_tasks();
    task->set_task_id(hand);
    task->set_hand(std::string("hands/") + hand);
  }
  const auto results = client.plan_hands(several);
  CHECK(results.size() == 2);
  for (const auto& result : results) CHECK(result.has_response() && result.response().grasps_size() > 0);
}

void refuses(const graspd::Client& client) {
  auto blind = graspd::box_on_table();
  blind.mutable_intrinsics()->set_fx_px(0);
  auto error = refused([&] { client.plan(blind, "leap"); });
  CHECK(error.code == grpc::StatusCode::INVALID_ARGUMENT && error.reason == "INVALID_INTRINSICS");
  CHECK(error.violations.size() == 1 && error.violations[0].field == "frames[0].intrinsics.fx_px");
  error = refused([&] { client.plan(graspd::box_on_table(), "no-such-hand"); });
  CHECK(error.code == grpc::StatusCode::NOT_FOUND && error.reason == "HAND_NOT_FOUND");
  bool thrown = false;
  try {
    graspd::depth_frame(4, 4, std::vector<float>(15), {1, 1, 1, 1});
  } catch (const std::invalid_argument&) {
    thrown = true;
  }
  CHECK(thrown);
}

void keeps_time(const graspd::Config& config) {
  graspd::Config hurried = config;
  hurried.timeout = std::chrono::milliseconds(6000);
  const graspd::Client client(hurried);
  const auto began = std::chrono::steady_clock::now();
  const auto plan = client.plan(question("leap", 1024, 10000));
  CHECK(plan.stats().budget_exhausted());
  CHECK(std::chrono::steady_clock::now() - began < std::chrono::seconds(9));
  hurried.timeout = std::chrono::milliseconds(3);
  const auto error = refused([&] { graspd::Client(hurried).plan(question("leap", 4096, 10000)); });
  // A server that knows how long such calls take refuses at once what cannot be done in time.
  const bool refused_at_once = error.code == grpc::StatusCode::RESOURCE_EXHAUSTED && error.reason == "CANNOT_FINISH";
  const bool too_late = error.code == grpc::StatusCode::DEADLINE_EXCEEDED && error.reason == "DEADLINE_EXCEEDED";
  CHECK(refused_at_once || too_late);

  // A stream that its reader leaves ends the work: the next answer comes soon.
  graspd::Config patient = config;
  patient.timeout = std::chrono::seconds(60);
  const graspd::Client other(patient);
  other.stream(question("leap", 4096, 10000), [](const graspd::v1::StreamGraspsResponse&) { return false; });
  CHECK(other.plan(graspd::box_on_table(), "panda").grasps_size() > 0);
}

void knows_the_rules() {
  const graspd::RetryPolicy policy;
  graspd::Error gone(grpc::StatusCode::UNAVAILABLE, "", "gone");
  CHECK(policy.wait(gone, 1, 1.0) == std::chrono::milliseconds(50));
  CHECK(policy.wait(gone, 3, 1.0) == std::chrono::milliseconds(200));
  CHECK(!policy.wait(gone, 4, 1.0));
  graspd::Error full(grpc::StatusCode::RESOURCE_EXHAUSTED, "QUEUE_FULL", "full");
  CHECK(!policy.wait(full, 1, 0.0));
  full.retry_after = std::chrono::milliseconds(40);
  CHECK(policy.wait(full, 1, 0.0) == std::chrono::milliseconds(40));
  for (int code = 0; code < 17; ++code) {
    const graspd::Error error(static_cast<grpc::StatusCode>(code), "", "");
    CHECK(policy.wait(error, 1, 0.5).has_value() == (code == grpc::StatusCode::UNAVAILABLE));
  }

  struct Pair {
    const char *client, *server;
    bool fits;
  };
  for (const Pair& pair : {Pair{"0.1.0", "0.1.9", true}, Pair{"0.2.0", "0.1.0", false}, Pair{"0.1.0", "0.2.0", false},
                           Pair{"1.2.0", "1.3.0", true}, Pair{"1.3.0", "1.2.0", false}, Pair{"0.1.0", "", false}}) {
    const auto error = refused([&] { graspd::check_version(pair.client, pair.server); });
    CHECK((error.reason == "NOT_REFUSED") == pair.fits);
  }

  graspd::Config nobody;
  nobody.address = "127.0.0.1:1";
  nobody.connect_timeout = std::chrono::milliseconds(300);
  const auto error = refused([&] { graspd::Client client(nobody); });
  CHECK(error.reason == "CONNECT" && error.code == grpc::StatusCode::UNAVAILABLE);
}

void leave_scene(const std::string& path) {
  const auto frame = graspd::box_on_table();
  std::ofstream file(path, std::ios::binary);
  file << "P5\n" << frame.width_px() << " " << frame.height_px() << "\n65535\n";
  // A PGM has its high bytes first.
  for (std::size_t i = 0; i + 1 < frame.data().size(); i += 2) file << frame.data()[i + 1] << frame.data()[i];
}

}  // namespace

int main(int argc, char** argv) {
  graspd::Config config;
  config.timeout = std::chrono::seconds(60);
  if (const char* address = std::getenv("GRASPD_ADDRESS")) config.address = address;
  try {
    const graspd::Client client(config);
    plans(client);
    refuses(client);
    keeps_time(config);
    knows_the_rules();
    if (argc > 1) leave_scene(argv[1]);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    ++failed;
  }
  std::cout << passed << " checks passed, " << failed << " failed\n";
  return failed == 0 ? 0 : 1;
}
