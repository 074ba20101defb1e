// solve_constraint_xpbd: 8 Jacobi iterations of compliant distance constraints, averaged by valence, FP32.
//
// Particles and springs come in random order. Particles are renumbered along a Morton curve; springs are
// sorted into rows, one a particle, each spring in the rows of both ends, by bins of 1024 particles in shared
// memory (spring_rows.cuh). An iteration then gathers: `lanes` threads a particle read its row, fetch the
// other ends, and add up the particle's displacement. Multipliers live beside the row entries and are
// advanced identically at both ends, so there are no atomics and no second pass.
//
// Positions are held as input plus displacement: differences of inputs are exact or nearly so, displacements
// of a centimetre keep their digits, and one addition at the end rounds.
//
// What bounds it (n = 1.05 million, m = 6.28 million, 12.56 million half-springs; times predicted): an
// iteration streams 8 + 4 + 4 bytes a half-spring and 32 + 32 bytes a particle, 268 MB, 0.063 ms; and the L1
// looks up a line for each random particle, about 0.06 ms. Sorting moves 477 MB and gathers 12.56 million
// numbers, 0.3 ms. Measured by ncu on an H100 (3.0 TB/s): 262 MB and 0.09-0.107 ms an iteration, device
// memory 70-76 %. What pays: the sector-sized particle (position, inverse mass, displacement and valence of a
// neighbour in one access), fetched by two lanes together, which halves the look-ups; whole sectors stored;
// the Morton curve, so that most neighbours are in the L1 or the L2; and multisplits in shared memory in
// place of random stores, with runs of whole records, in one array, long against a sector.
#include "cases/position_constraint/solve_constraint_xpbd.hpp"

#include <climits>
#include <stdexcept>
#include <utility>

#include "core/module.hpp"
#include "references/position_constraint/spatial_order.cuh"
#include "references/position_constraint/spring_projection.cuh"

namespace gpuphys::solve_constraint_xpbd {
namespace {

struct Policy {
#ifdef GPUPHYS_OTHER_BLOCKS
  static constexpr int threads = 256;
  static constexpr int lanes = 8;
  static constexpr int unroll = 2;
  static constexpr int blocks = 100;
  static constexpr int count_threads = 256;
  static constexpr int split_merged = 4;
  static constexpr int split_threads = 256;
  static constexpr int split_items = 4;
  static constexpr bool wide_records = true;
  static constexpr int bin_shift = 9;
  static constexpr int sort_threads = 512;
  static constexpr int sort_capacity = 6000;
#else
  static constexpr int threads = 128;
  static constexpr int lanes = 4;     // a row of 12 half-springs is three full turns
  static constexpr int unroll = 3;    // and all of them are in flight at once
  static constexpr int blocks = 264;  // that sort a share of the springs: two a multiprocessor
  static constexpr int count_threads = 1024;
  static constexpr int split_merged = 2;
  static constexpr int split_threads = 1024;
  static constexpr int split_items = 8;  // 16384 half-springs sorted in 160 KB of shared memory
  static constexpr bool wide_records = false;
  static constexpr int bin_shift = 10;  // 1024 particles a bin, about 12 thousand half-springs
  static constexpr int sort_threads = 1024;
  static constexpr int sort_capacity = 13312;  // half-springs, 104 KB: two blocks a multiprocessor
#endif
};

unsigned blocks_for(int items) {
  return static_cast<unsigned>((items + Policy::threads - 1) / Policy::threads);
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::int64_t n = in.x.shape[0], m = in.rest.shape[0];
    // Half-springs and lanes are counted in int.
    if (n > INT_MAX / 16 || m > INT_MAX / 4)
      throw std::runtime_error("more particles or springs than 32 bits count");
    n_ = static_cast<int>(n);
    m_ = static_cast<int>(m);
    rows_ = springs::HalfSprings<Policy>(n_, m_);
    order_ = spatial::Order(n_);
    multiplier_ = DeviceBuffer<float>(2 * static_cast<std::size_t>(m));
    for (DeviceBuffer<springs::Particle>& p : particles_) {
      p = DeviceBuffer<springs::Particle>(static_cast<std::size_t>(n));
    }
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    if (n_ == 0) return;
    order_.build(in.x.data, n_, Policy::threads);
    springs::Particle* now = particles_[0].get();
    springs::Particle* next = particles_[1].get();
    rows_.build(reinterpret_cast<const int2*>(in.springs.data), in.rest.data, order_.number(), order_.order(),
                in.x.data, in.inv_mass.data, now);
    const float dt = in.dt;
    const float alpha = in.compliance / (dt * dt);
    const int iterations = in.iters;
    for (int k = 0; k < iterations; ++k) {
      springs::project<Policy::lanes, Policy::unroll><<<blocks_for(n_ * Policy::lanes), Policy::threads>>>(
          now, next, rows_.begin(), rows_.half(), multiplier_.get(), n_, alpha, k == 0, k == iterations - 1,
          k % 2 == 1);
      std::swap(now, next);
    }
    springs::write_positions<<<blocks_for(n_), Policy::threads>>>(now, order_.number(), n_, out.x_new.data);
  }

 private:
  int n_ = 0, m_ = 0;
  springs::HalfSprings<Policy> rows_;
  spatial::Order order_;
  DeviceBuffer<float> multiplier_;
  DeviceBuffer<springs::Particle> particles_[2];
};

}  // namespace
}  // namespace gpuphys::solve_constraint_xpbd

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(solve_constraint_xpbd, solve_constraint_xpbd::Reference)
}
