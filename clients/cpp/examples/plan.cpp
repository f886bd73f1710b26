// Plans grasps of a depth image and prints them.
//
//   graspd-plan [--server HOST:PORT] [--hand ID] [DEPTH.pgm FX FY CX CY]
//
// DEPTH.pgm is a binary 16-bit PGM in millimetres (ImageMagick: convert depth.png depth.pgm). Without one, a box on a
// table is made up. The server is $GRASPD_ADDRESS, or 127.0.0.1:50051.
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <string>

#include "graspd/client.hpp"

namespace {

graspd::v1::DepthFrame read(const std::string& path, const graspd::Intrinsics& lens) {
  std::ifstream file(path, std::ios::binary);
  std::string kind;
  int width = 0, height = 0, most = 0;
  if (!(file >> kind >> width >> height >> most) || kind != "P5" || most < 256 || most > 65535 || width < 1 || height < 1 ||
      width > 16384 || height > 16384) {
    throw std::invalid_argument(path + ": expected a binary 16-bit PGM");
  }
  file.get();  // One blank ends the header.
  std::vector<std::uint16_t> pixels;
  pixels.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height));
  for (int high, low; (high = file.get()) != EOF && (low = file.get()) != EOF;) {
    pixels.push_back(static_cast<std::uint16_t>(high << 8 | low));
  }
  return graspd::depth_frame(width, height, pixels, 0.001, lens);
}

}  // namespace

int main(int argc, char** argv) {
  graspd::Config config;
  if (const char* address = std::getenv("GRASPD_ADDRESS")) config.address = address;
  std::string hand = "leap";
  std::vector<std::string> rest;
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    if (argument == "--server" && i + 1 < argc) {
      config.address = argv[++i];
    } else if (argument == "--hand" && i + 1 < argc) {
      hand = argv[++i];
    } else {
      rest.push_back(argument);
    }
  }
  try {
    if (!rest.empty() && rest.size() != 5) throw std::invalid_argument("expected DEPTH.pgm FX FY CX CY, or nothing");
    const auto number = [&](std::size_t i) { return std::stod(rest[i]); };
    const auto frame =
        rest.empty() ? graspd::box_on_table() : read(rest[0], {number(1), number(2), number(3), number(4)});
    const graspd::Client client(config);
    const auto plan = client.plan(frame, hand);
    if (plan.grasps().empty()) {
      std::cout << "no grasp: " << plan.no_grasp().nearest_fix() << "\n";
      return 0;
    }
    std::cout << plan.grasps_size() << " grasps, best first (position and x y z w of " << plan.grasps(0).wrist_link()
              << " in " << plan.grasps(0).wrist_pose().frame_id() << "):\n";
    for (const auto& grasp : plan.grasps()) {
      const auto& pose = grasp.wrist_pose().pose();
      std::cout << grasp.score() << "  " << pose.position().x() << " " << pose.position().y() << " " << pose.position().z()
                << "  " << pose.orientation().x() << " " << pose.orientation().y() << " " << pose.orientation().z() << " "
                << pose.orientation().w() << "  " << grasp.contacts_size() << " contacts\n";
    }
    return 0;
  } catch (const graspd::Error& error) {
    std::cerr << (error.reason.empty() ? "error" : error.reason) << ": " << error.what() << "\n";
    for (const auto& v : error.violations) std::cerr << "  " << v.field << ": " << v.description << "\n";
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
  }
  return 1;
}
