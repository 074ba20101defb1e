#include "core/contract/arrays.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/mman.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <new>
#include <sstream>

namespace gpuphys {
namespace {

std::vector<std::string> split(const std::string& text, char separator) {
  std::vector<std::string> parts;
  std::stringstream in(text);
  for (std::string part; std::getline(in, part, separator);) parts.push_back(part);
  return parts;
}

// Arrays from here on are mapped by themselves, in huge pages where the system has them: at paper size the
// faults of small pages would cost more than the copies that raise them.
constexpr std::size_t kMappedBytes = std::size_t{8} << 20;

// Untouched zero pages, so that construction costs nothing until they are filled; null without memory.
std::byte* zeroed(std::size_t bytes) {
  if (bytes < kMappedBytes) return static_cast<std::byte*>(std::calloc(std::max<std::size_t>(bytes, 1), 1));
  void* p = ::mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (p == MAP_FAILED) return nullptr;
  (void)::madvise(p, bytes, MADV_HUGEPAGE);
  return static_cast<std::byte*>(p);
}

// One term of a symbolic shape: a number, or a symbol plus an offset ("nx+1").
struct ShapeTerm {
  std::string symbol;  // empty for a plain number
  std::int64_t offset = 0;
};

ShapeTerm parse_term(const std::string& text) {
  const std::size_t plus = text.find('+');
  const std::string head = text.substr(0, plus);
  ShapeTerm term;
  if (plus != std::string::npos) term.offset = std::stoll(text.substr(plus + 1));
  if (head.find_first_not_of("0123456789") == std::string::npos) {
    term.offset += std::stoll(head);
  } else {
    term.symbol = head;
  }
  return term;
}

std::vector<ShapeTerm> parse_shape(const ArraySpec& spec) {
  std::vector<ShapeTerm> terms;
  for (const std::string& part : split(spec.shape, ',')) terms.push_back(parse_term(part));
  if (static_cast<int>(terms.size()) != spec.rank) {
    throw Error(ExitCode::internal, fmt::format("contract of array '{}': shape '{}' does not have rank {}",
                                                spec.name, spec.shape, spec.rank));
  }
  return terms;
}

// Whether some array's extent is stated in terms of `name`.
bool is_shape_symbol(const Contract& contract, const std::string& name) {
  for (const std::vector<ArraySpec>* specs : {&contract.inputs, &contract.outputs}) {
    for (const ArraySpec& spec : *specs) {
      for (const ShapeTerm& term : parse_shape(spec)) {
        if (term.symbol == name) return true;
      }
    }
  }
  return false;
}

}  // namespace

std::size_t size_of(DType type) {
  switch (type) {
    case DType::f32:
    case DType::i32:
      return 4;
    case DType::f64:
      return 8;
    case DType::boolean:
      return 1;
  }
  throw Error(ExitCode::internal, "size_of: unknown element type");
}

std::string to_string(DType type) {
  switch (type) {
    case DType::f32:
      return "float32";
    case DType::f64:
      return "float64";
    case DType::i32:
      return "int32";
    case DType::boolean:
      return "bool";
  }
  return "unknown";
}

std::string to_string(const Shape& shape) {
  return fmt::format("({})", fmt::join(shape, ", "));
}

std::int64_t element_count(const Shape& shape) {
  // Eight bytes per element must still fit: extents from files may be anything.
  constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max() / 16;
  std::int64_t n = 1;
  bool too_many = false;
  for (const std::int64_t extent : shape) {
    if (extent <= 0) return 0;
    too_many = too_many || __builtin_mul_overflow(n, extent, &n) || n > kMost;
  }
  if (too_many)
    throw Error(ExitCode::bad_input,
                fmt::format("shape {} has more elements than memory can hold", to_string(shape)));
  return n;
}

void HostArray::Free::operator()(std::byte* p) const {
  if (bytes < kMappedBytes)
    std::free(p);
  else
    ::munmap(p, bytes);
}

HostArray::HostArray(std::string name, DType dtype, Shape shape, std::string unit)
    : name_(std::move(name)), unit_(std::move(unit)), dtype_(dtype), shape_(std::move(shape)) {
  for (const std::int64_t extent : shape_) {
    if (extent < 0) {
      throw Error(ExitCode::bad_input,
                  fmt::format("array '{}': negative extent in shape {}", name_, gpuphys::to_string(shape_)));
    }
  }
  size_ = element_count(shape_);
  own_ = decltype(own_)(zeroed(bytes()), Free{bytes()});
  if (!own_) {
    throw Error(ExitCode::out_of_memory,
                fmt::format("array '{}': cannot allocate {} MiB of host memory", name_, bytes() >> 20));
  }
  data_ = own_.get();
}

HostArray::HostArray(std::string name, DType dtype, Shape shape, std::string unit,
                     std::shared_ptr<SharedMemory> memory, std::size_t offset)
    : name_(std::move(name)),
      unit_(std::move(unit)),
      dtype_(dtype),
      shape_(std::move(shape)),
      size_(element_count(shape_)),
      shared_(std::move(memory)),
      data_(shared_->data() + offset) {
  if (offset > shared_->bytes() || bytes() > shared_->bytes() - offset)
    throw Error(ExitCode::bad_input,
                fmt::format("array '{}' reaches beyond the memory that should hold it", name_));
}

void HostArray::require_writable() const {
  if (shared_ && !shared_->writable())
    throw Error(ExitCode::internal, fmt::format("array '{}' is read-only", name_));
}

void HostArray::require(DType wanted) const {
  if (wanted != dtype_) {
    throw Error(ExitCode::internal, fmt::format("array '{}' holds {}, accessed as {}", name_,
                                                gpuphys::to_string(dtype_), gpuphys::to_string(wanted)));
  }
}

HostArray HostArray::clone() const {
  HostArray copy(name_, dtype_, shape_, unit_);
  std::memcpy(copy.data(), data(), bytes());
  return copy;
}

const HostArray& find(const Arrays& arrays, const std::string& name, const std::string& where) {
  for (const HostArray& a : arrays) {
    if (a.name() == name) return a;
  }
  throw Error(ExitCode::bad_input, fmt::format("{}: array '{}' is missing", where, name));
}

double Problem::scalar(const std::string& name) const {
  for (const Scalar& s : scalars) {
    if (s.name == name) return s.value;
  }
  throw Error(ExitCode::internal, fmt::format("no scalar '{}' in this problem", name));
}

void Problem::set_scalar(const std::string& name, double value) {
  for (Scalar& s : scalars) {
    if (s.name != name) continue;
    // The value that a module sees is the rounded one; everybody else must see the same.
    s.value = s.dtype == DType::f32 ? static_cast<double>(static_cast<float>(value)) : value;
    return;
  }
  throw Error(ExitCode::unknown_name, fmt::format("the task has no scalar '{}'", name));
}

Problem Problem::clone() const {
  Problem copy;
  for (const HostArray& a : inputs) copy.inputs.push_back(a.clone());
  copy.scalars = scalars;
  return copy;
}

std::map<std::string, std::int64_t> resolve_symbols(const Contract& contract, const Problem& problem,
                                                    const std::string& where) {
  std::map<std::string, std::int64_t> symbols;
  std::map<std::string, std::string> bound_by;
  for (const ScalarSpec& spec : contract.scalars) {
    if (spec.dtype != DType::i32 || !is_shape_symbol(contract, spec.name)) continue;
    for (const Scalar& s : problem.scalars) {
      if (s.name != spec.name) continue;
      if (!(s.value >= 1 && s.value <= 2147483647.0) || s.value != std::floor(s.value)) {
        throw Error(ExitCode::bad_input,
                    fmt::format("{}: scalar '{}' is {}, must be a whole number of at least 1", where, s.name,
                                s.value));
      }
      symbols[s.name] = static_cast<std::int64_t>(s.value);
      bound_by[s.name] = fmt::format("scalar '{}'", s.name);
    }
  }
  for (const ArraySpec& spec : contract.inputs) {
    const HostArray& a = find(problem.inputs, spec.name, where);
    if (a.dtype() != spec.dtype) {
      throw Error(ExitCode::bad_input, fmt::format("{}: array '{}' is {}, expected {}", where, spec.name,
                                                   to_string(a.dtype()), to_string(spec.dtype)));
    }
    if (static_cast<int>(a.shape().size()) != spec.rank) {
      throw Error(ExitCode::bad_input,
                  fmt::format("{}: array '{}' has shape {}, expected rank {} ({})", where, spec.name,
                              to_string(a.shape()), spec.rank, spec.shape));
    }
    const std::vector<ShapeTerm> terms = parse_shape(spec);
    for (std::size_t d = 0; d < terms.size(); ++d) {
      const std::int64_t extent = a.shape()[d];
      if (terms[d].symbol.empty()) {
        if (extent != terms[d].offset) {
          throw Error(ExitCode::bad_input,
                      fmt::format("{}: array '{}' has shape {}, expected {} along index {}", where, spec.name,
                                  to_string(a.shape()), terms[d].offset, d));
        }
        continue;
      }
      const std::int64_t value = extent - terms[d].offset;
      const auto [it, fresh] = symbols.emplace(terms[d].symbol, value);
      if (fresh) {
        bound_by[terms[d].symbol] = fmt::format("array '{}'", spec.name);
        if (value < 1) {
          throw Error(ExitCode::bad_input,
                      fmt::format("{}: array '{}' has shape {}: {} would be {}, must be at least 1", where,
                                  spec.name, to_string(a.shape()), terms[d].symbol, value));
        }
      } else if (it->second != value) {
        throw Error(ExitCode::bad_input,
                    fmt::format("{}: array '{}' has shape {}, expected ({}) with {} = {} from {}", where,
                                spec.name, to_string(a.shape()), spec.shape, terms[d].symbol, it->second,
                                bound_by[terms[d].symbol]));
      }
    }
  }
  return symbols;
}

Shape evaluate_shape(const ArraySpec& spec, const std::map<std::string, std::int64_t>& symbols) {
  Shape shape;
  for (const ShapeTerm& term : parse_shape(spec)) {
    std::int64_t extent = term.offset;
    if (!term.symbol.empty()) {
      const auto it = symbols.find(term.symbol);
      if (it == symbols.end()) {
        throw Error(ExitCode::internal,
                    fmt::format("array '{}': shape symbol '{}' is not implied by the inputs", spec.name,
                                term.symbol));
      }
      extent += it->second;
    }
    shape.push_back(extent);
  }
  return shape;
}

Problem make_problem(const Contract& contract, const std::map<std::string, std::int64_t>& symbols) {
  Problem problem;
  for (const ArraySpec& spec : contract.inputs) {
    problem.inputs.emplace_back(spec.name, spec.dtype, evaluate_shape(spec, symbols), spec.unit);
  }
  for (const ScalarSpec& spec : contract.scalars) {
    const auto symbol = spec.dtype == DType::i32 ? symbols.find(spec.name) : symbols.end();
    const double value = symbol == symbols.end() ? 0.0 : static_cast<double>(symbol->second);
    problem.scalars.push_back({spec.name, spec.dtype, value});
  }
  return problem;
}

Arrays make_outputs(const Contract& contract, const Problem& problem, DType real) {
  const auto symbols = resolve_symbols(contract, problem, "inputs");
  Arrays outputs;
  for (const ArraySpec& spec : contract.outputs) {
    const bool floating = spec.dtype == DType::f32 || spec.dtype == DType::f64;
    outputs.emplace_back(spec.name, floating ? real : spec.dtype, evaluate_shape(spec, symbols), spec.unit);
  }
  return outputs;
}

gpuphys_array abi_array(const HostArray& a, void* data) {
  gpuphys_array abi{};
  abi.name = a.name().c_str();
  abi.dtype = static_cast<std::int32_t>(a.dtype());
  abi.rank = static_cast<std::int32_t>(a.shape().size());
  for (std::size_t d = 0; d < a.shape().size(); ++d) abi.shape[d] = a.shape()[d];
  abi.data = data;
  return abi;
}

AbiProblem abi_problem(const Problem& problem, const Arrays& outputs, bool with_data) {
  AbiProblem abi;
  for (const HostArray& a : problem.inputs) {
    abi.inputs.push_back(abi_array(a, with_data ? const_cast<void*>(a.data()) : nullptr));
  }
  for (const HostArray& a : outputs) {
    abi.outputs.push_back(abi_array(a, with_data ? const_cast<void*>(a.data()) : nullptr));
  }
  for (const Scalar& s : problem.scalars) {
    abi.scalars.push_back({s.name.c_str(), static_cast<std::int32_t>(s.dtype), s.value});
  }
  return abi;
}

gpuphys_problem AbiProblem::problem() const {
  gpuphys_problem p{};
  p.n_inputs = static_cast<std::int32_t>(inputs.size());
  p.n_outputs = static_cast<std::int32_t>(outputs.size());
  p.n_scalars = static_cast<std::int32_t>(scalars.size());
  p.inputs = inputs.data();
  p.outputs = outputs.data();
  p.scalars = scalars.data();
  return p;
}

}  // namespace gpuphys
