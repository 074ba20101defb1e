// Owning host arrays with a name, element type, shape and unit, and the sets of them that make up a problem.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/base/error.hpp"
#include "core/base/memory.hpp"
#include "core/contract/contract.hpp"

namespace gpuphys {

using Shape = std::vector<std::int64_t>;

std::string to_string(const Shape&);  ///< "(257, 256, 256)"
std::int64_t element_count(const Shape&);

/// A dense C-order array in host memory: its own, zeroed on construction, or a part of shared memory.
class HostArray {
 public:
  HostArray() = default;
  HostArray(std::string name, DType, Shape, std::string unit = "");
  /// The bytes from `offset` on. Where the memory is read-only, so is the array: write access throws
  /// Error(internal).
  HostArray(std::string name, DType, Shape, std::string unit, std::shared_ptr<SharedMemory>,
            std::size_t offset);

  const std::string& name() const { return name_; }
  DType dtype() const { return dtype_; }
  const Shape& shape() const { return shape_; }
  const std::string& unit() const { return unit_; }
  std::int64_t size() const { return size_; }
  std::size_t bytes() const { return static_cast<std::size_t>(size_) * size_of(dtype_); }
  void* data() {
    require_writable();
    return data_;
  }
  const void* data() const { return data_; }
  /// The shared memory that holds it, null if it has its own; and where in it.
  const std::shared_ptr<SharedMemory>& shared() const { return shared_; }
  std::size_t shared_offset() const {
    return shared_ ? static_cast<std::size_t>(data_ - shared_->data()) : 0;
  }

  /// Typed access; throws Error(internal) when T is not the element type.
  template <class T>
  std::span<T> as() {
    require(dtype_of<T>());
    require_writable();
    return {reinterpret_cast<T*>(data_), static_cast<std::size_t>(size_)};
  }
  template <class T>
  std::span<const T> as() const {
    require(dtype_of<T>());
    return {reinterpret_cast<const T*>(data_), static_cast<std::size_t>(size_)};
  }
  /// Element i as FP64, whatever the element type.
  double value(std::int64_t i) const;
  /// A deep copy (copying is explicit because arrays are large).
  HostArray clone() const;

  HostArray(HostArray&&) = default;
  HostArray& operator=(HostArray&&) = default;

 private:
  void require(DType) const;
  void require_writable() const;
  struct Free {
    std::size_t bytes;
    void operator()(std::byte* p) const;
  };
  std::string name_, unit_;
  DType dtype_ = DType::f32;
  Shape shape_;
  std::int64_t size_ = 0;
  std::unique_ptr<std::byte[], Free> own_;
  std::shared_ptr<SharedMemory> shared_;
  std::byte* data_ = nullptr;
};

using Arrays = std::vector<HostArray>;

/// The array called `name`; throws Error(bad_input) naming `where` when it is missing.
const HostArray& find(const Arrays&, const std::string& name, const std::string& where);

struct Scalar {
  std::string name;
  DType dtype;
  double value;
};

/// Everything a task reads.
struct Problem {
  Arrays inputs;
  std::vector<Scalar> scalars;

  double scalar(const std::string& name) const;
  void set_scalar(const std::string& name, double value);
  Problem clone() const;
};

/// Values of the shape symbols ("nx" -> 256) that the inputs imply: int32 scalars named like a symbol define
/// it (for outputs whose extents no input array has), arrays define the others. Throws Error(bad_input) with
/// one line naming the array, its shape and what was expected when an array is missing, has the wrong type or
/// rank, or contradicts another.
std::map<std::string, std::int64_t> resolve_symbols(const Contract&, const Problem&,
                                                    const std::string& where);

/// The shape that a symbolic shape has for these symbols. Throws Error(internal) for an unknown symbol.
Shape evaluate_shape(const ArraySpec&, const std::map<std::string, std::int64_t>& symbols);

/// Zeroed inputs and scalars of a contract for given symbol values; int32 scalars named like a symbol get its
/// value.
Problem make_problem(const Contract&, const std::map<std::string, std::int64_t>& symbols);

/// Zeroed outputs for these inputs; floating-point outputs are of type `real` (f32, or f64 for truth).
Arrays make_outputs(const Contract&, const Problem&, DType real = DType::f32);

/// Fills an Inputs or Outputs struct of views with pointers into `arrays`.
/// (Inputs views are const; generators bind a struct of their own or write through HostArray::as().)
template <class Inputs>
Inputs bind_inputs(const Problem& p);
template <class Outputs>
Outputs bind_outputs(Arrays& a);

/// The C structs of the module interface over these arrays. Keeps pointers into them; `with_data` false gives
/// null data.
struct AbiProblem {
  std::vector<gpuphys_array> inputs, outputs;
  std::vector<gpuphys_scalar> scalars;
  gpuphys_problem problem() const;
};
gpuphys_array abi_array(const HostArray&, void* data);
AbiProblem abi_problem(const Problem&, const Arrays& outputs, bool with_data);

// ---- implementation of templates, and of what inner loops call ----

inline double HostArray::value(std::int64_t i) const {
  switch (dtype_) {
    case DType::f32:
      return static_cast<double>(reinterpret_cast<const float*>(data_)[i]);
    case DType::f64:
      return reinterpret_cast<const double*>(data_)[i];
    case DType::i32:
      return static_cast<double>(reinterpret_cast<const std::int32_t*>(data_)[i]);
    case DType::boolean:
      return static_cast<double>(std::to_integer<int>(data_[i]));
  }
  return 0;
}

template <class Inputs>
Inputs bind_inputs(const Problem& p) {
  const AbiProblem abi = abi_problem(p, {}, true);
  Inputs in;
  detail::BindVisitor v{abi.inputs.data(), static_cast<int>(abi.inputs.size()), abi.scalars.data(),
                        static_cast<int>(abi.scalars.size())};
  in.visit(v);
  if (!v.ok) throw Error(ExitCode::internal, "bind_inputs: problem does not match the contract");
  return in;
}

template <class Outputs>
Outputs bind_outputs(Arrays& a) {
  std::vector<gpuphys_array> abi;
  for (HostArray& x : a) abi.push_back(abi_array(x, x.data()));
  Outputs out;
  detail::BindVisitor v{abi.data(), static_cast<int>(abi.size()), nullptr, 0};
  out.visit(v);
  if (!v.ok) throw Error(ExitCode::internal, "bind_outputs: arrays do not match the contract");
  return out;
}

}  // namespace gpuphys
