// The gather over tiles that the grid-to-particle references share, as a building block: every particle sees
// the samples around its own cell, clamped to the array, whatever the sizes of lists, tiles and arrays. All
// numbers are exact. On the GPU (exit code 77 if there is none), and on the CPU by tests/emulation.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstring>
#include <vector>

#include "core/generators/random.hpp"
#include "references/blocks/tile_gather.cuh"

namespace gpuphys::tiles {
namespace {

/// Blocks so small that lists end in the middle of them; `SharedKb`: for the counters of tiles.
template <int Piece, int SharedKb>
struct TestPolicy {
  static constexpr int mark_threads = 64;
  static constexpr int mark_stride = 4;
  static constexpr int plan_threads = 64;
  static constexpr int count_threads = 128;
  static constexpr int count_shared = SharedKb * 1024;
  static constexpr int place_threads = 64;
  static constexpr int gather_threads = 128;
  static constexpr int piece = Piece;
  static constexpr int gather_blocks_per_sm = 2;
};

/// Two arrays of samples whose values are their places in the array: the second one is one longer along x.
using Source = Samples<2>;

/// {lowest sample of the first array, highest of the second, place along x, y | z, cell, -, -}
template <class Tiling>
struct Probe {
  static constexpr int quads = 2, stride = 4;

  static __device__ __forceinline__ void evaluate(const Tile<Tiling, 2>& tile, const Placed& placed,
                                                  float (&result)[8]) {
    using T = Tile<Tiling, 2>;
    constexpr int reach = Tiling::highest - Tiling::lowest;
    const int lowest = T::lowest_of(placed.cell);
    result[0] = tile.values[0][lowest];
    result[1] = tile.values[1][lowest + reach * (T::kPlane + T::kRow + 1)];
    for (int d = 0; d < 3; ++d) result[2 + d] = placed.place[d];
    result[5] = static_cast<float>(placed.cell);
    result[6] = result[7] = 0;
  }
};

struct Case {
  const char* about;
  int extent[3];  ///< of the first array
  std::vector<float> x;
  float dx = 1;
};

int clamp(std::int64_t i, int n) {
  return static_cast<int>(i < 0 ? 0 : i > n - 1 ? n - 1 : i);
}

/// What a particle must see, computed in FP64 from its place in cells (exact, or well away from planes).
template <class Tiling>
void expect_neighbours(const Case& c) {
  const auto n = static_cast<std::int64_t>(c.x.size() / 3);
  const int second[3] = {c.extent[0] + 1, c.extent[1], c.extent[2]};
  std::vector<float> values[2];
  for (int a = 0; a < 2; ++a) {
    const int* e = a == 0 ? c.extent : second;
    for (int i = 0; i < e[0] * e[1] * e[2]; ++i) values[a].push_back(static_cast<float>(i));
  }
  DeviceBuffer<float> x(c.x.size()), first(values[0].size()), other(values[1].size());
  const auto upload = [](const DeviceBuffer<float>& to, const std::vector<float>& from) {
    GPUPHYS_CUDA(cudaMemcpy(to.get(), from.data(), from.size() * sizeof(float), cudaMemcpyHostToDevice));
  };
  upload(x, c.x);
  upload(first, values[0]);
  upload(other, values[1]);
  Source source{{first.get(), other.get()}, {}};
  for (int d = 0; d < 3; ++d) source.extent[0][d] = c.extent[d], source.extent[1][d] = second[d];
  // Collocated arrays share their extents.
  if (!Tiling::staggered) source.extent[1][0] = c.extent[0], source.values[1] = first.get();
  const TileGrid grid = make_tile_grid<Tiling>(c.extent[0] + 1, c.extent[1] + 1, c.extent[2] + 1, c.dx);

  const auto run = [&](auto policy) {
    TileGather<decltype(policy), Probe<Tiling>, Tiling, Source> gather;
    gather.allocate(grid, n);
    for (int again = 0; again < 2; ++again) {  // nothing is left of the first time
      gather.compute(grid, x.get(), n, source);
      std::vector<int> slots(static_cast<std::size_t>(n));
      std::vector<float4> results(static_cast<std::size_t>(4 * n));
      GPUPHYS_CUDA(
          cudaMemcpy(slots.data(), gather.slots(), slots.size() * sizeof(int), cudaMemcpyDeviceToHost));
      GPUPHYS_CUDA(cudaMemcpy(results.data(), gather.results(), results.size() * sizeof(float4),
                              cudaMemcpyDeviceToHost));
      std::vector<bool> taken(static_cast<std::size_t>(n));
      for (std::int64_t p = 0; p < n; ++p) {
        const int slot = slots[static_cast<std::size_t>(p)];
        ASSERT_TRUE(slot >= 0 && slot < n && !taken[static_cast<std::size_t>(slot)])
            << c.about << ": slot of " << p;
        taken[static_cast<std::size_t>(slot)] = true;
        const float4 a = results[static_cast<std::size_t>(4 * slot)],
                     b = results[static_cast<std::size_t>(4 * slot + 1)];
        std::int64_t low = 0, high = 0;
        const int* wide = Tiling::staggered ? second : c.extent;
        const float place[3] = {a.z, a.w, b.x};
        for (int d = 0; d < 3; ++d) {
          const double g =
              static_cast<double>(c.x[static_cast<std::size_t>(3 * p + d)]) / static_cast<double>(c.dx);
          const double key = std::floor(Tiling::staggered ? g : g - 0.5);
          const auto clamped = static_cast<std::int64_t>(std::min(std::max(key, -10.0), 1e6));
          low = low * c.extent[d] + clamp(clamped + Tiling::lowest, c.extent[d]);
          high = high * wide[d] + clamp(clamped + Tiling::highest, wide[d]);
          EXPECT_LE(std::abs(place[d]), 0.5f) << c.about << ": particle " << p << " along " << d;
          if (std::abs(g) < 1e5) {
            const double nearest = std::floor(g + 0.5);
            EXPECT_NEAR(place[d], g - nearest, 4e-7) << c.about << ": particle " << p << " along " << d;
          }
        }
        ASSERT_EQ(a.x, static_cast<float>(low)) << c.about << ": particle " << p << ", lowest sample";
        ASSERT_EQ(a.y, static_cast<float>(high)) << c.about << ": particle " << p << ", highest sample";
        const float4 padding = results[static_cast<std::size_t>(4 * slot + 3)];
        ASSERT_EQ(padding.x, 0.0f) << "what pads a result is written too";
      }
    }
  };
  run(TestPolicy<96, 64>{});
  run(TestPolicy<160, 2>{});  // counters for a few tiles only: the others ask for their slots
}

template <class Tiling>
class TileGatherBlock : public testing::Test {};
using Tilings = testing::Types<Tiling<4, 4, 8, 2, false, true>, Tiling<4, 4, 4, 2, false, true>,
                               Tiling<4, 4, 8, 1, true, true>, Tiling<4, 4, 8, 2, true, true>>;
TYPED_TEST_SUITE(TileGatherBlock, Tilings);

/// In multiples of 1/8 of a cell plus 1/16: off all planes, exact.
float random_place(std::uint64_t seed, std::uint64_t i, double low, double high) {
  return static_cast<float>(std::floor(8 * (low + (high - low) * uniform01(seed, 0, i))) / 8 + 0x1p-4);
}

TYPED_TEST(TileGatherBlock, ListsOfAnyLength) {
  // All in one tile: one particle, and as many as a piece takes, one less and one more.
  for (const int n : {1, 2, 31, 95, 96, 97, 159, 160, 161, 1000}) {
    Case c{.about = "one tile", .extent = {13, 14, 22}, .x = {}};
    for (int i = 0; i < 3 * n; ++i) c.x.push_back(random_place(101, static_cast<std::uint64_t>(i), 6.5, 7.5));
    expect_neighbours<TypeParam>(c);
  }
}

TYPED_TEST(TileGatherBlock, ArraysOfAnySize) {
  const int extents[][3] = {{1, 1, 1}, {2, 1, 3}, {5, 9, 17}, {40, 3, 2}, {3, 47, 1}, {1, 4, 90}};
  for (const auto& e : extents) {
    Case c{.about = "everywhere, and outside", .extent = {e[0], e[1], e[2]}, .x = {}};
    for (int p = 0; p < 700; ++p) {
      for (int d = 0; d < 3; ++d)
        c.x.push_back(random_place(102, static_cast<std::uint64_t>(3 * p + d), -5, e[d] + 5));
      if (p % 50 == 7) c.x[c.x.size() - 1 - static_cast<std::size_t>(p % 3)] = p % 100 == 7 ? 1e30f : -3e38f;
    }
    expect_neighbours<TypeParam>(c);
  }
}

TYPED_TEST(TileGatherBlock, ManyTilesFewParticles) {
  Case c{.about = "a particle in every twentieth tile", .extent = {120, 30, 25}, .x = {}};
  for (int p = 0; p < 60; ++p) {
    c.x.push_back(random_place(103, static_cast<std::uint64_t>(3 * p), 0, 120));
    c.x.push_back(random_place(103, static_cast<std::uint64_t>(3 * p + 1), 0, 30));
    c.x.push_back(random_place(103, static_cast<std::uint64_t>(3 * p + 2), 0, 25));
  }
  expect_neighbours<TypeParam>(c);
}

TYPED_TEST(TileGatherBlock, SpacingThatIsNoPowerOfTwo) {
  // Places of 1e-7 cells at cell 900, where the quotient has 6e-5.
  Case c{.about = "dx = 0.1", .extent = {1000, 2, 3}, .x = {}, .dx = 0.1f};
  for (int p = 0; p < 500; ++p) {
    const double cells[3] = {1000 * uniform01(104, 0, static_cast<std::uint64_t>(p)), 1.0625, 1.5625};
    const double rest = cells[0] * 2 - std::floor(cells[0] * 2);
    for (int d = 0; d < 3; ++d) {
      const double g = d == 0 && (rest < 0.01 || rest > 0.99) ? cells[0] + 0.1 : cells[d];
      c.x.push_back(static_cast<float>(g * 0.1));
    }
  }
  expect_neighbours<TypeParam>(c);
}

TYPED_TEST(TileGatherBlock, PlacesNearHalfCellsStayWithinHalfACell) {
  // On both sides of k + 1/2 by rounding, where the quotient decides for either: places must not leave [-1/2,
  // 1/2], and the place and the cell must agree. Samples along x differ by one from cell to cell, so the sum
  // of lowest sample and place tells.
  Case c{.about = "half cells of 0.1", .extent = {1000, 1, 1}, .x = {}, .dx = 0.1f};
  for (int p = 0; p < 600; ++p) {
    c.x.push_back(static_cast<float>((p + 0.5) * static_cast<double>(0.1f)));
    c.x.push_back(0.01f);
    c.x.push_back(0.01f);
  }
  const auto n = static_cast<std::int64_t>(c.x.size() / 3);
  const TileGrid grid = make_tile_grid<TypeParam>(1000, 1, 1, c.dx);
  std::vector<float> values(1000);
  for (int i = 0; i < 1000; ++i) values[static_cast<std::size_t>(i)] = static_cast<float>(i);
  DeviceBuffer<float> x(c.x.size()), samples(values.size());
  GPUPHYS_CUDA(cudaMemcpy(x.get(), c.x.data(), c.x.size() * sizeof(float), cudaMemcpyHostToDevice));
  GPUPHYS_CUDA(
      cudaMemcpy(samples.get(), values.data(), values.size() * sizeof(float), cudaMemcpyHostToDevice));
  Source source{{samples.get(), samples.get()}, {{1000, 1, 1}, {1000, 1, 1}}};
  TileGather<TestPolicy<96, 64>, Probe<TypeParam>, TypeParam, Source> gather;
  gather.allocate(grid, n);
  gather.compute(grid, x.get(), n, source);
  std::vector<int> slots(static_cast<std::size_t>(n));
  std::vector<float4> results(static_cast<std::size_t>(4 * n));
  GPUPHYS_CUDA(cudaMemcpy(slots.data(), gather.slots(), slots.size() * sizeof(int), cudaMemcpyDeviceToHost));
  GPUPHYS_CUDA(
      cudaMemcpy(results.data(), gather.results(), results.size() * sizeof(float4), cudaMemcpyDeviceToHost));
  for (std::int64_t p = 3; p < n; ++p) {
    const float4 a = results[static_cast<std::size_t>(4 * slots[static_cast<std::size_t>(p)])];
    const double g = static_cast<double>(c.x[static_cast<std::size_t>(3 * p)]) / static_cast<double>(c.dx);
    // The lowest sample is key + lowest; the key is the nearest whole number (less one if that lies above, or
    // collocated).
    const double key = static_cast<double>(a.x) - TypeParam::lowest;
    const double nearest = !TypeParam::staggered || a.z < 0 ? key + 1 : key;
    EXPECT_NEAR(nearest + static_cast<double>(a.z), g, 4e-7) << p;
    EXPECT_LE(std::abs(a.z), 0.5f) << p;
  }
}

}  // namespace
}  // namespace gpuphys::tiles

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::puts("no GPU");
    return 77;
  }
  return RUN_ALL_TESTS();
}
