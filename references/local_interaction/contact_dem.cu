// contact_dem: normal contact forces between overlapping spheres (Hertz, damped, no tension), FP32.
//
// For every grain: the grains that overlap it, found through a uniform grid, and the sum of their forces.
//
// Mapping: the grains are sorted by cell (references/blocks/neighbour_grid.cuh) as records of one sector:
// position, radius, velocity, index; the result is two arrays, spheres and motions. Each sphere is written
// again as a code of four bytes for the search. A thread owns one grain in the sorted order, so a warp owns a
// stretch of one column of cells and its candidates of another column are a short run of codes. Every pair is
// evaluated twice, once from either side, with bitwise opposite results: no atomics, and forces balance to
// the rounding of each sum.
//
// What bounds it: the sort, L2 and waits for memory (300 MB in and out by ncu, most of it records, at half
// the rate of a copy: docs/lab/local_interaction.md); the search, instructions (64 % of the issue slots) and
// L1 (77 %: of its 25 million wavefronts a third each for codes and for what the force gathers). A grain
// meets 8.2 columns of cells and 37 candidates (cells of 1.2 x 1.2 x 0.6 against a reach of 1.15), of
// which 4.7 touch. What pays:
// - Sorting in two levels: most atomics stay in shared memory, and records leave as whole sectors, close to
//   others of their bin.
// - Inputs are read by 16 bytes, whole lines a warp, and wait in shared memory for their turn.
// - Codes: a candidate costs one word instead of four (1.9 cache lines a load instead of about 7) and four
//   instructions: load, add, dp4a, shift. The test errs on the side of contact only and passes 0.6 candidates
//   a grain too many; the exact one in FP32 decides.
// - Three columns at a time, and six candidates of each without a branch: their loads are under way together.
//   Two more looks at longer ranges are all that a warp needs on average.
// - Columns in step: all lanes start at the column before their own, needed or not, so that they read the
//   same lines at the same time.
// - Search and force apart: hits are queued in shared memory as bits, a column an entry, and the force (about
//   57 instructions) runs over the queues with most lanes busy: the longest of a warp's 32 holds 6.4.
//   Evaluated inside the search, nearly every candidate would drag its warp through the force. Nor does the
//   search keep what only the force needs in registers: they limit the warps of an SM.
// - Spheres and motions in arrays of their own: what the lanes of a warp gather lies in fewer lines, and in
//   all banks of L1.
// The forces go back to the order of the input by scattered writes; three neighbouring lanes write the three
// words of a grain, so that it costs one or two sectors instead of three requests.
#include <cstdint>
#include <stdexcept>

#include "cases/local_interaction/contact_dem.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/neighbour_grid.cuh"
#include "references/common/alignment.hpp"
#include "references/common/machine.cuh"
#include "references/local_interaction/contact_search.cuh"
#include "references/local_interaction/grain_sort.cuh"
#include "references/local_interaction/normal_contact.cuh"

namespace gpuphys::contact_dem {
namespace {

using granular::Grain, granular::Grains, granular::NormalLaw;

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int threads = 64;
  static constexpr int blocks_per_sm = 16;
#else
  // Two columns of the paper's packing: its warps share what they read of the columns between. Larger blocks
  // leave places of their warps free for longer when they end.
  static constexpr int threads = 320;
  static constexpr int blocks_per_sm = 4;
#endif
};
static_assert(Policy::threads % 32 == 0);

// Adds to `force` what a grain feels from another one, if they touch.
__device__ __forceinline__ void add_contact(float3& force, const Grain& grain, const Grain& other,
                                            NormalLaw law) {
  const granular::Contact c =
      granular::normal_contact(grain.sphere, grain.motion, other.sphere, other.motion, law);
  force.x += c.push * c.normal.x;
  force.y += c.push * c.normal.y;
  force.z += c.push * c.normal.z;
}

__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    sum_contacts(const float4* spheres, const float4* motions, const unsigned* codes,
                 const neighbour_grid::Grid* grid_in, const int* start, float* result, NormalLaw law,
                 int count) {
  __shared__ int2 queue[granular::SearchPolicy::queue * Policy::threads];
  __shared__ float staged[3 * Policy::threads];
  __shared__ neighbour_grid::Grid grid;
  const int thread = static_cast<int>(threadIdx.x);
  // From the last slot to the first: what was sorted last is still in L2.
  const int slot = static_cast<int>(gridDim.x - 1 - blockIdx.x) * Policy::threads + thread;
  float3 force{0.0f, 0.0f, 0.0f};
  int index = -1;
  // Registers are short: the search reads the grid again and again, and global memory has a queue.
  if (thread == 0) grid = *grid_in;
  const float4 sphere = spheres[min(slot, count - 1)];
  __syncthreads();
  if (slot < count) {
    granular::search_contacts<Policy::threads>(
        grid, start, codes, sphere, slot, queue, [&]([[maybe_unused]] auto last, auto& hits) {
          // Loaded again, as the search has no registers to spare.
          const int own = opaque(slot);
          const Grain grain{spheres[own], motions[own]};
          if constexpr (decltype(last)::value) index = __float_as_int(grain.motion.w);
          while (hits.more()) {
            const int a = hits.take();
            if constexpr (decltype(last)::value) {
              // Half as many waits for records. A grain feels nothing from itself.
              const int b = hits.more() ? hits.take() : slot;
              const Grain first{spheres[a], motions[a]}, second{spheres[b], motions[b]};
              add_contact(force, grain, first, law);
              add_contact(force, grain, second, law);
            } else {
              add_contact(force, grain, {spheres[a], motions[a]}, law);
            }
          }
        });
  }
  granular::scatter_vectors(result, index, force, staged);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.radius.shape[0];
    if (n > (1 << 30)) throw std::runtime_error("contact_dem: more than 2^30 grains");
    grid_.allocate<Grains>(n);
    split_ = DeviceBuffer<Grain>(grid_.records(n));
    sorted_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(n));
    codes_ = DeviceBuffer<unsigned>(static_cast<std::size_t>(n) + granular::kPadding);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = static_cast<int>(in.radius.shape[0]);
    if (n == 0) return;
    // The sort reads its inputs by 16 bytes.
    require_aligned("contact_dem", "x", in.x.data);
    require_aligned("contact_dem", "v", in.v.data);
    require_aligned("contact_dem", "radius", in.radius.data);
    const auto blocks = [n](int threads) { return static_cast<unsigned>((n + threads - 1) / threads); };
    grid_.build(Grains{in.x.data, in.v.data, in.radius.data, split_.get(), sorted_.get(), codes_.get(), n});
    // An ordinary launch: blocks that join those of sort_bins on an SM would get what these leave of L1.
    sum_contacts<<<blocks(Policy::threads), Policy::threads>>>(sorted_.get(), sorted_.get() + n, codes_.get(),
                                                               grid_.grid(), grid_.start(), out.force.data,
                                                               NormalLaw{in.kn, in.cn}, n);
  }

 private:
  neighbour_grid::NeighbourGrid<granular::GridPolicy> grid_;
  DeviceBuffer<Grain> split_;
  DeviceBuffer<float4> sorted_;
  DeviceBuffer<unsigned> codes_;
};

}  // namespace
}  // namespace gpuphys::contact_dem

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(contact_dem, contact_dem::Reference)
}
