// Result files: what is written comes back, nothing unreadable is passed over, live results win over records.
#include "core/records/results.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <optional>
#include <vector>

#include "core/base/files.hpp"
#include "core/records/labels.hpp"
#include "core/records/record.hpp"
#include "core/records/results_json.hpp"

namespace gpuphys {
namespace {

namespace fs = std::filesystem;

RunResult sample(const std::string& label = "reference", const std::string& set = "public") {
  RunResult r;
  r.task = "t";
  r.lane = "gpu";
  r.label = label;
  r.role = label.starts_with("mutant.") ? "mutant" : "reference";
  r.set = set;
  r.run = "0123456789abcdef";
  r.module = {"aa", "-O3", "nvcc"};
  r.inputs = "11";
  r.truth = "22";
  r.state = r.is_mutant() ? RunState::killed : RunState::pass;
  r.checks = {{"l2", "paper", "u", "relative L2", 1.25e-7, 1e-6, 0.125, true, ""},
              {"local", "local", "u", "largest", std::nan(""), 1e-4, std::numeric_limits<double>::infinity(),
               false, "worst"}};
  r.faults = {{"zero_output", "u is zero"}};
  r.truth_gap = {{"u", 0.1 + 0.2}};
  r.milliseconds = 0.3;
  r.device = "NVIDIA H200";
  return r;
}

TimingResult timing(double ms) {
  TimingResult t;
  t.task = "t";
  t.label = "reference";
  t.set = "public";
  t.times_ms = {ms, ms, ms};
  t.median_ms = ms;
  t.gate = {"OK", 3.1, 3.3};
  t.ceilings = {{"copy_GBps", 4250}};
  t.device = "NVIDIA H200";
  return t;
}

class Results : public testing::Test {
 protected:
  Results() {
    std::string pattern = (fs::temp_directory_path() / "gpuphys_results_XXXXXX").string();
    root = ::mkdtemp(pattern.data());
  }
  ~Results() override { fs::remove_all(root); }
  std::string root;
};

TEST_F(Results, ARunComesBackWithEveryDigitAndNonFiniteNumbers) {
  const RunResult r = sample("mutant.sign");
  write_result(root, r);
  const ResultSet s = load_results(root);
  ASSERT_EQ(s.runs.size(), 1u) << (s.unreadable.empty() ? "" : s.unreadable[0]);
  EXPECT_EQ(to_json(s.runs[0]), to_json(r));
  EXPECT_EQ(s.runs[0].truth_gap.at("u"), 0.1 + 0.2);
  EXPECT_TRUE(std::isnan(s.runs[0].checks[1].error));
  EXPECT_TRUE(std::isnan(s.runs[0].checks[1].ratio));
  EXPECT_FALSE(s.runs[0].checks[1].pass);
  EXPECT_EQ(s.runs[0].module.sources, "aa");
  EXPECT_TRUE(fs::exists(root + "/t/gpu/mutant.sign/public.json"));
}

TEST_F(Results, ATimingComesBack) {
  write_result(root, timing(0.3));
  const ResultSet s = load_results(root);
  ASSERT_EQ(s.timings.size(), 1u);
  EXPECT_EQ(to_json(s.timings[0]), to_json(timing(0.3)));
  EXPECT_TRUE(fs::exists(root + "/t/gpu/reference/time.public.json"));
}

TEST_F(Results, EveryStateHasItsName) {
  for (int i = 0; i <= static_cast<int>(RunState::running); ++i) {
    const auto state = static_cast<RunState>(i);
    EXPECT_EQ(run_state_from(to_string(state)), state);
  }
  EXPECT_THROW(run_state_from("pass"), Error);
}

TEST_F(Results, UnreadableFilesAreNamed) {
  write_result(root, sample());
  const std::string path = root + "/t/gpu/reference/public.json";
  const std::string whole = read_file(path);
  const auto refused = [&](const std::string& text) {
    write_file(path, text);
    const ResultSet s = load_results(root);
    EXPECT_TRUE(s.runs.empty()) << text;
    EXPECT_EQ(s.unreadable.size(), 1u) << text;
    return s.unreadable.empty() ? "" : s.unreadable[0];
  };
  const auto replaced = [&](const std::string& from, const std::string& to) {
    std::string text = whole;
    EXPECT_NE(text.find(from), std::string::npos) << from;
    return text.replace(text.find(from), from.size(), to);
  };
  EXPECT_NE(refused(whole.substr(0, whole.size() / 2)).find("not valid JSON"), std::string::npos);
  EXPECT_NE(refused("").find("not valid JSON"), std::string::npos);
  EXPECT_NE(refused("[1]").find("expected a JSON object"), std::string::npos);
  EXPECT_NE(refused(replaced("\"schema\":2", "\"schema\":9")).find("schema 9 is not supported"),
            std::string::npos);
  EXPECT_NE(refused(replaced("\"PASS\"", "\"GREAT\"")).find("unknown state 'GREAT'"), std::string::npos);
  EXPECT_NE(refused(replaced("1.25e-07", "\"small\"")).find("\"small\" is not a number"), std::string::npos);
  EXPECT_NE(refused(replaced("1.25e-07", "1e999")).find("not usable JSON"), std::string::npos);
  EXPECT_NE(refused(replaced("\"label\"", "\"lebal\"")).find("key 'label' is missing"), std::string::npos);
  EXPECT_NE(refused(replaced("\"set\":\"public\"", "\"set\":\"hidden\"")).find("names another run"),
            std::string::npos);
}

TEST_F(Results, AFolderThatDoesNotExistIsEmpty) {
  EXPECT_TRUE(load_results(root + "/none").runs.empty());
}

TEST_F(Results, NamesThatAreNoFoldersAreRefused) {
  for (const std::string label : {"", "..", "a/b", "a\nb", "\x1b[2J"}) {
    RunResult r = sample();
    r.label = label;
    EXPECT_THROW(write_result(root, r), Error) << label;
  }
}

TEST_F(Results, LiveResultsWinOverRecords) {
  ResultSet live, recorded;
  live.runs = {sample("reference", "public")};
  live.runs[0].milliseconds = 1;
  live.timings = {timing(1)};
  recorded.runs = {sample("reference", "public"), sample("reference", "hidden")};
  for (RunResult& r : recorded.runs) r.origin = "record x";
  recorded.timings = {timing(2)};
  const ResultSet s = merge_results(live, recorded);
  ASSERT_EQ(s.runs.size(), 2u);
  EXPECT_EQ(s.find_run("t", "gpu", "reference", "public")->milliseconds, 1);
  EXPECT_EQ(s.find_run("t", "gpu", "reference", "hidden")->origin, "record x");
  ASSERT_EQ(s.timings.size(), 1u);
  EXPECT_EQ(s.timings[0].median_ms, 1);
}

TEST_F(Results, ASkippedRunDoesNotHideARecordAndIsMentioned) {
  ResultSet live, recorded;
  live.runs = {sample("reference", "public"), sample("reference", "hidden")};
  for (RunResult& r : live.runs) r.state = RunState::skipped;
  recorded.runs = {sample("reference", "public")};
  const ResultSet s = merge_results(live, recorded);
  ASSERT_EQ(s.runs.size(), 2u);
  EXPECT_EQ(s.find_run("t", "gpu", "reference", "public")->state, RunState::pass);
  EXPECT_EQ(s.find_run("t", "gpu", "reference", "hidden")->state, RunState::skipped);
  EXPECT_EQ(s.notes.size(), 1u);
}

// A role is no matter of what a file says.
TEST_F(Results, RoleAndLaneFollowFromTheLabel) {
  const std::vector<std::array<std::string, 3>> expected = {{"reference", "reference", "gpu"},
                                                            {"reference@tol=1e-4", "reference", "gpu"},
                                                            {"reference.permuted", "reference", "gpu"},
                                                            {"blocks", "reference", "gpu"},
                                                            {"fmad", "fmad", "gpu"},
                                                            {"fast_math", "fast_math", "gpu"},
                                                            {"baseline_f32", "baseline", "cpu"},
                                                            {"mutant.x", "mutant", "gpu"},
                                                            {"serial_mutant.x", "mutant", "cpu"},
                                                            {"mine", "user", "user"},
                                                            {"reference2", "user", "user"}};
  for (const auto& [label, role, lane] : expected) {
    EXPECT_EQ(role_of(label), role) << label;
    EXPECT_EQ(lane_of(label), lane) << label;
  }
  RunResult r = sample("mine");
  r.role = "reference";
  r.lane = "gpu";
  write_result(root, r);
  EXPECT_TRUE(fs::exists(root + "/t/user/mine/public.json"));
  EXPECT_EQ(load_results(root).runs.at(0).role, "user");
}

TEST_F(Results, ARunThatNeverCameToItsEndSaysSo) {
  RunResult r = sample();
  write_result(root, r);
  r.state = RunState::running;
  r.run = "another";
  write_result(root, r);
  const ResultSet s = load_results(root);
  ASSERT_EQ(s.runs.size(), 1u) << "the older PASS must not stand beside it";
  EXPECT_EQ(s.runs[0].state, RunState::running);
  EXPECT_FALSE(s.runs[0].as_it_should_be());
}

TEST_F(Results, ARecordComesBackAndFailsToLoadWhenDamaged) {
  TaskRecord record;
  record.task = "t";
  record.device = "NVIDIA H200";
  record.modules = {{"reference", {"aa", "-O3", "nvcc"}}};
  record.sets = {{"public", {"11", "22", 1e6, {{"l2", 0.001}}}}};
  record.case_sources = "cc";
  record.results = {sample()};
  record.timing = {timing(0.3)};
  write_record(root, "nvidia-h200", record);
  const std::optional<TaskRecord> back = load_record(root, "nvidia-h200", "t");
  ASSERT_TRUE(back.has_value());
  EXPECT_EQ(back->modules.at("reference").sources, "aa");
  EXPECT_EQ(back->sets.at("public").checks.at("l2"), 0.001);
  EXPECT_EQ(back->results.at(0).module.sources, "aa");
  EXPECT_EQ(back->results.at(0).truth_gap.at("u"), 0.1 + 0.2);
  EXPECT_EQ(back->timing.at(0).median_ms, 0.3);
  EXPECT_FALSE(load_record(root, "nvidia-h200", "other").has_value());
  EXPECT_EQ(recorded_gpus(root), std::vector<std::string>{"nvidia-h200"});
  EXPECT_EQ(load_records(root, "nvidia-h200").runs.at(0).origin, "record nvidia-h200");
  // One line for each run, so that a renewal reads as a diff.
  const std::string text = read_file(root + "/nvidia-h200/t.json");
  EXPECT_NE(text.find("\n{\"checks\""), std::string::npos) << text;
  write_file(root + "/nvidia-h200/t.json", "{");
  EXPECT_THROW(load_record(root, "nvidia-h200", "t"), Error);
  EXPECT_EQ(load_records(root, "nvidia-h200").unreadable.size(), 1u);
}

TEST_F(Results, OneUnreadableRecordStopsNoOther) {
  TaskRecord record;
  record.device = "g";
  record.results = {sample()};
  for (const char* task : {"a", "b"}) {
    record.task = task;
    write_record(root, "g", record);
  }
  write_file(root + "/g/a.json", "{\"schema\":2,\"x\":1e999}");
  const ResultSet s = load_records(root, "g");
  EXPECT_EQ(s.runs.size(), 1u);
  EXPECT_EQ(s.unreadable.size(), 1u);
}

// ---- history ----

HistoryEntry entry(double multiple, bool accepted = true, const std::string& reason = "") {
  HistoryEntry e;
  e.date = "2026-11-28";
  e.label = "reference";
  e.set = "public";
  e.sources = "abc";
  e.median_ms = e.min_ms = multiple / 10;
  e.floor_ms = 0.1;
  e.multiple = multiple;
  e.accepted = accepted;
  e.reason = reason;
  return e;
}

TEST_F(Results, AHistoryIsAppendedToAndComesBack) {
  append_history(root, "g", "t", {entry(3)});
  append_history(root, "g", "t", {entry(3.5, true, "safer, \"slower\" bounds")});
  const std::vector<HistoryEntry> all = load_history(root, "g", "t");
  ASSERT_EQ(all.size(), 2u);
  EXPECT_EQ(all[1].reason, "safer, \"slower\" bounds");
  EXPECT_EQ(all[0].multiple, 3);
  EXPECT_TRUE(load_history(root, "g", "u").empty());
  write_file(root + "/g/t.csv", read_file(root + "/g/t.csv") + "x,y\n");
  EXPECT_THROW(load_history(root, "g", "t"), Error);
}

TEST(History, TheBaselineIsTheBestEverAcceptedUntilAReasonStartsAnew) {
  EXPECT_EQ(best_accepted({}, "reference", "public"), nullptr);
  // Ten steps of 4 % each: the first is what the last is held against.
  std::vector<HistoryEntry> creeping;
  for (int i = 0; i < 10; ++i) creeping.push_back(entry(3 * std::pow(1.04, i)));
  EXPECT_EQ(best_accepted(creeping, "reference", "public")->multiple, 3);
  EXPECT_EQ(best_accepted({entry(3), entry(2, false)}, "reference", "public")->multiple, 3);
  EXPECT_EQ(best_accepted({entry(3), entry(4, true, "why")}, "reference", "public")->multiple, 4);
  EXPECT_EQ(best_accepted({entry(3), entry(4, true, "why"), entry(3.5)}, "reference", "public")->multiple,
            3.5);
  EXPECT_EQ(best_accepted({entry(3)}, "reference", "hidden"), nullptr);
}

TEST(GpuSlug, IsAFoldersName) {
  EXPECT_EQ(gpu_slug("NVIDIA H200"), "nvidia-h200");
  EXPECT_EQ(gpu_slug("NVIDIA GeForce RTX 4090 (x)"), "nvidia-geforce-rtx-4090-x");
}

TEST(WriteFile, ReplacesOrLeavesAlone) {
  std::string pattern = (fs::temp_directory_path() / "gpuphys_files_XXXXXX").string();
  const std::string folder = ::mkdtemp(pattern.data());
  write_file(folder + "/new/a", "one");
  { PendingFile abandoned(folder + "/new/a"); }
  EXPECT_EQ(read_file(folder + "/new/a"), "one");
  write_file(folder + "/new/a", "two");
  EXPECT_EQ(read_file(folder + "/new/a"), "two");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder + "/new"), fs::directory_iterator{}), 1);
  EXPECT_THROW(write_file(folder + "/new/a/below", "x"), Error);
  EXPECT_THROW(write_file(folder + "/new", "x"), Error);
  EXPECT_THROW(read_file(folder + "/none"), Error);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace gpuphys
