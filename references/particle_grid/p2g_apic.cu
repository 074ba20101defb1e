// p2g_apic: affine velocities of particles to the faces of a MAC grid, quadratic B-splines, FP32.
//
// For every face of component c: u = sum_p w (v_c + D_c . r) / sum_p w, r from the particle to the face in
// cells and D = 4 B / dx the change of the particle's velocity a cell; 0 where no weight arrives.
//
// The passes are those of mac_scatter.cuh. A record is two sectors: {place in the cell 3, cell number}, and
// for each component {v_c, D_c 3}, written at once by four lanes.
//
// What bounds it (33.0M particles): DRAM in pack (2.1 GB read, 2.1 GB written at random places), instructions
// in scatter (some 500 a particle).
#include "cases/particle_grid/p2g_apic.hpp"
#include "references/particle_grid/mac_scatter.cuh"

namespace gpuphys::p2g_apic {
namespace {

constexpr int kOrder = 2;  // of the spline: quadratic
constexpr int kQuads = 4;  // float4 a record

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
  static constexpr int scatter_blocks_per_sm = 3;
#else
  static constexpr int plan_threads = 256;
  static constexpr int count_threads = 1024;       // a block an SM: its histogram fills shared memory
  static constexpr int count_shared = 195 * 1024;  // leaves 60 KB of L1 to its loads
  static constexpr int pack_threads = 128;
  static constexpr int piece =
      560;  // half a tile's particles of eight a cell: four blocks an SM have the room
  static constexpr int scatter_blocks_per_sm = 4;
#endif
};

using Transfer = mac_scatter::Transfer<Policy, kOrder, kQuads>;

struct Particles {
  const float* __restrict__ x;
  const float* __restrict__ v;
  const float* __restrict__ b;
  std::int64_t n;
};

__global__ void __launch_bounds__(Policy::pack_threads)
    pack(const __grid_constant__ tiles::TileGrid grid, const __grid_constant__ Particles particles,
         const __grid_constant__ tiles::BinningView bins, float slope, float4* __restrict__ records) {
  __shared__ __align__(16) float staging[Policy::pack_threads / 32][32 * 4 * kQuads];
  float* stage = staging[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const std::int64_t p = static_cast<std::int64_t>(blockIdx.x) * Policy::pack_threads + threadIdx.x;
  float x[3], v[3], b[9];
  load_rows(particles.x, p - lane, particles.n, x);
  load_rows(particles.v, p - lane, particles.n, v);
  load_rows(particles.b, p - lane, particles.n, b);
  transpose_rows(stage, x);
  transpose_rows(stage + 32 * 3, v);
  transpose_rows(stage + 32 * 6, b);
  const tiles::Place at = tiles::locate<Transfer::T>(grid, x[0], x[1], x[2]);
  const int slot = tiles::slot_of(bins, at, p, particles.n);
  __syncwarp();  // the rows are read: their memory takes the records
  auto* packed = reinterpret_cast<float4*>(stage);
  packed[kQuads * lane] = make_float4(at.offset[0], at.offset[1], at.offset[2], __int_as_float(at.cell));
#pragma unroll
  for (int c = 0; c < 3; ++c)
    packed[kQuads * lane + 1 + c] =
        make_float4(v[c], slope * b[3 * c], slope * b[3 * c + 1], slope * b[3 * c + 2]);
  __syncwarp();
  write_records<kQuads>(packed, slot, records);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>& out) {
    transfer_.allocate(Transfer::grid_of(out, in.dx), in.x.shape[0]);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    require_aligned("p2g_apic", "x", in.x.data);  // counted by 16 bytes
    const tiles::TileGrid grid = Transfer::grid_of(out, in.dx);
    const Particles particles{in.x.data, in.v.data, in.B.data, in.x.shape[0]};
    const float slope = 4.0f / in.dx;
    transfer_.compute(grid, particles.x, particles.n, Transfer::faces_of(out),
                      [&](const tiles::BinningView& bins, float4* records) {
                        pack<<<Transfer::blocks(particles.n, Policy::pack_threads), Policy::pack_threads>>>(
                            grid, particles, bins, slope, records);
                      });
  }

 private:
  Transfer transfer_;
};

}  // namespace
}  // namespace gpuphys::p2g_apic

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(p2g_apic, p2g_apic::Reference)
}
