// The broad phase of the collision tasks as a building block (references/blocks/swept_pairs.cuh): every
// vertex and primitive whose boxes overlap is met exactly once, against all pairs tested one by one. Pairs
// whose boxes do not overlap may be met, since boxes are rounded outwards, but once at most and not many of
// them. Exit code 77 without a GPU.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <string>
#include <vector>

#include "core/generators/random.hpp"
#include "references/blocks/swept_pairs.cuh"

namespace gpuphys::testing {
namespace {

constexpr int kWarps = 2;

template <int Corners>
__global__ void count_pairs(const __grid_constant__ collision::SweptScene<Corners> s, int* met) {
  __shared__ collision::Grid grid;
  if (threadIdx.x == 0) grid = s.grid();
  __syncthreads();
  const int warp = static_cast<int>(blockIdx.x) * kWarps + static_cast<int>(threadIdx.x) / 32;
  collision::visit_swept_pairs(
      s, grid, warp, static_cast<int>(gridDim.x) * kWarps,
      [&](bool hit, const collision::MovingVertex& own, const collision::SweptRecord& record) {
        if (!hit) return;
        // A primitive is known by its first corner: every primitive of a scene here has one of its own.
        const int other =
            Corners == 1 ? collision::vertex_of(record).number : collision::corners_of(record).x;
        atomicAdd(met + static_cast<std::ptrdiff_t>(own.number) * s.n + other, 1);
      });
}

/// Vertices, and primitives whose first corner no other one has.
struct Scene {
  std::vector<float> x0, x1;
  std::vector<std::int32_t> primitives;
};

using Draw = std::array<double, 6>;  // start and motion

template <class F>
Scene scene_of(int corners, int primitives, int loose, F&& draw) {
  Scene s;
  const int vertices = corners == 1 ? loose : corners * primitives + loose;
  for (int v = 0; v < vertices; ++v) {
    const Draw d = draw(v);
    for (std::size_t k = 0; k < 3; ++k) {
      s.x0.push_back(static_cast<float>(d[k]));
      s.x1.push_back(static_cast<float>(d[k] + d[3 + k]));
    }
  }
  for (int e = 0; corners > 1 && e < corners * primitives; ++e) s.primitives.push_back(e);
  return s;
}

template <int Corners>
void expect_each_pair_once(const Scene& s, float margin, const std::string& what, float beyond = 0.0f) {
  const int n = static_cast<int>(s.x0.size() / 3);
  const int m = Corners == 1 ? n : static_cast<int>(s.primitives.size()) / Corners;
  DeviceBuffer<float> x0(s.x0.size()), x1(s.x1.size()), toi(static_cast<std::size_t>(n));
  DeviceBuffer<std::int32_t> primitives(s.primitives.size());
  const std::size_t cells = static_cast<std::size_t>(n) * static_cast<std::size_t>(n);
  DeviceBuffer<int> met(cells);
  GPUPHYS_CUDA(cudaMemcpy(x0.get(), s.x0.data(), sizeof(float) * s.x0.size(), cudaMemcpyHostToDevice));
  GPUPHYS_CUDA(cudaMemcpy(x1.get(), s.x1.data(), sizeof(float) * s.x1.size(), cudaMemcpyHostToDevice));
  if (!s.primitives.empty())
    GPUPHYS_CUDA(cudaMemcpy(primitives.get(), s.primitives.data(), sizeof(std::int32_t) * s.primitives.size(),
                            cudaMemcpyHostToDevice));
  const collision::SweptPairs<Corners> pairs(n, m);
  std::vector<int> host(cells);
  for (int run = 0; run < 2; ++run) {  // the second time on what the first one left
    GPUPHYS_CUDA(cudaMemset(met.get(), 0, sizeof(int) * cells));
    const auto scene = pairs.build(x0.get(), x1.get(), primitives.get(), margin, beyond, toi.get());
    count_pairs<Corners><<<pairs.visit_blocks(kWarps, 8), 32 * kWarps>>>(scene, met.get());
    GPUPHYS_CUDA(cudaDeviceSynchronize());
    GPUPHYS_CUDA(cudaMemcpy(host.data(), met.get(), sizeof(int) * cells, cudaMemcpyDeviceToHost));
    long missed = 0, repeated = 0, needless = 0, due = 0;
    for (int v = 0; v < n; ++v) {
      for (int e = 0; e < m; ++e) {
        bool overlap = true;
        for (std::size_t d = 0; d < 3; ++d) {
          const auto at = [&](const std::vector<float>& x, int i) {
            return static_cast<double>(x[3 * static_cast<std::size_t>(i) + d]);
          };
          double low = 1e30, high = -1e30;
          for (int k = 0; k < Corners; ++k) {
            const int c = Corners * e + k;
            low = std::min({low, at(s.x0, c), at(s.x1, c)});
            high = std::max({high, at(s.x0, c), at(s.x1, c)});
          }
          overlap = overlap && std::min(at(s.x0, v), at(s.x1, v)) - static_cast<double>(margin) <= high &&
                    std::max(at(s.x0, v), at(s.x1, v)) + static_cast<double>(margin) >= low;
        }
        // The interval along a diagonal may separate what the axes do not; only vertices have none.
        const int count = host[static_cast<std::size_t>(v) * static_cast<std::size_t>(n) +
                               static_cast<std::size_t>(Corners * e)];
        due += overlap;
        repeated += count > 1;
        missed += overlap && count == 0 && Corners == 1;
        needless += !overlap && count > 0;
        if (overlap && count == 0 && Corners > 1) {
          // It must be separated along one of the diagonals, by more than rounding.
          bool separated = false;
          for (int k = 0; k < 6; ++k) {
            const int p = k / 4, q = k < 2 ? 1 : 2;
            const double sign = k % 2 == 0 ? 1 : -1;
            const auto along = [&](const std::vector<float>& x, int i) {
              return static_cast<double>(x[3 * static_cast<std::size_t>(i) + static_cast<std::size_t>(p)]) +
                     sign * static_cast<double>(
                                x[3 * static_cast<std::size_t>(i) + static_cast<std::size_t>(q)]);
            };
            double low = 1e30, high = -1e30;
            for (int c = Corners * e; c < Corners * e + Corners; ++c) {
              low = std::min({low, along(s.x0, c), along(s.x1, c)});
              high = std::max({high, along(s.x0, c), along(s.x1, c)});
            }
            separated =
                separated ||
                std::min(along(s.x0, v), along(s.x1, v)) - 1.42 * static_cast<double>(margin) > high ||
                std::max(along(s.x0, v), along(s.x1, v)) + 1.42 * static_cast<double>(margin) < low;
          }
          missed += !separated;
        }
      }
    }
    EXPECT_EQ(missed, 0) << what;
    EXPECT_EQ(repeated, 0) << what;
    EXPECT_GT(due, 0) << what;
    // What is wider by a unit in the last place may be much wider.
    EXPECT_LE(needless, (beyond > 0 ? 2 * due : due / 4) + n) << what;
  }
}

double draw(std::uint64_t stream, int v, std::uint64_t d) {
  return uniform11(81, stream, 3 * static_cast<std::uint64_t>(v) + d);
}

template <int Corners>
void check_scenes() {
  for (const int size : {1, 2, 31, 33, 300}) {
    // Corners of a primitive stand together, loose vertices anywhere.
    const auto near = [&](double scene, double extent, double motion) {
      return [=](int v) {
        const int centre = v / Corners;
        Draw d{};
        for (std::uint64_t k = 0; k < 3; ++k) {
          d[k] = scene * draw(1, centre, k) + extent * draw(2, v, k);
          d[3 + k] = motion * draw(3, v, k);
        }
        return d;
      };
    };
    const std::string of = std::to_string(Corners) + " corners, " + std::to_string(size);
    expect_each_pair_once<Corners>(scene_of(Corners, size, size + 5, near(0.2, 1, 1)), 0.1f,
                                   of + ", crowded");
    expect_each_pair_once<Corners>(scene_of(Corners, size, size + 5, near(8, 1, 0.3)), 0.25f,
                                   of + ", spread");
    expect_each_pair_once<Corners>(scene_of(Corners, size, size, near(1000, 1, 0.3)), 2.0f,
                                   of + ", far apart");
    expect_each_pair_once<Corners>(scene_of(Corners, size, size, near(6, 0.5, 0)), 0.5f, of + ", at rest");
    expect_each_pair_once<Corners>(scene_of(Corners, size, size, [&](int) { return Draw{1, 2, 3, 0, 0, 0}; }),
                                   0.0f, of + ", in one point");
    expect_each_pair_once<Corners>(scene_of(Corners, size, size,
                                            [&](int v) {
                                              // Every eleventh one is huge, and so is every thirteenth
                                              // motion.
                                              Draw d = near(20, v / Corners % 11 == 0 ? 60 : 0.5, 0.5)(v);
                                              if (v % 13 == 0) d[5] += 80;
                                              return d;
                                            }),
                                   0.125f, of + ", large ones among small ones");
    expect_each_pair_once<Corners>(scene_of(Corners, size, size,
                                            [&](int v) {
                                              Draw d = near(1, 0.5, 0.5)(v);
                                              for (std::size_t k = 0; k < 3; ++k) d[k] += 1e6;
                                              d[1] -= 3 * v / Corners;
                                              return d;
                                            }),
                                   0.5f, of + ", in a row far from the origin");
    // A few units in the last place of the coordinates across.
    expect_each_pair_once<Corners>(scene_of(Corners, size, size,
                                            [&](int v) {
                                              Draw d = near(0.5, 0.1, 0.1)(v);
                                              for (std::size_t k = 0; k < 3; ++k) d[k] += 9e5;
                                              return d;
                                            }),
                                   0.0f, of + ", of few units in the last place", 0x1p-18f);
  }
}

TEST(SweptPairs, MeetsEveryPairOfVerticesFromBothSides) {
  check_scenes<1>();
}
TEST(SweptPairs, MeetsEveryVertexAndEdgeOnce) {
  check_scenes<2>();
}
TEST(SweptPairs, MeetsEveryVertexAndTriangleOnce) {
  check_scenes<3>();
}

}  // namespace
}  // namespace gpuphys::testing

int main(int argc, char** argv) {
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::fprintf(stderr, "test_swept_pairs_device: no CUDA device\n");
    return 77;
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
