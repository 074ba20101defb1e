// xpbd in FP32: one step of a cloth with springs and self-contact.
//
// Composed of two building blocks. Particles are renumbered along a Morton curve and the springs sorted into
// tiles of 1024 particles (spatial_order.cuh, spring_tiles.cuh), as in solve_constraint_xpbd; the prediction
// x + dt v is the displacement that the iterations begin with. Contacts of the predicted positions are found
// once and stand in rows by particle (references/blocks/contact_rows.cuh). An iteration is two kernels: a
// block a tile gathers the springs of its particles (spring_projection.cuh) and writes the displacements to
// come, and a thread a particle adds what its contacts make of the same positions. No atomics in either.
//
// Positions are held as input plus displacement; one addition at the end rounds the position, and the
// velocity comes from the displacement itself.
//
// What bounds it: the iterations of the springs, as in solve_constraint_xpbd (device memory and the wait for
// the halos); the contacts add 40 bytes out of the L2 for each of the 1.3 million ends and 40 for each
// particle that has any, every iteration.
#include "cases/position_constraint/xpbd.hpp"

#include <climits>
#include <stdexcept>
#include <utility>

#include "core/contract/module.hpp"
#include "references/blocks/contact_rows.cuh"
#include "references/position_constraint/spatial_order.cuh"
#include "references/position_constraint/spring_projection.cuh"

namespace gpuphys::xpbd {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  using Tile = springs::TileShape<9, 8, 256>;
  static constexpr int project_threads = 256;
  static constexpr int project_at_once = 4;
  static constexpr int unroll = 2, batch = 2;
  static constexpr int split_threads = 256;
  static constexpr int split_items = 4;
  static constexpr int split_blocks = 400;
  static constexpr bool wide_records = true;
  static constexpr int build_threads = 512;
  static constexpr int build_capacity = 6144;
  static constexpr int particle_threads = 128;
#else
  using Tile = springs::TileShape<10, 2, 1600>;
  static constexpr int project_threads = 512;
  static constexpr int project_at_once = 2;  // blocks a multiprocessor, of 64 registers a thread
  static constexpr int unroll = 3, batch = 4;
  static constexpr int split_threads = 1024;
  static constexpr int split_items = 8;
  static constexpr int split_blocks = 132;
  static constexpr bool wide_records = false;
  static constexpr int build_threads = 1024;
  static constexpr int build_capacity = 13056;
  static constexpr int particle_threads = 256;
#endif
};

// The prediction: dt v is the displacement to begin with, that of pinned particles 0. Keeps what stands
// behind it.
__global__ void __launch_bounds__(Policy::particle_threads)
    predict(const float* __restrict__ v, const float* __restrict__ inv_mass,
            const std::int32_t* __restrict__ number, float dt, int n, float4* __restrict__ step) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= n) return;
  const int at = number[i];
  float* const s = reinterpret_cast<float*>(step + at);
  const bool moves = inv_mass[i] > 0.0f;
#pragma unroll
  for (int d = 0; d < 3; ++d) s[d] = moves ? dt * v[3 * i + d] : 0.0f;
}

// Positions and velocities in input order. NaN if the contacts did not fit.
__global__ void __launch_bounds__(Policy::particle_threads)
    write(const float4* __restrict__ base, const float4* __restrict__ step,
          const std::int32_t* __restrict__ number, contacts::Scratch s, float dt, float* __restrict__ x_new,
          float* __restrict__ v_new) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= s.n) return;
  const int at = number[i];
  const float4 b = base[at], moved = step[at];
  const bool lost = s.head->used > static_cast<unsigned long long>(s.capacity);
  x_new[3 * i] = lost ? __int_as_float(0x7fc00000) : b.x + moved.x;
  x_new[3 * i + 1] = b.y + moved.y;
  x_new[3 * i + 2] = b.z + moved.z;
  v_new[3 * i] = moved.x / dt;
  v_new[3 * i + 1] = moved.y / dt;
  v_new[3 * i + 2] = moved.z / dt;
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0], m = in.rest.shape[0];
    // Threads and places of half-springs, filled up to slices, are counted in int.
    if (n > INT_MAX / 32 || m > INT_MAX / 16)
      throw std::runtime_error("xpbd: more particles or springs than 32 bits count");
    n_ = static_cast<int>(n);
    tiles_ = springs::SpringTiles<Policy>(n_, static_cast<int>(m));
    order_ = spatial::Order(n_);
    rows_ = contacts::ContactRows(n);
    shifted_rest_ = DeviceBuffer<float>(tiles_.places());
    base_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
    for (DeviceBuffer<float4>& step : step_) step = DeviceBuffer<float4>(static_cast<std::size_t>(n));
    frame_ = DeviceBuffer<springs::Frame>(static_cast<std::size_t>(tiles_.tiles()));
    exact_ = DeviceBuffer<unsigned char>(static_cast<std::size_t>(tiles_.tiles()));
    for (const auto kernel : {project<true>, project<false>}) {
      GPUPHYS_CUDA(cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize,
                                        static_cast<int>(springs::project_bytes<Policy::Tile>())));
    }
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    constexpr unsigned threads = Policy::particle_threads;
    const unsigned blocks = (static_cast<unsigned>(n_) + threads - 1) / threads;
    order_.build(in.x.data, n_);
    float4* now = step_[0].get();
    float4* next = step_[1].get();
    tiles_.build(reinterpret_cast<const int2*>(in.springs.data), in.rest.data, in.x.data, in.inv_mass.data,
                 order_.cell_and_place(), order_.first(), {base_.get(), now});
    predict<<<blocks, threads>>>(in.v.data, in.inv_mass.data, tiles_.number(), in.dt, n_, now);
    const contacts::Scratch s = rows_.build(contacts::MovedParticles{base_.get(), now}, in.search_radius);
    const float dt = in.dt;
    const float alpha = in.spring_compliance / (dt * dt);
    const contacts::Contact contact{in.thickness, in.contact_compliance / (dt * dt), in.relaxation};
    const int iterations = in.iters;
    for (int k = 0; k < iterations; ++k) {
      // Also the last one leaves displacements, to which the contacts are added.
      const springs::Iteration iteration{base_.get(),  now,          next,  shifted_rest_.get(),
                                         frame_.get(), exact_.get(), alpha, n_,
                                         false,        k % 2 == 1};
      const auto kernel = k == 0 ? project<true> : project<false>;
      kernel<<<static_cast<unsigned>(tiles_.tiles()), Policy::project_threads,
               springs::project_bytes<Policy::Tile>()>>>(iteration, tiles_.view());
      rows_.sweep<false>(s, contact, k == 0, base_.get(), now, next);
      std::swap(now, next);
    }
    write<<<blocks, threads>>>(base_.get(), now, tiles_.number(), s, dt, out.x_new.data, out.v_new.data);
  }

 private:
  template <bool First>
  static constexpr auto project =
      springs::project<Policy::Tile, Policy::project_threads, Policy::project_at_once, Policy::unroll,
                       Policy::batch, First>;

  int n_ = 0;
  springs::SpringTiles<Policy> tiles_;
  spatial::Order order_;
  contacts::ContactRows rows_;
  DeviceBuffer<float> shifted_rest_;
  DeviceBuffer<springs::Frame> frame_;
  DeviceBuffer<unsigned char> exact_;
  DeviceBuffer<float4> base_, step_[2];
};

}  // namespace
}  // namespace gpuphys::xpbd

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(xpbd, xpbd::Reference)
}
