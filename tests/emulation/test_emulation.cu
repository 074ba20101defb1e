// The emulation itself: kernels whose answer is known, and faults that it must name.
#include <gtest/gtest.h>

#include <cuda_pipeline.h>

#include <cstdlib>
#include <numeric>
#include <string>
#include <vector>

#include "references/common/device_buffer.cuh"
#include "references/common/primitives.hpp"

namespace {

using gpuphys::DeviceBuffer;

template <class T>
std::vector<T> read(const DeviceBuffer<T>& buffer, std::size_t n) {
  std::vector<T> values(n);
  cudaMemcpy(values.data(), buffer.get(), n * sizeof(T), cudaMemcpyDeviceToHost);
  return values;
}

/// What `body` throws.
template <class Body>
std::string message_of(const Body& body) {
  try {
    body();
  } catch (const std::exception& e) {
    return e.what();
  }
  return "nothing was thrown";
}

struct Seed {
  explicit Seed(const char* seed) { setenv("GPUPHYS_EMULATED_SEED", seed, 1); }
  ~Seed() { unsetenv("GPUPHYS_EMULATED_SEED"); }
};

// ---- What works ----

__global__ void number_threads(int* out, int nx, int ny) {
  const int x = blockIdx.x * blockDim.x + threadIdx.x, y = blockIdx.y * blockDim.y + threadIdx.y;
  const int z = blockIdx.z * blockDim.z + threadIdx.z;
  out[(z * ny + y) * nx + x] = (z * ny + y) * nx + x;
}

TEST(Emulation, EveryThreadOfAThreeDimensionalLaunchRuns) {
  for (const char* seed : {"0", "1", "5"}) {
    Seed use(seed);
    DeviceBuffer<int> out(12 * 10 * 6);
    number_threads<<<dim3(3, 5, 2), dim3(4, 2, 3)>>>(out.get(), 12, 10);
    const std::vector<int> values = read(out, 12 * 10 * 6);
    for (int i = 0; i < 12 * 10 * 6; ++i) ASSERT_EQ(values[static_cast<std::size_t>(i)], i);
  }
}

template <int Threads>
__global__ void reverse(const int* in, int* out) {
  __shared__ int values[Threads];
  values[threadIdx.x] = in[blockIdx.x * Threads + threadIdx.x];
  __syncthreads();
  out[blockIdx.x * Threads + threadIdx.x] = values[Threads - 1 - threadIdx.x];
}

TEST(Emulation, SharedMemoryAndBarriers) {
  DeviceBuffer<int> in(300), out(300);
  std::vector<int> numbers(300);
  std::iota(numbers.begin(), numbers.end(), 0);
  cudaMemcpy(in.get(), numbers.data(), 300 * sizeof(int), cudaMemcpyHostToDevice);
  reverse<100><<<3, 100>>>(in.get(), out.get());
  const std::vector<int> values = read(out, 300);
  for (int i = 0; i < 300; ++i) EXPECT_EQ(values[static_cast<std::size_t>(i)], i / 100 * 100 + 99 - i % 100);
}

__global__ void votes(int* out) {
  const int t = static_cast<int>(threadIdx.x);
  const int count = __syncthreads_count(t % 3 == 0), any = __syncthreads_or(t == 77);
  const int all = __syncthreads_and(t < 90), none = __syncthreads_or(t > 1000);
  if (t == 5) out[0] = count, out[1] = any, out[2] = all, out[3] = none;
}

TEST(Emulation, BarriersThatVote) {
  DeviceBuffer<int> out(4);
  votes<<<1, 100>>>(out.get());
  EXPECT_EQ(read(out, 4), (std::vector<int>{34, 1, 0, 0}));
}

__global__ void warp_intrinsics(int* out) {
  const int t = static_cast<int>(threadIdx.x), lane = t % 32;
  constexpr unsigned all = 0xffffffffu;
  int* o = out + t;
  o[0 * 64] = __shfl_sync(all, 10 * t, 7);
  o[1 * 64] = __shfl_sync(all, t, lane + 1, 8);
  o[2 * 64] = __shfl_up_sync(all, t, 3);
  o[3 * 64] = __shfl_down_sync(all, t, 3, 16);
  o[4 * 64] = __shfl_xor_sync(all, t, 5);
  o[5 * 64] = static_cast<int>(__ballot_sync(all, lane % 2));
  o[6 * 64] = __reduce_add_sync(all, t);
  o[7 * 64] = __reduce_min_sync(all, -t);
  o[8 * 64] = static_cast<int>(__match_any_sync(all, lane / 10));
  // Half of the lanes each, at the same time.
  if (lane < 16)
    o[9 * 64] = __reduce_max_sync(0x0000ffffu, t);
  else
    o[9 * 64] = __reduce_max_sync(0xffff0000u, -t);
  o[10 * 64] = static_cast<int>(__shfl_sync(all, 1e100 * t, 2) / 1e100 + 0.5);
}

TEST(Emulation, WarpIntrinsics) {
  for (const char* seed : {"0", "1", "9"}) {
    Seed use(seed);
    DeviceBuffer<int> out(11 * 64);
    warp_intrinsics<<<1, 64>>>(out.get());
    const std::vector<int> v = read(out, 11 * 64);
    for (int t = 0; t < 64; ++t) {
      const int lane = t % 32, base = t - lane;
      const auto got = [&](int row) { return v[static_cast<std::size_t>(row * 64 + t)]; };
      EXPECT_EQ(got(0), 10 * (base + 7));
      EXPECT_EQ(got(1), t / 8 * 8 + (t + 1) % 8);
      EXPECT_EQ(got(2), lane < 3 ? t : t - 3);
      EXPECT_EQ(got(3), t % 16 + 3 < 16 ? t + 3 : t);
      EXPECT_EQ(got(4), t ^ 5);
      EXPECT_EQ(got(5), static_cast<int>(0xaaaaaaaau));
      EXPECT_EQ(got(6), 32 * base + 496);
      EXPECT_EQ(got(7), -(base + 31));
      unsigned same = 0;
      for (int l = 0; l < 32; ++l) same |= static_cast<unsigned>(l / 10 == lane / 10) << l;
      EXPECT_EQ(got(8), static_cast<int>(same));
      EXPECT_EQ(got(9), lane < 16 ? base + 15 : -(base + 16));
      EXPECT_EQ(got(10), base + 2);
    }
  }
}

__global__ void ended_lanes(int* out) {
  if (threadIdx.x >= 20) return;
  __syncthreads();
  out[threadIdx.x] = static_cast<int>(__ballot_sync(0xffffffffu, 1));
}

TEST(Emulation, NobodyWaitsForThreadsThatHaveEnded) {
  DeviceBuffer<int> out(20);
  ended_lanes<<<1, 50>>>(out.get());
  for (const int ballot : read(out, 20)) EXPECT_EQ(ballot, (1 << 20) - 1);
}

__global__ void atomics(int* numbers, float4* sums, unsigned* largest, int* changed) {
  atomicAdd(numbers, 3);
  atomicAdd(sums, make_float4(1.0f, 2.0f, 3.0f, 4.0f));
  atomicMax(largest, blockIdx.x * blockDim.x + threadIdx.x);
  if (atomicCAS(changed, 0, 1) == 0) atomicAdd_block(changed + 1, 1);
}

TEST(Emulation, Atomics) {
  DeviceBuffer<int> numbers(1), changed(2);
  DeviceBuffer<float4> sums(1);
  DeviceBuffer<unsigned> largest(1);
  cudaMemset(numbers.get(), 0, 4), cudaMemset(changed.get(), 0, 8);
  cudaMemset(sums.get(), 0, 16), cudaMemset(largest.get(), 0, 4);
  atomics<<<4, 33>>>(numbers.get(), sums.get(), largest.get(), changed.get());
  EXPECT_EQ(read(numbers, 1)[0], 3 * 132);
  EXPECT_EQ(read(sums, 1)[0].w, 4.0f * 132);
  EXPECT_EQ(read(largest, 1)[0], 131u);
  EXPECT_EQ(read(changed, 2), (std::vector<int>{1, 1}));
}

__global__ void through_dynamic(int* out, int n) {
  extern __shared__ int values[];
  for (int i = static_cast<int>(threadIdx.x); i < n; i += static_cast<int>(blockDim.x)) values[i] = i;
  __syncthreads();
  if (threadIdx.x == 0) *out = values[n - 1];
}

TEST(Emulation, DynamicSharedMemoryBeyond48KbIsOptedIn) {
  DeviceBuffer<int> out(1);
  const std::size_t bytes = 60 * 1024;
  const auto launch = [&] { through_dynamic<<<1, 32, bytes>>>(out.get(), static_cast<int>(bytes / 4)); };
  EXPECT_NE(message_of(launch).find("61440 bytes of dynamic shared memory, 49152 are allowed"),
            std::string::npos);
  EXPECT_EQ(cudaFuncSetAttribute(through_dynamic, cudaFuncAttributeMaxDynamicSharedMemorySize, 60 * 1024),
            cudaSuccess);
  launch();
  EXPECT_EQ(read(out, 1)[0], 60 * 256 - 1);
  EXPECT_NE(cudaFuncSetAttribute(through_dynamic, cudaFuncAttributeMaxDynamicSharedMemorySize, 300 * 1024),
            cudaSuccess);
}

__global__ void wait_for_flag(volatile int* flag, int* out) {
  if (threadIdx.x == 0) {
    while (*flag == 0) __threadfence();
    *out = 1;
  } else if (threadIdx.x == 40) {
    *flag = 1;
  }
}

TEST(Emulation, AThreadMayWaitForAFlagOfAnother) {
  DeviceBuffer<int> flag(1), out(1);
  cudaMemset(flag.get(), 0, 4);
  wait_for_flag<<<1, 64>>>(flag.get(), out.get());
  EXPECT_EQ(read(out, 1)[0], 1);
}

TEST(Emulation, DirectedRoundingAndFastDivision) {
  EXPECT_EQ(__fadd_rd(1.0f, 0x1p-30f), 1.0f);
  EXPECT_EQ(__fadd_ru(1.0f, 0x1p-30f), 1.0f + 0x1p-23f);
  EXPECT_EQ(__fadd_rd(1.0f, -0x1p-60f), 1.0f - 0x1p-24f);
  EXPECT_EQ(__fmul_ru(1.0f + 0x1p-23f, 1.0f + 0x1p-23f), 1.0f + 0x1p-22f + 0x1p-23f);
  EXPECT_EQ(__fdividef(1.0f, 0x1.8p126f), 0.0f);
  EXPECT_EQ(__float2int_rn(1e20f), 2147483647);
  EXPECT_EQ(__float2int_rd(-2.5f), -3);
  EXPECT_EQ(__clz(0), 32);
  EXPECT_EQ(__ffs(8), 4);
  EXPECT_EQ(__brev(1u), 0x80000000u);
  EXPECT_EQ(__umulhi(0x80000000u, 6u), 3u);
  EXPECT_EQ(__dp4a(0x01ff0203, 0x01020304, 10), 10 + 1 - 2 + 6 + 12);
}

TEST(Emulation, Primitives) {
  const std::vector<std::uint32_t> keys{0x13, 0x21, 0x12, 0x01}, values{1, 2, 3, 4};
  std::vector<std::uint32_t> keys_out(4), values_out(4);
  std::vector<char> scratch(gpuphys::primitives::sort_pairs_bytes(4));
  gpuphys::primitives::sort_pairs(scratch.data(), scratch.size(), keys.data(), keys_out.data(), values.data(),
                                  values_out.data(), 4, 0, 4);
  EXPECT_EQ(values_out, (std::vector<std::uint32_t>{2, 4, 3, 1}));
}

// ---- What must be seen ----

__global__ void divergent_barriers(int* out) {
  if (threadIdx.x < 16)
    __syncthreads();
  else
    __syncthreads();
  *out = 1;
}
__global__ void barrier_within_a_warp_intrinsic(int* out) {
  if (threadIdx.x == 3)
    __syncthreads();
  else
    __shfl_sync(0xffffffffu, 1, 0);
  *out = 1;
}
__global__ void not_in_its_mask(int* out) {
  *out = __shfl_sync(0x0000ffffu, 1, 0);
}

TEST(Emulation, DivergenceIsNamed) {
  DeviceBuffer<int> out(1);
  EXPECT_NE(
      message_of([&] { divergent_barriers<<<1, 64>>>(out.get()); }).find("barrier divergence: thread 16"),
      std::string::npos);
  const std::string stuck = message_of([&] { barrier_within_a_warp_intrinsic<<<1, 32>>>(out.get()); });
  EXPECT_NE(stuck.find("the block is stuck"), std::string::npos) << stuck;
  EXPECT_NE(stuck.find("__shfl_sync in test_emulation.cu"), std::string::npos) << stuck;
  EXPECT_NE(message_of([&] { not_in_its_mask<<<1, 32>>>(out.get()); }).find("not in its own mask"),
            std::string::npos);
}

__global__ void missing_barrier(int* out) {
  __shared__ int values[64];
  values[threadIdx.x] = 1;
  out[threadIdx.x] = values[63 - threadIdx.x];
}
__global__ void never_written(float* out) {
  __shared__ float value;
  if (threadIdx.x > 100) value = 1.0f;
  *out = value;
}
__global__ void not_waited_for(const float4* in, float* out) {
  __shared__ float4 staged[32];
  __pipeline_memcpy_async(staged + threadIdx.x, in + threadIdx.x, 16);
  __pipeline_commit();
  out[threadIdx.x] = staged[threadIdx.x].x;
}

TEST(Emulation, WhatIsReadTooEarlyIsPoison) {
  DeviceBuffer<int> out(64);
  missing_barrier<<<2, 64>>>(out.get());
  int ones = 0;
  for (const int v : read(out, 64)) ones += v == 1;
  EXPECT_EQ(ones, 32);
  DeviceBuffer<float> value(32);
  never_written<<<1, 32>>>(value.get());
  EXPECT_TRUE(std::isnan(read(value, 1)[0]));
  DeviceBuffer<float4> in(32);
  cudaMemset(in.get(), 0, 32 * 16);
  not_waited_for<<<1, 32>>>(in.get(), value.get());
  EXPECT_TRUE(std::isnan(read(value, 32)[31]));
}

__global__ void write_at(int* out, int i) {
  out[i] = 1;
}
__global__ void last_block_wins(int* out) {
  *out = static_cast<int>(blockIdx.x);
}
__global__ void misaligned(const float* in, float4* out) {
  *out = __ldg(reinterpret_cast<const float4*>(in + 1));
}

TEST(Emulation, FaultsAreErrors) {
  EXPECT_NE(message_of([&] {
              DeviceBuffer<int> fresh(10);
              write_at<<<1, 1>>>(fresh.get(), 10);
            }).find("wrote beyond an allocation of 40 bytes"),
            std::string::npos);
  DeviceBuffer<int> out(10);
  EXPECT_NE(message_of([&] { write_at<<<0, 1>>>(out.get(), 0); }).find("a grid of 0 x 1 x 1"),
            std::string::npos);
  EXPECT_NE(message_of([&] { write_at<<<1, 1025>>>(out.get(), 0); }).find("1025 threads"), std::string::npos);
  DeviceBuffer<float> in(8);
  DeviceBuffer<float4> result(1);
  EXPECT_NE(message_of([&] { misaligned<<<1, 1>>>(in.get(), result.get()); }).find("misaligned address"),
            std::string::npos);
}

TEST(Emulation, TheSeedSetsTheOrderOfBlocks) {
  DeviceBuffer<int> out(1);
  last_block_wins<<<8, 1>>>(out.get());
  EXPECT_EQ(read(out, 1)[0], 7);
  Seed use("1");
  last_block_wins<<<8, 1>>>(out.get());
  EXPECT_EQ(read(out, 1)[0], 0);
}

}  // namespace
