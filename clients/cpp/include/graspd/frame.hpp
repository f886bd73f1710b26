// Depth frames from pixels.
#pragma once

#include <cstdint>
#include <vector>

#include "graspd/v1/frame.pb.h"

namespace graspd {

/// A pinhole lens, pixels.
struct Intrinsics {
  double fx, fy, cx, cy;
};

/// A frame of 16-bit pixels, row major; 0 is no return. `scale_m` metres for one unit: 0.001 for millimetres. Set
/// `camera_pose` of the result where the camera's pose is known.
/// Throws std::invalid_argument when the pixels are not width × height.
v1::DepthFrame depth_frame(int width, int height, const std::vector<std::uint16_t>& pixels, double scale_m,
                           const Intrinsics& lens);

/// A frame of metres, row major; NaN or 0 is no return.
/// Throws std::invalid_argument when the pixels are not width × height.
v1::DepthFrame depth_frame(int width, int height, const std::vector<float>& metres, const Intrinsics& lens);

/// A box of 4 × 7 × 8 cm on a table, half a metre below a camera that looks straight down: to try things with.
v1::DepthFrame box_on_table();

}  // namespace graspd
