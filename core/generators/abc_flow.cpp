#include "core/generators/abc_flow.hpp"

#include <cmath>
#include <numbers>

namespace gpuphys {

AbcFlow AbcFlow::periodic(double amplitude, int periods, const std::array<double, 3>& n) {
  AbcFlow flow{amplitude, {}};
  for (std::size_t d = 0; d < 3; ++d) flow.k[d] = 2 * std::numbers::pi * periods / n[d];
  return flow;
}

std::array<double, 3> AbcFlow::at(double x, double y, double z) const {
  const double ax = k[0] * x, ay = k[1] * y, az = k[2] * z;
  return {amplitude * (std::sin(az) + std::cos(ay)), amplitude * (std::sin(ax) + std::cos(az)),
          amplitude * (std::sin(ay) + std::cos(ax))};
}

}  // namespace gpuphys
