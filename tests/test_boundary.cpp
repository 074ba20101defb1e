// The boundary between judge and runner, attacked: every module of tests/exploits/ is run as the driver runs
// it, and must get the verdict that stands beside it. GPUPHYS_EXPLOITS holds host.<name>.so;
// tests/CMakeLists.txt lists them.
#include <dirent.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cfenv>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "core/base/files.hpp"
#include "core/judge/judge.hpp"
#include "core/judge/store.hpp"
#include "tests/exploits/target.hpp"

namespace gpuphys::exploit_target {
namespace {

namespace fs = std::filesystem;

RunnerOptions options(double timeout_s = 20) {
  return {.program = GPUPHYS_RUNNER_PROGRAM,
          .timeout_s = timeout_s,
          .under_tool = false,
          .build_root = GPUPHYS_BUILD_ROOT};
}
std::string module_path(const std::string& name) {
  return std::string(GPUPHYS_EXPLOITS) + "/host." + name + ".so";
}
Contract contract() {
  return gpuphys::describe<Inputs, Outputs<float>>();
}
Problem problem() {
  return make_target_problem(1000, 1);
}

CallReport judged(const std::string& name, double timeout_s = 20) {
  return run_once(options(timeout_s), module_path(name), GpuUse::unknown, contract(), problem());
}

// How losing the runner was described.
std::string lost(const std::string& name, bool timed_out = false, double timeout_s = 20) {
  try {
    const CallReport r = judged(name, timeout_s);
    return is_exact(r.outputs, problem()) ? "answered" : "answered wrongly";
  } catch (const RunnerLost& e) {
    if (e.timed_out() != timed_out) return std::string("wrong kind: ") + e.what();
    return e.what();
  } catch (const Error& e) {
    return std::string("Error: ") + e.what();
  }
}

bool has(const CallReport& r, Fault fault, const std::string& text = "") {
  for (const FaultReport& f : r.faults) {
    if (f.fault == fault && f.detail.find(text) != std::string::npos) return true;
  }
  return false;
}

testing::AssertionResult holds(const std::string& text, const std::string& part) {
  if (text.find(part) != std::string::npos) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "'" << text << "' does not hold '" << part << "'";
}

// ---- ending the process proves nothing ----

class EndsTheProcess : public testing::TestWithParam<std::pair<const char*, const char*>> {};
TEST_P(EndsTheProcess, IsCrashed) {
  EXPECT_TRUE(holds(lost(GetParam().first), GetParam().second));
}
INSTANTIATE_TEST_SUITE_P(
    Boundary, EndsTheProcess,
    testing::Values(
        std::pair{"exit_0", "exit code 0"}, std::pair{"_exit_0", "exit code 0"},
        std::pair{"_exit_77", "exit code 77"}, std::pair{"quick_exit", "exit code 0"},
        std::pair{"raw_exit", "exit code 0"}, std::pair{"execve", "exit code 0"},
        std::pair{"exit_in_thread", "exit code 0"}, std::pair{"handler_exits", "exit code 0"},
        std::pair{"abort", "signal 6"}, std::pair{"segfault", "signal 11"},
        std::pair{"exit_0_in_allocate", "exit code 0"}, std::pair{"exit_0_in_release", "exit code 0"},
        std::pair{"exit_0_in_constructor", "exit code 0"}, std::pair{"exit_0_in_entry", "exit code 0"},
        std::pair{"says_done", "without having computed"}, std::pair{"sends_garbage", "no answer"},
        std::pair{"unknown_fault", "fault that does not exist"}),
    [](const auto& i) {
      std::string name = i.param.first;
      return name[0] == '_' ? "raw" + name : name;
    });

TEST(Boundary, SayingDoneBeforeExitingDeliversOnlyWhatWasWritten) {
  const CallReport r = judged("says_done_and_exits");
  EXPECT_TRUE(has(r, Fault::unwritten_output));
}

// The judge and the supervisor are out of its reach.
TEST(Boundary, AModuleCannotStopWhoRunsIt) {
  EXPECT_EQ(lost("kills_its_parent"), "answered");
}

TEST(Boundary, SayingSkippedIsNoSkip) {
  const std::string text = lost("says_skipped");
  EXPECT_NE(text, "answered");
}

// ---- never ending ----

TEST(Boundary, WhatHangsTimesOutAndIsGone) {
  for (const char* name : {"hangs", "stops_itself", "spins_with_children"}) {
    const auto began = std::chrono::steady_clock::now();
    EXPECT_TRUE(holds(lost(name, true, 0.5), "no answer within 0.5 s")) << name;
    EXPECT_LT(std::chrono::steady_clock::now() - began, std::chrono::seconds(8)) << name;
  }
}

TEST(Boundary, LimitsAreFiniteAndPositive) {
  for (const double bad : {0.0, -1.0, std::nan(""), std::numeric_limits<double>::infinity()})
    EXPECT_THROW(Runner(options(bad), module_path("honest")), Error) << bad;
}

// ---- what a runner cannot touch ----

class Touches : public testing::TestWithParam<const char*> {
 protected:
  Touches() {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_target_XXXXXX").string();
    folder = ::mkdtemp(pattern.data());
    write_file(folder + "/target.raw", "the judge's own");
  }
  ~Touches() override {
    fs::remove_all(folder);
    ::unsetenv("GPUPHYS_ATTACK_TARGET");
  }
  std::string folder;
};
TEST_P(Touches, Nothing) {
  const std::string name = GetParam();
  ::setenv("GPUPHYS_ATTACK_TARGET", (name == "reads_truth" ? folder : folder + "/target.raw").c_str(), 1);
  Runner runner(options(), module_path(name));
  if (!runner.unconfined().empty()) GTEST_SKIP() << "unconfined: " << runner.unconfined();
  runner.load(GpuUse::no);
  const Problem p = problem();
  const CallReport r = runner.call(contract(), p, {});
  EXPECT_TRUE(is_exact(r.outputs, p)) << name << " succeeded";
  EXPECT_EQ(read_file(folder + "/target.raw"), "the judge's own");
}
INSTANTIATE_TEST_SUITE_P(Boundary, Touches,
                         testing::Values("reads_truth", "reads_target", "writes_target", "removes_target",
                                         "writes_files", "writes_inputs", "attaches_to_parent"),
                         [](const auto& i) { return std::string(i.param); });

TEST(Boundary, AnotherModuleOfTheSuiteCannotBeRead) {
  ::setenv("GPUPHYS_ATTACK_TARGET", module_path("honest").c_str(), 1);
  Runner runner(options(), module_path("reads_target"));
  ::unsetenv("GPUPHYS_ATTACK_TARGET");
  if (!runner.unconfined().empty()) GTEST_SKIP() << runner.unconfined();
  runner.load(GpuUse::no);
  const Problem p = problem();
  EXPECT_TRUE(is_exact(runner.call(contract(), p, {}).outputs, p));
}

TEST(Boundary, SealedInputsStayWhatTheyAreAcrossCalls) {
  Runner runner(options(), module_path("writes_inputs"));
  runner.load(GpuUse::no);
  const Problem p = problem();
  for (int i = 0; i < 2; ++i)
    EXPECT_TRUE(is_exact(runner.call(contract(), p, {.timed = false, .last = false}).outputs, p));
  EXPECT_EQ(digest_of(p), digest_of(problem()));
}

// ---- nothing outlives the verdict ----

TEST(Boundary, AChildThatStaysIsGoneBeforeTheVerdict) {
  const CallReport r = judged("leaves_a_child");
  std::this_thread::sleep_for(std::chrono::milliseconds(600));
  EXPECT_TRUE(is_exact(r.outputs, problem()));
}

TEST(Boundary, AThreadThatStaysReachesNoCopy) {
  Runner runner(options(), module_path("leaves_a_thread"));
  runner.load(GpuUse::no);
  const Problem p = problem();
  const CallReport r = runner.call(contract(), p, {.timed = false, .last = false});
  std::this_thread::sleep_for(std::chrono::milliseconds(400));
  EXPECT_TRUE(is_exact(r.outputs, p));
}

// ---- memory, arithmetic, text ----

TEST(Boundary, WritingBeyondAnOutputIsSeen) {
  EXPECT_TRUE(holds(lost("writes_1_MiB_beyond"), "output 'v': an access"));
  EXPECT_TRUE(holds(lost("writes_1_MiB_beyond"), "signal 11"));
}

#ifndef __SANITIZE_ADDRESS__
TEST(Boundary, MemoryIsLimited) {
  const CallReport r = judged("takes_all_memory", 60);
  EXPECT_TRUE(has(r, Fault::returned_error, "no memory"));
}
#endif

TEST(Boundary, TheArithmeticOfAModuleIsItsOwn) {
  for (const char* name : {"flushes_subnormals", "rounds_up"}) {
    (void)judged(name);
    volatile float tiny = 0x1p-140f;
    EXPECT_NE(tiny * 0.5f, 0.0f) << name;
    EXPECT_EQ(std::fegetround(), FE_TONEAREST) << name;
  }
}

TEST(Boundary, TextIsBoundedAndPrintable) {
  const CallReport endless = judged("endless_message"), bad = judged("bad_text");
  ASSERT_EQ(endless.faults.size(), 2u);  // and its output was never written
  EXPECT_LE(endless.faults[0].detail.size(), 800u);
  EXPECT_TRUE(has(bad, Fault::returned_error, "compute(): ???[31m red ? txet"));
}

TEST(Boundary, APrintedTableIsNoVerdict) {
  Runner runner(options(), module_path("prints_a_table"));
  runner.load(GpuUse::no);
  const Problem p = problem();
  const CallReport r = runner.call(contract(), p, {});
  EXPECT_FALSE(is_exact(r.outputs, p));
  EXPECT_LE(runner.printed().size(), 64u);
  for (const std::string& line : runner.printed()) EXPECT_EQ(line.find('\x1b'), std::string::npos);
}

TEST(Boundary, AnExceptionFromReleaseIsAFault) {
  EXPECT_TRUE(has(judged("throws_in_release"), Fault::returned_error,
                  "release(): threw across the C interface: escaped"));
}

TEST(Boundary, ATableThatMakesNoSenseIsNoModule) {
  for (const char* name : {"type_3", "type_0", "type_99", "space_7"}) {
    try {
      judged(name);
      ADD_FAILURE() << name;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ExitCode::module_fault) << name;
    }
  }
}

// ---- rules that honest authors break ----

struct Expectation {
  const char* name;
  Fault fault;
  const char* detail;
};
class BrokenRule : public testing::TestWithParam<Expectation> {};
TEST_P(BrokenRule, IsNamed) {
  EXPECT_TRUE(has(judged(GetParam().name), GetParam().fault, GetParam().detail));
}
INSTANTIATE_TEST_SUITE_P(
    Boundary, BrokenRule,
    testing::Values(Expectation{"modifies_input", Fault::input_modified, "input 'u': 1 of 1000"},
                    Expectation{"writes_past_end", Fault::out_of_bounds_write,
                                "output 'v': wrote 0 bytes before its start and 4 past"},
                    Expectation{"writes_nan", Fault::non_finite_output, "1 of 1000"},
                    Expectation{"leaves_part_unwritten", Fault::unwritten_output, "232 of 1000"},
                    Expectation{"throws", Fault::returned_error, "the solver diverged"},
                    Expectation{"throws_in_allocate", Fault::returned_error, "no room"},
                    Expectation{"returns_error", Fault::returned_error, "no convergence after 50 iterations"},
                    Expectation{"throws_across_interface", Fault::returned_error, "escaped"}),
    [](const auto& i) { return std::string(i.param.name); });

// Wrong values whose cause is named. Two calls in one process, as on two input sets.
TEST(Boundary, AnEarlierAnswerAZeroAndACopyAreDiagnosed) {
  const std::pair<const char*, Fault> cases[] = {{"returns_zeros", Fault::zero_output},
                                                 {"copies_input", Fault::copied_input},
                                                 {"returns_last_result", Fault::stale_output},
                                                 {"works_in_allocate", Fault::stale_output}};
  for (const auto& [name, fault] : cases) {
    Runner runner(options(), module_path(name));
    runner.load(GpuUse::no);
    const Problem one = make_target_problem(1000, 1), two = make_target_problem(1000, 2);
    const CallReport first = runner.call(contract(), one, {.timed = false, .last = false});
    const CallReport second = runner.call(contract(), two, {});
    EXPECT_FALSE(is_exact(second.outputs, two)) << name;
    const Arrays truth = exact_answer(two);
    bool named = false;
    for (const FaultReport& f : diagnose(two, second.outputs, &truth, &first.outputs))
      named = named || f.fault == fault;
    EXPECT_TRUE(named) << name;
  }
}

TEST(Boundary, AnHonestModulePasses) {
  const CallReport r = judged("honest");
  EXPECT_TRUE(r.faults.empty());
  EXPECT_TRUE(is_exact(r.outputs, problem()));
  EXPECT_GT(r.milliseconds, 0);
  EXPECT_GT(r.wall_ms, 0);
}

TEST(Boundary, WithoutLandlockBubblewrapConfines) {
  if (::access("/usr/bin/bwrap", X_OK) != 0) GTEST_SKIP() << "bubblewrap is not installed";
  ::setenv("GPUPHYS_NO_LANDLOCK", "1", 1);
  ::setenv("GPUPHYS_ATTACK_TARGET", "/dev/shm", 1);
  std::string confinement, answer;
  const Problem p = problem();
  try {
    Runner runner(options(), module_path("writes_files"));
    confinement = runner.unconfined();
    runner.load(GpuUse::no);
    answer = is_exact(runner.call(contract(), p, {}).outputs, p) ? "" : "wrote a file";
  } catch (const std::exception& e) {
    answer = e.what();
  }
  ::unsetenv("GPUPHYS_NO_LANDLOCK");
  ::unsetenv("GPUPHYS_ATTACK_TARGET");
  EXPECT_EQ(confinement, "");
  if (answer.find("gone") != std::string::npos) GTEST_SKIP() << "bubblewrap cannot start here: " << answer;
  EXPECT_FALSE(fs::exists("/tmp/gpuphys_attack"));
}

}  // namespace
}  // namespace gpuphys::exploit_target
