#include "core/contract/hdf5_io.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <hdf5.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <new>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "core/base/files.hpp"
#include "core/base/text.hpp"
#include "core/base/version.hpp"
#include "core/contract/valid.hpp"
#include "core/records/results.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kChunkBytes = std::size_t{1} << 20;  // HDF5's default chunk cache holds one such chunk
constexpr unsigned kDeflateLevel =
    1;  // higher levels cost much time and gain little on floating-point fields

[[noreturn]] void bad(const std::string& where, const std::string& what) {
  throw Error(ExitCode::bad_input, fmt::format("{}: {}", where, what));
}

/// Owns an HDF5 identifier. `close` is the H5?close function of its kind.
class Id {
 public:
  using Close = herr_t (*)(hid_t);
  Id() = default;
  Id(hid_t id, Close close) : id_(id), close_(close) {}
  Id(Id&& other) noexcept : id_(std::exchange(other.id_, -1)), close_(other.close_) {}
  Id& operator=(Id&& other) noexcept {
    reset();
    id_ = std::exchange(other.id_, -1);
    close_ = other.close_;
    return *this;
  }
  ~Id() { reset(); }

  operator hid_t() const { return id_; }
  bool valid() const { return id_ >= 0; }
  /// Closes now and says whether that succeeded (for files, that everything reached the disk).
  bool reset() {
    const bool ok = id_ < 0 || close_(id_) >= 0;
    id_ = -1;
    return ok;
  }

 private:
  hid_t id_ = -1;
  Close close_ = nullptr;
};

/// Every failure is reported as an Error; HDF5's own stack trace on stderr would only bury it.
void silence() {
  // What could not be written (a full disk) would be tried again by the library's exit handler, and crash
  // there.
  // (Refused where the library is in use already: then that is for whoever began.)
  static const bool done = (H5dont_atexit(), H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr) >= 0);
  if (!done) throw Error(ExitCode::internal, "cannot switch off HDF5's error printing");
}

// ---- element types ----

Id bool_type() {
  Id type(H5Tenum_create(H5T_NATIVE_INT8), H5Tclose);
  const std::int8_t no = 0, yes = 1;
  if (!type.valid() || H5Tenum_insert(type, "FALSE", &no) < 0 || H5Tenum_insert(type, "TRUE", &yes) < 0) {
    throw Error(ExitCode::internal, "HDF5 cannot create the bool type");
  }
  return type;
}

Id stored_type(DType type) {
  switch (type) {
    case DType::f32:
      return {H5Tcopy(H5T_IEEE_F32LE), H5Tclose};
    case DType::f64:
      return {H5Tcopy(H5T_IEEE_F64LE), H5Tclose};
    case DType::i32:
      return {H5Tcopy(H5T_STD_I32LE), H5Tclose};
    case DType::boolean:
      return bool_type();
  }
  throw Error(ExitCode::internal, "unknown element type");
}

Id memory_type(DType type) {
  switch (type) {
    case DType::f32:
      return {H5Tcopy(H5T_NATIVE_FLOAT), H5Tclose};
    case DType::f64:
      return {H5Tcopy(H5T_NATIVE_DOUBLE), H5Tclose};
    case DType::i32:
      return {H5Tcopy(H5T_NATIVE_INT32), H5Tclose};
    case DType::boolean:
      return bool_type();
  }
  throw Error(ExitCode::internal, "unknown element type");
}

bool is_any_of(hid_t type, std::initializer_list<hid_t> candidates) {
  return std::any_of(candidates.begin(), candidates.end(), [&](hid_t c) { return H5Tequal(type, c) > 0; });
}

/// A bool as h5py writes it (enum of FALSE and TRUE), or one byte (other languages; values are checked after
/// reading).
bool is_bool_like(hid_t type) {
  if (H5Tget_size(type) != 1) return false;
  switch (H5Tget_class(type)) {
    case H5T_INTEGER:
    case H5T_BITFIELD:
      return true;
    case H5T_ENUM: {
      const int members = H5Tget_nmembers(type);
      for (int i = 0; i < members; ++i) {
        char* name = H5Tget_member_name(type, static_cast<unsigned>(i));
        std::int8_t value = -1;
        const bool known = name != nullptr &&
                           H5Tget_member_value(type, static_cast<unsigned>(i), &value) >= 0 &&
                           ((std::strcmp(name, "FALSE") == 0 && value == 0) ||
                            (std::strcmp(name, "TRUE") == 0 && value == 1));
        H5free_memory(name);
        if (!known) return false;
      }
      return members == 2;
    }
    default:
      return false;
  }
}

bool matches(hid_t type, DType wanted) {
  switch (wanted) {
    case DType::f32:
      return is_any_of(type, {H5T_IEEE_F32LE, H5T_IEEE_F32BE});
    case DType::f64:
      return is_any_of(type, {H5T_IEEE_F64LE, H5T_IEEE_F64BE});
    case DType::i32:
      return is_any_of(type, {H5T_STD_I32LE, H5T_STD_I32BE});
    case DType::boolean:
      return is_bool_like(type);
  }
  return false;
}

std::string type_name(hid_t type) {
  const std::size_t bits = 8 * H5Tget_size(type);
  switch (H5Tget_class(type)) {
    case H5T_FLOAT:
      return is_any_of(type, {H5T_IEEE_F32LE, H5T_IEEE_F32BE, H5T_IEEE_F64LE, H5T_IEEE_F64BE})
                 ? fmt::format("float{}", bits)
                 : fmt::format("a {}-bit floating-point type that is neither IEEE float32 nor float64", bits);
    case H5T_INTEGER:
      return fmt::format("{}int{}", H5Tget_sign(type) == H5T_SGN_NONE ? "u" : "", bits);
    case H5T_ENUM:
      return is_bool_like(type) ? "bool" : "an enum";
    case H5T_STRING:
      return "a string";
    case H5T_COMPOUND:
      return "a compound";
    case H5T_BITFIELD:
      return fmt::format("a {}-bit field", bits);
    default:
      return "of another type";
  }
}

// ---- attributes ----

// Fixed length: such strings lie in the object header, which carries a checksum. Strings of variable length
// would lie in a heap that does not.
void write_attribute(hid_t object, const char* name, const std::string& text) {
  const Id type(H5Tcopy(H5T_C_S1), H5Tclose);
  const Id space(H5Screate(H5S_SCALAR), H5Sclose);
  const bool ok = H5Tset_size(type, std::max<std::size_t>(text.size(), 1)) >= 0 &&
                  H5Tset_strpad(type, H5T_STR_NULLPAD) >= 0 && H5Tset_cset(type, H5T_CSET_UTF8) >= 0;
  const Id attribute(H5Acreate2(object, name, type, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
  if (!ok || !attribute.valid() || H5Awrite(attribute, type, text.c_str()) < 0) {
    throw Error(ExitCode::bad_input, fmt::format("cannot write attribute '{}'", name));
  }
}

void write_attribute(hid_t object, const char* name, int value) {
  const Id space(H5Screate(H5S_SCALAR), H5Sclose);
  const Id attribute(H5Acreate2(object, name, H5T_STD_I32LE, space, H5P_DEFAULT, H5P_DEFAULT), H5Aclose);
  if (!attribute.valid() || H5Awrite(attribute, H5T_NATIVE_INT, &value) < 0) {
    throw Error(ExitCode::bad_input, fmt::format("cannot write attribute '{}'", name));
  }
}

/// Empty when there is no such attribute.
std::optional<Id> open_attribute(hid_t object, const char* name, const std::string& where) {
  const htri_t there = H5Aexists(object, name);
  if (there < 0) bad(where, "truncated or corrupt (its attributes cannot be read)");
  if (there == 0) return std::nullopt;
  Id attribute(H5Aopen(object, name, H5P_DEFAULT), H5Aclose);
  if (!attribute.valid())
    bad(where, fmt::format("truncated or corrupt (attribute '{}' cannot be opened)", name));
  const Id space(H5Aget_space(attribute), H5Sclose);
  if (H5Sget_simple_extent_npoints(space) != 1)
    bad(where, fmt::format("attribute '{}' is not a single value", name));
  return attribute;
}

std::string read_text_attribute(hid_t object, const char* name, const std::string& where) {
  const std::optional<Id> attribute = open_attribute(object, name, where);
  if (!attribute) return "";
  const Id type(H5Aget_type(*attribute), H5Tclose);
  if (H5Tget_class(type) != H5T_STRING) {
    bad(where, fmt::format("attribute '{}' is {}, expected a string", name, type_name(type)));
  }
  std::string text;
  bool ok = false;
  if (H5Tis_variable_str(type) > 0) {
    char* value = nullptr;
    const Id memory(H5Tcopy(type), H5Tclose);
    ok = H5Aread(*attribute, memory, &value) >= 0;
    if (ok && value != nullptr) text = value;
    H5free_memory(value);
  } else {
    text.resize(H5Tget_size(type));
    ok = H5Aread(*attribute, type, text.data()) >= 0;
    text.resize(std::min(text.size(), text.find('\0')));
    // Fortran pads with blanks.
    if (H5Tget_strpad(type) == H5T_STR_SPACEPAD) text.erase(text.find_last_not_of(' ') + 1);
  }
  if (!ok) bad(where, fmt::format("truncated or corrupt (attribute '{}' cannot be read)", name));
  return text;
}

int read_int_attribute(hid_t object, const char* name, const std::string& where) {
  const std::optional<Id> attribute = open_attribute(object, name, where);
  if (!attribute) return 0;
  const Id type(H5Aget_type(*attribute), H5Tclose);
  if (H5Tget_class(type) != H5T_INTEGER) {
    bad(where, fmt::format("attribute '{}' is {}, expected an integer", name, type_name(type)));
  }
  int value = 0;
  if (H5Aread(*attribute, H5T_NATIVE_INT, &value) < 0) {
    bad(where, fmt::format("truncated or corrupt (attribute '{}' cannot be read)", name));
  }
  return value;
}

// ---- writing ----

/// A file that appears under its name only when close() succeeded.
class Writer {
 public:
  Writer(const std::string& path, FileKind kind, const Task& task, const std::string& set,
         const std::string& provenance)
      : path_(path), pending_(path) {
    silence();
    const Id access(H5Pcreate(H5P_FILE_ACCESS), H5Pclose);
    // The 1.10 format carries checksums over all of its own structures; older ones do not.
    H5Pset_libver_bounds(access, H5F_LIBVER_V110, H5F_LIBVER_V110);
    file_ = Id(H5Fcreate(pending_.temporary_path().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, access), H5Fclose);
    if (!file_.valid()) bad(where(), "cannot be created");
    write_attribute(file_, "schema", kHdf5Schema);
    write_attribute(file_, "kind", to_string(kind));
    write_attribute(file_, "task", task.name);
    write_attribute(file_, "set", set);
    write_attribute(file_, "suite_version", kSuiteVersion);
    write_attribute(file_, "created", utc_now());
    write_attribute(file_, "provenance", provenance);
  }

  void array(const HostArray& a, const std::string& symbolic_shape) {
    const std::vector<hsize_t> extents(a.shape().begin(), a.shape().end());
    const Id space(H5Screate_simple(static_cast<int>(extents.size()), extents.data(), nullptr), H5Sclose);
    const Id properties(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
    bool ok = space.valid() && properties.valid();
    if (a.size() > 0 && !extents.empty()) {
      const std::vector<hsize_t> chunk = chunk_shape(extents, size_of(a.dtype()));
      ok = ok && H5Pset_chunk(properties, static_cast<int>(chunk.size()), chunk.data()) >= 0;
      ok = ok && H5Pset_shuffle(properties) >= 0 && H5Pset_deflate(properties, kDeflateLevel) >= 0;
      // The checksum comes last, so that it covers the bytes as they lie on the disk.
      ok = ok && H5Pset_fletcher32(properties) >= 0;
    }
    const Id type = stored_type(a.dtype());
    require_room(a.bytes());
    Id dataset(H5Dcreate2(file_, a.name().c_str(), type, space, H5P_DEFAULT, properties, H5P_DEFAULT),
               H5Dclose);
    ok = ok && dataset.valid() &&
         H5Dwrite(dataset, memory_type(a.dtype()), H5S_ALL, H5S_ALL, H5P_DEFAULT, a.data()) >= 0;
    if (!ok) bad(where(), fmt::format("array '{}' cannot be written (disk full?)", a.name()));
    write_attribute(dataset, "unit", a.unit());
    write_attribute(dataset, "shape", symbolic_shape);
    // Chunks that are still in the library's cache reach the disk now.
    if (!dataset.reset()) bad(where(), fmt::format("array '{}' cannot be written (disk full?)", a.name()));
  }

  void scalar(const Scalar& s, const std::string& unit) {
    const Id space(H5Screate(H5S_SCALAR), H5Sclose);
    const Id type = stored_type(s.dtype);
    const Id dataset(H5Dcreate2(file_, s.name.c_str(), type, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT),
                     H5Dclose);
    const float single = static_cast<float>(s.value);
    const std::int32_t integer = static_cast<std::int32_t>(s.value);
    const std::uint8_t flag = s.value != 0;
    const void* value = s.dtype == DType::f32   ? static_cast<const void*>(&single)
                        : s.dtype == DType::f64 ? static_cast<const void*>(&s.value)
                        : s.dtype == DType::i32 ? static_cast<const void*>(&integer)
                                                : static_cast<const void*>(&flag);
    if (!dataset.valid() ||
        H5Dwrite(dataset, memory_type(s.dtype), H5S_ALL, H5S_ALL, H5P_DEFAULT, value) < 0) {
      bad(where(), fmt::format("scalar '{}' cannot be written", s.name));
    }
    write_attribute(dataset, "unit", unit);
  }

  void close() {
    require_room(0);
    if (H5Fflush(file_, H5F_SCOPE_GLOBAL) < 0) bad(where(), "cannot be written completely (disk full?)");
    if (!file_.reset()) bad(where(), "cannot be written completely (disk full?)");
    pending_.commit();
  }

 private:
  std::string where() const { return fmt::format("'{}'", printable(path_)); }

  /// Asked before, because HDF5 1.10 does not always survive a disk that fills up under it.
  void require_room(std::size_t bytes) const {
    std::error_code ec;
    const fs::path folder = fs::path(path_).parent_path();
    const auto room = fs::space(folder.empty() ? fs::path(".") : folder, ec);
    constexpr std::uintmax_t kMargin = 64 << 10;
    if (!ec && room.available < bytes + kMargin) {
      bad(where(), fmt::format("disk full: up to {} KiB are needed, {} KiB are free", (bytes + kMargin) >> 10,
                               room.available >> 10));
    }
  }

  /// Whole trailing dimensions, as much of the leading ones as fits in a chunk.
  static std::vector<hsize_t> chunk_shape(std::vector<hsize_t> chunk, std::size_t element) {
    std::size_t bytes = element;
    for (const hsize_t e : chunk) bytes *= e;
    for (hsize_t& extent : chunk) {
      if (bytes <= kChunkBytes) break;
      const std::size_t slice = bytes / extent;
      extent = std::max<hsize_t>(1, kChunkBytes / std::max<std::size_t>(slice, 1));
      bytes = slice * extent;
    }
    return chunk;
  }

  std::string path_;
  PendingFile pending_;
  Id file_;
};

// ---- reading ----

Id open_file(const std::string& path) {
  silence();
  const std::string where = fmt::format("'{}'", path);
  std::error_code ec;
  if (!fs::exists(path, ec)) bad(where, "no such file");
  if (!fs::is_regular_file(path, ec)) bad(where, "not a regular file");
  if (fs::file_size(path, ec) == 0 && !ec) bad(where, "the file is empty");
  Id file(H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
  if (file.valid()) return file;
  if (const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC); fd >= 0) {
    const bool locked = ::flock(fd, LOCK_SH | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    ::close(fd);
    if (locked) bad(where, "it is locked by another program (is it still being written?)");
  }
  // Which of the three it is: not HDF5, HDF5 that ends too early, or damaged.
  const std::string signature("\x89HDF\r\n\x1a\n", 8);
  const std::string head = read_file(path).substr(0, signature.size());
  if (!signature.starts_with(head)) bad(where, "not an HDF5 file");
  bad(where, head == signature ? "truncated or corrupt HDF5 file" : "truncated HDF5 file");
}

/// Throws when the data are not all in the file, which HDF5 would silently replace by a fill value.
void require_written(hid_t dataset, const Shape& shape, const std::string& what) {
  const Id properties(H5Dget_create_plist(dataset), H5Pclose);
  const H5D_layout_t layout = H5Pget_layout(properties);
  if (layout == H5D_VIRTUAL || H5Pget_external_count(properties) > 0)
    bad(what, "its data lie in another file");
  const int filters = H5Pget_nfilters(properties);
  for (int i = 0; i < filters; ++i) {
    unsigned flags = 0, config = 0;
    std::size_t n = 0;
    char name[64] = "";
    const H5Z_filter_t filter =
        H5Pget_filter2(properties, static_cast<unsigned>(i), &flags, &n, nullptr, sizeof name, name, &config);
    if (filter >= 0 && H5Zfilter_avail(filter) <= 0) {
      bad(what,
          fmt::format(
              "it is compressed with filter '{}' (number {}), which is not available here; write it with "
              "deflate or without compression",
              name, filter));
    }
  }
  bool complete = true;
  if (layout == H5D_CONTIGUOUS) complete = H5Dget_offset(dataset) != HADDR_UNDEF;
  if (layout == H5D_CHUNKED) {
    std::vector<hsize_t> chunk(shape.size());
    H5Pget_chunk(properties, static_cast<int>(chunk.size()), chunk.data());
    hsize_t expected = 1, stored = 0;
    for (std::size_t d = 0; d < shape.size(); ++d) {
      if (chunk[d] == 0) bad(what, "truncated or corrupt");
      expected *= (static_cast<hsize_t>(shape[d]) + chunk[d] - 1) / chunk[d];
    }
    const Id space(H5Dget_space(dataset), H5Sclose);
    if (H5Dget_num_chunks(dataset, space, &stored) < 0) bad(what, "truncated or corrupt");
    complete = stored == expected;
  }
  if (!complete) bad(what, "it was never completely written");
}

struct Opened {
  Id dataset, type;
  Shape shape;
};

Opened open_dataset(hid_t file, const std::string& name, DType wanted, const std::string& where,
                    const char* kind) {
  const std::string what = fmt::format("{}: {} '{}'", where, kind, name);
  const htri_t there = H5Lexists(file, name.c_str(), H5P_DEFAULT);
  if (there < 0) bad(where, "truncated or corrupt (its table of contents cannot be read)");
  if (there == 0) bad(where, fmt::format("{} '{}' is missing", kind, name));
  // A link may lead out of the file, to anything: a pipe that nobody writes to, another user's data.
  H5L_info_t link{};
  if (H5Lget_info(file, name.c_str(), &link, H5P_DEFAULT) < 0) bad(what, "truncated or corrupt");
  if (link.type != H5L_TYPE_HARD) bad(what, "it is a link, not a dataset of this file");
  const Id object(H5Oopen(file, name.c_str(), H5P_DEFAULT), H5Oclose);
  if (!object.valid()) bad(what, "truncated or corrupt");
  if (H5Iget_type(object) != H5I_DATASET) bad(what, "it is not a dataset");
  Opened o;
  o.dataset = Id(H5Dopen2(file, name.c_str(), H5P_DEFAULT), H5Dclose);
  o.type = Id(H5Dget_type(o.dataset), H5Tclose);
  const Id space(H5Dget_space(o.dataset), H5Sclose);
  if (!o.dataset.valid() || !o.type.valid() || !space.valid()) bad(what, "truncated or corrupt");
  if (!matches(o.type, wanted)) {
    bad(what, fmt::format("it is {}, expected {} (values are never converted)", type_name(o.type),
                          to_string(wanted)));
  }
  if (H5Sget_simple_extent_type(space) == H5S_NULL) bad(what, "it is empty");
  std::vector<hsize_t> extents(static_cast<std::size_t>(std::max(0, H5Sget_simple_extent_ndims(space))));
  if (!extents.empty()) H5Sget_simple_extent_dims(space, extents.data(), nullptr);
  for (const hsize_t e : extents) o.shape.push_back(static_cast<std::int64_t>(e));
  return o;
}

void read_values(const Opened& o, DType dtype, void* data, const std::string& what) {
  // One-byte types are read as they are: HDF5 has no conversion between enums, bit fields and integers.
  const Id memory = dtype == DType::boolean ? Id(H5Tcopy(o.type), H5Tclose) : memory_type(dtype);
  if (H5Dread(o.dataset, memory, H5S_ALL, H5S_ALL, H5P_DEFAULT, data) < 0) {
    bad(what, "its data are truncated or corrupt (checksum or size does not match)");
  }
  if (dtype != DType::boolean) return;
  const std::int64_t n = element_count(o.shape);
  const auto* bytes = static_cast<const unsigned char*>(data);
  for (std::int64_t i = 0; i < n; ++i) {
    if (bytes[i] > 1) bad(what, fmt::format("value {} at flat index {} is not a bool", bytes[i], i));
  }
}

/// `expected` is null when only the rank is known yet.
HostArray read_array(hid_t file, const ArraySpec& spec, DType dtype, const Shape* expected,
                     const std::string& where) {
  const std::string what = fmt::format("{}: array '{}'", where, spec.name);
  const Opened o = open_dataset(file, spec.name, dtype, where, "array");
  if (static_cast<int>(o.shape.size()) != spec.rank) {
    bad(what, fmt::format("it has rank {} with shape {}, expected rank {} ({})", o.shape.size(),
                          to_string(o.shape), spec.rank, spec.shape));
  }
  for (const std::int64_t extent : o.shape) {
    if (extent == 0) bad(what, fmt::format("it is empty, shape {}", to_string(o.shape)));
  }
  if (expected != nullptr && o.shape != *expected) {
    bad(what, fmt::format("it has shape {}, expected {} ({})", to_string(o.shape), to_string(*expected),
                          spec.shape));
  }
  require_written(o.dataset, o.shape, what);
  HostArray a(spec.name, dtype, o.shape, spec.unit);
  read_values(o, dtype, a.data(), what);
  return a;
}

Scalar read_scalar(hid_t file, const ScalarSpec& spec, const std::string& where) {
  const std::string what = fmt::format("{}: scalar '{}'", where, spec.name);
  const Opened o = open_dataset(file, spec.name, spec.dtype, where, "scalar");
  if (element_count(o.shape) != 1)
    bad(what, fmt::format("it has shape {}, expected a single value", to_string(o.shape)));
  require_written(o.dataset, o.shape, what);
  HostArray value(spec.name, spec.dtype, {1});
  read_values(o, spec.dtype, value.data(), what);
  return {spec.name, spec.dtype, value.value(0)};
}

FileInfo info_of(hid_t file, const std::string& where) {
  FileInfo info;
  info.schema = read_int_attribute(file, "schema", where);
  const bool has_schema = H5Aexists(file, "schema") > 0;
  if (has_schema && info.schema != kHdf5Schema) {
    bad(where,
        fmt::format("schema {} is not supported (this suite reads schema {})", info.schema, kHdf5Schema));
  }
  info.kind = read_text_attribute(file, "kind", where);
  info.task = read_text_attribute(file, "task", where);
  info.set = read_text_attribute(file, "set", where);
  info.suite_version = read_text_attribute(file, "suite_version", where);
  info.created = read_text_attribute(file, "created", where);
  info.provenance = read_text_attribute(file, "provenance", where);
  return info;
}

void require_info(const FileInfo& info, const Task& task, std::initializer_list<FileKind> kinds,
                  const std::string& where) {
  if (!info.task.empty() && info.task != task.name) {
    bad(where, fmt::format("it belongs to task '{}', expected '{}'", info.task, task.name));
  }
  if (info.kind.empty()) return;
  std::string expected;
  for (const FileKind kind : kinds) {
    if (info.kind == to_string(kind)) return;
    expected += (expected.empty() ? "" : " or ") + to_string(kind);
  }
  bad(where, fmt::format("it holds {}, expected {}", info.kind, expected));
}

/// What a file held.
struct Parsed {
  FileInfo info;
  Arrays arrays;
  std::vector<Scalar> scalars;
};

// ---- reading in a child ----

// HDF5 1.10 does not survive every damaged file (its older structures carry no checksums), and what one
// process survives may kill the next. So a file is read by a child only, which hands over what it read
// through shared memory: a JSON head of kHeadBytes, then the arrays, each from a page of its own on.
constexpr std::size_t kHeadBytes = 64 << 10, kPage = 4096;

using nlohmann::json;

void write_all(int fd, const void* data, std::size_t bytes, std::size_t at) {
  const char* from = static_cast<const char*>(data);
  while (bytes > 0) {
    const ssize_t n = ::pwrite(fd, from, bytes, static_cast<off_t>(at));
    if (n <= 0) throw std::bad_alloc();
    from += n;
    at += static_cast<std::size_t>(n);
    bytes -= static_cast<std::size_t>(n);
  }
}

void hand_over(int fd, const json& head) {
  const std::string text = head.dump(-1, ' ', false, json::error_handler_t::replace);
  if (text.size() >= kHeadBytes) throw Error(ExitCode::internal, "the head of a parsed file is too long");
  write_all(fd, text.c_str(), text.size() + 1, 0);
}

void hand_over(int fd, const Parsed& parsed) {
  json arrays = json::array(), scalars = json::array();
  std::size_t at = kHeadBytes;
  for (const HostArray& a : parsed.arrays) {
    arrays.push_back({a.name(), static_cast<int>(a.dtype()), a.shape(), a.unit(), at});
    write_all(fd, a.data(), a.bytes(), at);
    at += (a.bytes() + kPage - 1) / kPage * kPage;
  }
  if (::ftruncate(fd, static_cast<off_t>(at)) != 0) throw std::bad_alloc();
  for (const Scalar& s : parsed.scalars)
    scalars.push_back({s.name, static_cast<int>(s.dtype), fmt::format("{:a}", s.value)});
  const FileInfo& i = parsed.info;
  hand_over(fd, {{"info", {i.schema, i.kind, i.task, i.set, i.suite_version, i.created, i.provenance}},
                 {"arrays", arrays},
                 {"scalars", scalars}});
}

Parsed taken_over(int fd, const std::string& where) {
  const off_t size = ::lseek(fd, 0, SEEK_END);
  if (size < 2) bad(where, "truncated or corrupt HDF5 file");
  std::string text(std::min<std::size_t>(static_cast<std::size_t>(size), kHeadBytes), '\0');
  if (::pread(fd, text.data(), text.size(), 0) != static_cast<ssize_t>(text.size()))
    bad(where, "cannot be read");
  const json head = json::parse(text.c_str());
  if (head.contains("error"))
    throw Error(static_cast<ExitCode>(head.at("code").get<int>()), head.at("error").get<std::string>());
  Parsed parsed;
  const json& i = head.at("info");
  parsed.info = {i[0].get<int>(),         i[1].get<std::string>(), i[2].get<std::string>(),
                 i[3].get<std::string>(), i[4].get<std::string>(), i[5].get<std::string>(),
                 i[6].get<std::string>()};
  for (const json& a : head.at("arrays")) {
    HostArray array(a[0].get<std::string>(), static_cast<DType>(a[1].get<int>()), a[2].get<Shape>(),
                    a[3].get<std::string>());
    auto* to = static_cast<char*>(array.data());
    for (std::size_t done = 0; done < array.bytes();) {
      const ssize_t n =
          ::pread(fd, to + done, array.bytes() - done, static_cast<off_t>(a[4].get<std::size_t>() + done));
      if (n <= 0) bad(where, "cannot be read");
      done += static_cast<std::size_t>(n);
    }
    parsed.arrays.push_back(std::move(array));
  }
  for (const json& s : head.at("scalars")) {
    parsed.scalars.push_back({s[0].get<std::string>(), static_cast<DType>(s[1].get<int>()),
                              std::strtod(s[2].get<std::string>().c_str(), nullptr)});
  }
  return parsed;
}

template <class F>
Parsed in_child(const std::string& path, F&& read) {
  const std::string where = fmt::format("'{}'", printable(path));
  std::error_code ec;
  const std::uintmax_t size = fs::file_size(path, ec);
  const int memory = ::memfd_create("gpuphys-hdf5", MFD_CLOEXEC);
  const pid_t child = memory < 0 ? -1 : ::fork();
  if (child < 0) throw Error(ExitCode::internal, "cannot start a process to read a file in");
  if (child == 0) {
    for (const int signal : {SIGSEGV, SIGBUS, SIGABRT, SIGFPE, SIGILL, SIGXCPU, SIGALRM})
      ::signal(signal, SIG_DFL);
    rlimit limit{};
    ::setrlimit(RLIMIT_CORE, &limit);
    // Damage can also make it loop or wait for ever: no file takes longer than this to read.
    limit.rlim_cur = limit.rlim_max = 10 + (ec ? 0 : size >> 22);
    ::setrlimit(RLIMIT_CPU, &limit);
    ::alarm(static_cast<unsigned>(6 * limit.rlim_cur));
    if (const int null = ::open("/dev/null", O_WRONLY); null >= 0) ::dup2(null, STDERR_FILENO);
    try {
      try {
        hand_over(memory, read());
      } catch (const Error& e) {
        hand_over(memory, json{{"error", e.what()}, {"code", static_cast<int>(e.code())}});
      } catch (const std::bad_alloc&) {
        hand_over(memory, json{{"error", where + ": out of host memory"},
                               {"code", static_cast<int>(ExitCode::out_of_memory)}});
      }
    } catch (...) {
      ::_exit(1);
    }
    ::_exit(0);
  }
  int status = 0;
  while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  struct Closer {
    int fd;
    ~Closer() { ::close(fd); }
  } closer{memory};
  if (!WIFEXITED(status) || WEXITSTATUS(status) != 0)
    bad(where, "truncated or corrupt HDF5 file (the HDF5 library cannot survive it)");
  return taken_over(memory, where);
}

Parsed problem_in(const std::string& path, const Task& task) {
  const std::string where = fmt::format("'{}'", printable(path));
  const Id file = open_file(path);
  Parsed parsed;
  parsed.info = info_of(file, where);
  require_info(parsed.info, task, {FileKind::inputs}, where);
  for (const ArraySpec& spec : task.contract.inputs)
    parsed.arrays.push_back(read_array(file, spec, spec.dtype, nullptr, where));
  for (const ScalarSpec& spec : task.contract.scalars)
    parsed.scalars.push_back(read_scalar(file, spec, where));
  return parsed;
}

Parsed arrays_in(const std::string& path, const Task& task, const Problem& problem, DType real) {
  const std::string where = fmt::format("'{}'", printable(path));
  const Id file = open_file(path);
  Parsed parsed;
  parsed.info = info_of(file, where);
  require_info(parsed.info, task, {FileKind::outputs, FileKind::truth}, where);
  const auto symbols = resolve_symbols(task.contract, problem, "inputs");
  for (const ArraySpec& spec : task.contract.outputs) {
    const bool floating = spec.dtype == DType::f32 || spec.dtype == DType::f64;
    const Shape expected = evaluate_shape(spec, symbols);
    parsed.arrays.push_back(read_array(file, spec, floating ? real : spec.dtype, &expected, where));
  }
  return parsed;
}

Parsed info_in(const std::string& path) {
  const Id file = open_file(path);
  Parsed parsed;
  parsed.info = info_of(file, fmt::format("'{}'", printable(path)));
  return parsed;
}

}  // namespace

std::string to_string(FileKind kind) {
  switch (kind) {
    case FileKind::inputs:
      return "inputs";
    case FileKind::outputs:
      return "outputs";
    case FileKind::truth:
      return "truth";
  }
  return "unknown";
}

void write_problem(const std::string& path, const Task& task, const std::string& set, const Problem& problem,
                   const std::string& provenance) {
  Writer writer(path, FileKind::inputs, task, set, provenance);
  for (const ArraySpec& spec : task.contract.inputs)
    writer.array(find(problem.inputs, spec.name, "inputs"), spec.shape);
  for (const ScalarSpec& spec : task.contract.scalars) {
    writer.scalar({spec.name, spec.dtype, problem.scalar(spec.name)}, spec.unit);
  }
  writer.close();
}

void write_arrays(const std::string& path, FileKind kind, const Task& task, const std::string& set,
                  const Arrays& arrays, const std::string& provenance) {
  Writer writer(path, kind, task, set, provenance);
  for (const ArraySpec& spec : task.contract.outputs)
    writer.array(find(arrays, spec.name, "outputs"), spec.shape);
  writer.close();
}

FileInfo read_info(const std::string& path) {
  return in_child(path, [&] { return info_in(path); }).info;
}

Problem read_problem(const std::string& path, const Task& task) {
  Parsed parsed = in_child(path, [&] { return problem_in(path, task); });
  Problem problem;
  problem.inputs = std::move(parsed.arrays);
  problem.scalars = std::move(parsed.scalars);
  const std::string where = fmt::format("'{}'", printable(path));
  resolve_symbols(task.contract, problem, where);
  require_valid(task.contract, problem, where);
  return problem;
}

Arrays read_arrays(const std::string& path, const Task& task, const Problem& problem, DType real) {
  return in_child(path, [&] { return arrays_in(path, task, problem, real); }).arrays;
}

}  // namespace gpuphys
