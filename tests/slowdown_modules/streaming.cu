// v = u + 1, one 16-byte word a thread, with GPUPHYS_SLOWDOWN_PERCENT per cent of the work: beyond 100 the
// threads start over at the first word, which by then has left the cache, as a careless kernel would read it
// again.
#include "core/contract/module.hpp"
#include "tests/slowdown_modules/target.hpp"

#ifndef GPUPHYS_SLOWDOWN_PERCENT
#error "compile with -DGPUPHYS_SLOWDOWN_PERCENT=100, 110, 125 or 200"
#endif

namespace gpuphys::slowdown_target {

constexpr int kThreads = 256;

__global__ void stream_kernel(float4* v, const float4* u, std::int64_t words, std::int64_t steps) {
  const std::int64_t step = static_cast<std::int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
  if (step >= steps) return;
  const std::int64_t i = step % words;
  const float4 w = u[i];
  v[i] = make_float4(w.x + 1, w.y + 1, w.z + 1, w.w + 1);
}

class Streaming {
 public:
  void allocate(const Inputs&, const Outputs<float>&) {}
  void compute(const Inputs& in, const Outputs<float>& out) {
    const std::int64_t words = in.u.size() / 4;
    if (words * 4 != in.u.size() || words == 0)
      throw std::runtime_error("n must be a positive multiple of 4");
    const std::int64_t steps = words * GPUPHYS_SLOWDOWN_PERCENT / 100;
    const auto blocks = static_cast<unsigned>((steps + kThreads - 1) / kThreads);
    stream_kernel<<<blocks, kThreads>>>(reinterpret_cast<float4*>(out.v.data),
                                        reinterpret_cast<const float4*>(in.u.data), words, steps);
  }
};

}  // namespace gpuphys::slowdown_target

GPUPHYS_DEVICE_MODULE(slowdown_target, gpuphys::slowdown_target::Streaming)
