// The driver as its users meet it: bad input gets one clear line and its own exit code, and nothing written
// is lost.
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>

#include "core/base/error.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

struct Outcome {
  int code;
  std::string text;  // stdout and stderr together
};

class Cli : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_cli_XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { fs::remove_all(folder_); }

  Outcome call(const std::string& arguments) const {
    const std::string command = "cd '" + folder_.string() +
                                "' && unset GPUPHYS_REQUIRE_GPU; '" GPUPHYS_DRIVER
                                "' --results results --store store " +
                                arguments + " 2>&1";
    const std::unique_ptr<FILE, int (*)(FILE*)> pipe(
        popen(command.c_str(), "r"), +[](FILE*) { return 0; });
    Outcome o{-1, ""};
    std::array<char, 4096> buffer;
    while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe.get()))
      o.text.append(buffer.data(), n);
    const int status = pclose(pipe.get());
    o.code = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
    return o;
  }

  // One line that contains every part, and the exit code.
  void expect_error(const std::string& arguments, ExitCode code,
                    const std::vector<std::string>& parts) const {
    const Outcome o = call(arguments);
    EXPECT_EQ(o.code, static_cast<int>(code)) << arguments << "\n" << o.text;
    for (const std::string& part : parts)
      EXPECT_NE(o.text.find(part), std::string::npos) << arguments << "\n" << o.text;
    EXPECT_EQ(o.text.find("terminate called"), std::string::npos) << o.text;
  }

  fs::path folder_;
};

TEST_F(Cli, UnknownNamesSuggestWhatExists) {
  expect_error("run --task advect_rk3x --module baseline_f32", ExitCode::unknown_name,
               {"'advect_rk3x'", "advect_rk3"});
  expect_error("run --task advect_rk2 --module baseline_f32 --set nosuch", ExitCode::unknown_name,
               {"'nosuch'", "public_smoke"});
  expect_error("run --task advect_rk2 --module baseline_f16 --set public_smoke", ExitCode::unknown_name,
               {"'baseline_f16'", "baseline_f64"});
  expect_error("run --task advect_rk2 --module ./missing.so --set public_smoke", ExitCode::unknown_name,
               {"./missing.so"});
  expect_error("run --task advect_rk2 --module baseline_f32 --set public_smoke --scalar nu=1",
               ExitCode::unknown_name, {"'nu'"});
}

TEST_F(Cli, BadCommandLines) {
  EXPECT_EQ(call("").code, static_cast<int>(ExitCode::usage));
  EXPECT_EQ(call("frobnicate").code, static_cast<int>(ExitCode::usage));
  EXPECT_EQ(call("run --task advect_rk2").code, static_cast<int>(ExitCode::usage));
  for (const char* scalar : {"dt", "dt=", "dt=0,001", "dt=1e-3abc", "dt=nan", "dt=inf", "dt= 1"})
    expect_error(std::string("run --task advect_rk2 --module baseline_f32 --scalar '") + scalar + "'",
                 ExitCode::usage, {"NAME=NUMBER"});
  for (const char* limit : {"nan", "inf", "0", "-1"})
    EXPECT_EQ(
        call(std::string("run --task advect_rk2 --module baseline_f32 --set public_smoke --timeout ") + limit)
            .code,
        static_cast<int>(ExitCode::usage))
        << limit;
}

TEST_F(Cli, HelpHasExamplesAndTheExitCodes) {
  const Outcome o = call("--help");
  EXPECT_EQ(o.code, 0);
  EXPECT_NE(o.text.find("Exit codes"), std::string::npos);
  for (const char* command :
       {"list", "run", "check", "export", "tolerance", "mutants", "time", "report", "verdict", "record"}) {
    const Outcome help = call(std::string(command) + " --help");
    EXPECT_EQ(help.code, 0) << command;
    EXPECT_NE(help.text.find("xample"), std::string::npos) << command << " --help has no example\n"
                                                           << help.text;
  }
}

TEST_F(Cli, AFileThatIsNoModuleIsRefused) {
  std::ofstream(folder_ / "text.so") << "not a shared object";
  expect_error("run --task advect_rk2 --module ./text.so --set public_smoke", ExitCode::module_fault,
               {"text.so"});
}

TEST_F(Cli, AModuleOfAnotherTaskIsRefused) {
  expect_error("run --task advect_rk2 --module " GPUPHYS_MODULES
               "/poisson_neumann/baseline_f32.so --label mine --set public_smoke",
               ExitCode::module_fault, {"poisson_neumann", "advect_rk2"});
}

TEST_F(Cli, AUsersFileCannotPassForAModuleOfTheSuite) {
  const std::string run =
      "run --task advect_rk2 --set public_smoke --module " GPUPHYS_MODULES "/advect_rk2/baseline_f32.so";
  expect_error(run, ExitCode::usage, {"'baseline_f32'", "--label"});
  expect_error(run + " --label reference", ExitCode::usage, {"'reference'", "--label"});
  expect_error(run + " --label mutant.mine", ExitCode::usage, {"'mutant.mine'", "--label"});
  EXPECT_FALSE(fs::exists(folder_ / "results/advect_rk2"));
  EXPECT_EQ(call(run + " --label mine").code, 0);
}

TEST_F(Cli, ASweepFailsWhereThePrescribedSettingDoes) {
  // Loose tolerances may miss the check; the mutant misses it at the prescribed one too.
  const std::string sweep = "run --task poisson_neumann --set public_smoke --sweep --module ";
  EXPECT_EQ(call(sweep + "baseline_f32").code, 0);
  EXPECT_EQ(call(sweep + "serial_mutant.stop_at_ten_times_tol").code,
            static_cast<int>(ExitCode::check_failed));
}

TEST_F(Cli, ACorrectModulePassesAndItsResultIsKept) {
  const Outcome o = call("run --task advect_rk2 --module baseline_f32 --set public_smoke");
  EXPECT_EQ(o.code, 0) << o.text;
  EXPECT_TRUE(fs::exists(folder_ / "results/advect_rk2/cpu/baseline_f32/public_smoke.json")) << o.text;
}

TEST_F(Cli, AMutantFailsAsAModuleAndSucceedsAsAMutant) {
  const std::string run = "run --task advect_rk2 --module serial_mutant.forward_half_step --set public_smoke";
  EXPECT_EQ(call(run).code, static_cast<int>(ExitCode::check_failed));
  EXPECT_EQ(call(run + " --expect killed").code, 0);
  // The honest baseline "as a mutant" survives, and that is a failure.
  expect_error("run --task advect_rk2 --module baseline_f32 --set public_smoke --expect killed",
               ExitCode::check_failed, {"SURVIVED"});
}

TEST_F(Cli, AStuckModuleIsStoppedAndNamed) {
  expect_error("run --task poisson_neumann --module baseline_f64 --set public_smoke --timeout 0.01",
               ExitCode::crashed, {"TIMEOUT"});
}

// A verdict that nobody could read is none.
TEST_F(Cli, ClosedOrFullOutputIsNoSuccess) {
  const int lost = static_cast<int>(ExitCode::output_lost);
  const std::string list = "list --task advect_rk2";
  EXPECT_EQ(call(list + " > /dev/full").code, lost);
  EXPECT_EQ(call(list + " >&- 2> /dev/null; exit $? #").code, lost);
}

TEST_F(Cli, ExportThenCheckOfWrongFiles) {
  ASSERT_EQ(call("export --task advect_rk2 --set public_smoke --output inputs.h5").code, 0);
  expect_error("check --task advect_rk2 --set public_smoke --outputs missing.h5", ExitCode::bad_input,
               {"missing.h5"});
  expect_error("check --task advect_rk2 --set public_smoke --outputs inputs.h5", ExitCode::bad_input,
               {"inputs.h5"});
  std::ofstream(folder_ / "text.h5") << "not HDF5";
  expect_error("check --task advect_rk2 --set public_smoke --outputs text.h5", ExitCode::bad_input,
               {"text.h5"});
}

}  // namespace
}  // namespace gpuphys
