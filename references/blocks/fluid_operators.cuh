// The operators of a position-based fluid on particles that are sorted (fluid_search.cuh): density
// constraint, vorticity confinement and viscosity, a thread per particle. Every pair is evaluated from either
// side, with opposite results: no atomics, and momentum is kept to the rounding of each sum.
//
// Two kernels make an iteration of the solver, two the confinement, one the viscosity. The first at new
// positions searches and writes the lists that the others read. Kernels' factors, like 45/(pi h^4), which may
// be very large or small, multiply finished sums.
#pragma once

#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>

#include "references/blocks/fluid_search.cuh"
#include "references/common/approximate.cuh"
#include "references/common/device_buffer.cuh"

namespace gpuphys::fluid {

// ---- What a pair weighs ----

/// 1 - r^2/h^2, and 0 from h on: W(r) = poly6 depth^3.
__device__ __forceinline__ float depth_of(const Fluid& f, const Pair& pair) {
  return fmaxf(1.0f - pair.square * f.inverse_square, 0.0f);
}

/// (1 - r/h)^2 / r, and 0 from h on: grad W = -spiky slope d. Finite where r = 0, as is its square.
__device__ __forceinline__ float slope_of(const Fluid& f, const Pair& pair) {
  const float inverse = approximate_rsqrt(fmaxf(pair.square, 1e-36f));
  const float inside = fmaxf(1.0f - pair.square * inverse * f.inverse_h, 0.0f);
  return inside * inside * inverse;
}

__device__ __forceinline__ float3 cross(const float3& a, const float3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// ---- Results in the order of the input ----

/// Lane l of a warp writes words l, l + 32 and l + 64 of the warp's 96: words of one particle side by side,
/// one or two sectors instead of three requests. By all lanes; index -1: nothing to write.
__device__ __forceinline__ void scatter(float* out, float* staged, int index, const float3& value) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  float* const words = staged + 3 * (static_cast<int>(threadIdx.x) - lane);
  __syncwarp();
  words[3 * lane] = value.x;
  words[3 * lane + 1] = value.y;
  words[3 * lane + 2] = value.z;
  __syncwarp();
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    const int word = k * 32 + lane;
    const int target = __shfl_sync(0xffffffffu, index, word / 3);
    if (target >= 0)
      out[3 * static_cast<std::size_t>(target) + static_cast<std::size_t>(word % 3)] = words[word];
  }
}

/// The slot of this thread. Those behind the last particle work on it too, and write nothing.
struct Slot {
  int slot;
  bool mine;
};
__device__ __forceinline__ Slot own_slot(const Fluid& f) {
  const int slot = static_cast<int>(blockIdx.x) * Policy::threads + static_cast<int>(threadIdx.x);
  return {min(slot, f.count - 1), slot < f.count};
}

// ---- Density constraint ----

struct Constraint {
  float poly6;  // 315 / (64 pi h^3) / rho0
  float spiky;  // 45 / (pi h^4) / rho0
  float eps;
  float pressure;  // k_corr / (1 - dq^2)^12
};

/// lambda, into the fourth word of a copy of the places.
static __global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    find_lambda(const __grid_constant__ Fluid f, const __grid_constant__ Constraint law, int4* with_lambda) {
  __shared__ Queue<Lists::written> queue;
  const auto [slot, mine] = own_slot(f);
  float density = 0.0f, squares = 0.0f;  // with the particle's own
  float3 sum{0.0f, 0.0f, 0.0f};
  for_each_neighbour<true, Lists::written>(f, queue, slot, mine, [&](int, const Pair& pair, float) {
    const float depth = depth_of(f, pair), slope = slope_of(f, pair);
    density += depth * depth * depth;
    squares += slope * slope * pair.square;
    sum.x += slope * pair.d.x;
    sum.y += slope * pair.d.y;
    sum.z += slope * pair.d.z;
  });
  squares += sum.x * sum.x + sum.y * sum.y + sum.z * sum.z;
  const float excess = law.poly6 * density - 1.0f;
  int4 own = f.places[slot];
  own.w = __float_as_int(-excess / (law.spiky * law.spiky * squares + law.eps));
  if (mine) with_lambda[slot] = own;
}

/// What an iteration writes.
struct Moved {
  float4* shift;
  float* now;  // positions, x, y, z
  float* out;  // or, if this is not null, only those, in the order of the input
};

/// Moves the particles; lambda is in the fourth word of their places.
static __global__ void __launch_bounds__(Policy::threads, Policy::reading_blocks_per_sm)
    move(const __grid_constant__ Fluid f, const __grid_constant__ Constraint law,
         const __grid_constant__ Moved moved) {
  __shared__ Queue<Lists::read> queue;
  __shared__ float staged[3 * Policy::threads];
  const auto [slot, mine] = own_slot(f);
  const float lambda = __int_as_float(f.places[slot].w);
  float3 sum{0.0f, 0.0f, 0.0f};
  for_each_neighbour<true, Lists::read>(f, queue, slot, mine, [&](int, const Pair& pair, float other) {
    const float depth = depth_of(f, pair), cube = depth * depth * depth, sixth = cube * cube;
    const float factor = slope_of(f, pair) * (lambda + other - law.pressure * (sixth * sixth));
    sum.x += factor * pair.d.x;
    sum.y += factor * pair.d.y;
    sum.z += factor * pair.d.z;
  });
  const float4 x = f.x[slot];
  float4 shift = f.shift[slot];
  shift.x -= law.spiky * sum.x;
  shift.y -= law.spiky * sum.y;
  shift.z -= law.spiky * sum.z;
  const float3 now{x.x + shift.x, x.y + shift.y, x.z + shift.z};
  if (moved.out == nullptr && mine) moved.shift[slot] = shift;
  const int index = moved.out != nullptr ? __float_as_int(x.w) : slot;
  scatter(moved.out != nullptr ? moved.out : moved.now, staged, mine ? index : -1, now);
}

// ---- Velocities: of a fluid at rest in its places, `velocity`; of one that moved, shift / dt ----

/// Where velocities are: scale times the three words of each.
struct Velocities {
  const float4* at;
  float scale;
};

/// omega / (45 / (pi h^4)), and its size.
template <bool moves>
static __global__ void __launch_bounds__(Policy::threads, Policy::blocks_per_sm)
    find_vorticity(const __grid_constant__ Fluid f, const __grid_constant__ Velocities v, float4* curl,
                   float* size) {
  __shared__ Queue<Lists::written> queue;
  const auto [slot, mine] = own_slot(f);
  const float4 own = v.at[slot];
  float3 sum{0.0f, 0.0f, 0.0f};
  for_each_neighbour<moves, Lists::written>(f, queue, slot, mine, [&](int j, const Pair& pair, float) {
    const float slope = slope_of(f, pair);
    const float4 other = v.at[j];
    const float3 turn = cross({other.x - own.x, other.y - own.y, other.z - own.z}, pair.d);
    sum.x += slope * turn.x;
    sum.y += slope * turn.y;
    sum.z += slope * turn.z;
  });
  const float3 found{v.scale * sum.x, v.scale * sum.y, v.scale * sum.z};
  if (!mine) return;
  curl[slot] = make_float4(found.x, found.y, found.z, 0.0f);
  size[slot] = sqrtf(found.x * found.x + found.y * found.y + found.z * found.z);
}

struct Confinement {
  float factor;       // dt epsilon 45 / (pi h^4)
  float regulariser;  // 2^-20 / (45 / (pi h^4))^2
};

/// Velocities after confinement: into `after` by slots, or to `out` in the order of the input.
template <bool moves>
static __global__ void __launch_bounds__(Policy::threads, Policy::reading_blocks_per_sm)
    confine(const __grid_constant__ Fluid f, const __grid_constant__ Velocities v,
            const __grid_constant__ Confinement law, const float4* curl, const float* size, float4* after,
            float* out) {
  __shared__ Queue<Lists::read> queue;
  __shared__ float staged[3 * Policy::threads];
  const auto [slot, mine] = own_slot(f);
  const float own = size[slot];
  float3 rise{0.0f, 0.0f, 0.0f};
  for_each_neighbour<moves, Lists::read>(f, queue, slot, mine, [&](int j, const Pair& pair, float) {
    const float factor = slope_of(f, pair) * (own - size[j]);
    rise.x += factor * pair.d.x;
    rise.y += factor * pair.d.y;
    rise.z += factor * pair.d.z;
  });
  const float length = sqrtf(rise.x * rise.x + rise.y * rise.y + rise.z * rise.z) + law.regulariser;
  const float4 turning = curl[slot], before = v.at[slot];
  const float3 push =
      cross({rise.x / length, rise.y / length, rise.z / length}, {turning.x, turning.y, turning.z});
  const float4 result =
      make_float4(v.scale * before.x + law.factor * push.x, v.scale * before.y + law.factor * push.y,
                  v.scale * before.z + law.factor * push.z, 0.0f);
  if constexpr (moves) {
    if (mine) after[slot] = result;
  } else {
    scatter(out, staged, mine ? __float_as_int(f.x[slot].w) : -1, {result.x, result.y, result.z});
  }
}

/// Velocities after viscosity, to `out` in the order of the input; and positions, where they moved.
template <bool moves>
static __global__ void __launch_bounds__(Policy::threads,
                                         moves ? Policy::reading_blocks_per_sm : Policy::blocks_per_sm)
    even_out(const __grid_constant__ Fluid f, const float4* velocity, float factor, float* out,
             float* positions) {
  constexpr Lists lists = moves ? Lists::read : Lists::unused;
  __shared__ Queue<lists> queue;
  __shared__ float staged[3 * Policy::threads];
  const auto [slot, mine] = own_slot(f);
  const float4 own = velocity[slot];
  float3 sum{0.0f, 0.0f, 0.0f};
  for_each_neighbour<moves, lists>(f, queue, slot, mine, [&](int j, const Pair& pair, float) {
    const float depth = depth_of(f, pair), weight = depth * depth * depth;
    const float4 other = velocity[j];
    sum.x += weight * (other.x - own.x);
    sum.y += weight * (other.y - own.y);
    sum.z += weight * (other.z - own.z);
  });
  const float4 x = f.x[slot];
  const int index = mine ? __float_as_int(x.w) : -1;
  scatter(out, staged, index, {own.x + factor * sum.x, own.y + factor * sum.y, own.z + factor * sum.z});
  if constexpr (moves) {
    const float4 shift = f.shift[slot];
    scatter(positions, staged, index, {x.x + shift.x, x.y + shift.y, x.z + shift.z});
  }
}

// ---- On the host ----

inline double poly6_factor(float h) {
  return 315 / (64 * std::numbers::pi) / std::pow(static_cast<double>(h), 3);
}
inline double spiky_factor(float h) {
  return 45 / std::numbers::pi / std::pow(static_cast<double>(h), 4);
}

/// Memory of a fluid and the launches on it, in the order in which a step goes: sort, iterations, velocities.
template <With with>
class Solver {
 public:
  /// For n particles. `lists`: more than one sweep sees the same positions. `iterations`: of the constraint.
  void allocate(const char* task, std::int64_t n, bool lists, int iterations) {
    if (n > (1 << 28)) throw std::runtime_error(std::string(task) + ": more than 2^28 particles");
    const auto count = static_cast<std::size_t>(n);
    grid_.template allocate<Particles<with>>(n);
    split_ = DeviceBuffer<Particle>(grid_.records(n));
    sorted_[0] = DeviceBuffer<float4>(2 * count);
    codes_ = DeviceBuffer<unsigned>(count + padding);
    if constexpr (kMoves) places_[0] = DeviceBuffer<int4>(count);
    if (lists) {
      hits_ = DeviceBuffer<int>(static_cast<std::size_t>(Policy::listed) * count);
      hit_count_ = DeviceBuffer<int>(count);
    }
    if (iterations > 0) {
      sorted_[1] = DeviceBuffer<float4>(2 * count);
      places_[1] = DeviceBuffer<int4>(count);
      moved_ = DeviceBuffer<float4>(count);
      now_ = DeviceBuffer<float>(3 * count);
    }
  }

  /// Sorts the particles. `predicted`, dt and g for With::step only.
  void sort(const float* x, const float* v, int n, float h, const float* predicted = nullptr, float dt = 0,
            float3 g = {0, 0, 0}) {
    source_ = {x,
               v,
               with == With::step ? predicted : x,
               {nullptr, nullptr},
               h,
               dt,
               g,
               units_of(h),
               split_.get(),
               sorted_[0].get(),
               codes_.get(),
               places_[0].get(),
               n};
    grid_.build(source_);
    fluid_ = {};
    fluid_.grid = grid_.grid();
    fluid_.start = grid_.start();
    fluid_.codes = codes_.get();
    fluid_.hits = hits_.get();
    fluid_.hit_count = hit_count_.get();
    fluid_.count = n;
    fluid_.units = source_.units;
    fluid_.h = h;
    const double reach = static_cast<double>(h) * (kMoves ? static_cast<double>(source_.units.per_metre) : 1);
    fluid_.inverse_h = static_cast<float>(1 / reach);
    fluid_.inverse_square = static_cast<float>(1 / (reach * reach));
    use(source_);
  }

  /// Jacobi iterations on the sorted particles, which are sorted again after each. If `out` is not null, only
  /// the positions after the last one are of interest: they go there, in the order of the input.
  void solve(float rho0, float eps, float k_corr, float dq, int iterations, float* out) {
    const double reference = 1 - static_cast<double>(dq) * static_cast<double>(dq);
    const auto rest = static_cast<double>(rho0);
    const Constraint law{static_cast<float>(poly6_factor(fluid_.h) / rest),
                         static_cast<float>(spiky_factor(fluid_.h) / rest), eps,
                         static_cast<float>(static_cast<double>(k_corr) / std::pow(reference, 12))};
    for (int k = 0; k < iterations; ++k) {
      find_lambda<<<blocks(), Policy::threads>>>(fluid_, law, places_[1].get());
      fluid_.places = places_[1].get();
      const bool last = k + 1 == iterations && out != nullptr;
      move<<<blocks(), Policy::threads>>>(fluid_, law, Moved{moved_.get(), now_.get(), last ? out : nullptr});
      if (last) break;
      source_.now = now_.get();
      source_.before = {fluid_.x, moved_.get()};
      source_.sorted = sorted_[1 - k % 2].get();
      grid_.build(source_);
      use(source_);
    }
  }

  /// Vorticity confinement of the velocities `v`: into `after` (of particles that moved) or `out`.
  template <bool moves>
  void confine_vorticity(const Velocities& v, float epsilon, float dt, float4* curl, float* size,
                         float4* after, float* out) {
    const double spiky = spiky_factor(fluid_.h);
    const Confinement law{static_cast<float>(static_cast<double>(dt) * static_cast<double>(epsilon) * spiky),
                          static_cast<float>(0x1p-20 / spiky / spiky)};
    find_vorticity<moves><<<blocks(), Policy::threads>>>(fluid_, v, curl, size);
    confine<moves><<<blocks(), Policy::threads>>>(fluid_, v, law, curl, size, after, out);
  }

  /// Viscosity of the velocities `v`.
  template <bool moves>
  void viscosity(const float4* v, float c, float* out, float* positions) {
    const auto factor = static_cast<float>(static_cast<double>(c) * poly6_factor(fluid_.h));
    even_out<moves><<<blocks(), Policy::threads>>>(fluid_, v, factor, out, positions);
  }

  /// The second half of the sorted particles: velocity or displacement.
  const float4* other() const { return fluid_.shift; }

 private:
  static constexpr bool kMoves = with != With::velocity;

  void use(const Particles<with>& sorted) {
    fluid_.x = sorted.sorted;
    fluid_.shift = sorted.sorted + sorted.count;
    fluid_.places = sorted.places;
  }

  unsigned blocks() const {
    return static_cast<unsigned>((fluid_.count + Policy::threads - 1) / Policy::threads);
  }

  neighbour_grid::NeighbourGrid<GridPolicy> grid_;
  DeviceBuffer<Particle> split_;
  DeviceBuffer<float4> sorted_[2], moved_;
  DeviceBuffer<int4> places_[2];
  DeviceBuffer<unsigned> codes_;
  DeviceBuffer<int> hits_, hit_count_;
  DeviceBuffer<float> now_;
  Particles<with> source_{};
  Fluid fluid_{};
};

}  // namespace gpuphys::fluid
