// Kernels with which the harness guards, poisons, hashes and measures. One element or one 16-byte word a
// thread and step, grid-stride, so that any size fits one launch.
#include <cstring>

#include "core/generators/random.hpp"
#include "core/run/gpu/cuda_call.hpp"
#include "core/run/gpu/device_kernels.hpp"

namespace gpuphys::device {
namespace {

constexpr int kThreads = 256;
// Enough blocks to fill any present GPU several times over; the stride loop takes the rest.
constexpr std::size_t kMaxBlocks = 8192;

unsigned blocks_for(std::size_t items) {
  const std::size_t blocks = (items + kThreads - 1) / kThreads;
  return static_cast<unsigned>(blocks < 1 ? 1 : blocks > kMaxBlocks ? kMaxBlocks : blocks);
}

__device__ std::size_t first_item() {
  return static_cast<std::size_t>(blockIdx.x) * blockDim.x + threadIdx.x;
}
__device__ std::size_t stride() {
  return static_cast<std::size_t>(gridDim.x) * blockDim.x;
}

template <class T>
__global__ void fill_kernel(T* data, std::size_t count, T value) {
  for (std::size_t i = first_item(); i < count; i += stride()) data[i] = value;
}

template <class T>
void fill_with(void* data, std::size_t count, const void* element) {
  T value;
  std::memcpy(&value, element, sizeof(T));
  fill_kernel<<<blocks_for(count), kThreads>>>(static_cast<T*>(data), count, value);
}

__global__ void count_other_kernel(const unsigned char* data, std::size_t bytes, unsigned char value,
                                   unsigned long long* counter) {
  unsigned long long mine = 0;
  for (std::size_t i = first_item(); i < bytes; i += stride()) mine += data[i] != value;
  if (mine != 0) atomicAdd(counter, mine);
}

__global__ void hash_kernel(const unsigned char* data, std::size_t bytes, unsigned long long* sum) {
  const std::size_t words = bytes / 8;
  const auto* word = reinterpret_cast<const std::uint64_t*>(data);
  unsigned long long mine = 0;
  for (std::size_t i = first_item(); i < words; i += stride()) mine += random_bits(word[i], 0, i);
  // The last, partial word.
  if (first_item() == 0 && bytes % 8 != 0) {
    std::uint64_t last = 0;
    for (std::size_t b = words * 8; b < bytes; ++b) last = last << 8 | data[b];
    mine += random_bits(last, 1, words);
  }
  for (int lane = 16; lane > 0; lane /= 2) mine += __shfl_down_sync(0xFFFFFFFFu, mine, lane);
  if (threadIdx.x % 32 == 0) atomicAdd(sum, mine);
}

__global__ void read_kernel(const uint4* data, std::size_t words, std::uint32_t* sink) {
  std::uint32_t mix = 0;
  for (std::size_t i = first_item(); i < words; i += stride()) {
    const uint4 w = data[i];
    mix ^= w.x + 3u * w.y + 5u * w.z + 7u * w.w;
  }
  if (mix == 0x9E3779B9u) *sink = mix;
}

__global__ void copy_kernel(uint4* to, const uint4* from, std::size_t words) {
  for (std::size_t i = first_item(); i < words; i += stride()) to[i] = from[i];
}

constexpr int kChains = 8;  // independent chains a thread: more than the latency of an FMA

__global__ void __launch_bounds__(kThreads) multiply_add_kernel(int rounds, float factor, float* sink) {
  float x[kChains];
  for (int c = 0; c < kChains; ++c) x[c] = static_cast<float>(threadIdx.x + c);
  for (int r = 0; r < rounds; ++r) {
#pragma unroll
    for (int c = 0; c < kChains; ++c) x[c] = fmaf(x[c], factor, 1.0f);
  }
  float sum = 0;
  for (int c = 0; c < kChains; ++c) sum += x[c];
  if (sum == -1.0f) *sink = sum;
}

__global__ void empty_kernel() {}

}  // namespace

void fill(void* data, std::size_t count, const void* element, std::size_t element_bytes) {
  if (count == 0) return;
  if (element_bytes == 1) fill_with<std::uint8_t>(data, count, element);
  if (element_bytes == 4) fill_with<std::uint32_t>(data, count, element);
  if (element_bytes == 8) fill_with<std::uint64_t>(data, count, element);
  GPUPHYS_CUDA_CALL(cudaGetLastError());
}

void count_other_bytes(const void* data, std::size_t bytes, unsigned char value, std::uint64_t* counter) {
  if (bytes == 0) return;
  count_other_kernel<<<blocks_for(bytes), kThreads>>>(static_cast<const unsigned char*>(data), bytes, value,
                                                      reinterpret_cast<unsigned long long*>(counter));
  GPUPHYS_CUDA_CALL(cudaGetLastError());
}

void hash(const void* data, std::size_t bytes, std::uint64_t* sum) {
  if (bytes == 0) return;
  hash_kernel<<<blocks_for(bytes / 8 + 1), kThreads>>>(static_cast<const unsigned char*>(data), bytes,
                                                       reinterpret_cast<unsigned long long*>(sum));
  GPUPHYS_CUDA_CALL(cudaGetLastError());
}

void read_all(const void* data, std::size_t bytes, std::uint32_t* sink) {
  read_kernel<<<blocks_for(bytes / 16), kThreads>>>(static_cast<const uint4*>(data), bytes / 16, sink);
  GPUPHYS_CUDA_CALL(cudaGetLastError());
}

void copy(void* to, const void* from, std::size_t bytes) {
  copy_kernel<<<blocks_for(bytes / 16), kThreads>>>(static_cast<uint4*>(to), static_cast<const uint4*>(from),
                                                    bytes / 16);
  GPUPHYS_CUDA_CALL(cudaGetLastError());
}

double multiply_add(int multiprocessors, int rounds, float* sink) {
  const int blocks = multiprocessors * 8;
  multiply_add_kernel<<<blocks, kThreads>>>(rounds, 0.5f, sink);
  GPUPHYS_CUDA_CALL(cudaGetLastError());
  return 2.0 * kChains * rounds * kThreads * blocks;
}

void empty() {
  empty_kernel<<<1, 1>>>();
  GPUPHYS_CUDA_CALL(cudaGetLastError());
}

}  // namespace gpuphys::device
