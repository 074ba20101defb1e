// p2g_pic_flip: velocities of particles to the faces of a MAC grid, hat kernel, FP32.
//
// For every face of component c: u = sum_p w v_c / sum_p w, the sums over the particles within one cell; 0
// where no weight arrives.
//
// The passes are those of mac_scatter.cuh. A record is one sector: {place in the cell 3, cell number, v 3,
// padding}, written at once by two lanes.
//
// What bounds it (33.0M particles): DRAM in count (x read, 0.4 GB) and pack (0.93 GB read, 1.06 GB written at
// random places), instructions in scatter (some 200 a particle) nearly as much as its 1.06 GB.
#include "cases/particle_grid/p2g_pic_flip.hpp"
#include "references/particle_grid/mac_scatter.cuh"

namespace gpuphys::p2g_pic_flip {
namespace {

constexpr int kOrder = 1;  // of the spline: hat
constexpr int kQuads = 2;  // float4 a record

struct Policy {
  static constexpr int mark_threads = 256;
  static constexpr int mark_stride = 32;  // one row of 32 particles in so many
  static constexpr int normalise_threads = 128;
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int plan_threads = 128;
  static constexpr int count_threads = 512;
  static constexpr int count_shared = 98 * 1024;  // takes half the tiles of the paper's size
  static constexpr int pack_threads = 256;
  static constexpr int piece = 500;
  static constexpr int scatter_blocks_per_sm = 4;
#else
  static constexpr int plan_threads = 256;
  static constexpr int count_threads = 1024;       // a block an SM: its histogram fills shared memory
  static constexpr int count_shared = 195 * 1024;  // leaves 60 KB of L1 to its loads
  static constexpr int pack_threads = 128;
  static constexpr int piece =
      1088;  // particles of a tile that a block takes: eight a cell, and room for chance
  static constexpr int scatter_blocks_per_sm = 5;
#endif
};

using Transfer = mac_scatter::Transfer<Policy, kOrder, kQuads>;

struct Particles {
  const float* __restrict__ x;
  const float* __restrict__ v;
  std::int64_t n;
};

__global__ void __launch_bounds__(Policy::pack_threads)
    pack(const __grid_constant__ tiles::TileGrid grid, const __grid_constant__ Particles particles,
         const __grid_constant__ tiles::BinningView bins, float4* __restrict__ records) {
  __shared__ __align__(16) float staging[Policy::pack_threads / 32][32 * 4 * kQuads];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::pack_threads + threadIdx.x;
  float x[3], v[3];
  load_rows(particles.x, p - lane, particles.n, x);
  load_rows(particles.v, p - lane, particles.n, v);
  transpose_rows(stage, x);
  transpose_rows(stage + 32 * 3, v);
  const tiles::Place at = tiles::locate<Transfer::T>(grid, x[0], x[1], x[2]);
  const int slot = tiles::slot_of(bins, at, p, particles.n);
  __syncwarp();  // the rows are read: their memory takes the records
  auto* packed = reinterpret_cast<float4*>(stage);
  packed[kQuads * lane] = make_float4(at.offset[0], at.offset[1], at.offset[2], __int_as_float(at.cell));
  packed[kQuads * lane + 1] = make_float4(v[0], v[1], v[2], 0.0f);
  __syncwarp();
  write_records<kQuads>(packed, slot, records);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>& out) {
    transfer_.allocate(Transfer::grid_of(out, in.dx), in.x.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("p2g_pic_flip", "x", in.x.data);  // counted by 16 bytes
    const tiles::TileGrid grid = Transfer::grid_of(out, in.dx);
    const Particles particles{in.x.data, in.v.data, in.x.shape[0]};
    transfer_.compute(grid, particles.x, particles.n, Transfer::faces_of(out),
                      [&](const tiles::BinningView& bins, float4* records) {
                        pack<<<Transfer::blocks(particles.n, Policy::pack_threads), Policy::pack_threads>>>(
                            grid, particles, bins, records);
                      });
  }

 private:
  Transfer transfer_;
};

}  // namespace
}  // namespace gpuphys::p2g_pic_flip

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(p2g_pic_flip, p2g_pic_flip::Reference)
}
