// self_collision_xpbd in FP32: Jacobi sweeps of XPBD over the contacts of cloth particles.
//
// Particles are sorted into the cells of a grid and from then on stand in that order; each gets a row of the
// particles nearer than the search radius, found once (references/blocks/contact_rows.cuh). In a sweep a
// thread gathers the displacement of its particle from its row: the other end's position and displacement,
// and a multiplier of its own that equals the other end's bit by bit. Displacements are kept apart from
// positions, so that they keep their digits where coordinates are large; one addition at the end rounds.
//
// What bounds it: everything is in L2. The search reads some 17 candidates a particle, a sweep 40 bytes for
// each end of a contact (2 million) and 40 for each particle that has any.
#include "cases/position_constraint/self_collision_xpbd.hpp"

#include <climits>
#include <stdexcept>
#include <utility>

#include "core/contract/module.hpp"
#include "references/blocks/contact_rows.cuh"

namespace gpuphys::self_collision_xpbd {
namespace {

#ifdef GPUPHYS_OTHER_BLOCKS  // contact_rows.cuh has others as well
constexpr int kWriteThreads = 128;
#else
constexpr int kWriteThreads = 256;
#endif

// Positions back in input order; those without a contact as they were. NaN if the contacts did not fit.
__global__ void __launch_bounds__(kWriteThreads)
    write_positions(const float4* __restrict__ base, const float4* __restrict__ step,
                    const std::int32_t* __restrict__ number, contacts::Scratch s, float* __restrict__ x_new) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= s.n) return;
  const int place = number[i];
  float4 p = base[place];
  if (s.rows[place].y > 0) {
    const float4 moved = step[place];
    p = make_float4(p.x + moved.x, p.y + moved.y, p.z + moved.z, 0.0f);
  }
  if (s.head->used > static_cast<unsigned long long>(s.capacity)) p.x = __int_as_float(0x7fc00000);
  x_new[3 * i] = p.x;
  x_new[3 * i + 1] = p.y;
  x_new[3 * i + 2] = p.z;
}

class Reference {
 public:
  void allocate(const Inputs& in, const Outputs<float>&) {
    const std::size_t n = static_cast<std::size_t>(in.x.shape[0]);
    rows_ = contacts::ContactRows(in.x.shape[0]);
    base_ = DeviceBuffer<float4>(n);
    for (DeviceBuffer<float4>& step : step_) step = DeviceBuffer<float4>(n);
    number_ = DeviceBuffer<std::int32_t>(n);
  }

  void compute(const Inputs& in, const Outputs<float>& out) {
    const std::int64_t n = in.x.shape[0];
    if (in.iters <= 0) {
      GPUPHYS_CUDA(cudaMemcpyAsync(out.x_new.data, in.x.data, 3 * sizeof(float) * static_cast<std::size_t>(n),
                                   cudaMemcpyDeviceToDevice));
      return;
    }
    const contacts::Scratch s = rows_.build(
        contacts::InputParticles{in.x.data, in.inv_mass.data, base_.get(), number_.get()}, in.search_radius);
    const contacts::Contact contact{in.thickness, in.compliance / (in.dt * in.dt), in.relaxation};
    float4* now = step_[0].get();
    float4* next = step_[1].get();
    for (int k = 0; k < in.iters; ++k) {
      rows_.sweep<true>(s, contact, k == 0, base_.get(), now, next);
      std::swap(now, next);
    }
    write_positions<<<static_cast<unsigned>((n + kWriteThreads - 1) / kWriteThreads), kWriteThreads>>>(
        base_.get(), now, number_.get(), s, out.x_new.data);
  }

 private:
  contacts::ContactRows rows_;
  DeviceBuffer<float4> base_, step_[2];
  DeviceBuffer<std::int32_t> number_;
};

}  // namespace
}  // namespace gpuphys::self_collision_xpbd

namespace gpuphys {
GPUPHYS_DEVICE_MODULE(self_collision_xpbd, self_collision_xpbd::Reference)
}
