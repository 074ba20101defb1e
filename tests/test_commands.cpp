// The driver's commands as users call them: export, check, record, check-records, verdict, report.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "core/base/files.hpp"
#include "core/contract/hdf5_io.hpp"
#include "core/contract/task.hpp"
#include "core/driver/context.hpp"
#include "core/driver/inventory.hpp"
#include "core/judge/judge.hpp"
#include "core/records/labels.hpp"
#include "core/records/record.hpp"
#include "core/records/results.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

struct Outcome {
  int code = -1;
  std::string output;  // stdout and stderr
};

// Every command works on a copy of the sources and on results of its own.
class Commands : public testing::Test {
 protected:
  Commands() {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_commands_XXXXXX").string();
    folder = ::mkdtemp(pattern.data());
    source = folder + "/source";
    for (const char* part : {"core", "cases", "references", "serial_baselines", "mutants", "fmad_variants"}) {
      fs::create_directories(source);
      fs::copy(std::string(GPUPHYS_SOURCE_ROOT) + "/" + part, source + "/" + part,
               fs::copy_options::recursive);
    }
  }
  ~Commands() override { fs::remove_all(folder); }

  Outcome gpuphys(const std::string& arguments) const {
    const std::string command = "GPUPHYS_SOURCE_DIR='" + source + "' '" GPUPHYS_DRIVER "' --results '" +
                                folder + "/results' --store '" + folder +
                                "/store' --modules '" GPUPHYS_MODULES "' " + arguments + " 2>&1";
    FILE* pipe = ::popen(command.c_str(), "r");
    Outcome outcome;
    std::array<char, 4096> buffer;
    while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe))
      outcome.output.append(buffer.data(), n);
    const int status = ::pclose(pipe);
    outcome.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    return outcome;
  }

  Context context() const {
    Context ctx;
    ctx.source_root = source;
    ctx.modules_root = GPUPHYS_MODULES;
    ctx.build_root = GPUPHYS_BUILD_ROOT;
    ctx.results_root = folder + "/results";
    ctx.store_root = folder + "/store";
    ctx.runner = GPUPHYS_RUNNER_PROGRAM;
    return ctx;
  }

  // Results of a GPU run in which everything went well, made up; of the modules and inputs as they are now.
  void put_gpu_results() const {
    const Task& task = find_task(kTask);
    const std::map<std::string, ModuleStamp> stamps = expected_stamps(context(), task);
    if (stamps.empty()) GTEST_SKIP() << "a build without CUDA notes no device modules";
    const auto run = [&](const std::string& label, const std::string& role, const InputSet& set) {
      RunResult r;
      r.task = task.name;
      r.label = label;
      r.set = set.name;
      r.module = stamps.at(module_of(label));
      const SetEvidence& evidence = evidence_of_set(task, set);
      r.inputs = evidence.inputs;
      r.truth = evidence.truth;
      r.device = "NVIDIA Test";
      r.state = role == "mutant" ? RunState::killed : RunState::pass;
      for (const Check& c : checks_of(task, set)) {
        const double error = c.tolerance * (role == "mutant" ? 100 : 0.1);
        r.checks.push_back({c.name, to_string(c.kind), c.quantity, c.norm, error, c.tolerance,
                            ratio_of(error, c.tolerance), role != "mutant", ""});
      }
      r.truth_gap = {{"toi", 7e-8}};
      r.milliseconds = 0.4;
      write_result(folder + "/results", r);
    };
    for (const InputSet& set : task.sets) {
      const bool hard = set.kind == SetKind::hard, smoke = set.size == Size::smoke;
      if (smoke && !hard) continue;
      run("reference", "reference", set);
      run("fmad", "fmad", set);
      if (hard) continue;
      for (const auto& [label, sets] : expectation_of(task, source).gpu_ensemble) {
        if (std::find(sets.begin(), sets.end(), set.name) != sets.end()) run(label, "reference", set);
      }
      for (const auto& entry : fs::directory_iterator(source + "/mutants/" + task.name)) {
        run("mutant." + entry.path().stem().string(), "mutant", set);
      }
      TimingResult t;
      t.task = task.name;
      t.label = "reference";
      t.set = set.name;
      t.module = stamps.at("reference");
      t.times_ms = {0.3, 0.3, 0.3, 0.3, 0.3};
      t.min_ms = t.median_ms = 0.3;
      t.floor_ms = 0.1;
      t.multiple = 3;
      t.device = "NVIDIA Test";
      t.gate.state = "UNBASELINED";
      write_result(folder + "/results", t);
    }
  }
  // Computed once for all tests: none changes what the driver generates.
  const SetEvidence& evidence_of_set(const Task& task, const InputSet& set) const {
    static std::map<std::string, SetEvidence> known;
    if (!known.contains(set.name))
      known[set.name] = evidence_of(context(), task, set, set.size == Size::smoke);
    return known[set.name];
  }
  std::string record_file() const { return source + "/ci/records/nvidia-test/" + kTask + ".json"; }

  // Small also at paper size, so that its inputs are made in a moment.
  static constexpr const char* kTask = "ccd_ee";

  std::string folder, source;
};

#define EXPECT_OUTCOME(outcome, expected_code, part)                     \
  do {                                                                   \
    const Outcome seen = (outcome);                                      \
    EXPECT_EQ(seen.code, expected_code) << seen.output;                  \
    EXPECT_NE(seen.output.find(part), std::string::npos) << seen.output; \
  } while (false)

TEST_F(Commands, AnExportedSetCanBeSolvedElsewhereAndChecked) {
  const std::string inputs = folder + "/in.h5", truth = folder + "/truth.h5", outputs = folder + "/out.h5";
  ASSERT_EQ(
      gpuphys("export --task advect_rk2 --set public_smoke --output " + inputs + " --expected " + truth).code,
      0);
  const Task& task = find_task("advect_rk2");
  const Problem problem = read_problem(inputs, task);
  const Arrays exact = read_arrays(truth, task, problem, DType::f64);
  Arrays rounded = make_outputs(task.contract, problem);
  for (std::size_t a = 0; a < rounded.size(); ++a) {
    for (std::int64_t i = 0; i < rounded[a].size(); ++i) {
      rounded[a].as<float>()[static_cast<std::size_t>(i)] = static_cast<float>(exact[a].value(i));
    }
  }
  const std::string by_set = "check --task advect_rk2 --set public_smoke --outputs " + outputs;
  const std::string by_file = "check --task advect_rk2 --inputs " + inputs + " --outputs " + outputs;
  write_arrays(outputs, FileKind::outputs, task, "", rounded);
  EXPECT_OUTCOME(gpuphys(by_set), 0, "PASS");
  EXPECT_OUTCOME(gpuphys(by_file + " --label mine"), 0, "PASS");
  EXPECT_TRUE(fs::exists(folder + "/results/advect_rk2/user/mine/custom.json"));
  EXPECT_OUTCOME(gpuphys(by_set + " --label reference"), 2, "belongs to a module of the suite");

  rounded[1].as<float>()[17] += 1;
  write_arrays(outputs, FileKind::outputs, task, "", rounded);
  EXPECT_OUTCOME(gpuphys(by_set), 3, "FAIL");
  EXPECT_OUTCOME(gpuphys(by_file), 3, "uy_local");

  write_arrays(outputs, FileKind::outputs, task, "hidden_smoke", rounded);
  EXPECT_OUTCOME(gpuphys(by_set), 5, "belongs to input set 'hidden_smoke'");
  const std::string whole = read_file(outputs);
  write_file(outputs, whole.substr(0, whole.size() / 2));
  EXPECT_OUTCOME(gpuphys(by_set), 5, "truncated or corrupt");
  EXPECT_OUTCOME(gpuphys("check --task advect_rk2 --set public_smoke --outputs " + truth), 5,
                 "it is float64, expected float32");
  EXPECT_OUTCOME(gpuphys("check --task advect_rk2 --outputs " + outputs), 2, "either --set or --inputs");
}

TEST_F(Commands, UnknownNamesAreRefusedWithWhatExists) {
  EXPECT_OUTCOME(gpuphys("export --task advect_rk22 --set public --output x.h5"), 6, "nearest: advect_rk2");
  EXPECT_OUTCOME(gpuphys("export --task advect_rk2 --set nothing --output x.h5"), 6, "public_smoke");
  EXPECT_OUTCOME(gpuphys("verdict --gpu none"), 6, "no records of GPU 'none'");
  EXPECT_OUTCOME(gpuphys("tolerance --value 1"), 2, "--check and --value belong together");
}

TEST_F(Commands, WithoutResultsTheVerdictNamesWhatIsMissing) {
  EXPECT_OUTCOME(gpuphys("verdict --task ccd_ee"), 3, "MISSING ccd_ee gpu: ");
  EXPECT_OUTCOME(gpuphys("mutants --task ccd_ee"), 3, "no mutant has been run");
  EXPECT_OUTCOME(gpuphys("check-records"), 13, "no GPU records");
  EXPECT_OUTCOME(gpuphys("record"), 5, "no GPU results");
}

TEST_F(Commands, OneChangedSourceMakesItsOwnModulesStaleAndNoOther) {
  put_gpu_results();
  EXPECT_OUTCOME(gpuphys("record"), 0, "runs and 2 timings of");
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 0, "complete and matches its sources");
  fs::remove_all(folder + "/results");
  EXPECT_OUTCOME(gpuphys("verdict --lane gpu --task ccd_ee"), 0, "1 tasks: 1 OK");

  const std::string reference = source + "/references/collision_query/ccd_ee.cu", text = read_file(reference);
  write_file(reference, "// a remark\n\n" + text);
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 0, "complete");
  write_file(reference, text + "\nint changed;\n");
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 13, "STALE ccd_ee gpu reference: ");
  EXPECT_OUTCOME(gpuphys("verdict --lane gpu --task ccd_ee"), 3, "its sources have changed since");
  write_file(reference, text);

  // A changed tolerance's reason, a changed driver: nothing.
  const std::string other = source + "/core/driver/table.cpp";
  write_file(other, read_file(other) + "\nint changed;\n");
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 0, "complete");
  // Another case file, which generates the same: computed again, and still good.
  const std::string case_file = source + "/cases/collision_query/ccd_ee.cpp";
  write_file(case_file, read_file(case_file) + "\nint changed;\n");
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 0, "complete");

  // A fault planted after the run.
  const std::string patch = source + "/mutants/ccd_ee/new_fault.patch";
  write_file(patch, "what: x\nclass: x\ncheck: x\n--- a/references/x\n+++ b/references/x\n");
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 13,
                 "MISSING ccd_ee gpu: 2 results of mutant.new_fault");
  fs::remove(patch);
  EXPECT_EQ(gpuphys("check-records --task ccd_ee").code, 0);
}

TEST_F(Commands, ResultsOfOtherSourcesAreNotRecorded) {
  put_gpu_results();
  const std::string path = folder + "/results/ccd_ee/gpu/fmad/public.json";
  nlohmann::json j = nlohmann::json::parse(read_file(path));
  j["module"]["sources"] = "0";
  write_file(path, j.dump());
  EXPECT_OUTCOME(gpuphys("record"), 3, "refused: ccd_ee fmad public: it is of other sources or flags");
  EXPECT_FALSE(fs::exists(record_file()));
}

TEST_F(Commands, ARecordEditedByHandIsRefused) {
  put_gpu_results();
  ASSERT_EQ(gpuphys("record").code, 0);
  const std::string whole = read_file(record_file());
  const auto refused = [&](auto&& edit, const std::string& part) {
    nlohmann::json j = nlohmann::json::parse(whole);
    edit(j);
    write_file(record_file(), j.dump());
    EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 13, part);
  };
  const auto first_reference = [](nlohmann::json& j) -> nlohmann::json& {
    for (auto& r : j["runs"]) {
      if (r["label"] == "reference") return r;
    }
    return j["runs"][0];
  };
  refused([](auto& j) { j["runs"].erase(0); }, "MISSING");
  refused([&](auto& j) { first_reference(j)["state"] = "CRASHED"; }, "CRASHED");
  refused([&](auto& j) { first_reference(j)["checks"].begin().value()[0] = 1e9; },
          "PASS although a check exceeds its tolerance");
  refused([&](auto& j) { first_reference(j)["checks"].begin().value()[1] = 1e9; },
          "was judged with tolerance 1e+09");
  refused([](auto& j) { j["timings"].clear(); }, "MISSING ccd_ee gpu: 1 results of reference");
  refused([](auto& j) { j["modules"]["reference"]["flags"] = "--use_fast_math"; },
          "it was built with '--use_fast_math'");
  write_file(record_file(), whole.substr(0, whole.size() / 2));
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 13, "not valid JSON");
}

TEST_F(Commands, AnIncompleteRunIsNotRecorded) {
  put_gpu_results();
  fs::remove(folder + "/results/ccd_ee/gpu/fmad/hidden.json");
  EXPECT_OUTCOME(gpuphys("record"), 3, "not recorded");
  EXPECT_FALSE(fs::exists(record_file()));
  EXPECT_OUTCOME(gpuphys("record --incomplete"), 0, "recorded");
  EXPECT_OUTCOME(gpuphys("check-records --task ccd_ee"), 13, "MISSING ccd_ee gpu: 1 results of fmad");
  // What is run later is joined to what was recorded from the same sources.
  fs::remove_all(folder + "/results");
  put_gpu_results();
  EXPECT_OUTCOME(gpuphys("record"), 0, "recorded");
  EXPECT_EQ(gpuphys("check-records --task ccd_ee").code, 0);
}

TEST_F(Commands, ASlowerTimeIsRecordedOnlyOnPurposeAndWithItsReason) {
  put_gpu_results();
  const std::string path = folder + "/results/ccd_ee/gpu/reference/time.public.json";
  nlohmann::json j = nlohmann::json::parse(read_file(path));
  j["gate"]["state"] = "SLOW";
  write_file(path, j.dump());
  EXPECT_OUTCOME(gpuphys("record"), 3, "SLOW");
  EXPECT_OUTCOME(gpuphys("record --accept-slower 'safer bounds'"), 0, "recorded");
  EXPECT_EQ(gpuphys("check-records --task ccd_ee").code, 0);
  EXPECT_NE(read_file(record_file()).find("ACCEPTED"), std::string::npos);
  EXPECT_NE(read_file(source + "/ci/history/nvidia-test/ccd_ee.csv").find("safer bounds"), std::string::npos);
  EXPECT_OUTCOME(gpuphys("verdict --lane gpu --task ccd_ee"), 3,
                 "SLOW");  // the live result is still what it was
}

TEST_F(Commands, TheReportIsMadeFromRecordsAlone) {
  put_gpu_results();
  ASSERT_EQ(gpuphys("record").code, 0);
  fs::remove_all(folder + "/results");
  const Outcome made = gpuphys("report --task ccd_ee --output " + folder + "/report");
  ASSERT_EQ(made.code, 0) << made.output;
  const std::string page = read_file(folder + "/report/index.html");
  for (const char* part : {"ccd_ee", "data:image/png;base64,", "Tolerance windows", "Kill matrix", "hard_"}) {
    EXPECT_NE(page.find(part), std::string::npos) << part;
  }
  EXPECT_EQ(page.find("src=\"http"), std::string::npos) << "the page must stand alone";
  for (const char* table : {"verdict", "speed_error", "windows", "kills", "timing", "hard_cases"}) {
    const std::string csv = read_file(folder + "/report/" + table + ".csv");
    EXPECT_NE(csv.find("ccd_ee,"), std::string::npos) << table;
  }
  EXPECT_OUTCOME(gpuphys("report --output " + folder + "/other --python /none"), 5, "cannot start '/none'");
}

// A crash replaces the PASS of the run before, also in another lane and within the same second.
TEST_F(Commands, AnOlderPassNeverStandsBesideANewerCrash) {
  const std::string run = "run --task contact_dem --set hard_two_grains --label mine --module ";
  EXPECT_OUTCOME(gpuphys(run + "'" GPUPHYS_MODULES "/contact_dem/baseline_f32.so'"), 0, "PASS");
  EXPECT_OUTCOME(gpuphys(run + "'" GPUPHYS_EXPLOITS "/host.crashes_contact_dem.so'"), 9, "CRASHED");
  const ResultSet s = load_results(folder + "/results");
  ASSERT_EQ(s.runs.size(), 1u);
  EXPECT_EQ(s.runs[0].state, RunState::crashed);
  EXPECT_NE(s.runs[0].state_detail.find("exit code 0"), std::string::npos) << s.runs[0].state_detail;
}

TEST_F(Commands, OnesOwnInputsAreJudgedAgainstTheBaseline) {
  const std::string inputs = folder + "/in.h5";
  ASSERT_EQ(gpuphys("export --task contact_dem --set hard_two_grains --output " + inputs).code, 0);
  const std::string run = "run --task contact_dem --label mine --inputs " + inputs + " --module ";
  EXPECT_OUTCOME(gpuphys(run + "'" GPUPHYS_MODULES "/contact_dem/baseline_f32.so'"), 0, "own: PASS");
  EXPECT_OUTCOME(gpuphys("run --task contact_dem --inputs " + inputs + " --module baseline_f32"), 2,
                 "of one's own");
  // Values that the contract does not allow never reach a module.
  const Task& task = find_task("contact_dem");
  Problem bad = read_problem(inputs, task);
  bad.inputs[2].as<float>()[1] = -1;
  write_problem(inputs, task, "", bad);
  EXPECT_OUTCOME(gpuphys(run + "'" GPUPHYS_MODULES "/contact_dem/baseline_f32.so'"), 5, "radius[1] is -1");
}

TEST_F(Commands, OutputGoesOnlyWhereItWasMeantToGo) {
  const std::string e = "export --task contact_dem --set hard_two_grains --output ";
  EXPECT_OUTCOME(gpuphys(e + "/dev/null"), 5, "no ordinary file");
  EXPECT_OUTCOME(gpuphys(e + folder + "/none/in.h5"), 5, "its folder does not exist");
  fs::create_symlink("/etc/hostname", folder + "/link.h5");
  EXPECT_OUTCOME(gpuphys(e + folder + "/link.h5"), 5, "it is a link");
  EXPECT_OUTCOME(gpuphys(e + folder + "/x.h5 --expected " + folder + "/./x.h5"), 2, "the same file");
}

}  // namespace
}  // namespace gpuphys
