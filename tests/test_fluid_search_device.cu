// The neighbour search of the position-based fluid as a building block. On the host: units of places and
// codes. On the device: who is met, by searching and by reading lists, at rest and after moves, at the sizes
// where runs, queues and lists overflow; these are taken from the policy. Exit code 77 if the device part was
// asked for (argument `device`) and there is none.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "core/base/error.hpp"
#include "core/generators/random.hpp"
#include "core/run/gpu/ceilings.hpp"
#include "references/blocks/fluid_search.cuh"

namespace gpuphys::testing {
namespace {

using fluid::Fluid, fluid::Lists, fluid::Pair, fluid::Particles, fluid::Policy, fluid::Units, fluid::With;
using Point = std::array<float, 3>;

// ---- host ----

TEST(FluidSearchHost, UnitsFitH) {
  for (float h = 1e-6f; h < 1e6f; h *= 1.3f) {
    const Units units = fluid::units_of(h);
    const double reach = static_cast<double>(h) * static_cast<double>(units.per_metre);
    EXPECT_GT(reach, 0x1p23) << h;
    EXPECT_LE(reach, 0x1p24) << h;
    int exponent = 0;
    EXPECT_EQ(std::frexp(units.per_metre, &exponent), 0.5f) << "a power of two, " << h;
    const double steps = std::ldexp(reach, -units.step);
    EXPECT_GE(steps, 42) << h;
    EXPECT_LE(steps, 84) << h;
  }
}

TEST(FluidSearchHost, PowersOfTwoAreTheFinestUnits) {
  EXPECT_EQ(fluid::units_of(2.0f).per_metre, 0x1p23f);
  EXPECT_EQ(fluid::units_of(1.0f).per_metre, 0x1p24f);
  EXPECT_EQ(fluid::units_of(1.0000001f).per_metre, 0x1p23f);
}

// ---- device ----

/// Of each slot: met within h and sum of the distances, by each way of looking, and among all.
struct Found {
  int searched, listed, read, all;
  float searched_sum, read_sum, all_sum;
};

template <bool moves>
__global__ void search(const __grid_constant__ Fluid f, Found* found) {
  __shared__ fluid::Queue<Lists::written> queue;
  const int slot = static_cast<int>(blockIdx.x * Policy::threads + threadIdx.x);
  const int own = min(slot, f.count - 1);
  const float unit = moves ? 1.0f / f.units.per_metre : 1.0f;
  int met = 0;
  float sum = 0.0f;
  fluid::for_each_neighbour<moves, Lists::written>(f, queue, own, slot < f.count,
                                                   [&](int, const Pair& pair, float) {
                                                     const float r = sqrtf(pair.square) * unit;
                                                     met += r < f.h;
                                                     sum += r < f.h ? r : 0.0f;
                                                   });
  if (slot >= f.count) return;
  found[slot].searched = met;
  found[slot].searched_sum = sum;
  found[slot].listed = f.hit_count[slot];
  const float4 x = f.x[slot], s = moves ? f.shift[slot] : make_float4(0, 0, 0, 0);
  int all = 0;
  float all_sum = 0.0f;
  for (int j = 0; j < f.count; ++j) {
    const float4 y = f.x[j], t = moves ? f.shift[j] : make_float4(0, 0, 0, 0);
    const float dx = x.x - y.x + (s.x - t.x), dy = x.y - y.y + (s.y - t.y), dz = x.z - y.z + (s.z - t.z);
    const float r = sqrtf(dx * dx + dy * dy + dz * dz);
    all += r < f.h;
    all_sum += r < f.h ? r : 0.0f;
  }
  found[slot].all = all;
  found[slot].all_sum = all_sum;
}

template <bool moves>
__global__ void read(const __grid_constant__ Fluid f, Found* found) {
  __shared__ fluid::Queue<Lists::read> queue;
  const int slot = static_cast<int>(blockIdx.x * Policy::threads + threadIdx.x);
  const int own = min(slot, f.count - 1);
  const float unit = moves ? 1.0f / f.units.per_metre : 1.0f;
  int met = 0;
  float sum = 0.0f;
  fluid::for_each_neighbour<moves, Lists::read>(f, queue, own, slot < f.count,
                                                [&](int, const Pair& pair, float) {
                                                  const float r = sqrtf(pair.square) * unit;
                                                  met += r < f.h;
                                                  sum += r < f.h ? r : 0.0f;
                                                });
  if (slot >= f.count) return;
  found[slot].read = met;
  found[slot].read_sum = sum;
}

/// Moves every particle after the sort.
__global__ void shift_all(Fluid f, float4* shift, float* now, float most) {
  const int slot = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (slot >= f.count) return;
  const auto along = [&](int c) {
    return most *
           static_cast<float>(uniform11(9, static_cast<std::uint64_t>(c), static_cast<std::uint64_t>(slot)));
  };
  const float4 s = make_float4(along(0), along(1), along(2), 0), x = f.x[slot];
  shift[slot] = s;
  now[3 * slot] = x.x + s.x;
  now[3 * slot + 1] = x.y + s.y;
  now[3 * slot + 2] = x.z + s.z;
}

template <class T>
DeviceBuffer<T> upload(const std::vector<T>& host) {
  DeviceBuffer<T> device(host.size());
  GPUPHYS_CUDA(cudaMemcpy(device.get(), host.data(), sizeof(T) * host.size(), cudaMemcpyHostToDevice));
  return device;
}

/// Finds everybody's neighbours; `most`: how far particles move after the sort.
template <bool moves>
std::vector<Found> find(const std::vector<Point>& points, float h, float most = 0) {
  constexpr With with = moves ? With::nothing : With::velocity;
  const int n = static_cast<int>(points.size());
  const std::size_t size = points.size();
  std::vector<float> flat;
  for (const Point& p : points) flat.insert(flat.end(), p.begin(), p.end());
  const DeviceBuffer<float> x = upload(flat);
  neighbour_grid::NeighbourGrid<fluid::GridPolicy> grid;
  grid.allocate<Particles<with>>(n);
  DeviceBuffer<fluid::Particle> split(grid.records(n));
  DeviceBuffer<float4> sorted(2 * size), again(2 * size), shift(size);
  DeviceBuffer<unsigned> codes(size + fluid::padding);
  DeviceBuffer<int4> places(size);
  DeviceBuffer<int> hits(Policy::listed * size), hit_count(size);
  DeviceBuffer<float> now(3 * size);
  DeviceBuffer<Found> found(size);
  Particles<with> source{
      x.get(),     x.get(),      x.get(),     {nullptr, nullptr}, h, 0, {0, 0, 0}, fluid::units_of(h),
      split.get(), sorted.get(), codes.get(), places.get(),       n};
  grid.build(source);
  Fluid f{};
  f.grid = grid.grid();
  f.start = grid.start();
  f.x = sorted.get();
  f.shift = sorted.get() + n;
  f.places = places.get();
  f.codes = codes.get();
  f.hits = hits.get();
  f.hit_count = hit_count.get();
  f.count = n;
  f.units = source.units;
  f.h = h;
  const auto blocks = static_cast<unsigned>((n + Policy::threads - 1) / Policy::threads);
  if (most > 0) {
    shift_all<<<blocks, Policy::threads>>>(f, shift.get(), now.get(), most);
    source.now = now.get();
    source.before = {sorted.get(), shift.get()};
    source.sorted = again.get();
    grid.build(source);
    f.x = again.get();
    f.shift = again.get() + n;
  }
  search<moves><<<blocks, Policy::threads>>>(f, found.get());
  read<moves><<<blocks, Policy::threads>>>(f, found.get());
  GPUPHYS_CUDA(cudaDeviceSynchronize());
  std::vector<Found> host(size);
  GPUPHYS_CUDA(cudaMemcpy(host.data(), found.get(), sizeof(Found) * size, cudaMemcpyDeviceToHost));
  return host;
}

/// What searching and reading must find; returns the longest list.
template <bool moves>
int expect_found(const std::vector<Point>& points, float h, float most = 0) {
  int longest = 0;
  std::size_t slot = 0;
  for (const Found& f : find<moves>(points, h, most)) {
    // A pair at h exactly may be taken or left: it weighs nothing.
    const int slack = moves ? 1 : 0;
    EXPECT_NEAR(f.searched, f.all, slack) << "slot " << slot;
    EXPECT_EQ(f.read, f.searched) << "slot " << slot;
    const float tolerance = 1e-5f * static_cast<float>(f.all + 1) * h;
    if (f.searched == f.all) {
      EXPECT_NEAR(f.searched_sum, f.all_sum, tolerance) << "slot " << slot;
      EXPECT_NEAR(f.read_sum, f.all_sum, tolerance) << "slot " << slot;
    }
    longest = std::max(longest, f.listed);
    ++slot;
    if (::testing::Test::HasFailure()) break;
  }
  return longest;
}

/// n points uniform in a box with a corner at `low`.
std::vector<Point> cloud(int n, Point low, Point size, std::uint64_t seed = 1) {
  std::vector<Point> points(static_cast<std::size_t>(n));
  for (std::size_t i = 0; i < points.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c)
      points[i][c] = low[c] + size[c] * static_cast<float>(uniform01(seed, c, i));
  }
  return points;
}

TEST(FluidSearchDevice, FindsWhatAllPairsFind) {
  for (const int n : {1, 2, 31, 32, 33, Policy::threads, Policy::threads + 1, 1500}) {
    const float side = std::cbrt(static_cast<float>(n));
    expect_found<false>(cloud(n, {-3, 5, 0}, {side, side, side}), 2.0f);
    expect_found<true>(cloud(n, {-3, 5, 0}, {side, side, side}), 2.0f);
  }
}

TEST(FluidSearchDevice, FindsThemAfterMoves) {
  const std::vector<Point> points = cloud(1500, {-3, 5, 0}, {11, 12, 13});
  for (const float most : {0.1f, 0.7f, 3.0f, 50.0f}) expect_found<true>(points, 2.0f, most);
}

TEST(FluidSearchDevice, RunsQueuesAndListsOverflow) {
  // As many in a small ball as fill a list and one more, and so for runs and the queue.
  for (const int n : {Policy::listed - 1, Policy::listed, Policy::listed + 1, Policy::longest_run,
                      Policy::longest_run + 1, 4 * Policy::longest_run + 3, 700}) {
    EXPECT_GE(expect_found<false>(cloud(n, {1, 1, 1}, {0.5f, 0.5f, 0.5f}), 2.0f), n);
    EXPECT_GE(expect_found<true>(cloud(n, {1, 1, 1}, {0.5f, 0.5f, 0.5f}), 2.0f), n);
  }
}

TEST(FluidSearchDevice, CodesLetFewPassTooMany) {
  const std::vector<Point> points = cloud(3000, {0, 0, 0}, {14, 14, 14});
  int listed = 0, all = 0;
  for (const Found& f : find<false>(points, 2.0f)) {
    listed += f.listed;
    all += f.all;
  }
  EXPECT_LT(listed, 1.2 * all);
}

TEST(FluidSearchDevice, LatticesHaveNeighboursAtExactlyH) {
  std::vector<Point> points;
  for (int i = 0; i < 7; ++i) {
    for (int j = 0; j < 6; ++j) {
      for (int k = 0; k < 9; ++k)
        points.push_back({static_cast<float>(i), static_cast<float>(-j), static_cast<float>(k)});
    }
  }
  for (const Found& f : find<false>(points, 2.0f)) ASSERT_EQ(f.searched, f.all);
  for (const Found& f : find<true>(points, 2.0f)) {
    ASSERT_EQ(f.searched, f.all);  // places of whole metres are exact
    ASSERT_EQ(f.read, f.all);
  }
}

TEST(FluidSearchDevice, FarFromTheOriginAndFarApart) {
  std::vector<Point> points = cloud(300, {1e4f, -1e4f, 1e4f}, {6, 7, 8});
  expect_found<false>(points, 2.0f);
  expect_found<true>(points, 2.0f);
  // Cells as wide as the distance between the clouds, in which places wrap around: 2^9 m at h = 2.
  for (const Point& low : {Point{-5e5f, 0, 0}, Point{0, 7e5f, 0}, Point{0, 7e5f + 512, 0}}) {
    for (const Point& p : cloud(150, low, {6, 5, 7}, 3)) points.push_back(p);
  }
  expect_found<false>(points, 2.0f);
  expect_found<true>(points, 2.0f);
  expect_found<true>(points, 2.0f, 0.5f);
}

TEST(FluidSearchDevice, AnyH) {
  for (const float h : {1e-3f, 0.7f, 1.0f, 1.37f, 1e3f}) {
    const float side = 5 * h;
    expect_found<false>(cloud(700, {0, -side, 2 * side}, {side, side, side}), h);
    expect_found<true>(cloud(700, {0, -side, 2 * side}, {side, side, side}), h, 0.2f * h);
  }
}

TEST(FluidSearchDevice, BoxesWithoutWidth) {
  for (std::size_t axis = 0; axis < 3; ++axis) {
    Point size{0, 0, 0};
    size[axis] = 300;
    expect_found<false>(cloud(600, {1, 2, 3}, size), 2.0f);
    expect_found<true>(cloud(600, {1, 2, 3}, size), 2.0f, 0.3f);
  }
}

}  // namespace
}  // namespace gpuphys::testing

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  const bool device = argc == 2 && std::string(argv[1]) == "device";
  if (argc > 2 || (argc == 2 && !device && std::string(argv[1]) != "host")) {
    std::fprintf(stderr, "usage: test_fluid_search_device [host|device]\n");
    return 2;
  }
#ifndef GPUPHYS_EMULATED
  if (device) {
    try {
      gpuphys::require_gpu();
    } catch (const gpuphys::Error& e) {
      std::fprintf(stderr, "test_fluid_search_device: %s\n", e.what());
      return static_cast<int>(e.code());
    }
  }
#endif
  testing::GTEST_FLAG(filter) = device ? "FluidSearchDevice.*" : "FluidSearchHost.*";
  return RUN_ALL_TESTS();
}
