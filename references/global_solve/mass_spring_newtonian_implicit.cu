// mass_spring_newtonian_implicit: backward Euler for springs in random order by Newton's method
// (newton_step.cuh), FP32.
//
// Particles are renumbered along a Morton curve (spatial_order.cuh), springs become rows of their particles
// (spring_rows.cuh), so that forces and products are gathered, four lanes a row, without atomics. Of the
// Hessian of each spring, k (n n^T + (1 - L/l)(I - n n^T)), the part across the spring is left out where it
// is negative; per Newton step its direction and the part across are stored with the entry, 16 bytes.
//
// What bounds it (n = 889 thousand, m = 7.82 million): some 45 products in each of two or three steps, of 313
// MB of entries from device memory and 18 look-ups of 16 bytes a row, and 13 vectors besides. With
// GPUPHYS_OTHER_BLOCKS eight lanes share a row.
#include "cases/global_solve/mass_spring_newtonian_implicit.hpp"

#include <climits>
#include <stdexcept>

#include "cases/global_solve/poisson_neumann.hpp"
#include "core/contract/module.hpp"
#include "references/global_solve/multigrid_solver.cuh"
#include "references/global_solve/newton_step.cuh"
#include "references/global_solve/spring_rows.cuh"

namespace gpuphys::mass_spring_newtonian_implicit {
namespace {

using displaced::Particles;

// Minus the gradient, and the value, of Phi at u. A spring's energy belongs to its ends by halves.
__global__ void __launch_bounds__(cg::kThreads)
    evaluate(rows::Rows rows, const float* __restrict__ length, Particles p, const float4* __restrict__ u,
             float kappa, float4* __restrict__ residual, float* __restrict__ partials, newton::Value* value) {
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = thread / rows::kLanes, lane = thread % rows::kLanes;
  const bool there = i < rows.n;
  float sx = 0.0f, sy = 0.0f, sz = 0.0f;
  float sum[2] = {0.0f, 0.0f};
  float4 own = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  if (there) {
    const float4 x = p.position[i];
    own = u[i];
    const int end = rows.first[i + 1];
    for (int e = rows.first[i] + lane; e < end; e += rows::kLanes) {
      const int j = rows.other[e];
      const float4 xj = p.position[j], uj = u[j];
      const float dx = (x.x - xj.x) + (own.x - uj.x), dy = (x.y - xj.y) + (own.y - uj.y),
                  dz = (x.z - xj.z) + (own.z - uj.z);
      const float now = sqrtf(dx * dx + dy * dy + dz * dz), stretch = now - length[e];
      sum[0] += 0.25f * kappa * stretch * stretch;
      if (now == 0.0f) continue;
      const float pull = -stretch / now;
      sx += pull * dx;
      sy += pull * dy;
      sz += pull * dz;
    }
  }
  sx = rows::sum_lanes(sx);
  sy = rows::sum_lanes(sy);
  sz = rows::sum_lanes(sz);
  if (there && lane == 0) {
    const float4 t = p.target[i];
    const float mass = p.mass[i], ox = t.x - own.x, oy = t.y - own.y, oz = t.z - own.z;
    const float4 r =
        make_float4(mass * ox + kappa * sx, mass * oy + kappa * sy, mass * oz + kappa * sz, 0.0f);
    residual[i] = r;
    sum[0] += 0.5f * mass * (ox * ox + oy * oy + oz * oz);
    sum[1] = cg::dot(r, r);
  }
  if (!cg::sum_everything(sum, partials, &value->finished)) return;
  value->energy = sum[0];
  value->gradient2 = sum[1];
}

// Direction and part across of each entry's spring, and the inverse of the Hessian's diagonal.
__global__ void __launch_bounds__(cg::kThreads)
    linearise(rows::Rows rows, const float* __restrict__ length, Particles p, const float4* __restrict__ u,
              float kappa, float4* __restrict__ entry, float4* __restrict__ inverse_diagonal) {
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = thread / rows::kLanes, lane = thread % rows::kLanes;
  const bool there = i < rows.n;
  float sx = 0.0f, sy = 0.0f, sz = 0.0f;
  if (there) {
    const float4 x = p.position[i], own = u[i];
    const int end = rows.first[i + 1];
    for (int e = rows.first[i] + lane; e < end; e += rows::kLanes) {
      const int j = rows.other[e];
      const float4 xj = p.position[j], uj = u[j];
      const float dx = (x.x - xj.x) + (own.x - uj.x), dy = (x.y - xj.y) + (own.y - uj.y),
                  dz = (x.z - xj.z) + (own.z - uj.z);
      const float now = sqrtf(dx * dx + dy * dy + dz * dz), rest = length[e];
      const float inverse = now == 0.0f ? 0.0f : 1.0f / now;
      const float across = now == 0.0f ? (rest == 0.0f ? 1.0f : 0.0f) : fmaxf(0.0f, (now - rest) * inverse);
      const float nx = dx * inverse, ny = dy * inverse, nz = dz * inverse;
      entry[e] = make_float4(nx, ny, nz, across);
      sx += across + (1.0f - across) * nx * nx;
      sy += across + (1.0f - across) * ny * ny;
      sz += across + (1.0f - across) * nz * nz;
    }
  }
  sx = rows::sum_lanes(sx);
  sy = rows::sum_lanes(sy);
  sz = rows::sum_lanes(sz);
  if (!there || lane != 0) return;
  const float mass = p.mass[i];
  inverse_diagonal[i] =
      make_float4(1.0f / (mass + kappa * sx), 1.0f / (mass + kappa * sy), 1.0f / (mass + kappa * sz), 0.0f);
}

// q = (M + dt^2 K) p.
__global__ void __launch_bounds__(cg::kThreads)
    apply(rows::Rows rows, const float4* __restrict__ entry, float kappa, const float4* __restrict__ p,
          float4* __restrict__ q, const cg::State* __restrict__ state) {
  if (state->status != 0) return;
  const int thread = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int i = thread / rows::kLanes, lane = thread % rows::kLanes;
  const bool there = i < rows.n;
  float sx = 0.0f, sy = 0.0f, sz = 0.0f;
  float4 own = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  if (there) {
    own = p[i];
    const int end = rows.first[i + 1];
#pragma unroll 2
    for (int e = rows.first[i] + lane; e < end; e += rows::kLanes) {
      const float4 s = __ldcs(entry + e), other = p[rows.other[e]];
      const float dx = own.x - other.x, dy = own.y - other.y, dz = own.z - other.z;
      const float along = (1.0f - s.w) * (s.x * dx + s.y * dy + s.z * dz);
      sx += s.w * dx + along * s.x;
      sy += s.w * dy + along * s.y;
      sz += s.w * dz + along * s.z;
    }
  }
  sx = rows::sum_lanes(sx);
  sy = rows::sum_lanes(sy);
  sz = rows::sum_lanes(sz);
  if (!there || lane != 0) return;
  const float mass = rows.mass[i];
  q[i] = make_float4(mass * own.x + kappa * sx, mass * own.y + kappa * sy, mass * own.z + kappa * sz, 0.0f);
}

struct Springs {
  rows::Rows rows;
  const float* length;
  Particles particles;
  float kappa;
  float4* entry;
  float* partials;

  unsigned blocks() const {
    return static_cast<unsigned>((std::int64_t{rows::kLanes} * rows.n + cg::kThreads - 1) / cg::kThreads);
  }
  void evaluate(const float4* u, float4* residual, newton::Value* value) const {
    mass_spring_newtonian_implicit::evaluate<<<blocks(), cg::kThreads>>>(rows, length, particles, u, kappa,
                                                                         residual, partials, value);
  }
  void linearise(const float4* u, float4* inverse_diagonal) const {
    mass_spring_newtonian_implicit::linearise<<<blocks(), cg::kThreads>>>(rows, length, particles, u, kappa,
                                                                          entry, inverse_diagonal);
  }
  void apply(const float4* p, float4* q, const cg::State* state) const {
    mass_spring_newtonian_implicit::apply<<<blocks(), cg::kThreads>>>(rows, entry, kappa, p, q, state);
  }
};

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.mass.shape[0], m = in.rest.shape[0];
    if (n > INT_MAX / 8 || m > INT_MAX / 2)
      throw std::runtime_error(
          "mass_spring_newtonian_implicit: more particles or springs than 32 bits count");
    body_ = displaced::Body(static_cast<int>(n));
    rows_ = springs::SpringRows(static_cast<int>(n), static_cast<int>(m));
    newton_ = newton::Newton(static_cast<int>(n));
    entry_ = DeviceBuffer<float4>(2 * static_cast<std::size_t>(m));
    partials_ = DeviceBuffer<float>(2 * static_cast<std::size_t>(rows::kLanes * n / cg::kThreads + 1));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    body_.place(in);
    const Particles particles = body_.particles();
    rows_.build(in.springs.data, in.rest.data, body_.number());
    const float kappa = in.dt * in.dt * in.k;
    newton_.minimise(particles, in.tol, "mass_spring_newtonian_implicit",
                     Springs{rows_.rows(kappa, particles.mass), rows_.length(), particles, kappa,
                             entry_.get(), partials_.get()});
    newton_.write(in, body_, out);
  }

 private:
  displaced::Body body_;
  springs::SpringRows rows_;
  newton::Newton newton_;
  DeviceBuffer<float4> entry_;
  DeviceBuffer<float> partials_;
};

}  // namespace
}  // namespace gpuphys::mass_spring_newtonian_implicit

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(mass_spring_newtonian_implicit, mass_spring_newtonian_implicit::Reference)
}
