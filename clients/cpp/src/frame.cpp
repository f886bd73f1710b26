// Depth frames from pixels.
#include "graspd/frame.hpp"

#include <cmath>
#include <cstring>
#include <stdexcept>
#include <string>

namespace graspd {

namespace {

template <typename Pixel>
v1::DepthFrame frame(int width, int height, const std::vector<Pixel>& pixels, const Intrinsics& lens) {
  if (width < 1 || height < 1 || pixels.size() != static_cast<std::size_t>(width) * static_cast<std::size_t>(height)) {
    throw std::invalid_argument("depth: found " + std::to_string(pixels.size()) + " pixels, expected " +
                                std::to_string(width) + " x " + std::to_string(height));
  }
  static_assert(sizeof(Pixel) == 2 || sizeof(Pixel) == 4, "pixels are 16-bit numbers or floats");
  v1::DepthFrame message;
  message.set_width_px(width);
  message.set_height_px(height);
  // The wire is little-endian, as every processor that a distribution packages gRPC for here.
  std::string bytes(pixels.size() * sizeof(Pixel), '\0');
  std::memcpy(&bytes[0], pixels.data(), bytes.size());
  message.set_data(std::move(bytes));
  auto* intrinsics = message.mutable_intrinsics();
  intrinsics->set_fx_px(lens.fx);
  intrinsics->set_fy_px(lens.fy);
  intrinsics->set_cx_px(lens.cx);
  intrinsics->set_cy_px(lens.cy);
  return message;
}

}  // namespace

v1::DepthFrame depth_frame(int width, int height, const std::vector<std::uint16_t>& pixels, double scale_m,
                           const Intrinsics& lens) {
  v1::DepthFrame message = frame(width, height, pixels, lens);
  message.set_encoding(v1::DEPTH_ENCODING_RAW_U16);
  message.set_depth_scale_m(scale_m);
  return message;
}

v1::DepthFrame depth_frame(int width, int height, const std::vector<float>& metres, const Intrinsics& lens) {
  v1::DepthFrame message = frame(width, height, metres, lens);
  message.set_encoding(v1::DEPTH_ENCODING_RAW_F32);
  return message;
}

v1::DepthFrame box_on_table() {
  constexpr int width = 320, height = 240;
  constexpr double focal = 300.0, table = 0.50, top = 0.42, half_x = 0.02, half_y = 0.035;
  const Intrinsics lens{focal, focal, (width - 1) / 2.0, (height - 1) / 2.0};
  std::vector<std::uint16_t> millimetres;
  millimetres.reserve(static_cast<std::size_t>(width) * height);
  for (int row = 0; row < height; ++row) {
    for (int column = 0; column < width; ++column) {
      const double x = (column - lens.cx) / focal * top, y = (row - lens.cy) / focal * top;
      const bool box = std::abs(x) < half_x && std::abs(y) < half_y;
      millimetres.push_back(static_cast<std::uint16_t>(std::lround((box ? top : table) * 1000)));
    }
  }
  return depth_frame(width, height, millimetres, 0.001, lens);
}

}  // namespace graspd
