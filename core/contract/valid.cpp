#include "core/contract/valid.hpp"

#include <fmt/format.h>

#include <cmath>
#include <optional>

#include "core/base/parallel.hpp"

namespace gpuphys {
namespace {

std::string index_text(const HostArray& a, std::int64_t flat) {
  std::string text;
  for (std::size_t d = a.shape().size(); d-- > 0;) {
    text = fmt::format("{}{}{}", flat % a.shape()[d], text.empty() ? "" : ",", text);
    flat /= a.shape()[d];
  }
  return fmt::format("{}[{}]", a.name(), text);
}

bool holds(double v, const Valid& valid) {
  return std::isfinite(v) && v >= valid.least && v <= valid.most && !(valid.above_least && v == valid.least);
}

// Bounds as the type holds them: 1e-6 is no float32, and the nearest one is valid.
Valid as_held(Valid v, DType dtype) {
  if (dtype != DType::f32) return v;
  if (std::isfinite(v.least)) v.least = static_cast<double>(static_cast<float>(v.least));
  if (std::isfinite(v.most)) v.most = static_cast<double>(static_cast<float>(v.most));
  return v;
}

// The bounds with an index's extent put in.
Valid bounds_of(const Valid& valid, const std::map<std::string, std::int64_t>& symbols) {
  if (valid.index_of.empty()) return valid;
  const auto found = symbols.find(valid.index_of);
  if (found == symbols.end())
    throw Error(ExitCode::internal, fmt::format("valid range: no shape symbol '{}'", valid.index_of));
  return between(0, static_cast<double>(found->second) - 1);
}

}  // namespace

std::string to_string(const Valid& v) {
  if (!v.index_of.empty()) return "index along " + v.index_of;
  const bool low = std::isfinite(v.least), high = std::isfinite(v.most);
  if (!low && !high) return "finite";
  if (low && high) return fmt::format("in {}{:g}, {:g}]", v.above_least ? "(" : "[", v.least, v.most);
  if (low) return fmt::format("{} {:g}", v.above_least ? ">" : ">=", v.least);
  return fmt::format("<= {:g}", v.most);
}

void require_valid(const Contract& contract, const Problem& problem, const std::string& where) {
  const auto symbols = resolve_symbols(contract, problem, where);
  for (const ArraySpec& spec : contract.inputs) {
    const HostArray& a = find(problem.inputs, spec.name, where);
    const Valid valid =
        spec.dtype == DType::boolean ? between(0, 1) : as_held(bounds_of(spec.valid, symbols), spec.dtype);
    std::vector<std::int64_t> first(static_cast<std::size_t>(pieces_of(a.size())), -1);
    parallel_pieces(a.size(), [&](std::int64_t piece, std::int64_t begin, std::int64_t end) {
      for (std::int64_t i = begin; i < end; ++i) {
        if (holds(a.value(i), valid)) continue;
        first[static_cast<std::size_t>(piece)] = i;
        return;
      }
    });
    for (const std::int64_t i : first) {
      if (i < 0) continue;
      throw Error(
          ExitCode::bad_input,
          fmt::format("{}: {} is {:.9g}, must be {}", where, index_text(a, i), a.value(i),
                      spec.valid.index_of.empty() ? to_string(valid)
                                                  : fmt::format("an index along {} ({})", spec.valid.index_of,
                                                                symbols.at(spec.valid.index_of))));
    }
  }
  for (const ScalarSpec& spec : contract.scalars) {
    const double v = problem.scalar(spec.name);
    if (!holds(v, as_held(bounds_of(spec.valid, symbols), spec.dtype)))
      throw Error(ExitCode::bad_input, fmt::format("{}: scalar '{}' is {:.9g}, must be {}", where, spec.name,
                                                   v, to_string(spec.valid)));
  }
}

}  // namespace gpuphys
