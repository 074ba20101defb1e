// The blocks that the implicit elastic references share (references/blocks/): merged rows of elements in
// random order, Chebyshev's iteration, conjugate gradients. On random graphs, against plain loops in FP64.
// Exit code 77 without a GPU.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <map>
#include <utility>
#include <vector>

#include "core/generators/random.hpp"
#include "references/blocks/chebyshev.cuh"
#include "references/blocks/conjugate_gradient.cuh"
#include "references/blocks/laplacian_rows.cuh"

namespace gpuphys {
namespace {

struct Edge {
  int i, j;
  float weight;
};

struct Graph {
  int n;
  std::vector<float> mass;
  std::vector<Edge> edges;  // repeated ones add up
};

/// Every fifth edge is one of those before again, turned round; edge 0 to `hub` - 1 lead to vertex 0.
Graph random_graph(int n, int edges, int hub, std::uint64_t seed) {
  Graph g{n, {}, {}};
  for (int i = 0; i < n; ++i)
    g.mass.push_back(static_cast<float>(0.5 + uniform01(seed, 0, static_cast<unsigned>(i))));
  for (int e = 0; e < edges; ++e) {
    const auto item = static_cast<std::uint64_t>(e);
    int i = e < hub ? 0 : static_cast<int>(random_bits(seed, 1, item) % static_cast<unsigned>(n));
    int j = static_cast<int>(random_bits(seed, 2, item) % static_cast<unsigned>(n));
    if (e % 5 == 4) {
      i = g.edges[static_cast<std::size_t>(e / 2)].j;
      j = g.edges[static_cast<std::size_t>(e / 2)].i;
    }
    if (i == j) j = (i + 1) % n;
    g.edges.push_back({i, j, static_cast<float>(0.25 + uniform01(seed, 3, item))});
  }
  return g;
}

template <class T>
DeviceBuffer<T> upload(const std::vector<T>& v) {
  DeviceBuffer<T> b(v.size());
  GPUPHYS_CUDA(cudaMemcpy(b.get(), v.data(), sizeof(T) * v.size(), cudaMemcpyHostToDevice));
  return b;
}
template <class T>
std::vector<T> download(const T* from, std::size_t count) {
  std::vector<T> v(count);
  GPUPHYS_CUDA(cudaMemcpy(v.data(), from, sizeof(T) * count, cudaMemcpyDeviceToHost));
  return v;
}

__global__ void count_room(const Edge* edges, int m, std::int32_t* room) {
  const int e = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (e >= m) return;
  atomicAdd(room + edges[e].i, 1);
  atomicAdd(room + edges[e].j, 1);
}
__global__ void add_edges(const Edge* edges, int m, rows::Tables tables) {
  const int e = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (e >= m) return;
  tables.add(edges[e].i, edges[e].j, edges[e].weight);
  tables.add(edges[e].j, edges[e].i, edges[e].weight);
}

/// Rows of a graph on the device.
struct OnDevice {
  explicit OnDevice(const Graph& g)
      : edges(upload(g.edges)),
        mass(upload(g.mass)),
        matrix(g.n, 2 * static_cast<std::int64_t>(g.edges.size())) {
    const int m = static_cast<int>(g.edges.size());
    const auto blocks = static_cast<unsigned>(m / 128 + 1);
    count_room<<<blocks, 128>>>(edges.get(), m, matrix.room());
    add_edges<<<blocks, 128>>>(edges.get(), m, matrix.begin());
    rows = matrix.finish(mass.get());
  }
  DeviceBuffer<Edge> edges;
  DeviceBuffer<float> mass;
  rows::MergedRows matrix;
  rows::Rows rows{};
};

using Vectors = std::vector<std::array<double, 3>>;

Vectors product(const Graph& g, const Vectors& x) {
  Vectors y(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) y[i][c] = static_cast<double>(g.mass[i]) * x[i][c];
  }
  for (const Edge& e : g.edges) {
    const auto i = static_cast<std::size_t>(e.i), j = static_cast<std::size_t>(e.j);
    for (std::size_t c = 0; c < 3; ++c) {
      const double flow = static_cast<double>(e.weight) * (x[i][c] - x[j][c]);
      y[i][c] += flow;
      y[j][c] -= flow;
    }
  }
  return y;
}

/// A random solution and the right-hand side that belongs to it.
std::pair<Vectors, std::vector<float4>> manufactured(const Graph& g, std::uint64_t seed) {
  Vectors x(static_cast<std::size_t>(g.n));
  for (std::size_t i = 0; i < x.size(); ++i) {
    for (std::size_t c = 0; c < 3; ++c) x[i][c] = uniform11(seed, 10, 3 * i + c);
  }
  std::vector<float4> b;
  for (const auto& r : product(g, x))
    b.push_back(
        make_float4(static_cast<float>(r[0]), static_cast<float>(r[1]), static_cast<float>(r[2]), 0.0f));
  return {x, b};
}

double relative_error(const std::vector<float4>& got, const Vectors& expected) {
  double error = 0, size = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    const double g[3] = {got[i].x, got[i].y, got[i].z};
    for (std::size_t c = 0; c < 3; ++c) {
      error += (g[c] - expected[i][c]) * (g[c] - expected[i][c]);
      size += expected[i][c] * expected[i][c];
    }
  }
  return std::sqrt(error / size);
}

TEST(MergedRows, HoldEachPairOnceWithTheSumOfItsWeights) {
  for (const auto& [n, m, hub] : {std::array{2, 3, 0}, std::array{33, 97, 0}, std::array{1025, 7001, 600}}) {
    const Graph g = random_graph(n, m, hub, 5);
    std::vector<std::map<int, double>> expected(static_cast<std::size_t>(n));
    for (const Edge& e : g.edges) {
      expected[static_cast<std::size_t>(e.i)][e.j] += static_cast<double>(e.weight);
      expected[static_cast<std::size_t>(e.j)][e.i] += static_cast<double>(e.weight);
    }
    const OnDevice d(g);
    const auto first = download(d.rows.first, static_cast<std::size_t>(n) + 1);
    const auto entries = static_cast<std::size_t>(first.back());
    const auto other = download(d.rows.other, entries);
    const auto weight = download(d.rows.weight, entries);
    for (std::size_t i = 0; i < expected.size(); ++i) {
      ASSERT_EQ(static_cast<std::size_t>(first[i + 1] - first[i]), expected[i].size())
          << "row " << i << " of " << n;
      for (auto e = static_cast<std::size_t>(first[i]); e < static_cast<std::size_t>(first[i + 1]); ++e) {
        ASSERT_EQ(expected[i].count(other[e]), 1u);
        EXPECT_NEAR(static_cast<double>(weight[e]), expected[i][other[e]], 1e-5 * expected[i][other[e]]);
      }
    }
  }
}

TEST(Chebyshev, SolvesToThePartOfTheErrorThatIsAskedFor) {
  const Graph g = random_graph(1025, 7001, 600, 6);
  const OnDevice d(g);
  const auto [x, b] = manufactured(g, 7);
  const DeviceBuffer<float4> rhs = upload(b);
  chebyshev::Solver solver(g.n);
  int earlier = 0;
  for (const double part : {1e-1, 1e-3, 1e-5}) {
    solver.prepare(d.rows, part);
    EXPECT_GT(solver.steps(), earlier);
    earlier = solver.steps();
    // In the norm of A it is below `part`; in the plain norm by no more than the root of the condition above.
    EXPECT_LT(relative_error(download(solver.solve(rhs.get()), x.size()), x), 10 * part) << part;
  }
}

TEST(Chebyshev, WithoutEntriesAFewStepsAreExact) {
  Graph g = random_graph(37, 1, 0, 8);
  g.edges[0].weight = 0;
  const OnDevice d(g);
  const auto [x, b] = manufactured(g, 9);
  const DeviceBuffer<float4> rhs = upload(b);
  chebyshev::Solver solver(g.n);
  solver.prepare(d.rows, 1e-5);
  EXPECT_LE(solver.steps(), 2);  // bounds have a margin of 1e-5
  EXPECT_LT(relative_error(download(solver.solve(rhs.get()), x.size()), x), 1e-6);
}

__global__ void multiply(rows::Rows a, float sign, const float4* p, float4* q, const cg::State* state) {
  if (state->status != 0) return;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= a.n) return;
  float4 sum = make_float4(a.mass[i] * p[i].x, a.mass[i] * p[i].y, a.mass[i] * p[i].z, 0.0f);
  for (int e = a.first[i]; e < a.first[i + 1]; ++e)
    sum = cg::plus(sum, a.weight_of(e), cg::plus(p[i], -1.0f, p[a.other[e]]));
  q[i] = make_float4(sign * sum.x, sign * sum.y, sign * sum.z, 0.0f);
}

struct CgRun {
  std::vector<float4> x;
  cg::State state;
};
CgRun run_cg(const Graph& g, const std::vector<float4>& b, float sign, float part) {
  const OnDevice d(g);
  const std::vector<float4> ones(b.size(), make_float4(1.0f, 1.0f, 1.0f, 0.0f));
  const DeviceBuffer<float4> r = upload(b), diagonal = upload(ones);
  const cg::Solver solver(g.n);
  const float4* const x = solver.solve(
      r.get(), diagonal.get(), part, 0.0f, 2000, [&](const float4* p, float4* q, const cg::State* state) {
        multiply<<<static_cast<unsigned>(g.n / 128 + 1), 128>>>(d.rows, sign, p, q, state);
      });
  return {download(x, b.size()), solver.read()};
}

TEST(ConjugateGradient, SolvesUntilTheResidualIsSmall) {
  const Graph g = random_graph(1025, 7001, 0, 10);
  const auto [x, b] = manufactured(g, 11);
  const CgRun run = run_cg(g, b, 1.0f, 1e-5f);
  EXPECT_EQ(run.state.status, 1);
  EXPECT_LE(run.state.residual2, run.state.target2);
  EXPECT_LT(run.state.iterations, 100);
  EXPECT_LT(relative_error(run.x, x), 1e-3);
}

TEST(ConjugateGradient, OfNegativeCurvatureTakesTheFirstDirectionAndStops) {
  const Graph g = random_graph(65, 201, 0, 12);
  const auto [x, b] = manufactured(g, 13);
  const CgRun run = run_cg(g, b, -1.0f, 1e-5f);
  EXPECT_EQ(run.state.status, 1);
  EXPECT_EQ(run.state.iterations, 1);
  for (std::size_t i = 0; i < b.size(); ++i) EXPECT_EQ(run.x[i].x, b[i].x);
}

TEST(ConjugateGradient, OfNothingIsZero) {
  const Graph g = random_graph(65, 201, 0, 14);
  const CgRun run = run_cg(g, std::vector<float4>(65, make_float4(0.0f, 0.0f, 0.0f, 0.0f)), 1.0f, 1e-5f);
  EXPECT_EQ(run.state.iterations, 0);
  for (const float4& x : run.x) EXPECT_EQ(x.x, 0.0f);
}

}  // namespace
}  // namespace gpuphys

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::puts("no GPU");
    return 77;
  }
  return RUN_ALL_TESTS();
}
