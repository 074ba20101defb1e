// The hard cases that g2p_pic_flip and g2p_apic share: the particles of mac_transfer_sets.hpp and some more,
// with values on the faces.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "cases/particle_grid/mac_transfer_sets.hpp"
#include "core/contract/arrays.hpp"

namespace gpuphys::mac_particles {

struct FaceStress {
  Placement particles;
  /// Value of sample (i, j, k) of component c, of field 0 or 1.
  std::function<double(int field, int c, std::int64_t i, std::int64_t j, std::int64_t k)> u;
  /// An axis has one cell: nothing but rounding is left of derivatives along it.
  bool flat = false;
};
const std::vector<FaceStress>& face_stresses();

/// Fills a component's samples.
void fill_samples(const FaceStress&, int field, int c, HostArray& u);

/// Of "linear": u_c = kSlope[c] . g + kStart[c], g the place of the sample in cells, dyadic.
inline constexpr std::array<Vec3, 3> kSlope{{{0.25, -0.5, 1.0}, {2.0, 0.125, -0.25}, {-1.0, 0.75, 0.5}}};
inline constexpr Vec3 kStart{1.0, -2.0, 0.5};
double linear_at(int c, const Vec3& g);
inline constexpr Vec3 kConstantFaces{1000.0, -3.0, 0.1};  ///< of "constant"

}  // namespace gpuphys::mac_particles
