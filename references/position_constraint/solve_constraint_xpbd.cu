// solve_constraint_xpbd: 8 Jacobi iterations of compliant distance constraints, averaged by valence, FP32.
//
// Particles and springs come in random order. Particles are renumbered along a Morton curve
// (spatial_order.cuh); 1024 consecutive ones make a tile, and each spring is sorted into the rows of both
// ends in their tiles (spring_tiles.cuh). In an iteration a block takes a tile: it loads the tile's
// particles and their neighbours outside (the halo) into shared memory, two threads a particle read its
// row, fetch the other ends from there, and add up the particle's displacement. The state of a spring
// lives beside the row entries and is advanced identically at both ends, so there are no atomics and no
// second pass.
//
// Positions are held as input plus displacement: displacements of a centimetre keep their digits, and one
// addition at the end rounds. In shared memory their sum is an integer of a unit that suits the tile, so that
// differences are exact but for that unit (spring_projection.cuh).
//
// What bounds it (n = 1.05 million, m = 6.28 million, 12.56 million half-springs): an iteration moves
// 2 + 4 + 4 bytes a half-spring and 32 + 16 bytes a particle of device memory, and 43 MB of halos out of
// the L2, whose rate is the nearest limit (71 %); but a third of a block's time is the wait for the
// particles, a fifth that for the rows, and more loads under way together, more warps with fewer registers,
// or the next tile fetched during this one were slower: docs/lab/position_constraint.md has what was
// measured. Sorting moves 360 MB and gathers 12.56 million numbers out of the L2 (0.1 ms). What pays: halos,
// so that no half-spring looks beyond shared memory and 16 bits name its other end; other ends of 16 bytes,
// read at random; positions and displacements in arrays of their own, of which only the second is written;
// one number of state, the rest length shifted by the multiplier; rows interleaved so that a warp reads 32
// neighbours; a sort that writes each chunk as it is and lets the tile collect its runs (one pass over the
// springs, no scan); whole sectors stored.
#include "cases/position_constraint/solve_constraint_xpbd.hpp"

#include <climits>
#include <stdexcept>
#include <utility>

#include "core/contract/module.hpp"
#include "references/position_constraint/spatial_order.cuh"
#include "references/position_constraint/spring_projection.cuh"

namespace gpuphys::solve_constraint_xpbd {
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
#else
  using Tile = springs::TileShape<10, 2, 1600>;  // a row of 12 half-springs is six full turns of 2 threads
  static constexpr int project_threads = 512;
  static constexpr int project_at_once = 2;  // blocks a multiprocessor, of 64 registers a thread
  static constexpr int unroll = 3, batch = 4;
  static constexpr int split_threads = 1024;
  static constexpr int split_items = 8;     // 16384 half-springs sorted in 128 KB of shared memory
  static constexpr int split_blocks = 132;  // one a multiprocessor of an H200
  static constexpr bool wide_records = false;
  static constexpr int build_threads = 1024;
  static constexpr int build_capacity = 13056;  // half-springs; two blocks a multiprocessor
#endif
};

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0], m = in.rest.shape[0];
    // Threads and places of half-springs, filled up to slices, are counted in int.
    if (n > INT_MAX / 16 || m > INT_MAX / 16)
      throw std::runtime_error("more particles or springs than 32 bits count");
    n_ = static_cast<int>(n);
    m_ = static_cast<int>(m);
    tiles_ = springs::SpringTiles<Policy>(n_, m_);
    order_ = spatial::Order(n_);
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
    if (n_ == 0) return;
    if (in.iters == 0) {
      GPUPHYS_CUDA(cudaMemcpyAsync(out.x_new.data, in.x.data,
                                   3 * sizeof(float) * static_cast<std::size_t>(n_),
                                   cudaMemcpyDeviceToDevice));
      return;
    }
    order_.build(in.x.data, n_);
    float4* now = step_[0].get();
    float4* next = step_[1].get();
    tiles_.build(reinterpret_cast<const int2*>(in.springs.data), in.rest.data, in.x.data, in.inv_mass.data,
                 order_.cell_and_place(), order_.first(), {base_.get(), now});
    const float dt = in.dt;
    const float alpha = in.compliance / (dt * dt);
    const int iterations = in.iters;
    for (int k = 0; k < iterations; ++k) {
      const springs::Iteration iteration{base_.get(),  now,   next, shifted_rest_.get(), frame_.get(),
                                         exact_.get(), alpha, n_,   k == iterations - 1, k % 2 == 1};
      const auto kernel = k == 0 ? project<true> : project<false>;
      kernel<<<static_cast<unsigned>(tiles_.tiles()), Policy::project_threads,
               springs::project_bytes<Policy::Tile>()>>>(iteration, tiles_.view());
      std::swap(now, next);
    }
    constexpr int threads = 256;
    springs::write_positions<<<static_cast<unsigned>((n_ + threads - 1) / threads), threads>>>(
        now, tiles_.number(), n_, out.x_new.data);
  }

 private:
  template <bool First>
  static constexpr auto project =
      springs::project<Policy::Tile, Policy::project_threads, Policy::project_at_once, Policy::unroll,
                       Policy::batch, First>;

  int n_ = 0, m_ = 0;
  springs::SpringTiles<Policy> tiles_;
  spatial::Order order_;
  DeviceBuffer<float> shifted_rest_;
  DeviceBuffer<springs::Frame> frame_;
  DeviceBuffer<unsigned char> exact_;
  DeviceBuffer<float4> base_, step_[2];
};

}  // namespace
}  // namespace gpuphys::solve_constraint_xpbd

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(solve_constraint_xpbd, solve_constraint_xpbd::Reference)
}
