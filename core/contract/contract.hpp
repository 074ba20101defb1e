// What a task reads and writes: names, element types, symbolic shapes, units. Each task states its contract
// once, as two structs with a visit() function (cases/<family>/<task>.hpp); everything else (module binding,
// HDF5 files, shape checks, documentation) is derived from it.
//
//     struct Inputs {
//       View<const float, 3> ux;
//       float dt;
//       template <class V> void visit(V&& v) {
//         v.array("ux", ux, "nx+1,ny,nz", "m/s", between(-1e9, 1e9));
//         v.scalar("dt", dt, "s", positive());
//       }
//     };
#pragma once

#include <cstdint>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "core/contract/module_abi.h"
#include "core/contract/view.hpp"

namespace gpuphys {

enum class DType : int { f32 = GPUPHYS_F32, f64 = GPUPHYS_F64, i32 = GPUPHYS_I32, boolean = GPUPHYS_BOOL };

std::size_t size_of(DType);
std::string to_string(DType);

template <class T>
constexpr DType dtype_of() {
  using U = std::remove_const_t<T>;
  if constexpr (std::is_same_v<U, float>) return DType::f32;
  if constexpr (std::is_same_v<U, double>) return DType::f64;
  if constexpr (std::is_same_v<U, std::int32_t>) return DType::i32;
  if constexpr (std::is_same_v<U, bool>) return DType::boolean;
}

enum class Access { read_only, overwritable };

/// The values of an array or scalar that are valid: finite, and within the bounds. A specification says what
/// they are; inputs from files are held to them, and so are the suite's own sets.
struct Valid {
  double least = -std::numeric_limits<double>::infinity();
  double most = std::numeric_limits<double>::infinity();
  bool above_least = false;  ///< `least` itself is not valid
  std::string index_of;      ///< the shape symbol that entries count along: [0, its value)
};
inline Valid finite() {
  return {};
}
inline Valid positive(double most = std::numeric_limits<double>::infinity()) {
  return {0, most, true, {}};
}
inline Valid at_least(double least) {
  return {least, std::numeric_limits<double>::infinity(), false, {}};
}
inline Valid between(double least, double most) {
  return {least, most, false, {}};
}
/// Entries that count along the shape symbol `symbol`, from 0.
inline Valid index_into(std::string symbol) {
  Valid v;
  v.index_of = std::move(symbol);
  return v;
}

/// One array of a contract. `shape` is symbolic: comma-separated terms, each a number, a name, or name+number
/// ("nx+1").
struct ArraySpec {
  std::string name;
  DType dtype;
  int rank;
  std::string shape;
  std::string unit;
  Access access = Access::read_only;
  Valid valid = {};
};

struct ScalarSpec {
  std::string name;
  DType dtype;
  std::string unit;
  Valid valid = {};
};

struct Contract {
  std::vector<ArraySpec> inputs, outputs;
  std::vector<ScalarSpec> scalars;
};

namespace detail {

struct DescribeVisitor {
  std::vector<ArraySpec>& arrays;
  std::vector<ScalarSpec>& scalars;
  template <class T, int R>
  void array(const char* name, View<T, R>&, const char* shape, const char* unit,
             Access access = Access::read_only, Valid valid = {}) {
    arrays.push_back({name, dtype_of<T>(), R, shape, unit, access, std::move(valid)});
  }
  template <class T, int R>
  void array(const char* name, View<T, R>& view, const char* shape, const char* unit, Valid valid) {
    array(name, view, shape, unit, Access::read_only, std::move(valid));
  }
  template <class T>
  void scalar(const char* name, T&, const char* unit, Valid valid = {}) {
    scalars.push_back({name, dtype_of<T>(), unit, std::move(valid)});
  }
};

// Binds ABI arrays to views in declaration order. Throwing is left to the caller: `ok` says whether
// everything matched.
struct BindVisitor {
  const gpuphys_array* arrays;
  int n_arrays;
  const gpuphys_scalar* scalars;
  int n_scalars;
  int next_array = 0, next_scalar = 0;
  bool ok = true;

  template <class T, int R, class... Rest>
  void array(const char*, View<T, R>& view, const char*, const char*, const Rest&...) {
    if (next_array >= n_arrays) {
      ok = false;
      return;
    }
    const gpuphys_array& a = arrays[next_array++];
    if (a.rank != R || a.dtype != static_cast<int>(dtype_of<T>())) {
      ok = false;
      return;
    }
    view.data = static_cast<T*>(a.data);
    for (int d = 0; d < R; ++d) view.shape[d] = a.shape[d];
  }
  template <class T, class... Rest>
  void scalar(const char*, T& value, const char*, const Rest&...) {
    if (next_scalar >= n_scalars) {
      ok = false;
      return;
    }
    value = static_cast<T>(scalars[next_scalar++].value);
  }
};

}  // namespace detail

/// The contract that an Inputs and an Outputs struct describe.
template <class Inputs, class Outputs>
Contract describe() {
  Contract c;
  std::vector<ScalarSpec> none;
  Inputs in;
  Outputs out;
  in.visit(detail::DescribeVisitor{c.inputs, c.scalars});
  out.visit(detail::DescribeVisitor{c.outputs, none});
  return c;
}

}  // namespace gpuphys
