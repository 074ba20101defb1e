// Advection on a MAC grid whose closed faces stay at rest: one semi-Lagrangian step, and one MacCormack step
// of any field along any velocity. Marches, traces and interpolation are those of the advection tasks
// (references/grid_lattice/mac_advection.cuh); what is added is the mask at every store.
#pragma once

#include "core/contract/module.hpp"
#include "references/common/device_buffer.cuh"
#include "references/grid_lattice/mac_advection.cuh"

namespace gpuphys::mac {

using ClosedMarch = TiledMarch<4>;  // another tile under GPUPHYS_OTHER_BLOCKS

/// Which faces are open: w > 0, and not on the outside of the box.
struct OpenFaces {
  const float* __restrict__ w[3];
  int n[3];  ///< cells

  template <class Face>
  __device__ __forceinline__ bool operator()(const Face& face, int at) const {
    constexpr int c = Face::component;
    const int own = c == 0 ? face.i : c == 1 ? face.j : face.k;
    return own > 0 && own < n[c] && __ldg(w[c] + at) > 0.0f;
  }
};

/// Every component carried along by the velocity of the march.
struct ClosedSemiLagrangian {
  MidpointTrace back;
  OpenFaces open;
  float* __restrict__ u[3];

  template <class Face>
  __device__ __forceinline__ float update(const Face& face) const {
    return face.own(back.departure(face)).value();
  }
  template <class Face>
  __device__ __forceinline__ void store(const Face& face, float value) const {
    const int at = face.offset();
    u[Face::component][at] = open(face, at) ? value : 0.0f;
  }
};

/// First march of a MacCormack step: `carried` along the velocity of the march, and the bounds of its
/// correction.
struct ClosedPredictor {
  MidpointTrace back;
  OpenFaces open;
  const float* __restrict__ carried[3];
  float* __restrict__ predicted[3];
  float2* __restrict__ bounds[3];

  struct Prediction {
    float value, low, high;
  };
  template <class Face>
  __device__ __forceinline__ Prediction update(const Face& face) const {
    const Stencil s = face.own_of(carried[Face::component] + face.offset(), back.departure(face));
    return {s.value(), s.smallest(), s.largest()};
  }
  template <class Face>
  __device__ __forceinline__ void store(const Face& face, const Prediction& p) const {
    const int at = face.offset();
    predicted[Face::component][at] = open(face, at) ? p.value : 0.0f;
    bounds[Face::component][at] = {p.low, p.high};
  }
};

/// Second march: the prediction carried back; half of what that misses of `carried` corrects it.
struct ClosedCorrector {
  MidpointTrace forward;
  OpenFaces open;
  const float* __restrict__ carried[3];
  const float* __restrict__ predicted[3];
  const float2* __restrict__ bounds[3];
  float* __restrict__ u[3];

  template <class Face>
  __device__ __forceinline__ float update(const Face& face) const {
    constexpr int c = Face::component;
    const int at = face.offset();
    const float returned = face.own_of(predicted[c] + at, forward.departure(face)).value();
    const float2 limits = __ldg(bounds[c] + at);
    const float corrected = __ldg(predicted[c] + at) + 0.5f * (__ldg(carried[c] + at) - returned);
    return fminf(fmaxf(corrected, limits.x), limits.y);
  }
  template <class Face>
  __device__ __forceinline__ void store(const Face& face, float value) const {
    const int at = face.offset();
    u[Face::component][at] = open(face, at) ? value : 0.0f;
  }
};

/// A velocity of three arrays, as kernels take them.
struct FaceArrays {
  float* u[3];
};

/// Memory for a velocity of this grid.
class FaceBuffers {
 public:
  void allocate(const View<const float, 3>& ux, const View<const float, 3>& uy,
                const View<const float, 3>& uz) {
    const std::int64_t size[3] = {ux.size(), uy.size(), uz.size()};
    for (int c = 0; c < 3; ++c) u_[c] = DeviceBuffer<float>(static_cast<std::size_t>(size[c]));
  }
  FaceArrays arrays() const { return {{u_[0].get(), u_[1].get(), u_[2].get()}}; }

 private:
  DeviceBuffer<float> u_[3];
};

/// MacCormack steps with the memory that they need.
class ClosedMacCormack {
 public:
  void allocate(const View<const float, 3>& ux, const View<const float, 3>& uy,
                const View<const float, 3>& uz) {
    predicted_.allocate(ux, uy, uz);
    const std::int64_t size[3] = {ux.size(), uy.size(), uz.size()};
    for (int c = 0; c < 3; ++c) bounds_[c] = DeviceBuffer<float2>(static_cast<std::size_t>(size[c]));
  }

  /// `carried` along `by` (the velocity of the march) for a step of `step` cells per unit velocity, to `u`,
  /// which is neither of them.
  void advect(const Velocity& by, const OpenFaces& open, const float* const (&carried)[3], float step,
              const FaceArrays& u) {
    const FaceArrays p = predicted_.arrays();
    launch_march<ClosedMarch>(by, ClosedPredictor{MidpointTrace{-step},
                                                  open,
                                                  {carried[0], carried[1], carried[2]},
                                                  {p.u[0], p.u[1], p.u[2]},
                                                  {bounds_[0].get(), bounds_[1].get(), bounds_[2].get()}});
    launch_march<ClosedMarch>(by, ClosedCorrector{MidpointTrace{step},
                                                  open,
                                                  {carried[0], carried[1], carried[2]},
                                                  {p.u[0], p.u[1], p.u[2]},
                                                  {bounds_[0].get(), bounds_[1].get(), bounds_[2].get()},
                                                  {u.u[0], u.u[1], u.u[2]}});
  }

 private:
  FaceBuffers predicted_;
  DeviceBuffer<float2> bounds_[3];
};

}  // namespace gpuphys::mac
