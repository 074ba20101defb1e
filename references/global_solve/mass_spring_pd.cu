// mass_spring_pd: local-global iterations of projective dynamics for springs in random order, FP32.
//
// Particles are renumbered along a Morton curve (spatial_order.cuh), springs become rows of their particles
// (spring_rows.cuh). An iteration is the residual of the global step, mass (y - z) + dt^2 k sum (L d / |d| -
// d), formed row by row without atomics, and the solve of A (z' - z) = residual by Chebyshev's iteration
// (chebyshev.cuh): the matrix is the same in all 30, so its bounds are read back once and everything else is
// queued at once.
//
// The unknown is the displacement from x. Global steps are solved to 1e-5 of their error in the norm of A. A
// thousandth, 40 % cheaper, would do for the paper's 30 iterations, which correct each other, but not for few
// ones or for stiff springs.
//
// What bounds it (n = 889 thousand, m = 7.82 million): the solves, about 130 iterations each at dt^2 k / mass
// = 10, of 63 MB of entries and 64 MB of vectors from device memory, and 18 look-ups of 16 bytes a row in the
// L1. A multigrid hierarchy would need a tenth of the products; springs at random have none that comes for
// free.
#include "cases/global_solve/mass_spring_pd.hpp"

#include <climits>
#include <stdexcept>

#include "core/contract/module.hpp"
#include "references/blocks/chebyshev.cuh"
#include "references/global_solve/displaced_particles.cuh"
#include "references/global_solve/spring_rows.cuh"

// With GPUPHYS_OTHER_BLOCKS eight lanes share a row, and blocks have 128 threads (laplacian_rows.cuh,
// displaced_particles.cuh).
namespace gpuphys::mass_spring_pd {
namespace {

constexpr double kPartOfError = 1e-5;  // that a global step may leave

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.mass.shape[0], m = in.rest.shape[0];
    if (n > INT_MAX / 8 || m > INT_MAX / 2)
      throw std::runtime_error("mass_spring_pd: more particles or springs than 32 bits count");
    body_ = displaced::Body(static_cast<int>(n));
    springs_ = springs::SpringRows(static_cast<int>(n), static_cast<int>(m));
    solver_ = chebyshev::Solver(static_cast<int>(n));
    residual_ = DeviceBuffer<float4>(static_cast<std::size_t>(n));
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const int n = body_.size();
    body_.place(in);
    const displaced::Particles particles = body_.particles();
    const float kappa = in.dt * in.dt * in.k;
    if (in.iters > 0) {
      springs_.build(in.springs.data, in.rest.data, body_.number());
      const rows::Rows rows = springs_.rows(kappa, particles.mass);
      solver_.prepare(rows, kPartOfError);
      const float4* step = nullptr;
      for (int k = 0; k < in.iters; ++k) {
        displaced::advance<<<displaced::blocks_for(n), displaced::kThreads>>>(particles, step, n,
                                                                              residual_.get());
        springs::add_pulls<<<displaced::blocks_for(std::int64_t{rows::kLanes} * n), displaced::kThreads>>>(
            rows, springs_.length(), particles, kappa, residual_.get());
        step = solver_.solve(residual_.get());
      }
      displaced::advance<<<displaced::blocks_for(n), displaced::kThreads>>>(particles, step, n,
                                                                            residual_.get());
    }
    body_.write(in, out);
  }

 private:
  displaced::Body body_;
  springs::SpringRows springs_;
  chebyshev::Solver solver_;
  DeviceBuffer<float4> residual_;
};

}  // namespace
}  // namespace gpuphys::mass_spring_pd

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(mass_spring_pd, mass_spring_pd::Reference)
}
