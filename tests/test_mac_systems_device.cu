// The systems that fluids on a MAC grid hand to the multigrid (references/global_solve/mac_systems.cuh), as a
// building block. On the host: what one cycle does to the residual of viscosity and pressure at every grid
// size, from systems written down plainly. On the device: the assembled systems are those, and solves take
// few cycles. Exit code 77 if the device part was asked for (argument `device`) and there is none.
#include "references/global_solve/mac_systems.cuh"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "cases/global_solve/mac_fluid_inputs.hpp"
#include "cases/global_solve/viscosity_implicit.hpp"
#include "core/contract/task.hpp"
#include "core/generators/random.hpp"
#include "core/run/gpu/ceilings.hpp"
#include "tests/multigrid_host.hpp"

namespace gpuphys::testing {
namespace {

using mac_fluid::Extents;

Problem fluid(const Extents& n, const mac_fluid::Open& open, std::uint64_t seed) {
  Problem p = mac_fluid::make_fluid(find_task("viscosity_implicit").contract, n, open);
  p.set_scalar("dx", 1);
  p.set_scalar("dt", 1);
  p.set_scalar("nu", 1);
  p.set_scalar("tol", 1e-4);
  mac_fluid::set_noise(p, seed, 1);
  return p;
}

mac_fluid::Inputs inputs_of(const Problem& p) {
  return bind_inputs<viscosity_implicit::Inputs>(p);
}

/// A system in plain C order, with its right-hand side.
struct Plain {
  HostLevel level;
  std::vector<float> b;
};

/// Viscosity of one component: entry (i,j,k) is the face on the upper side of cell (i,j,k).
Plain viscosity(const Problem& p, int axis, float alpha) {
  const mac_fluid::Inputs in = inputs_of(p);
  const int n[3] = {static_cast<int>(in.uy.shape[0]), static_cast<int>(in.ux.shape[1]),
                    static_cast<int>(in.ux.shape[2])};
  Plain s{HostLevel(n[0], n[1], n[2], n[2]), {}};
  s.b.assign(s.level.diag.size(), 0.0f);
  const View<const float, 3>&w = axis == 0   ? in.wx
                                 : axis == 1 ? in.wy
                                             : in.wz,
                          &u = axis == 0   ? in.ux
                               : axis == 1 ? in.uy
                                           : in.uz;
  s.level.each([&](int i, int j, int k, int at) {
    std::int64_t face[3] = {i, j, k};
    ++face[axis];
    if (!mac_fluid::is_open(in, axis, face[0], face[1], face[2])) return;
    const float open = w(face[0], face[1], face[2]);
    s.b[at] = open * u(face[0], face[1], face[2]);
    int neighbours = 0;
    for (int d = 0; d < 3; ++d) {
      for (const int side : {-1, 1}) {
        std::int64_t other[3] = {face[0], face[1], face[2]};
        other[d] += side;
        if (other[d] < 0 || other[d] >= w.shape[d]) continue;
        ++neighbours;
        if (side == 1 && mac_fluid::is_open(in, axis, other[0], other[1], other[2]))
          (d == 0 ? s.level.ax : d == 1 ? s.level.ay : s.level.az)[at] = -alpha;
      }
    }
    s.level.diag[at] = open + static_cast<float>(neighbours) * alpha;
  });
  return s;
}

Plain pressure(const Problem& p) {
  const mac_fluid::Inputs in = inputs_of(p);
  const int n[3] = {static_cast<int>(in.uy.shape[0]), static_cast<int>(in.ux.shape[1]),
                    static_cast<int>(in.ux.shape[2])};
  Plain s{HostLevel(n[0], n[1], n[2], n[2]), {}};
  s.b.assign(s.level.diag.size(), 0.0f);
  s.level.each([&](int i, int j, int k, int at) {
    double diagonal = 0, outflow = 0;
    for (int d = 0; d < 3; ++d) {
      const View<const float, 3>&w = d == 0   ? in.wx
                                     : d == 1 ? in.wy
                                              : in.wz,
                              &u = d == 0   ? in.ux
                                   : d == 1 ? in.uy
                                            : in.uz;
      for (const int side : {0, 1}) {
        std::int64_t face[3] = {i, j, k};
        face[d] += side;
        if (!mac_fluid::is_open(in, d, face[0], face[1], face[2])) continue;
        const float open = w(face[0], face[1], face[2]);
        diagonal += open;
        outflow += (side == 1 ? 1 : -1) * static_cast<double>(open) * u(face[0], face[1], face[2]);
        if (side == 1) (d == 0 ? s.level.ax : d == 1 ? s.level.ay : s.level.az)[at] = -open;
      }
    }
    s.level.diag[at] = static_cast<float>(diagonal);
    s.b[at] = static_cast<float>(-outflow);
  });
  return s;
}

double norm(const Field& a) {
  double sum = 0;
  for (const double v : a) sum += v * v;
  return std::sqrt(sum);
}

/// Largest factor between the residuals of cycles 2 to 6 of x <- x + M (b - A x).
double convergence_factor(const Plain& s, bool singular) {
  const HostMultigrid m(s.level, singular,
                        singular ? mac_systems::kPressureTuning : mac_systems::kViscosityTuning);
  Field r(s.b.begin(), s.b.end());
  double before = 0, worst = 0;
  for (int n = 0; n < 6; ++n) {
    const Field d = m.cycle(r), ad = s.level.multiply(d);
    for (std::size_t c = 0; c < r.size(); ++c) r[c] -= ad[c];
    if (n > 1 && before > 0) worst = std::max(worst, norm(r) / before);
    before = norm(r);
  }
  return worst;
}

// ---- host ----

TEST(MacSystemsHost, ViscosityConvergesAtAFactorThatDoesNotGrowWithTheGrid) {
  for (const double alpha : {0.0, 0.5, 16.0, 1e3, 1e5}) {
    for (const std::int64_t n : {16, 32, 33, 48}) {
      const Extents e{n, n, n};
      const Problem p = fluid(e, mac_fluid::cylinder(e, 0.2), 3);
      for (const int axis : {0, 2}) {
        const double factor = convergence_factor(viscosity(p, axis, static_cast<float>(alpha)), false);
        std::printf("alpha %g, component %d, %d^3: %.3f\n", alpha, axis, static_cast<int>(n), factor);
        EXPECT_LT(factor, 0.3) << alpha << ' ' << n << ' ' << axis;
      }
    }
  }
}

TEST(MacSystemsHost, PressureConvergesAtAFactorThatDoesNotGrowWithTheGrid) {
  for (const std::int64_t n : {16, 32, 33, 48}) {
    const Extents e{n, n, n};
    const double factor = convergence_factor(pressure(fluid(e, mac_fluid::cylinder(e, 0.2), 3)), true);
    std::printf("pressure, %d^3: %.3f\n", static_cast<int>(n), factor);
    EXPECT_LT(factor, 0.25) << n;
  }
}

// ---- device ----

struct Uploaded {
  DeviceBuffer<float> u[3], w[3];
  explicit Uploaded(const Problem& p) {
    for (std::size_t c = 0; c < 3; ++c) {
      for (const bool open : {false, true}) {
        const HostArray& a = p.inputs[c + (open ? 3 : 0)];
        DeviceBuffer<float>& to = open ? w[c] : u[c];
        to = DeviceBuffer<float>(static_cast<std::size_t>(a.size()));
        GPUPHYS_CUDA(cudaMemcpy(to.get(), a.data(), a.bytes(), cudaMemcpyHostToDevice));
      }
    }
  }
};

template <class T>
std::vector<T> on_host(const T* data, std::size_t count) {
  std::vector<T> v(count);
  GPUPHYS_CUDA(cudaMemcpy(v.data(), data, sizeof(T) * count, cudaMemcpyDeviceToHost));
  return v;
}

void expect_system(const mac_systems::System& s, const Plain& expected, const std::string& what) {
  const std::size_t n = expected.b.size();
  const auto expect_near = [&](const float* got, const std::vector<float>& wanted, const char* name) {
    const std::vector<float> v = on_host(got, n);
    for (std::size_t c = 0; c < n; ++c)
      ASSERT_NEAR(v[c], wanted[c], 2e-6f * (1 + std::abs(wanted[c]))) << what << ' ' << name << ' ' << c;
  };
  expect_near(s.diag, expected.level.diag, "diag");
  expect_near(s.ax, expected.level.ax, "ax");
  expect_near(s.ay, expected.level.ay, "ay");
  expect_near(s.az, expected.level.az, "az");
  expect_near(s.b, expected.b, "b");
  std::vector<char> active(n);
  GPUPHYS_CUDA(cudaMemcpy(active.data(), s.active, n, cudaMemcpyDeviceToHost));
  for (std::size_t c = 0; c < n; ++c)
    ASSERT_EQ(active[c] != 0, expected.level.diag[c] > 0) << what << ' ' << c;
}

TEST(MacSystemsDevice, SystemsAreThoseOfTheHost) {
  for (const Extents& e : {Extents{9, 7, 5}, Extents{1, 6, 33}, Extents{12, 1, 8}, Extents{20, 17, 1}}) {
    const Problem p = fluid(e, mac_fluid::random_faces(e, 5, 0.3), 6);
    const Uploaded d(p);
    const mac_systems::Grid g{{static_cast<int>(e[0]), static_cast<int>(e[1]), static_cast<int>(e[2])}};
    mac_systems::SystemBuffers buffers;
    buffers.allocate(g);
    const unsigned blocks = mac_systems::blocks_for(g.cells());
    constexpr int threads = mac_systems::kThreads;
    mac_systems::assemble_viscosity<0>
        <<<blocks, threads>>>(g, d.w[0].get(), d.u[0].get(), 0.75f, buffers.system());
    expect_system(buffers.system(), viscosity(p, 0, 0.75f), "x");
    mac_systems::assemble_viscosity<1>
        <<<blocks, threads>>>(g, d.w[1].get(), d.u[1].get(), 0.75f, buffers.system());
    expect_system(buffers.system(), viscosity(p, 1, 0.75f), "y");
    mac_systems::assemble_viscosity<2>
        <<<blocks, threads>>>(g, d.w[2].get(), d.u[2].get(), 0.75f, buffers.system());
    expect_system(buffers.system(), viscosity(p, 2, 0.75f), "z");
    mac_systems::assemble_pressure<<<blocks, threads>>>(g, {{d.w[0].get(), d.w[1].get(), d.w[2].get()}},
                                                        d.u[0].get(), d.u[1].get(), d.u[2].get(),
                                                        buffers.system());
    expect_system(buffers.system(), pressure(p), "pressure");
  }
}

TEST(MacSystemsDevice, SolvesTakeFewCyclesOnEveryGrid) {
  for (const std::int64_t n : {31, 32, 64, 128}) {
    const Extents e{n, n, n};
    const Problem p = fluid(e, mac_fluid::cylinder(e, 0.2), 3);
    const Uploaded d(p);
    const int m = static_cast<int>(n);
    const mac_systems::Grid g{{m, m, m}};
    mac_systems::SystemBuffers buffers;
    buffers.allocate(g);
    for (const float alpha : {0.5f, 16.0f, 1000.0f}) {
      multigrid::Solver solver;
      solver.allocate(m, m, m, false, mac_systems::kViscosityTuning);
      mac_systems::assemble_viscosity<2><<<mac_systems::blocks_for(g.cells()), mac_systems::kThreads>>>(
          g, d.w[2].get(), d.u[2].get(), alpha, buffers.system());
      buffers.solve(solver, 1e-4f);
      std::printf("alpha %g, %d^3: %d cycles\n", alpha, m, solver.report().cycles);
      EXPECT_TRUE(solver.report().converged) << alpha << ' ' << n;
      EXPECT_LE(solver.report().cycles, 8) << alpha << ' ' << n;
    }
    multigrid::Solver solver;
    solver.allocate(m, m, m, true, mac_systems::kPressureTuning);
    float* u[3] = {d.u[0].get(), d.u[1].get(), d.u[2].get()};
    mac_systems::project(g, {{d.w[0].get(), d.w[1].get(), d.w[2].get()}}, u, 1e-4f, buffers, solver, u);
    std::printf("pressure, %d^3: %d cycles\n", m, solver.report().cycles);
    EXPECT_TRUE(solver.report().converged) << n;
    EXPECT_LE(solver.report().cycles, 8) << n;
  }
}

}  // namespace
}  // namespace gpuphys::testing

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  const bool device = argc == 2 && std::string(argv[1]) == "device";
  if (argc > 2 || (argc == 2 && !device && std::string(argv[1]) != "host")) {
    std::fprintf(stderr, "usage: test_mac_systems_device [host|device]\n");
    return 2;
  }
  if (device) {
    try {
      gpuphys::require_gpu();
    } catch (const gpuphys::Error& e) {
      std::fprintf(stderr, "test_mac_systems_device: %s\n", e.what());
      return static_cast<int>(e.code());
    }
  }
  testing::GTEST_FLAG(filter) = device ? "MacSystemsDevice.*" : "MacSystemsHost.*";
  return RUN_ALL_TESTS();
}
