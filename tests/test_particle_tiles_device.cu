// The building blocks of transfers from particles to grids: every particle lies in the tile, the cell and the
// place in it that FP64 says, gets a slot of its own in its tile's list whether or not shared memory has a
// counter for it, and the pieces cover the lists; a piece is sorted by cell, and cells side by side add up.
// On the GPU (exit code 77 if there is none), and on the CPU by tests/emulation.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <string>
#include <vector>

#include "core/generators/random.hpp"
#include "references/blocks/particle_tiles.cuh"
#include "references/blocks/tile_sums.cuh"
#ifndef GPUPHYS_EMULATED
#include "core/base/error.hpp"
#include "core/run/gpu/ceilings.hpp"
#endif

namespace gpuphys::tiles {
namespace {

template <class T>
DeviceBuffer<T> uploaded(const std::vector<T>& from) {
  DeviceBuffer<T> to(from.size());
  GPUPHYS_CUDA(cudaMemcpy(to.get(), from.data(), from.size() * sizeof(T), cudaMemcpyHostToDevice));
  return to;
}

template <class T>
std::vector<T> downloaded(const T* from, std::size_t n) {
  std::vector<T> to(n);
  GPUPHYS_CUDA(cudaMemcpy(to.data(), from, n * sizeof(T), cudaMemcpyDeviceToHost));
  return to;
}

template <class Tiling>
__global__ void locate_all(const __grid_constant__ TileGrid grid, const float* __restrict__ x, int n,
                           Place* places) {
  const int p = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (p < n) places[p] = locate<Tiling>(grid, x[3 * p], x[3 * p + 1], x[3 * p + 2]);
}

template <class Tiling>
__global__ void slots_of_all(const __grid_constant__ TileGrid grid, const __grid_constant__ BinningView bins,
                             const float* __restrict__ x, int n, int* slots) {
  const int p = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (p < n) slots[p] = slot_of(bins, locate<Tiling>(grid, x[3 * p], x[3 * p + 1], x[3 * p + 2]), p, n);
}

struct Case {
  const char* about;
  int nodes[3];
  float dx = 1;
  std::vector<float> x = {};
};

/// Along an axis, where FP64 finds a particle: the key of its cell, and its place as `Place` keeps it.
template <class Tiling>
struct Expected {
  std::int64_t key = 0;
  bool reaches = true;
  double place = 0;

  Expected(double g, int nodes) {
    const double shift = Tiling::staggered || Tiling::order == 1 ? 0 : 0.5;
    const double whole = std::floor(g - shift);
    reaches = whole >= -Tiling::highest && whole < nodes - Tiling::lowest;
    if (!reaches) return;
    key = static_cast<std::int64_t>(whole);
    if (Tiling::staggered)
      place = g - whole < 0.5 ? g - whole : g - whole - 1;
    else
      place = g - whole;
  }
};

template <class Tiling>
void expect_places(const Case& c) {
  const int n = static_cast<int>(c.x.size() / 3);
  const TileGrid grid = make_tile_grid<Tiling>(c.nodes[0], c.nodes[1], c.nodes[2], c.dx);
  const DeviceBuffer<float> x = uploaded(c.x);
  const DeviceBuffer<Place> places(static_cast<std::size_t>(n));
  locate_all<Tiling><<<static_cast<unsigned>(n / 64 + 1), 64>>>(grid, x.get(), n, places.get());
  const std::vector<Place> got = downloaded(places.get(), static_cast<std::size_t>(n));
  for (int p = 0; p < n; ++p) {
    int tile[3];
    int cell = 0;
    bool reaches = true;
    double place[3];
    for (int d = 0; d < 3; ++d) {
      const Expected<Tiling> e(
          static_cast<double>(c.x[static_cast<std::size_t>(3 * p + d)]) / static_cast<double>(c.dx),
          c.nodes[d]);
      reaches = reaches && e.reaches;
      const auto from_first = static_cast<int>(e.key - Tiling::first(d));
      tile[d] = from_first / Tiling::side(d);
      cell = cell * Tiling::side(d) + from_first % Tiling::side(d);
      place[d] = Tiling::staggered ? e.place : from_first % Tiling::side(d) + e.place;
    }
    const Place& at = got[static_cast<std::size_t>(p)];
    const int number = reaches ? (tile[0] * grid.tiles[1] + tile[1]) * grid.tiles[2] + tile[2] : -1;
    ASSERT_EQ(at.tile, number) << c.about << ": particle " << p;
    if (!reaches) continue;
    int found = at.cell;
    if (!Tiling::staggered) {
      found = 0;
      for (int d = 0; d < 3; ++d) {
        const float shift = Tiling::order == 1 ? 0.0f : 0.5f;
        found = found * Tiling::side(d) + static_cast<int>(std::floor(at.offset[d] - shift));
      }
    }
    ASSERT_EQ(found, cell) << c.about << ": particle " << p;
    for (int d = 0; d < 3; ++d) ASSERT_NEAR(at.offset[d], place[d], 5e-7) << c.about << ": particle " << p;
  }
}

/// `shared`: bytes for marks and counters.
template <class Tiling>
void expect_lists(const Case& c, std::size_t shared, int parts) {
  constexpr int piece = 40, threads = 64, stride = 4, quads = 2;
  const int n = static_cast<int>(c.x.size() / 3);
  const TileGrid grid = make_tile_grid<Tiling>(c.nodes[0], c.nodes[1], c.nodes[2], c.dx);
  const auto tile_count = static_cast<std::size_t>(grid.tile_count());
  const DeviceBuffer<float> x = uploaded(c.x);
  const DeviceBuffer<Place> places(static_cast<std::size_t>(n));
  locate_all<Tiling><<<static_cast<unsigned>(n / 64 + 1), 64>>>(grid, x.get(), n, places.get());
  const std::vector<Place> at = downloaded(places.get(), static_cast<std::size_t>(n));
  const Binning binning(grid, n, piece, shared, parts);
  const BinningView& bins = binning.view();
  const DeviceBuffer<float4> sums =
      uploaded(std::vector<float4>(tile_count * quads, make_float4(7.0f, 7.0f, 7.0f, 7.0f)));
  const DeviceBuffer<int> slots(static_cast<std::size_t>(n));
  for (int again = 0; again < 2; ++again) {  // nothing is left of the first time
    binning.clear();
    mark_tiles<Tiling, threads, stride>
        <<<static_cast<unsigned>(n / (threads * stride) + 1), threads>>>(grid, bins, x.get(), n);
    count_particles<Tiling, threads>
        <<<static_cast<unsigned>(bins.parts), threads, count_shared_bytes(bins)>>>(grid, bins, x.get(), n);
    plan_tiles<Tiling, threads, quads>
        <<<static_cast<unsigned>((tile_count + threads - 1) / threads), threads>>>(grid, bins, piece,
                                                                                   sums.get());
    assign_slots<threads><<<static_cast<unsigned>(bins.parts), threads,
                            sizeof(int) * static_cast<std::size_t>(bins.indexed)>>>(bins, n);
    slots_of_all<Tiling><<<static_cast<unsigned>(n / 64 + 1), 64>>>(grid, bins, x.get(), n, slots.get());
  }
  const std::vector<int> slot = downloaded(slots.get(), static_cast<std::size_t>(n));
  const std::vector<int> cursors = downloaded(bins.cursors, 3);
  const auto reach =
      static_cast<int>(std::count_if(at.begin(), at.end(), [](const Place& p) { return p.tile >= 0; }));
  ASSERT_EQ(cursors[0], reach) << c.about;
  std::vector<int> tile_of_slot(static_cast<std::size_t>(reach), -1);
  for (int p = 0; p < n; ++p) {
    const auto particle = static_cast<std::size_t>(p);
    if (at[particle].tile < 0) {
      ASSERT_LT(slot[particle], 0) << c.about;
      continue;
    }
    ASSERT_TRUE(slot[particle] >= 0 && slot[particle] < reach) << c.about << ": slot " << slot[particle];
    int& tile = tile_of_slot[static_cast<std::size_t>(slot[particle])];
    ASSERT_EQ(tile, -1) << c.about << ": slot " << slot[particle] << " is taken twice";
    tile = at[particle].tile;
  }
  // Pieces cover the slots once, each with slots of its own tile.
  const auto items = downloaded(bins.items, static_cast<std::size_t>(cursors[1]));
  std::vector<bool> covered(static_cast<std::size_t>(reach));
  for (std::size_t i = 0; i < items.size(); ++i) {
    const WorkItem& w = items[i];
    ASSERT_TRUE(w.count >= 1 && w.count <= piece) << c.about;
    const int tile = (w.tile.x * grid.tiles[1] + w.tile.y) * grid.tiles[2] + w.tile.z;
    for (int s = w.first; s < w.first + w.count; ++s) {
      ASSERT_EQ(tile_of_slot[static_cast<std::size_t>(s)], tile) << c.about;
      ASSERT_FALSE(covered[static_cast<std::size_t>(s)]) << c.about;
      covered[static_cast<std::size_t>(s)] = true;
    }
    if (w.tile.w != 0) {
      ASSERT_LT(i + 1, items.size());
      EXPECT_EQ(items[i + 1].tile.z, w.tile.z + 1);
      EXPECT_EQ(items[i + 1].tile.x, w.tile.x);
      EXPECT_EQ(items[i + 1].tile.y, w.tile.y);
    }
  }
  EXPECT_EQ(std::count(covered.begin(), covered.end(), true), reach) << c.about;
  // Node blocks that a tile with particles writes to are marked and cleared, the others are left alone.
  std::vector<bool> expected(tile_count);
  for (const Place& p : at) {
    if (p.tile < 0) continue;
    const int z = p.tile % grid.tiles[2], y = p.tile / grid.tiles[2] % grid.tiles[1],
              t = p.tile / grid.tiles[2] / grid.tiles[1];
    for (int s = 0; s < 8; ++s) {
      const int i = t + s / 4, j = y + s / 2 % 2, k = z + s % 2;
      if (i < grid.tiles[0] && j < grid.tiles[1] && k < grid.tiles[2])
        expected[static_cast<std::size_t>((i * grid.tiles[1] + j) * grid.tiles[2] + k)] = true;
    }
  }
  const auto touched = downloaded(bins.touched, tile_count);
  const auto cleared = downloaded(sums.get(), tile_count * quads);
  for (std::size_t t = 0; t < tile_count; ++t) {
    ASSERT_EQ(touched[t] != 0, expected[t]) << c.about << ": node block " << t;
    for (std::size_t e = 0; e < quads; ++e)
      ASSERT_EQ(cleared[quads * t + e].y, expected[t] ? 0.0f : 7.0f) << c.about;
  }
}

/// Multiples of 1/8 of a cell plus 1/16: off all planes.
std::vector<float> random_places(std::uint64_t seed, int n, const int (&nodes)[3], float dx, double margin) {
  std::vector<float> x;
  for (int i = 0; i < 3 * n; ++i) {
    const double at =
        -margin + (nodes[i % 3] + 2 * margin) * uniform01(seed, 0, static_cast<std::uint64_t>(i));
    x.push_back(static_cast<float>((std::floor(8 * at) / 8 + 0x1p-4) * static_cast<double>(dx)));
  }
  return x;
}

std::vector<Case> cases() {
  std::vector<Case> all{{.about = "inside and around", .nodes = {13, 22, 17}},
                        {.about = "one node", .nodes = {1, 1, 1}},
                        {.about = "a tenth", .nodes = {9, 7, 301}, .dx = 0.1f},
                        {.about = "thin", .nodes = {2, 40, 3}, .dx = 3.0f}};
  std::uint64_t seed = 200;
  for (Case& c : all) {
    c.x = random_places(seed++, 3001, c.nodes, c.dx, 4);
    c.x[4] = 1e30f, c.x[9] = -1e30f, c.x[14] = -0.0f;
  }
  Case one{.about = "one cell", .nodes = {12, 12, 12}};
  for (int i = 0; i < 3 * 997; ++i) one.x.push_back(5.0f + static_cast<float>(i % 31 + 1) / 64);
  all.push_back(one);
  all.push_back({.about = "one particle", .nodes = {5, 6, 7}, .x = {2.25f, 3.125f, 4.75f}});
  Case outside{.about = "all outside", .nodes = {5, 6, 7}};
  for (int i = 0; i < 3 * 70; ++i) outside.x.push_back(i % 3 == 0 ? -5.25f : 2.25f);
  all.push_back(outside);
  return all;
}

template <class Tiling>
class ParticleTilesDevice : public testing::Test {};
using Tilings = testing::Types<Tiling<4, 4, 4, 2, false>, Tiling<4, 4, 4, 1, false>, Tiling<4, 4, 8, 1, true>,
                               Tiling<4, 4, 8, 2, true>>;
TYPED_TEST_SUITE(ParticleTilesDevice, Tilings);

TYPED_TEST(ParticleTilesDevice, Places) {
  for (const Case& c : cases()) expect_places<TypeParam>(c);
}

TYPED_TEST(ParticleTilesDevice, PlacesOnPlanes) {
  // Whole, half and quarter multiples: cells are half open, and places exact.
  Case c{.about = "planes", .nodes = {9, 10, 11}};
  for (int i = 0; i < 3 * 2000; ++i)
    c.x.push_back(static_cast<float>(std::floor(60 * uniform01(301, 0, static_cast<std::uint64_t>(i)))) / 4 -
                  2.0f);
  expect_places<TypeParam>(c);
}

TYPED_TEST(ParticleTilesDevice, Lists) {
  for (const Case& c : cases()) {
    expect_lists<TypeParam>(c, 32 * 1024, 5);
    expect_lists<TypeParam>(c, 256, 3);  // counters for a few tiles only: the others are counted at L2
    expect_lists<TypeParam>(c, 32 * 1024, 1);
  }
}

// ---- the second half ----

constexpr int kTestCells = 64, kTestPiece = 150, kTestThreads = 64;

__global__ void sort_once(const int* __restrict__ cells, int count, int* starts, int* order) {
  __shared__ CellOrder<kTestCells, kTestPiece> shared;
  const int thread = static_cast<int>(threadIdx.x);
  shared.counts[thread] = 0;
  __syncthreads();
  sort_by_cell<kTestThreads>(shared, count, [&](int p) { return p < count ? cells[p] : 0; });
  starts[thread] = shared.starts[thread];
  if (thread == 0) starts[kTestCells] = shared.starts[kTestCells];
  for (int q = thread; q < count; q += kTestThreads) order[q] = shared.order[q];
}

TEST(TileSumsDevice, SortByCell) {
  for (const int count : {0, 1, 63, 64, 65, 150}) {
    for (const int different : {1, 7, 64}) {
      std::vector<int> cells;
      for (int p = 0; p < kTestPiece; ++p)
        cells.push_back(static_cast<int>(random_bits(302, 0, static_cast<std::uint64_t>(p)) %
                                         static_cast<unsigned>(different)));
      const DeviceBuffer<int> in = uploaded(cells), starts(kTestCells + 1), order(kTestPiece);
      sort_once<<<1, kTestThreads>>>(in.get(), count, starts.get(), order.get());
      const auto first = downloaded(starts.get(), kTestCells + 1);
      const auto sorted = downloaded(order.get(), static_cast<std::size_t>(count));
      ASSERT_EQ(first[0], 0);
      ASSERT_EQ(first[kTestCells], count);
      std::vector<bool> seen(static_cast<std::size_t>(count));
      for (int cell = 0; cell < kTestCells; ++cell) {
        for (int q = first[static_cast<std::size_t>(cell)]; q < first[static_cast<std::size_t>(cell) + 1];
             ++q) {
          const int p = sorted[static_cast<std::size_t>(q)];
          ASSERT_EQ(cells[static_cast<std::size_t>(p)], cell);
          ASSERT_FALSE(seen[static_cast<std::size_t>(p)]);
          seen[static_cast<std::size_t>(p)] = true;
        }
      }
    }
  }
}

// Eight cells side by side, each with sums of four nodes; four rows of them in a warp.
__global__ void add_once(const float* __restrict__ sums, float* __restrict__ out) {
  const int lane = static_cast<int>(threadIdx.x);
  float s[4];
  for (int k = 0; k < 4; ++k) s[k] = sums[4 * lane + k];
  add_along<1>(lane % 8 > 0, s[0], s[1], s[2], s[3]);
  for (int k = 0; k < 4; ++k) out[4 * lane + k] = s[k];
}

TEST(TileSumsDevice, AddAlong) {
  std::vector<float> sums;
  for (int i = 0; i < 32 * 4; ++i)
    sums.push_back(static_cast<float>(random_bits(303, 0, static_cast<std::uint64_t>(i)) % 1000));
  const DeviceBuffer<float> in = uploaded(sums), out(32 * 4);
  add_once<<<1, 32>>>(in.get(), out.get());
  const auto got = downloaded(out.get(), 32 * 4);
  for (int row = 0; row < 4; ++row) {
    for (int node = 0; node < 8 + 3; ++node) {
      float expected = 0;
      for (int cell = std::max(0, node - 3); cell <= std::min(7, node); ++cell)
        expected += sums[static_cast<std::size_t>(4 * (8 * row + cell) + node - cell)];
      const int cell = std::min(node, 7);
      EXPECT_EQ(got[static_cast<std::size_t>(4 * (8 * row + cell) + node - cell)], expected)
          << row << " " << node;
    }
  }
}

}  // namespace
}  // namespace gpuphys::tiles

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  if (argc > 2 || (argc == 2 && std::string(argv[1]) != "device")) {
    std::fprintf(stderr, "usage: test_particle_tiles_device [device]\n");
    return 2;
  }
#ifndef GPUPHYS_EMULATED
  try {
    gpuphys::require_gpu();
  } catch (const gpuphys::Error& e) {
    std::fprintf(stderr, "test_particle_tiles_device: %s\n", e.what());
    return static_cast<int>(e.code());
  }
#endif
  return RUN_ALL_TESTS();
}
