// What a task reads and writes: names, element types, symbolic shapes, units. Each task states its contract
// once, as two structs with a visit() function (cases/<family>/<task>.hpp); everything else (module binding,
// HDF5 files, shape checks, documentation) is derived from it.
//
//     struct Inputs {
//       View<const float, 3> ux;
//       float dt;
//       template <class V> void visit(V&& v) {
//         v.array("ux", ux, "nx+1,ny,nz", "m/s");
//         v.scalar("dt", dt, "s");
//       }
//     };
#pragma once

#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

#include "core/module_abi.h"
#include "core/view.hpp"

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

/// One array of a contract. `shape` is symbolic: comma-separated terms, each a number, a name, or name+number
/// ("nx+1").
struct ArraySpec {
  std::string name;
  DType dtype;
  int rank;
  std::string shape;
  std::string unit;
  Access access = Access::read_only;
};

struct ScalarSpec {
  std::string name;
  DType dtype;
  std::string unit;
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
             Access access = Access::read_only) {
    arrays.push_back({name, dtype_of<T>(), R, shape, unit, access});
  }
  template <class T>
  void scalar(const char* name, T&, const char* unit) {
    scalars.push_back({name, dtype_of<T>(), unit});
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

  template <class T, int R>
  void array(const char*, View<T, R>& view, const char*, const char*, Access = Access::read_only) {
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
  template <class T>
  void scalar(const char*, T& value, const char*) {
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
