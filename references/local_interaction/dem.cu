// dem: one time step of spherical grains with damped Hertz contacts, friction and rotation, FP32.
//
// For every grain: the grains that overlap it, found through a uniform grid; the sum of their forces and
// torques; then its new velocity, angular velocity and position.
//
// Mapping: as contact_dem, whose sort, search and normal law it shares. The grains are sorted by cell
// (references/blocks/neighbour_grid.cuh) into arrays of spheres, motions and, here, spins. A thread owns one
// grain in the sorted order, searches its contacts on codes of four bytes (grain_sort.cuh), queues the hits
// and evaluates them (contact_search.cuh). Every pair is evaluated from either side: no atomics. The same
// thread then makes the step and scatters its grain's nine numbers to the order of the input.
//
// What bounds it: as contact_dem (the sort L2 and waits for memory, the search instructions and L1), and
// besides: 16 bytes more to gather per contact, about twice the arithmetic per contact, and three scattered
// vectors per grain instead of one. Two choices matter.
// - Spins do not travel with the records of the sort, which fill sectors as they are: they are fetched when
//   the grain has found its place. The 25 MB of them fit in L2.
// - Friction needs no branch: a pair that does not touch has a cap of zero.
#include <cstdint>
#include <stdexcept>

#include "cases/local_interaction/dem.hpp"
#include "core/contract/module.hpp"
#include "references/blocks/neighbour_grid.cuh"
#include "references/common/alignment.hpp"
#include "references/common/approximate.cuh"
#include "references/common/machine.cuh"
#include "references/local_interaction/contact_search.cuh"
#include "references/local_interaction/grain_sort.cuh"
#include "references/local_interaction/normal_contact.cuh"

namespace gpuphys::dem {
namespace {

using granular::Grain, granular::Grains, granular::NormalLaw;

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int threads = 96;
  static constexpr int blocks_per_sm = 6;
#else
  static constexpr int threads = 256;
  static constexpr int blocks_per_sm = 4;
#endif
};
static_assert(Policy::threads % 32 == 0);

struct Law {
  NormalLaw normal;
  float gt, mu, rho, dt;
};

// The Source of the neighbour grid: grains, and what fetches their spins.
struct SpinningGrains : Grains {
  const float* __restrict__ omega;
  float4* __restrict__ spins;

  __device__ __forceinline__ void placed(const neighbour_grid::Grid& grid, int slot,
                                         const Grain& grain) const {
    const float* const own = omega + 3 * static_cast<std::size_t>(__float_as_int(grain.motion.w));
    spins[slot] = make_float4(own[0], own[1], own[2], 0.0f);
    Grains::placed(grid, slot, grain);
  }
};

struct SpinningGrain {
  float4 sphere, motion, spin;
};

struct Load {
  float3 force{0.0f, 0.0f, 0.0f}, torque{0.0f, 0.0f, 0.0f};
};

__device__ __forceinline__ float3 cross(const float3& a, const float3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Adds what a grain feels from another one, if they touch.
__device__ __forceinline__ void add_contact(Load& load, const SpinningGrain& grain,
                                            const SpinningGrain& other, const Law& law) {
  const granular::Contact c =
      granular::normal_contact(grain.sphere, grain.motion, other.sphere, other.motion, law.normal);
  const float3 n = c.normal;
  // From the centres to the middle of the overlap.
  const float arm = grain.sphere.w - 0.5f * c.overlap, other_arm = other.sphere.w - 0.5f * c.overlap;
  const float3 turn{arm * grain.spin.x + other_arm * other.spin.x,
                    arm * grain.spin.y + other_arm * other.spin.y,
                    arm * grain.spin.z + other_arm * other.spin.z};
  const float3 rolled = cross(turn, n);
  const float3 slip{(grain.motion.x - other.motion.x) - c.separation * n.x - rolled.x,
                    (grain.motion.y - other.motion.y) - c.separation * n.y - rolled.y,
                    (grain.motion.z - other.motion.z) - c.separation * n.z - rolled.z};
  const float square = slip.x * slip.x + slip.y * slip.y + slip.z * slip.z;
  // Viscous below the cap, which is zero without a contact. No slip is viscous: nothing is divided by it.
  const float cap = law.mu * c.push;
  const float factor =
      law.gt * approximate_sqrt(square) <= cap ? law.gt : cap * approximate_rsqrt(fmaxf(square, 1e-37f));
  const float3 friction{-factor * slip.x, -factor * slip.y, -factor * slip.z};
  load.force.x += c.push * n.x + friction.x;
  load.force.y += c.push * n.y + friction.y;
  load.force.z += c.push * n.z + friction.z;
  const float3 twist = cross(n, friction);
  load.torque.x -= arm * twist.x;
  load.torque.y -= arm * twist.y;
  load.torque.z -= arm * twist.z;
}

// What the sort leaves, in the order of cells.
struct Sorted {
  const float4 *spheres, *motions, *spins;
  const unsigned* codes;
  const neighbour_grid::Grid* grid;
  const int* start;
  int count;

  __device__ __forceinline__ SpinningGrain operator[](int slot) const {
    return {spheres[slot], motions[slot], spins[slot]};
  }
};

struct Results {
  float *x, *v, *omega;
};

__global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    advance(const __grid_constant__ Sorted grains, const __grid_constant__ Results results,
            const __grid_constant__ Law law) {
  __shared__ int2 queue[granular::SearchPolicy::queue * Policy::threads];
  __shared__ float staged[3 * Policy::threads];
  __shared__ neighbour_grid::Grid grid;
  const int thread = static_cast<int>(threadIdx.x);
  // From the last slot to the first: what was sorted last is still in L2.
  const int slot = static_cast<int>(gridDim.x - 1 - blockIdx.x) * Policy::threads + thread;
  // Registers are short: the search reads the grid again and again, and global memory has a queue.
  if (thread == 0) grid = *grains.grid;
  const float4 sphere = grains.spheres[min(slot, grains.count - 1)];
  __syncthreads();
  int index = -1;
  float3 x{}, v{}, omega{};
  if (slot < grains.count) {
    Load load;
    granular::search_contacts<Policy::threads>(
        grid, grains.start, grains.codes, sphere, slot, queue, [&](auto last, auto& hits) {
          // Loaded again, as the search has no registers to spare.
          const SpinningGrain grain = grains[opaque(slot)];
          while (hits.more()) {
            const int a = hits.take();
            if constexpr (decltype(last)::value) {
              // Half as many waits for records. A grain feels nothing from itself.
              const int b = hits.more() ? hits.take() : slot;
              const SpinningGrain first = grains[a], second = grains[b];
              add_contact(load, grain, first, law);
              add_contact(load, grain, second, law);
            } else {
              add_contact(load, grain, grains[a], law);
            }
          }
        });
    const SpinningGrain grain = grains[opaque(slot)];
    const float r = grain.sphere.w;
    const float mass = 4.18879020f * law.rho * (r * r * r);
    const float inertia = 0.4f * mass * (r * r);
    index = __float_as_int(grain.motion.w);
    v = {grain.motion.x + law.dt * (load.force.x / mass), grain.motion.y + law.dt * (load.force.y / mass),
         grain.motion.z + law.dt * (load.force.z / mass)};
    x = {grain.sphere.x + law.dt * v.x, grain.sphere.y + law.dt * v.y, grain.sphere.z + law.dt * v.z};
    omega = {grain.spin.x + law.dt * (load.torque.x / inertia),
             grain.spin.y + law.dt * (load.torque.y / inertia),
             grain.spin.z + law.dt * (load.torque.z / inertia)};
  }
  granular::scatter_vectors(results.v, index, v, staged);
  __syncwarp();
  granular::scatter_vectors(results.x, index, x, staged);
  __syncwarp();
  granular::scatter_vectors(results.omega, index, omega, staged);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.radius.shape[0];
    if (n > (1 << 30)) throw std::runtime_error("dem: more than 2^30 grains");
    grid_.allocate<SpinningGrains>(n);
    const auto size = static_cast<std::size_t>(n);
    split_ = DeviceBuffer<Grain>(grid_.records(n));
    sorted_ = DeviceBuffer<float4>(3 * size);
    codes_ = DeviceBuffer<unsigned>(size + granular::kPadding);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = static_cast<int>(in.radius.shape[0]);
    if (n == 0) return;
    // The sort reads its inputs by 16 bytes.
    require_aligned("dem", "x", in.x.data);
    require_aligned("dem", "v", in.v.data);
    require_aligned("dem", "radius", in.radius.data);
    float4 *const spheres = sorted_.get(), *const motions = spheres + n, *const spins = motions + n;
    grid_.build(SpinningGrains{{in.x.data, in.v.data, in.radius.data, split_.get(), spheres, codes_.get(), n},
                               in.omega.data,
                               spins});
    // An ordinary launch: blocks that join those of sort_bins on an SM would get what these leave of L1.
    const auto blocks = static_cast<unsigned>((n + Policy::threads - 1) / Policy::threads);
    advance<<<blocks, Policy::threads>>>(
        Sorted{spheres, motions, spins, codes_.get(), grid_.grid(), grid_.start(), n},
        Results{out.x_new.data, out.v_new.data, out.omega_new.data},
        Law{{in.kn, in.cn}, in.gt, in.mu, in.rho, in.dt});
  }

 private:
  neighbour_grid::NeighbourGrid<granular::GridPolicy> grid_;
  DeviceBuffer<Grain> split_;
  DeviceBuffer<float4> sorted_;
  DeviceBuffer<unsigned> codes_;
};

}  // namespace
}  // namespace gpuphys::dem

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(dem, dem::Reference)
}
