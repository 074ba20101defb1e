#include "core/contract/permutation.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <numeric>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys {
namespace {

constexpr std::int64_t kBlock = 1 << 16;

// The symbol that is the whole of an array's first extent.
std::string first_symbol(const ArraySpec& spec) {
  return spec.shape.substr(0, spec.shape.find(','));
}

template <class Body>
void for_each_item(std::int64_t n, Body&& body) {
  parallel_for((n + kBlock - 1) / kBlock, [&](std::int64_t block) {
    for (std::int64_t i = block * kBlock; i < std::min(n, (block + 1) * kBlock); ++i) body(i);
  });
}

std::vector<std::int64_t> random_order(std::int64_t n, std::uint64_t seed, std::uint64_t stream) {
  std::vector<std::pair<std::uint64_t, std::int64_t>> keyed(static_cast<std::size_t>(n));
  for_each_item(n, [&](std::int64_t i) {
    keyed[static_cast<std::size_t>(i)] = {random_bits(seed, stream, static_cast<std::uint64_t>(i)), i};
  });
  std::sort(keyed.begin(), keyed.end());
  std::vector<std::int64_t> order(keyed.size());
  for (std::size_t i = 0; i < keyed.size(); ++i) order[i] = keyed[i].second;
  return order;
}

// to[i] = from[order[i]], or to[order[i]] = from[i] when `back`; items are the slices along the first extent.
void move_items(HostArray& to, const HostArray& from, const std::vector<std::int64_t>& order, bool back) {
  const auto n = static_cast<std::int64_t>(order.size());
  if (n == 0) return;
  const std::size_t bytes = from.bytes() / static_cast<std::size_t>(n);
  auto* target = static_cast<char*>(to.data());
  const auto* source = static_cast<const char*>(from.data());
  for_each_item(n, [&](std::int64_t i) {
    const auto here = static_cast<std::size_t>(i), there = static_cast<std::size_t>(order[here]);
    std::memcpy(target + (back ? there : here) * bytes, source + (back ? here : there) * bytes, bytes);
  });
}

}  // namespace

PermutedProblem permuted(const Task& task, const Problem& problem, std::uint64_t seed) {
  if (task.unordered.empty()) {
    throw Error(
        ExitCode::usage,
        fmt::format("the order of the items of task '{}' means something: it cannot be permuted", task.name));
  }
  PermutedProblem result;
  result.problem = problem.clone();
  const std::map<std::string, std::int64_t> symbols = resolve_symbols(task.contract, problem, "inputs");
  std::uint64_t stream = 0;
  for (const Unordered& u : task.unordered) {
    const auto symbol = symbols.find(u.symbol);
    if (symbol == symbols.end())
      throw Error(ExitCode::internal, fmt::format("task '{}' has no shape symbol '{}'", task.name, u.symbol));
    const std::vector<std::int64_t>& order = result.permutation[u.symbol] =
        random_order(symbol->second, seed, stream++);
    for (std::size_t a = 0; a < task.contract.inputs.size(); ++a) {
      if (first_symbol(task.contract.inputs[a]) != u.symbol) continue;
      const HostArray before = result.problem.inputs[a].clone();
      move_items(result.problem.inputs[a], before, order, false);
    }
    std::vector<std::int64_t> position(order.size());
    for (std::size_t i = 0; i < order.size(); ++i)
      position[static_cast<std::size_t>(order[i])] = static_cast<std::int64_t>(i);
    for (const std::string& name : u.index_arrays) {
      const auto it = std::find_if(result.problem.inputs.begin(), result.problem.inputs.end(),
                                   [&](const HostArray& x) { return x.name() == name; });
      if (it == result.problem.inputs.end())
        throw Error(ExitCode::internal, fmt::format("task '{}' has no index array '{}'", task.name, name));
      for (std::int32_t& index : it->as<std::int32_t>()) {
        if (index >= 0 && index < symbol->second)
          index = static_cast<std::int32_t>(position[static_cast<std::size_t>(index)]);
      }
    }
  }
  return result;
}

Arrays restore_order(const Task& task, const Permutation& permutation, const Arrays& outputs) {
  Arrays restored;
  for (std::size_t a = 0; a < outputs.size(); ++a) {
    restored.push_back(outputs[a].clone());
    const auto it = permutation.find(first_symbol(task.contract.outputs[a]));
    if (it != permutation.end()) move_items(restored.back(), outputs[a], it->second, true);
  }
  return restored;
}

}  // namespace gpuphys
