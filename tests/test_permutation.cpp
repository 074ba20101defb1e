// Reordering a problem and putting its outputs back.
#include <gtest/gtest.h>

#include <algorithm>

#include "core/contract/permutation.hpp"

namespace gpuphys {
namespace {

struct Inputs {
  View<const float, 2> x;
  View<const std::int32_t, 2> springs;
  View<const float, 1> rest;
  template <class V>
  void visit(V&& v) {
    v.array("x", x, "n,3", "m");
    v.array("springs", springs, "m,2", "1");
    v.array("rest", rest, "m", "m");
  }
};
template <class Real>
struct Outputs {
  View<Real, 2> y;
  View<Real, 1> total;
  template <class V>
  void visit(V&& v) {
    v.array("y", y, "n,3", "m");
    v.array("total", total, "4", "m");
  }
};

Task chain_task() {
  Task task;
  task.name = "chain";
  task.contract = describe<Inputs, Outputs<float>>();
  task.unordered = {{"n", {"springs"}}, {"m", {}}};
  return task;
}

// n points on a line at x = 10 i, springs between neighbours with rest length 10 i; the last spring's second
// end is not a particle.
Problem chain(std::int64_t n) {
  Problem p = make_problem(chain_task().contract, {{"n", n}, {"m", n}});
  for (std::int64_t i = 0; i < n; ++i) {
    const auto at = static_cast<std::size_t>(i);
    for (std::size_t d = 0; d < 3; ++d)
      p.inputs[0].as<float>()[3 * at + d] = static_cast<float>(10 * i) + static_cast<float>(d);
    p.inputs[1].as<std::int32_t>()[2 * at] = static_cast<std::int32_t>(i);
    p.inputs[1].as<std::int32_t>()[2 * at + 1] = i + 1 < n ? static_cast<std::int32_t>(i + 1) : -1;
    p.inputs[2].as<float>()[at] = static_cast<float>(10 * i);
  }
  return p;
}

TEST(Permutation, ItemsMoveWholeAndIndicesFollowThem) {
  const Problem before = chain(100);
  const PermutedProblem after = permuted(chain_task(), before, 7);
  const auto x = after.problem.inputs[0].as<float>();
  const auto springs = after.problem.inputs[1].as<std::int32_t>();
  const auto rest = after.problem.inputs[2].as<float>();
  int moved = 0;
  for (std::size_t s = 0; s < 100; ++s) {
    const auto a = static_cast<std::size_t>(springs[2 * s]);
    // The spring starts at the particle that it started at before, which its rest length tells.
    EXPECT_EQ(x[3 * a], rest[s]);
    EXPECT_EQ(x[3 * a + 2], rest[s] + 2);
    if (springs[2 * s + 1] >= 0)
      EXPECT_EQ(x[3 * static_cast<std::size_t>(springs[2 * s + 1])], rest[s] + 10);
    else
      EXPECT_EQ(rest[s], 990);
    moved += rest[s] != static_cast<float>(10 * s);
  }
  EXPECT_GT(moved, 50);
  EXPECT_EQ(before.inputs[2].as<float>()[3], 30);
}

TEST(Permutation, OutputsComeBackInTheOriginalOrder) {
  const Problem before = chain(100);
  const PermutedProblem after = permuted(chain_task(), before, 8);
  Arrays outputs = make_outputs(chain_task().contract, after.problem);
  std::ranges::copy(after.problem.inputs[0].as<float>(), outputs[0].as<float>().begin());
  outputs[1].as<float>()[2] = 5;
  const Arrays restored = restore_order(chain_task(), after.permutation, outputs);
  EXPECT_TRUE(std::ranges::equal(restored[0].as<float>(), before.inputs[0].as<float>()));
  EXPECT_EQ(restored[1].as<float>()[2], 5);
}

TEST(Permutation, OneItemStaysWhereItIs) {
  const PermutedProblem after = permuted(chain_task(), chain(1), 1);
  EXPECT_EQ(after.problem.inputs[0].as<float>()[2], 2);
}

TEST(Permutation, ATaskWhoseOrderMeansSomethingIsRefused) {
  Task task = chain_task();
  task.unordered.clear();
  EXPECT_THROW(permuted(task, chain(3), 1), Error);
}

}  // namespace
}  // namespace gpuphys
