// The truth cache: computed once, also by processes at the same time; never served damaged or for other
// inputs.
#include "core/truth_cache.hpp"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "core/files.hpp"

// HDF5 1.10 leaks on its own error paths when it meets a damaged file; leaks of ours are still reported.
extern "C" const char* __lsan_default_suppressions() {
  return "leak:libhdf5";
}

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

class TruthCache : public testing::Test {
 protected:
  TruthCache() {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_truth_XXXXXX").string();
    folder = ::mkdtemp(pattern.data());
    task.name = "sample";
    task.contract.inputs = {{"u", DType::f32, 1, "n", ""}};
    task.contract.scalars = {{"dt", DType::f32, "s"}};
    task.contract.outputs = {{"v", DType::f32, 1, "n", ""}};
    set.name = "public";
    // Twice the input, and a byte in a file for each time it was asked.
    set.known_solution = [this](const Problem& p) {
      std::ofstream(folder + "/calls", std::ios::app | std::ios::binary).put('x');
      Arrays out = make_outputs(task.contract, p, DType::f64);
      for (std::int64_t i = 0; i < out[0].size(); ++i) {
        out[0].as<double>()[static_cast<std::size_t>(i)] = 2 * p.inputs[0].value(i) + offset;
      }
      return out;
    };
    problem = make_problem(task.contract, {{"n", 1000}});
    for (std::size_t i = 0; float& v : problem.inputs[0].as<float>()) v = std::sin(static_cast<float>(i++));
  }
  ~TruthCache() override { fs::remove_all(folder); }

  Arrays obtain() const { return obtain_truth(task, set, problem, "", folder + "/cache"); }
  std::size_t calls() const { return fs::exists(folder + "/calls") ? fs::file_size(folder + "/calls") : 0; }
  std::vector<std::string> cached() const {
    std::vector<std::string> files;
    for (const auto& entry : fs::directory_iterator(folder + "/cache/" + task.name)) {
      if (entry.path().extension() == ".h5") files.push_back(entry.path().string());
    }
    return files;
  }

  Task task;
  InputSet set;
  Problem problem;
  double offset = 0;
  std::string folder;
};

TEST_F(TruthCache, ComputesOnceAndReturnsTheSameBits) {
  const Arrays first = obtain(), second = obtain();
  EXPECT_EQ(calls(), 1u);
  ASSERT_EQ(first[0].dtype(), DType::f64);
  EXPECT_EQ(std::memcmp(first[0].data(), second[0].data(), first[0].bytes()), 0);
  EXPECT_EQ(first[0].value(7), 2 * problem.inputs[0].value(7));
}

TEST_F(TruthCache, OneBitOfAnInputOrScalarIsAnotherTruth) {
  obtain();
  problem.inputs[0].as<float>()[999] = std::nextafter(problem.inputs[0].as<float>()[999], 2.0f);
  EXPECT_EQ(obtain()[0].value(999), 2 * problem.inputs[0].value(999));
  EXPECT_EQ(calls(), 2u);
  problem.set_scalar("dt", 0.5);
  obtain();
  EXPECT_EQ(calls(), 3u);
  EXPECT_EQ(cached().size(), 3u);
}

TEST_F(TruthCache, ShapesAreWithinTheDigest) {
  Task square = task;
  square.contract.inputs = {{"u", DType::f32, 2, "n,m", ""}};
  const Problem a = make_problem(square.contract, {{"n", 10}, {"m", 100}});
  const Problem b = make_problem(square.contract, {{"n", 100}, {"m", 10}});
  EXPECT_NE(digest_of(a), digest_of(b));
}

TEST_F(TruthCache, DamagedFilesAreComputedAgainWithANote) {
  obtain();
  const std::string path = cached().at(0), whole = read_file(path);
  for (const std::string& damaged :
       {whole.substr(0, whole.size() / 2), std::string("not HDF5"), std::string(), [&] {
          std::string flipped = whole;
          flipped[flipped.size() - 100] = static_cast<char>(flipped[flipped.size() - 100] ^ 4);
          return flipped;
        }()}) {
    write_file(path, damaged);
    const std::size_t before = calls();
    testing::internal::CaptureStderr();
    EXPECT_EQ(obtain()[0].value(999), 2 * problem.inputs[0].value(999));
    EXPECT_NE(testing::internal::GetCapturedStderr().find("note: truth is computed again"),
              std::string::npos);
    EXPECT_EQ(calls(), before + 1);
    obtain();
    EXPECT_EQ(calls(), before + 1) << "the cache was not repaired";
  }
}

TEST_F(TruthCache, ProcessesAtTheSameTimeComputeItOnce) {
  std::vector<pid_t> children;
  for (int i = 0; i < 6; ++i) {
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      int status = 1;
      try {
        status = obtain()[0].value(5) == 2 * problem.inputs[0].value(5) ? 0 : 2;
      } catch (...) {
      }
      ::_exit(status);
    }
    children.push_back(child);
  }
  for (const pid_t child : children) {
    int status = -1;
    ::waitpid(child, &status, 0);
    EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  }
  EXPECT_EQ(calls(), 1u);
}

TEST_F(TruthCache, NonFiniteTruthIsAnErrorAndNotCached) {
  offset = std::nan("");
  try {
    obtain();
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::module_fault);
    EXPECT_NE(std::string(e.what()).find("array 'v' is not finite at flat index 0"), std::string::npos)
        << e.what();
  }
  EXPECT_TRUE(cached().empty());
}

TEST_F(TruthCache, TruthOfTheWrongShapeIsAnError) {
  set.known_solution = [](const Problem&) {
    Arrays out;
    out.emplace_back("v", DType::f64, Shape{3});
    return out;
  };
  EXPECT_THROW(obtain(), Error);
}

TEST_F(TruthCache, WithoutABaselineThereIsNoTruth) {
  set.known_solution = nullptr;
  try {
    obtain_truth(task, set, problem, folder + "/none.so", folder + "/cache");
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::unknown_name);
  }
}

TEST_F(TruthCache, AFolderThatCannotBeWrittenIsOneClearError) {
  write_file(folder + "/cache", "a file where the folder should be");
  try {
    obtain();
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::bad_input);
  }
}

// With a real baseline: another module file means another truth, and its predecessor makes room.
TEST_F(TruthCache, FollowsTheBaselineModule) {
  const Task& real = find_task("advect_rk2");
  const InputSet& smoke = real.set("public_smoke");
  const Problem inputs = smoke.make();
  const std::string built = std::string(GPUPHYS_MODULES) + "/advect_rk2/baseline_f64.so";
  const std::string module = folder + "/baseline.so", cache = folder + "/cache";
  fs::copy_file(built, module);
  const Arrays first = obtain_truth(real, smoke, inputs, module, cache);
  task.name = real.name;
  const std::string before = cached().at(0);
  // Padding behind an ELF file changes its digest and nothing else.
  fs::copy_file(built, folder + "/newer.so");
  std::ofstream(folder + "/newer.so", std::ios::app | std::ios::binary).put('\0');
  const Arrays second = obtain_truth(real, smoke, inputs, folder + "/newer.so", cache);
  ASSERT_EQ(cached().size(), 1u);
  EXPECT_NE(cached()[0], before);
  EXPECT_EQ(std::memcmp(first[0].data(), second[0].data(), first[0].bytes()), 0);
}

TEST_F(TruthCache, AModuleThatIsNoFp64BaselineIsRefused) {
  const Task& real = find_task("advect_rk2");
  const InputSet& smoke = real.set("public_smoke");
  const Problem inputs = smoke.make();
  const std::string wrong = std::string(GPUPHYS_MODULES) + "/advect_rk2/baseline_f32.so";
  try {
    obtain_truth(real, smoke, inputs, wrong, folder + "/cache");
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::module_fault);
    EXPECT_NE(std::string(e.what()).find("is not the FP64 host baseline"), std::string::npos);
  }
}

}  // namespace
}  // namespace gpuphys
