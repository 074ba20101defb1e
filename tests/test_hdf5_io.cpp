// HDF5 files: what is written comes back, files by other writers are read, and every way in which a file can
// be wrong gives one clear error.
#include "core/contract/hdf5_io.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <hdf5.h>
#include <sys/file.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numeric>
#include <string>

#include "core/base/files.hpp"

// HDF5 1.10 leaks on its own error paths when it meets a damaged file; leaks of ours are still reported.
extern "C" const char* __lsan_default_suppressions() {
  return "leak:libhdf5";
}

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

// A contract with every element type, ranks 1 to 4, and shapes that depend on each other.
Task sample_task() {
  Task task;
  task.name = "sample";
  task.contract.inputs = {{"ux", DType::f32, 3, "nx+1,ny,nz", "m/s"},
                          {"mask", DType::boolean, 3, "nx,ny,nz", ""},
                          {"edges", DType::i32, 2, "m,2", ""},
                          {"weights", DType::f64, 1, "m", "kg"}};
  task.contract.scalars = {{"dt", DType::f32, "s"}, {"steps", DType::i32, ""}, {"tol", DType::f64, ""}};
  task.contract.outputs = {{"p", DType::f32, 3, "nx,ny,nz", "Pa"}, {"count", DType::i32, 1, "m", ""}};
  return task;
}

Problem sample_problem(std::int64_t nx = 5) {
  Problem p = make_problem(sample_task().contract, {{"nx", nx}, {"ny", 7}, {"nz", 11}, {"m", 13}});
  for (std::size_t i = 0; float& v : p.inputs[0].as<float>()) v = std::sin(static_cast<float>(i++));
  for (std::size_t i = 0; bool& v : p.inputs[1].as<bool>()) v = i++ % 3 == 0;
  for (std::int32_t i = -5; std::int32_t & v : p.inputs[2].as<std::int32_t>()) v = i++;
  for (double x = 0.1; double& v : p.inputs[3].as<double>()) v = x *= 1.7;
  p.set_scalar("dt", 0.1);
  p.set_scalar("steps", 3);
  p.set_scalar("tol", 1e-7);
  return p;
}

Arrays sample_outputs(const Problem& problem) {
  Arrays out = make_outputs(sample_task().contract, problem);
  for (std::size_t i = 0; float& v : out[0].as<float>()) v = std::cos(static_cast<float>(i++));
  for (std::int32_t i = 0; std::int32_t & v : out[1].as<std::int32_t>()) v = i++;
  return out;
}

bool same(const HostArray& a, const HostArray& b) {
  return a.name() == b.name() && a.dtype() == b.dtype() && a.shape() == b.shape() && a.unit() == b.unit() &&
         std::memcmp(a.data(), b.data(), a.bytes()) == 0;
}

class Hdf5 : public testing::Test {
 protected:
  Hdf5() : problem(sample_problem()), outputs(sample_outputs(problem)) {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_hdf5_XXXXXX").string();
    folder = ::mkdtemp(pattern.data());
    path = folder + "/file.h5";
  }
  ~Hdf5() override { fs::remove_all(folder); }

  // The one line with which reading fails; the test fails when it does not, or not as bad input.
  template <class F>
  std::string error_of(F&& read) {
    testing::internal::CaptureStderr();
    std::string message;
    try {
      read();
      ADD_FAILURE() << "accepted";
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ExitCode::bad_input) << e.what();
      message = e.what();
    }
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "") << "HDF5's own error stack reached the user";
    EXPECT_EQ(message.find('\n'), std::string::npos) << message;
    EXPECT_NE(message.find(path), std::string::npos) << message << " does not name the file";
    return message;
  }
  std::string inputs_error() {
    return error_of([&] { read_problem(path, task); });
  }
  std::string outputs_error() {
    return error_of([&] { read_arrays(path, task, problem); });
  }

  // A file as another program would write it: one dataset, whatever type, shape and storage.
  void put(const char* name, hid_t type, std::vector<hsize_t> shape, const void* data = nullptr,
           hid_t memory = -1, hid_t properties = H5P_DEFAULT) {
    const bool fresh = !fs::exists(path);
    const hid_t file = fresh ? H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT)
                             : H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
    const hid_t space = H5Screate_simple(static_cast<int>(shape.size()), shape.data(), nullptr);
    const hid_t dataset = H5Dcreate2(file, name, type, space, H5P_DEFAULT, properties, H5P_DEFAULT);
    ASSERT_GE(dataset, 0);
    if (data != nullptr) {
      ASSERT_GE(H5Dwrite(dataset, memory < 0 ? type : memory, H5S_ALL, H5S_ALL, H5P_DEFAULT, data), 0);
    }
    H5Dclose(dataset);
    H5Sclose(space);
    ASSERT_GE(H5Fclose(file), 0);
  }
  void put_good_outputs(hid_t float_type = H5T_IEEE_F32LE, hid_t int_type = H5T_STD_I32LE) {
    put("p", float_type, {5, 7, 11}, outputs[0].data(), H5T_NATIVE_FLOAT);
    put("count", int_type, {13}, outputs[1].data(), H5T_NATIVE_INT32);
  }
  void put_attribute(const char* name, const std::string& text) {
    const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
    const hid_t type = H5Tcopy(H5T_C_S1);
    H5Tset_size(type, text.size());
    const hid_t space = H5Screate(H5S_SCALAR);
    if (H5Aexists(file, name) > 0) H5Adelete(file, name);
    const hid_t attribute = H5Acreate2(file, name, type, space, H5P_DEFAULT, H5P_DEFAULT);
    ASSERT_GE(H5Awrite(attribute, type, text.data()), 0);
    H5Aclose(attribute);
    H5Sclose(space);
    H5Tclose(type);
    H5Fclose(file);
  }
  void put_attribute(const char* name, int value) {
    const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
    const hid_t space = H5Screate(H5S_SCALAR);
    if (H5Aexists(file, name) > 0) H5Adelete(file, name);
    const hid_t attribute = H5Acreate2(file, name, H5T_STD_I32LE, space, H5P_DEFAULT, H5P_DEFAULT);
    ASSERT_GE(H5Awrite(attribute, H5T_NATIVE_INT, &value), 0);
    H5Aclose(attribute);
    H5Sclose(space);
    H5Fclose(file);
  }
  // Damages every `stride`-th byte in turn; `read` says whether what it read is right. Returns the file's
  // size.
  template <class F>
  std::size_t damage_every(std::size_t stride, F&& read, std::size_t& refused) {
    const std::string whole = read_file(path);
    std::fstream file(path, std::ios::binary | std::ios::in | std::ios::out);
    const auto put_byte = [&](std::size_t at, char c) {
      file.seekp(static_cast<std::streamoff>(at));
      file.put(c).flush();
    };
    for (std::size_t at = 0; at < whole.size(); at += stride) {
      put_byte(at, static_cast<char>(whole[at] ^ 0x10));
      try {
        EXPECT_TRUE(read()) << "byte " << at << " was read as data";
      } catch (const Error& e) {
        ++refused;
        EXPECT_EQ(e.code(), ExitCode::bad_input) << "byte " << at << ": " << e.what();
      }
      put_byte(at, whole[at]);
    }
    return whole.size();
  }
  void remove_dataset(const char* name) {
    const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
    ASSERT_GE(H5Ldelete(file, name, H5P_DEFAULT), 0);
    H5Fclose(file);
  }

  Task task = sample_task();
  Problem problem;
  Arrays outputs;
  std::string folder, path;
};

#define EXPECT_CONTAINS(text, part) \
  EXPECT_NE((text).find(part), std::string::npos) << "\"" << (text) << "\" lacks \"" << (part) << "\""

TEST_F(Hdf5, AProblemComesBackBitForBit) {
  write_problem(path, task, "public", problem, "seed 1");
  const Problem back = read_problem(path, task);
  ASSERT_EQ(back.inputs.size(), problem.inputs.size());
  for (std::size_t i = 0; i < back.inputs.size(); ++i)
    EXPECT_TRUE(same(back.inputs[i], problem.inputs[i])) << i;
  ASSERT_EQ(back.scalars.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(back.scalars[i].name, problem.scalars[i].name);
    EXPECT_EQ(back.scalars[i].value, problem.scalars[i].value);
  }
}

TEST_F(Hdf5, OutputsAndTruthComeBackBitForBit) {
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  const Arrays back = read_arrays(path, task, problem);
  for (std::size_t i = 0; i < back.size(); ++i) EXPECT_TRUE(same(back[i], outputs[i])) << i;

  Arrays truth = make_outputs(task.contract, problem, DType::f64);
  for (double x = 1; double& v : truth[0].as<double>()) v = x += 1e-13;
  write_arrays(path, FileKind::truth, task, "public", truth);
  EXPECT_TRUE(same(read_arrays(path, task, problem, DType::f64)[0], truth[0]));
}

TEST_F(Hdf5, NonFiniteValuesAreKeptForTheChecksToJudge) {
  outputs[0].as<float>()[3] = std::numeric_limits<float>::quiet_NaN();
  outputs[0].as<float>()[4] = std::numeric_limits<float>::infinity();
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  EXPECT_TRUE(same(read_arrays(path, task, problem)[0], outputs[0]));
}

TEST_F(Hdf5, TheFileSaysWhatItIs) {
  write_problem(path, task, "public", problem, "seed 1");
  const FileInfo info = read_info(path);
  EXPECT_EQ(info.schema, kHdf5Schema);
  EXPECT_EQ(info.kind, "inputs");
  EXPECT_EQ(info.task, "sample");
  EXPECT_EQ(info.set, "public");
  EXPECT_EQ(info.provenance, "seed 1");
  EXPECT_FALSE(info.suite_version.empty());
  EXPECT_EQ(info.created.size(), std::strlen("2026-11-22T05:30:00Z"));
}

TEST_F(Hdf5, StorageIsChunkedShuffledDeflatedAndChecksummed) {
  write_problem(path, task, "public", problem);
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
  const hid_t dataset = H5Dopen2(file, "ux", H5P_DEFAULT);
  const hid_t properties = H5Dget_create_plist(dataset);
  EXPECT_EQ(H5Pget_layout(properties), H5D_CHUNKED);
  std::vector<H5Z_filter_t> filters;
  for (unsigned i = 0; i < static_cast<unsigned>(H5Pget_nfilters(properties)); ++i) {
    unsigned flags, config;
    std::size_t n = 0;
    filters.push_back(H5Pget_filter2(properties, i, &flags, &n, nullptr, 0, nullptr, &config));
  }
  EXPECT_EQ(filters,
            (std::vector<H5Z_filter_t>{H5Z_FILTER_SHUFFLE, H5Z_FILTER_DEFLATE, H5Z_FILTER_FLETCHER32}));
  EXPECT_GT(H5Aexists(dataset, "unit"), 0);
  EXPECT_GT(H5Aexists(dataset, "shape"), 0);
  H5Pclose(properties);
  H5Dclose(dataset);
  H5Fclose(file);
}

TEST_F(Hdf5, ArraysLargerThanAChunkComeBack) {
  problem = sample_problem(9001);
  outputs = sample_outputs(problem);
  ASSERT_GT(outputs[0].bytes(), std::size_t{2} << 20);
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  EXPECT_TRUE(same(read_arrays(path, task, problem)[0], outputs[0]));
}

// ---- files by other writers ----

TEST_F(Hdf5, ContiguousFilesWithoutAttributesAreRead) {
  put_good_outputs();
  EXPECT_TRUE(same(read_arrays(path, task, problem)[0], outputs[0]));
}

TEST_F(Hdf5, BigEndianFilesAreRead) {
  put_good_outputs(H5T_IEEE_F32BE, H5T_STD_I32BE);
  const Arrays back = read_arrays(path, task, problem);
  EXPECT_TRUE(same(back[0], outputs[0]));
  EXPECT_TRUE(same(back[1], outputs[1]));
}

TEST_F(Hdf5, BoolsAreReadAsEnumOrAsBytes) {
  write_problem(path, task, "public", problem);
  remove_dataset("mask");
  put("mask", H5T_STD_U8LE, {5, 7, 11}, problem.inputs[1].data(), H5T_NATIVE_UINT8);
  EXPECT_TRUE(same(read_problem(path, task).inputs[1], problem.inputs[1]));
}

TEST_F(Hdf5, ByteThatIsNoBoolIsRefused) {
  write_problem(path, task, "public", problem);
  remove_dataset("mask");
  std::vector<std::uint8_t> bytes(5 * 7 * 11, 1);
  bytes[17] = 2;
  put("mask", H5T_STD_U8LE, {5, 7, 11}, bytes.data());
  EXPECT_CONTAINS(inputs_error(), "array 'mask': value 2 at flat index 17 is not a bool");
}

TEST_F(Hdf5, FixedLengthStringAttributesAreRead) {
  put_good_outputs();
  put_attribute("task", std::string("sample"));
  EXPECT_EQ(read_info(path).task, "sample");
  EXPECT_NO_THROW(read_arrays(path, task, problem));
}

// ---- everything that can be wrong ----

TEST_F(Hdf5, MissingFile) {
  EXPECT_CONTAINS(inputs_error(), "no such file");
}

TEST_F(Hdf5, EmptyFile) {
  write_file(path, "");
  EXPECT_CONTAINS(inputs_error(), "the file is empty");
}

TEST_F(Hdf5, FolderInsteadOfFile) {
  fs::create_directory(path);
  EXPECT_CONTAINS(inputs_error(), "not a regular file");
}

TEST_F(Hdf5, NotHdf5) {
  write_file(path, "x,y\n1,2\n");
  EXPECT_CONTAINS(inputs_error(), "not an HDF5 file");
}

TEST_F(Hdf5, TruncatedAnywhere) {
  write_problem(path, task, "public", problem);
  const std::string whole = read_file(path);
  for (const double part : {0.0005, 0.001, 0.01, 0.1, 0.25, 0.5, 0.75, 0.9, 0.99, 0.9999}) {
    const std::size_t size =
        std::max<std::size_t>(1, static_cast<std::size_t>(part * static_cast<double>(whole.size())));
    ASSERT_LT(size, whole.size());
    write_file(path, whole.substr(0, size));
    const std::string message = inputs_error();
    EXPECT_CONTAINS(message, "truncated") << "at " << size << " of " << whole.size();
  }
}

// A link may lead to anything, for instance to a pipe that nobody writes to.
TEST_F(Hdf5, LinksAreNotFollowed) {
  put_good_outputs();
  const std::string name = outputs[0].name();
  const std::string pipe = folder + "/pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  for (const bool external : {true, false}) {
    const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
    H5Ldelete(file, name.c_str(), H5P_DEFAULT);
    if (external)
      H5Lcreate_external(pipe.c_str(), "/x", file, name.c_str(), H5P_DEFAULT, H5P_DEFAULT);
    else
      H5Lcreate_soft("/elsewhere", file, name.c_str(), H5P_DEFAULT, H5P_DEFAULT);
    H5Fclose(file);
    EXPECT_CONTAINS(error_of([&] { read_arrays(path, task, problem); }), "it is a link");
  }
}

TEST_F(Hdf5, ALockedFileIsCalledLocked) {
  put_good_outputs();
  const int fd = ::open(path.c_str(), O_RDWR);
  ASSERT_EQ(::flock(fd, LOCK_EX), 0);
  EXPECT_CONTAINS(error_of([&] { read_arrays(path, task, problem); }), "locked by another program");
  ::close(fd);
}

// Needs a file system of its own, and so root.
TEST_F(Hdf5, AFullDiskIsOneLineAndNoFile) {
  const std::string small = folder + "/small";
  fs::create_directory(small);
  if (::mount("tmpfs", small.c_str(), "tmpfs", 0, "size=200k") != 0)
    GTEST_SKIP() << "cannot mount a small tmpfs";
  problem = sample_problem(9001);
  path = small + "/x.h5";
  const std::string full = error_of([&] { write_problem(path, task, "public", problem); });
  EXPECT_CONTAINS(full, "disk full");
  EXPECT_TRUE(fs::is_empty(small));
  ::umount(small.c_str());
}

// Reading a file with one byte damaged either fails with one clear error or returns exactly what was written.
TEST_F(Hdf5, NoDamagedByteOfOurFilesIsReadAsData) {
  problem = sample_problem(2);
  outputs = sample_outputs(problem);
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  std::size_t refused = 0;
  const std::size_t size = damage_every(
      1,
      [&] {
        const Arrays back = read_arrays(path, task, problem);
        return same(back[0], outputs[0]) && same(back[1], outputs[1]);
      },
      refused);
  EXPECT_GT(refused, outputs[0].bytes() / 4) << "of " << size;
}

// The 1.8 format has no checksums over its structures, and attributes as h5py writes them lie in a heap:
// damage there can kill the library. That must not kill the program.
TEST_F(Hdf5, DamagedFilesByOtherWritersDoNotKillTheProgram) {
  put_good_outputs();
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  const hid_t type = H5Tcopy(H5T_C_S1), space = H5Screate(H5S_SCALAR);
  H5Tset_size(type, H5T_VARIABLE);
  const char* text = "sample";
  const hid_t attribute = H5Acreate2(file, "task", type, space, H5P_DEFAULT, H5P_DEFAULT);
  ASSERT_GE(H5Awrite(attribute, type, &text), 0);
  H5Aclose(attribute);
  H5Sclose(space);
  H5Tclose(type);
  H5Fclose(file);
  EXPECT_EQ(read_info(path).task, "sample");
  std::size_t refused = 0;
  damage_every(
      53,
      [&] {
        read_arrays(path, task, problem);
        return true;  // without checksums damaged values cannot be told from others
      },
      refused);
  EXPECT_GT(refused, 3u);
}

TEST_F(Hdf5, CorruptChunkIsNamed) {
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  hsize_t address = 0;
  {
    const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT);
    const hid_t dataset = H5Dopen2(file, "p", H5P_DEFAULT);
    const hid_t space = H5Dget_space(dataset);
    haddr_t at = 0;
    hsize_t offset[3], size = 0;
    unsigned mask = 0;
    ASSERT_GE(H5Dget_chunk_info(dataset, space, 0, offset, &mask, &at, &size), 0);
    address = at + size / 2;
    H5Sclose(space);
    H5Dclose(dataset);
    H5Fclose(file);
  }
  std::string bytes = read_file(path);
  bytes[address] = static_cast<char>(bytes[address] ^ 1);
  write_file(path, bytes);
  const std::string message = outputs_error();
  EXPECT_CONTAINS(message, "array 'p'");
  EXPECT_CONTAINS(message, "corrupt");
}

TEST_F(Hdf5, MissingDatasetAndMissingScalar) {
  write_problem(path, task, "public", problem);
  remove_dataset("dt");
  EXPECT_CONTAINS(inputs_error(), "scalar 'dt' is missing");
  remove_dataset("ux");
  EXPECT_CONTAINS(inputs_error(), "array 'ux' is missing");
}

TEST_F(Hdf5, GroupInsteadOfDataset) {
  const hid_t file = H5Fcreate(path.c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  H5Gclose(H5Gcreate2(file, "p", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
  H5Fclose(file);
  EXPECT_CONTAINS(outputs_error(), "array 'p': it is not a dataset");
}

TEST_F(Hdf5, WrongTypesAreNeverConverted) {
  const std::vector<double> doubles(5 * 7 * 11, 1.0);
  put("p", H5T_IEEE_F64LE, {5, 7, 11}, doubles.data(), H5T_NATIVE_DOUBLE);
  EXPECT_CONTAINS(outputs_error(), "array 'p': it is float64, expected float32");
  remove_dataset("p");
  put("p", H5T_STD_I32LE, {5, 7, 11}, outputs[0].data(), H5T_NATIVE_INT32);
  EXPECT_CONTAINS(outputs_error(), "it is int32, expected float32");
  remove_dataset("p");
  put("p", H5T_IEEE_F32LE, {5, 7, 11}, outputs[0].data(), H5T_NATIVE_FLOAT);
  const std::vector<std::int64_t> longs(13, 1);
  put("count", H5T_STD_I64LE, {13}, longs.data(), H5T_NATIVE_INT64);
  EXPECT_CONTAINS(outputs_error(), "array 'count': it is int64, expected int32");
  remove_dataset("count");
  put("count", H5T_STD_U32LE, {13}, outputs[1].data(), H5T_NATIVE_UINT32);
  EXPECT_CONTAINS(outputs_error(), "it is uint32, expected int32");
}

TEST_F(Hdf5, WrongRankSaysBoth) {
  put("p", H5T_IEEE_F32LE, {5, 77}, outputs[0].data(), H5T_NATIVE_FLOAT);
  const std::string message = outputs_error();
  EXPECT_CONTAINS(message, "rank 2 with shape (5, 77)");
  EXPECT_CONTAINS(message, "expected rank 3 (nx,ny,nz)");
}

TEST_F(Hdf5, WrongShapeSaysBoth) {
  put("p", H5T_IEEE_F32LE, {11, 7, 5}, outputs[0].data(), H5T_NATIVE_FLOAT);
  EXPECT_CONTAINS(outputs_error(), "it has shape (11, 7, 5), expected (5, 7, 11) (nx,ny,nz)");
}

TEST_F(Hdf5, InputsThatContradictEachOther) {
  write_problem(path, task, "public", problem);
  remove_dataset("weights");
  const std::vector<double> weights(12, 1.0);
  put("weights", H5T_IEEE_F64LE, {12}, weights.data(), H5T_NATIVE_DOUBLE);
  const std::string message = inputs_error();
  EXPECT_CONTAINS(message, "'weights' has shape (12), expected (m) with m = 13 from array 'edges'");
}

TEST_F(Hdf5, EmptyDataset) {
  put("p", H5T_IEEE_F32LE, {0, 7, 11});
  EXPECT_CONTAINS(outputs_error(), "array 'p': it is empty, shape (0, 7, 11)");
}

TEST_F(Hdf5, DatasetThatWasNeverWritten) {
  put("p", H5T_IEEE_F32LE, {5, 7, 11});  // HDF5 would read zeros
  put("count", H5T_STD_I32LE, {13}, outputs[1].data(), H5T_NATIVE_INT32);
  EXPECT_CONTAINS(outputs_error(), "array 'p': it was never completely written");
}

TEST_F(Hdf5, DatasetWithChunksMissing) {
  const hid_t properties = H5Pcreate(H5P_DATASET_CREATE);
  const hsize_t chunk[3] = {1, 7, 11};
  H5Pset_chunk(properties, 3, chunk);
  put("p", H5T_IEEE_F32LE, {5, 7, 11}, nullptr, -1, properties);
  H5Pclose(properties);
  const hid_t file = H5Fopen(path.c_str(), H5F_ACC_RDWR, H5P_DEFAULT);
  const hid_t dataset = H5Dopen2(file, "p", H5P_DEFAULT), space = H5Dget_space(dataset);
  const hsize_t start[3] = {0, 0, 0}, count[3] = {4, 7, 11};  // four of five chunks
  H5Sselect_hyperslab(space, H5S_SELECT_SET, start, nullptr, count, nullptr);
  const hid_t memory = H5Screate_simple(3, count, nullptr);
  ASSERT_GE(H5Dwrite(dataset, H5T_NATIVE_FLOAT, memory, space, H5P_DEFAULT, outputs[0].data()), 0);
  H5Sclose(memory);
  H5Sclose(space);
  H5Dclose(dataset);
  H5Fclose(file);
  EXPECT_CONTAINS(outputs_error(), "it was never completely written");
}

TEST_F(Hdf5, ScalarThatIsAnArray) {
  write_problem(path, task, "public", problem);
  remove_dataset("dt");
  const float values[2] = {1, 2};
  put("dt", H5T_IEEE_F32LE, {2}, values, H5T_NATIVE_FLOAT);
  EXPECT_CONTAINS(inputs_error(), "scalar 'dt': it has shape (2), expected a single value");
}

TEST_F(Hdf5, WrongTaskKindAndSchema) {
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  EXPECT_CONTAINS(inputs_error(), "it holds outputs, expected inputs");
  put_attribute("task", std::string("other"));
  EXPECT_CONTAINS(outputs_error(), "it belongs to task 'other', expected 'sample'");
  put_attribute("schema", 99);
  EXPECT_CONTAINS(outputs_error(), "schema 99 is not supported");
  put_attribute("schema", std::string("one"));
  EXPECT_CONTAINS(outputs_error(), "attribute 'schema' is a string, expected an integer");
}

// ---- writing never costs what was there ----

TEST_F(Hdf5, AFailedWriteLeavesTheOldFileAndNoTemporary) {
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  const std::string before = read_file(path);
  Arrays incomplete;
  incomplete.push_back(outputs[0].clone());
  EXPECT_THROW(write_arrays(path, FileKind::outputs, task, "public", incomplete), Error);
  EXPECT_EQ(read_file(path), before);
  EXPECT_EQ(std::distance(fs::directory_iterator(folder), fs::directory_iterator{}), 1);
}

// A file-size limit stands in for a full disk: the write fails half way through the data.
TEST_F(Hdf5, AFullDiskLeavesTheOldFile) {
  write_arrays(path, FileKind::outputs, task, "public", outputs);
  const std::string before = read_file(path);
  const Problem large = sample_problem(20000);
  const Arrays more = sample_outputs(large);
  const auto write_with_limit = [&] {
    std::signal(SIGXFSZ, SIG_IGN);
    rlimit limit{};
    limit.rlim_cur = limit.rlim_max = rlim_t{1} << 20;
    setrlimit(RLIMIT_FSIZE, &limit);
    try {
      write_arrays(path, FileKind::outputs, task, "public", more);
    } catch (const Error& e) {
      std::_Exit(static_cast<int>(e.code()));
    }
    std::_Exit(0);
  };
  EXPECT_EXIT(write_with_limit(), testing::ExitedWithCode(static_cast<int>(ExitCode::bad_input)), "");
  EXPECT_EQ(read_file(path), before);
}

TEST_F(Hdf5, UnwritableFolder) {
  write_file(folder + "/file", "x");
  EXPECT_THROW(write_arrays(folder + "/file/below.h5", FileKind::outputs, task, "public", outputs), Error);
}

}  // namespace
}  // namespace gpuphys
