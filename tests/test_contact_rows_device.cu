// Contact rows as a building block (references/blocks/contact_rows.cuh): every pair of particles nearer than
// the radius stands once in the rows of both, and nothing else does, against all pairs tested one by one;
// both kinds of particles; and a list that has no room. Exit code 77 without a GPU.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "core/generators/random.hpp"
#include "references/blocks/contact_rows.cuh"

namespace gpuphys::testing {
namespace {

using Points = std::vector<std::array<float, 3>>;

template <class T>
DeviceBuffer<T> to_device(const std::vector<T>& host) {
  DeviceBuffer<T> buffer(host.size());
  GPUPHYS_CUDA(cudaMemcpy(buffer.get(), host.data(), sizeof(T) * host.size(), cudaMemcpyHostToDevice));
  return buffer;
}
template <class T>
std::vector<T> to_host(const T* data, std::size_t count) {
  std::vector<T> host(count);
  GPUPHYS_CUDA(cudaDeviceSynchronize());
  GPUPHYS_CUDA(cudaMemcpy(host.data(), data, sizeof(T) * count, cudaMemcpyDeviceToHost));
  return host;
}

/// The partners of each particle, in order; `name` tells a particle's name.
std::vector<std::vector<int>> rows_of(const contacts::Scratch& s, const std::vector<int>& name) {
  const std::size_t n = name.size();
  const std::vector<int2> rows = to_host(s.rows, n);
  const auto used =
      std::min<unsigned long long>(to_host(s.head, 1)[0].used, static_cast<unsigned long long>(s.capacity));
  const std::vector<std::int32_t> other = to_host(s.other, static_cast<std::size_t>(used));
  std::vector<int> particle(n);
  for (std::size_t i = 0; i < n; ++i) particle[static_cast<std::size_t>(name[i])] = static_cast<int>(i);
  std::vector<std::vector<int>> partners(n);
  for (std::size_t i = 0; i < n; ++i) {
    const int2 row = rows[static_cast<std::size_t>(name[i])];
    for (int k = row.x; k < row.x + row.y; ++k)
      partners[i].push_back(particle[static_cast<std::size_t>(other[static_cast<std::size_t>(k)])]);
    std::sort(partners[i].begin(), partners[i].end());
  }
  return partners;
}

/// By all pairs, with the operations of the rows in float32: differences and squares of these numbers are
/// exact or far from the radius.
std::vector<std::vector<int>> expected_rows(const Points& x, const Points& step, float radius) {
  std::vector<std::vector<int>> partners(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t j = 0; j < x.size(); ++j) {
      double square = 0;
      for (std::size_t d = 0; d < 3; ++d) {
        const double e = (static_cast<double>(x[i][d]) - static_cast<double>(x[j][d])) +
                         (static_cast<double>(step[i][d]) - static_cast<double>(step[j][d]));
        square += e * e;
      }
      if (square > 0 && std::sqrt(square) < static_cast<double>(radius))
        partners[i].push_back(static_cast<int>(j));
    }
  }
  return partners;
}

void expect_rows(const Points& x, const Points& step, float radius, const std::string& what) {
  const std::size_t n = x.size();
  const contacts::ContactRows rows(static_cast<std::int64_t>(n));
  std::vector<float> flat, inv_mass(n, 1.0f);
  std::vector<float4> base, moved;
  std::vector<int> own(n);
  for (std::size_t i = 0; i < n; ++i) {
    flat.insert(flat.end(), x[i].begin(), x[i].end());
    base.push_back({x[i][0], x[i][1], x[i][2], 1.0f});
    moved.push_back({step[i][0], step[i][1], step[i][2], 0.0f});
    own[i] = static_cast<int>(i);
  }
  const DeviceBuffer<float> positions = to_device(flat), masses = to_device(inv_mass);
  const DeviceBuffer<float4> bases = to_device(base), steps = to_device(moved);
  const DeviceBuffer<float4> sorted(n);
  const DeviceBuffer<std::int32_t> number(n);
  const Points still(n, {0.0f, 0.0f, 0.0f});
  for (int run = 0; run < 2; ++run) {  // the second time on what the first one left
    const contacts::Scratch s = rows.build(
        contacts::InputParticles{positions.get(), masses.get(), sorted.get(), number.get()}, radius);
    EXPECT_EQ(rows_of(s, to_host(number.get(), n)), expected_rows(x, still, radius)) << what;
    const contacts::Scratch t = rows.build(contacts::MovedParticles{bases.get(), steps.get()}, radius);
    EXPECT_EQ(rows_of(t, own), expected_rows(x, step, radius)) << what << ", moved";
  }
}

Points cloud(std::size_t n, double size, std::uint64_t stream, double offset = 0) {
  Points x(n);
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t d = 0; d < 3; ++d)
      x[i][d] = static_cast<float>(offset + size * uniform11(82, stream, 3 * i + d));
  }
  return x;
}

TEST(ContactRows, HoldEveryNearPairOnceOnBothSides) {
  for (const std::size_t n : {1, 2, 31, 129, 500}) {
    const std::string of = std::to_string(n) + " particles";
    const Points step = cloud(n, 0.3, 9);
    expect_rows(cloud(n, 2, 1), step, 0.7f, of + ", some partners each");
    expect_rows(cloud(n, 0.2, 2), step, 0.9f, of + ", all near each other");
    expect_rows(cloud(n, 1000, 3), step, 0.9f, of + ", far apart");
    expect_rows(cloud(n, 4, 4, 1e4), step, 1.0f, of + ", far from the origin");
    expect_rows(cloud(n, 1e5, 5), step, 1e5f, of + ", on a large scale");
    Points row = cloud(n, 0.01, 6);
    for (std::size_t i = 0; i < n; ++i) row[i][1] = 0.4f * static_cast<float>(i);
    expect_rows(row, step, 1.0f, of + ", in a row");
    expect_rows(Points(n, {1.0f, 2.0f, 3.0f}), Points(n, {0.0f, 0.0f, 0.5f}), 1.0f, of + ", in one point");
  }
}

TEST(ContactRows, TheRadiusItselfIsOutside) {
  const Points still(3, {0.0f, 0.0f, 0.0f});
  expect_rows({{0, 0, 0}, {1.25f, 0, 0}, {0, -1.2499999f, 0}}, still, 1.25f, "at the radius and just below");
}

TEST(ContactRows, SayWhenThereIsNoRoom) {
  // 3000 particles in one spot are 9 million entries, of which 4.2 million fit.
  const std::size_t n = 3000;
  const Points x = cloud(n, 0.1, 7);
  const contacts::ContactRows rows(static_cast<std::int64_t>(n));
  std::vector<float4> base, moved(n, float4{0.0f, 0.0f, 0.0f, 0.0f});
  for (const auto& p : x) base.push_back({p[0], p[1], p[2], 1.0f});
  const DeviceBuffer<float4> bases = to_device(base), steps = to_device(moved);
  const contacts::Scratch s = rows.build(contacts::MovedParticles{bases.get(), steps.get()}, 1.0f);
  EXPECT_EQ(to_host(s.head, 1)[0].used, static_cast<unsigned long long>(n * (n - 1)));
  EXPECT_LT(static_cast<std::size_t>(s.capacity), n * (n - 1));
}

}  // namespace
}  // namespace gpuphys::testing

int main(int argc, char** argv) {
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::fprintf(stderr, "test_contact_rows_device: no CUDA device\n");
    return 77;
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
