// What the results mean, on results made up for the purpose: windows, kill matrix, proposed tolerances, and
// that no survivor, crash, skip or missing result disappears in a total.
#include "core/report/analysis.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace gpuphys {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInf = std::numeric_limits<double>::infinity();

RunResult run(const std::string& lane, const std::string& label, const std::string& set,
              const std::vector<std::pair<std::string, double>>& errors) {
  RunResult r;
  r.task = "t";
  r.lane = lane;
  r.label = label;
  r.set = set;
  r.set_kind = set.starts_with("hard") ? "hard" : set.starts_with("hidden") ? "hidden" : "public";
  r.size = set.ends_with("smoke") ? "smoke" : "paper";
  r.role = label.find("mutant.") != std::string::npos ? "mutant"
           : label.starts_with("baseline")            ? "baseline"
           : label == "reference" || label == "fmad"  ? label
                                                      : "user";
  bool pass = true;
  for (const auto& [name, error] : errors) {
    CheckResult c;
    c.name = name;
    c.kind = "paper";
    c.error = error;
    c.tolerance = name == "l2" ? 1e-6 : 1e-4;
    c.ratio = ratio_of(error, c.tolerance);
    c.pass = std::isfinite(error) && error <= c.tolerance;
    pass = pass && c.pass;
    r.checks.push_back(c);
  }
  r.state = r.role == "mutant" ? (pass ? RunState::survived : RunState::killed)
                               : (pass ? RunState::pass : RunState::fail);
  if (r.role == "mutant") r.expected_check = "l2";
  return r;
}

Expectation expectation() {
  Expectation e;
  e.task = "t";
  e.cpu_sets = {"public_smoke", "hidden_smoke"};
  e.gpu_sets = {"public", "hidden", "hard_sliver"};
  e.cpu_mutant_sets = {"public_smoke"};
  e.gpu_mutant_sets = {"public"};
  e.mutants = {"sign", "edge"};
  e.serial_mutants = {"sign"};
  for (const std::string set : {"public", "hidden", "hard_sliver", "public_smoke", "hidden_smoke"}) {
    e.tolerances[set] = {{"l2", 1e-6}, {"local", 1e-4}};
  }
  return e;
}

TimingResult timing(const std::string& set, double ms, const std::string& gate = "OK") {
  TimingResult t;
  t.task = "t";
  t.label = "reference";
  t.set = set;
  t.median_ms = ms;
  t.floor_ms = 0.1;
  t.multiple = ms / 0.1;
  t.gate.state = gate;
  return t;
}

// Complete and in order.
ResultSet good() {
  ResultSet s;
  for (const std::string label : {"baseline_f32", "baseline_f32_fma"}) {
    for (const std::string set : {"public_smoke", "hidden_smoke"}) {
      s.runs.push_back(run("cpu", label, set, {{"l2", 1e-7}, {"local", 1e-6}}));
    }
  }
  for (const std::string label : {"reference", "fmad"}) {
    for (const std::string set : {"public", "hidden", "hard_sliver"}) {
      s.runs.push_back(run("gpu", label, set, {{"l2", 2e-8}, {"local", 5e-6}}));
      s.runs.back().truth_gap = {{"u", 3e-8}};
    }
  }
  s.runs.push_back(run("cpu", "serial_mutant.sign", "public_smoke", {{"l2", 1e-2}, {"local", 1e-1}}));
  s.runs.push_back(run("gpu", "mutant.sign", "public", {{"l2", 1e-2}, {"local", 1e-1}}));
  s.runs.push_back(run("gpu", "mutant.edge", "public", {{"l2", 5e-7}, {"local", 1e-2}}));
  s.timings.push_back(timing("public", 0.3));
  return s;
}

RunResult& find(ResultSet& s, const std::string& label, const std::string& set) {
  return *std::find_if(s.runs.begin(), s.runs.end(),
                       [&](const RunResult& r) { return r.label == label && r.set == set; });
}

void remove(ResultSet& s, const std::string& label, const std::string& set) {
  std::erase_if(s.runs, [&](const RunResult& r) { return r.label == label && r.set == set; });
}

// The only issue that a change to good results must produce.
Issue only_issue(const ResultSet& s) {
  const std::vector<Issue> found = issues(s, expectation(), {});
  EXPECT_EQ(found.size(), 1u);
  for (const Issue& i : found) SCOPED_TRACE(to_string(i));
  const Verdict v = verdict(s, expectation(), {});
  EXPECT_NE(v.state, "OK") << "the verdict hides it";
  EXPECT_EQ(v.issues.size(), found.size());
  return found.empty() ? Issue{} : found.front();
}

// ---- ratios ----

TEST(Ratio, OfZeroToleranceAndOfNonFiniteErrors) {
  EXPECT_DOUBLE_EQ(ratio_of(5e-7, 1e-6), 0.5);
  EXPECT_EQ(ratio_of(0, 0), 0);
  EXPECT_EQ(ratio_of(1e-30, 0), kInf);
  EXPECT_TRUE(std::isnan(ratio_of(kNan, 1)));
  EXPECT_EQ(ratio_of(kInf, 1), kInf);
}

// ---- windows ----

TEST(Windows, LieBetweenTheWorstCorrectVariantAndTheWeakestMutant) {
  const std::vector<CheckWindow> w = windows(good(), "t");
  ASSERT_EQ(w.size(), 2u);
  EXPECT_EQ(w[0].check, "l2");
  EXPECT_DOUBLE_EQ(w[0].correct.ratio, 0.1);
  EXPECT_EQ(w[0].correct.label, "baseline_f32");
  EXPECT_DOUBLE_EQ(w[0].mutant.ratio, 1e4);  // the edge mutant's best check is the other one
  EXPECT_EQ(w[0].mutants_best, 2);
  EXPECT_EQ(w[0].mutants_killed, 2);
  EXPECT_DOUBLE_EQ(w[0].separation(), 1e5);
  EXPECT_EQ(w[1].check, "local");
  EXPECT_DOUBLE_EQ(w[1].correct.ratio, 0.05);
  EXPECT_EQ(w[1].mutant.label, "mutant.edge");
  EXPECT_DOUBLE_EQ(w[1].mutant.ratio, 100);
  EXPECT_EQ(w[1].mutants_killed, 3);
}

TEST(Windows, ANonFiniteErrorIsTheWorstForEverybody) {
  ResultSet s = good();
  CheckResult& c = find(s, "fmad", "hidden").checks[0];
  c.error = c.ratio = kNan;
  const CheckWindow w = windows(s, "t")[0];
  EXPECT_EQ(w.correct.label, "fmad");
  EXPECT_EQ(w.correct.ratio, kInf);
  EXPECT_EQ(w.separation(), 0);
}

TEST(Windows, ExactResultsSeparateInfinitely) {
  ResultSet s = good();
  for (RunResult& r : s.runs) {
    if (!r.is_mutant()) r.checks[0].error = r.checks[0].ratio = 0;
  }
  EXPECT_EQ(windows(s, "t")[0].separation(), kInf);
}

TEST(Windows, WithoutMutantsThereIsNoSeparation) {
  ResultSet s = good();
  std::erase_if(s.runs, [](const RunResult& r) { return r.is_mutant(); });
  EXPECT_FALSE(windows(s, "t")[0].mutant.exists());
  EXPECT_TRUE(std::isnan(windows(s, "t")[0].separation()));
}

TEST(Windows, KnobSweepsAndUsersModulesAreNotCorrectVariants) {
  ResultSet s = good();
  RunResult sweep = run("gpu", "reference", "public", {{"l2", 1e-3}, {"local", 1e-3}});
  sweep.label = "reference@tol=1e-2";
  sweep.scalar_overrides = {{"tol", 1e-2}};
  s.runs.push_back(sweep);
  s.runs.push_back(run("gpu", "mine", "public", {{"l2", 1e-3}, {"local", 1e-3}}));
  EXPECT_DOUBLE_EQ(windows(s, "t")[0].correct.ratio, 0.1);
  EXPECT_TRUE(issues(s, expectation(), {}).empty());
}

TEST(Windows, ACrashSaysNothingAboutATolerance) {
  ResultSet s = good();
  RunResult& r = find(s, "mutant.edge", "public");
  r.state = RunState::crashed;
  EXPECT_FALSE(windows(s, "t")[1].mutant.exists());
  EXPECT_EQ(windows(s, "t")[1].mutants_killed, 2);
}

// ---- kill matrix ----

TEST(KillMatrix, HasARowForEachMutantAndLane) {
  const std::vector<MutantRow> rows = kill_matrix(good(), "t");
  ASSERT_EQ(rows.size(), 3u);
  const MutantRow& edge = rows[2];
  EXPECT_EQ(edge.label, "mutant.edge");
  EXPECT_DOUBLE_EQ(edge.ratios.at("l2"), 0.5);
  EXPECT_DOUBLE_EQ(edge.ratios.at("local"), 100);
  EXPECT_TRUE(edge.killed_everywhere);
  EXPECT_FALSE(edge.expected_check_saw_it);
  EXPECT_EQ(edge.weakest.check, "local");
  EXPECT_TRUE(rows[1].expected_check_saw_it);
}

TEST(KillMatrix, OneSurvivalSpoilsTheRow) {
  ResultSet s = good();
  s.runs.push_back(run("gpu", "mutant.sign", "hidden", {{"l2", 1e-8}, {"local", 1e-6}}));
  const MutantRow row = kill_matrix(s, "t")[1];
  EXPECT_FALSE(row.killed_everywhere);
  EXPECT_FALSE(row.expected_check_saw_it);
  EXPECT_EQ(row.states.at("hidden"), "SURVIVED");
  EXPECT_EQ(row.weakest.set, "hidden");
  EXPECT_DOUBLE_EQ(row.ratios.at("l2"),
                   1e4);  // the largest, so that the cell says whether the check can see it at all
}

// ---- nothing is hidden ----

TEST(Issues, CompleteAndGoodResultsHaveNone) {
  for (const Issue& i : issues(good(), expectation(), {})) ADD_FAILURE() << to_string(i);
  const Verdict v = verdict(good(), expectation(), {});
  EXPECT_EQ(v.state, "OK");
  EXPECT_EQ(v.mutants_killed, 2);
  EXPECT_EQ(v.mutants_total, 2);
  EXPECT_EQ(v.hard_passed, 2);
  EXPECT_EQ(v.hard_total, 2);
  EXPECT_EQ(v.weakest_mutant.label, "mutant.edge");
  EXPECT_DOUBLE_EQ(v.weakest_mutant.ratio, 100);
  EXPECT_DOUBLE_EQ(v.separation, 2000);
  EXPECT_DOUBLE_EQ(v.truth_gap, 3e-8);
  EXPECT_EQ(v.truth_gap_of, "reference");
  EXPECT_DOUBLE_EQ(v.milliseconds, 0.3);
  EXPECT_DOUBLE_EQ(v.multiple, 3);
}

TEST(Issues, ASurvivorIsNamed) {
  ResultSet s = good();
  find(s, "mutant.edge", "public") = run("gpu", "mutant.edge", "public", {{"l2", 1e-8}, {"local", 1e-6}});
  const Issue i = only_issue(s);
  EXPECT_EQ(i.kind, IssueKind::survivor);
  EXPECT_EQ(to_string(i).rfind("SURVIVED t gpu mutant.edge public", 0), 0u);
  const Verdict v = verdict(s, expectation(), {});
  EXPECT_EQ(v.state, "SURVIVED");
  EXPECT_EQ(v.mutants_killed, 1);
  EXPECT_EQ(v.mutants_total, 2);
}

TEST(Issues, EveryOtherEndOfARunIsNamed) {
  const std::pair<RunState, std::string> ends[] = {
      {RunState::fail, "FAIL"},       {RunState::fault, "FAULT"}, {RunState::crashed, "CRASHED"},
      {RunState::timeout, "CRASHED"}, {RunState::error, "ERROR"}, {RunState::skipped, "SKIPPED"}};
  for (const std::string label : {"reference", "mutant.sign"}) {
    for (const auto& [state, name] : ends) {
      ResultSet s = good();
      find(s, label, "public").state = state;
      const Issue i = only_issue(s);
      EXPECT_EQ(to_string(i.kind), name) << label;
      EXPECT_EQ(i.label, label);
      EXPECT_EQ(verdict(s, expectation(), {}).state, name);
    }
  }
}

TEST(Issues, AMutantThatPassesAsIfItWereAReferenceIsNotKilled) {
  ResultSet s = good();
  find(s, "mutant.sign", "public").state = RunState::pass;
  EXPECT_EQ(only_issue(s).kind, IssueKind::error);
}

TEST(Issues, EveryMissingResultIsNamed) {
  const ResultSet complete = good();
  for (const RunResult& gone : complete.runs) {
    ResultSet s = complete;
    remove(s, gone.label, gone.set);
    const Issue i = only_issue(s);
    EXPECT_EQ(i.kind, IssueKind::missing);
    EXPECT_EQ(i.label, gone.label);
    EXPECT_EQ(i.set, gone.set);
    EXPECT_EQ(i.lane, gone.lane);
  }
  ResultSet s = complete;
  s.timings.clear();
  EXPECT_EQ(only_issue(s).detail, "no timing");
}

TEST(Issues, WithNothingAtAllEverythingIsMissing) {
  const Verdict v = verdict({}, expectation(), {});
  EXPECT_EQ(v.state, "MISSING");
  EXPECT_EQ(v.issues.size(), 4u + 1u + 6u + 2u + 1u);
  EXPECT_EQ(v.mutants_killed, 0);
  EXPECT_EQ(v.mutants_total, 2);
}

TEST(Issues, MissingResultsShareOneLineForEachTaskAndLane) {
  ResultSet s = good();
  remove(s, "fmad", "public");
  remove(s, "fmad", "hard_sliver");
  find(s, "mutant.sign", "public").state = RunState::survived;
  s.timings.clear();
  const std::vector<std::string> lines = issue_lines(issues(s, expectation(), {}));
  ASSERT_EQ(lines.size(), 2u);
  EXPECT_EQ(lines[0].rfind("SURVIVED t gpu mutant.sign public", 0), 0u);
  EXPECT_EQ(lines[1], "MISSING t gpu: 3 results of fmad, reference");
}

TEST(Issues, ALaneThatIsNotDemandedIsNotMissed) {
  ResultSet s = good();
  std::erase_if(s.runs, [](const RunResult& r) { return r.lane == "gpu"; });
  s.timings.clear();
  EXPECT_TRUE(issues(s, expectation(), {.cpu = true, .gpu = false}).empty());
  EXPECT_FALSE(issues(s, expectation(), {}).empty());
}

TEST(Issues, AStateThatItsChecksContradictIsNotBelieved) {
  ResultSet s = good();
  find(s, "reference", "public").checks[0].error = 1;
  EXPECT_EQ(only_issue(s).detail, "PASS although a check exceeds its tolerance");
  s = good();
  find(s, "reference", "public").checks[0].error = kNan;
  EXPECT_EQ(only_issue(s).detail, "PASS although a check exceeds its tolerance");
  s = good();
  for (CheckResult& c : find(s, "mutant.sign", "public").checks) c.error = 0;
  EXPECT_EQ(only_issue(s).detail, "KILLED although no check exceeds its tolerance");
  s = good();
  find(s, "reference", "public").checks.clear();
  EXPECT_EQ(only_issue(s).detail, "PASS without a single check");
}

TEST(Issues, ResultsOfAnotherCaseFileAreStale) {
  ResultSet s = good();
  find(s, "reference", "public").checks[0].tolerance = 1e-5;
  EXPECT_EQ(only_issue(s).kind, IssueKind::stale);
  s = good();
  find(s, "reference", "public").checks.pop_back();
  EXPECT_EQ(only_issue(s).detail, "check 'local' was not judged");
  s = good();
  s.runs.push_back(run("gpu", "mutant.gone", "public", {{"l2", 1}, {"local", 1}}));
  EXPECT_EQ(only_issue(s).kind, IssueKind::stale);
  s = good();
  s.runs.push_back(run("gpu", "reference", "hard_gone", {{"l2", 1e-8}, {"local", 1e-8}}));
  EXPECT_EQ(only_issue(s).detail, "there is no such input set any more");
}

TEST(Issues, TimingGatesCount) {
  for (const std::string gate : {"SLOW", "BELOW_FLOOR", "UNBASELINED"}) {
    ResultSet s = good();
    s.timings[0].gate.state = gate;
    EXPECT_EQ(only_issue(s).kind, IssueKind::timing);
    EXPECT_EQ(verdict(s, expectation(), {}).state, gate);
  }
  ResultSet own = good();
  own.timings.push_back(timing("public", 9, "UNBASELINED"));
  own.timings.back().label = "mine";
  EXPECT_TRUE(issues(own, expectation(), {}).empty());
  ResultSet s = good();  // a record is the baseline
  s.timings[0].gate.state = "UNBASELINED";
  s.timings[0].origin = "record nvidia-h200";
  EXPECT_TRUE(issues(s, expectation(), {}).empty());
}

TEST(Issues, TheGravestGivesTheVerdict) {
  ResultSet s = good();
  s.timings[0].gate.state = "SLOW";
  find(s, "mutant.edge", "public").state = RunState::survived;
  remove(s, "fmad", "hidden");
  EXPECT_EQ(verdict(s, expectation(), {}).state, "SURVIVED");
  EXPECT_EQ(verdict(s, expectation(), {}).issues.size(), 3u);
  find(s, "reference", "hard_sliver").state = RunState::fail;
  EXPECT_EQ(verdict(s, expectation(), {}).state, "FAIL");
  EXPECT_EQ(verdict(s, expectation(), {}).hard_passed, 1);
}

TEST(HardCases, AreListedByCaseWithTheirStates) {
  ResultSet s = good();
  find(s, "fmad", "hard_sliver").state = RunState::fail;
  const std::vector<HardCase> cases = hard_cases(s, "t");
  ASSERT_EQ(cases.size(), 2u);
  EXPECT_EQ(cases[0].state + cases[1].state, "PASSFAIL");
}

// ---- what if ----

TEST(WhatIf, ATighterToleranceFailsCorrectVariantsByName) {
  const WhatIf w = what_if(good(), "t", "l2", 5e-8);
  EXPECT_DOUBLE_EQ(w.current, 1e-6);
  EXPECT_EQ(w.correct_total, 10);
  ASSERT_EQ(w.failing.size(), 4u);
  for (const WhatIf::Run& r : w.failing) {
    EXPECT_TRUE(r.label.starts_with("baseline_f32"));
    EXPECT_TRUE(r.changes);
  }
  EXPECT_TRUE(w.escaping.empty());
}

TEST(WhatIf, ALooserToleranceOnlyLetsEscapeWhatNoOtherCheckSees) {
  const WhatIf l2 = what_if(good(), "t", "l2", 1);
  EXPECT_TRUE(l2.escaping.empty()) << "the local check sees every mutant";
  EXPECT_TRUE(std::isnan(l2.suggested));
  EXPECT_NE(l2.reason.find("no mutant depends on this check"), std::string::npos);

  const WhatIf local = what_if(good(), "t", "local", 0.05);
  ASSERT_EQ(local.escaping.size(), 1u);
  EXPECT_EQ(local.escaping[0].label, "mutant.edge");
  EXPECT_TRUE(local.escaping[0].changes);
  EXPECT_EQ(local.mutants_total, 3);
}

TEST(WhatIf, SuggestsTheGeometricMean) {
  const WhatIf w = what_if(good(), "t", "local", 1e-4);
  EXPECT_EQ(w.largest_correct.label, "reference");
  EXPECT_EQ(w.smallest_dependent.label, "mutant.edge");
  EXPECT_NEAR(w.suggested, std::sqrt(5e-6 * 1e-2), 1e-12);
}

TEST(WhatIf, SaysWhyThereIsNoWindow) {
  ResultSet s = good();
  find(s, "reference", "public").checks[1].error = 0.5;
  const WhatIf w = what_if(s, "t", "local", 1e-4);
  EXPECT_TRUE(std::isnan(w.suggested));
  EXPECT_NE(w.reason.find("there is no window"), std::string::npos);
}

TEST(WhatIf, ASurvivorOfTodayIsListedButNotAsAChange) {
  ResultSet s = good();
  find(s, "mutant.sign", "public") = run("gpu", "mutant.sign", "public", {{"l2", 1e-8}, {"local", 1e-6}});
  const WhatIf w = what_if(s, "t", "l2", 2e-6);
  ASSERT_EQ(w.escaping.size(), 1u);
  EXPECT_FALSE(w.escaping[0].changes);
}

TEST(WhatIf, NonFiniteErrorsFailAnyTolerance) {
  ResultSet s = good();
  find(s, "reference", "public").checks[0].error = kNan;
  EXPECT_EQ(what_if(s, "t", "l2", 1e300).failing.size(), 1u);
}

TEST(WhatIf, RunsThatWereNotJudgedAreListed) {
  ResultSet s = good();
  find(s, "mutant.sign", "public").state = RunState::crashed;
  const WhatIf w = what_if(s, "t", "l2", 1e-6);
  ASSERT_EQ(w.unjudged.size(), 1u);
  EXPECT_EQ(w.unjudged[0].label, "mutant.sign");
  EXPECT_EQ(w.mutants_total, 2);
}

TEST(WhatIf, AnUnknownCheckIsRefusedWithThoseThatExist) {
  try {
    what_if(good(), "t", "l3", 1);
    FAIL() << "accepted";
  } catch (const Error& e) {
    EXPECT_EQ(e.code(), ExitCode::unknown_name);
    EXPECT_NE(std::string(e.what()).find("l2, local"), std::string::npos);
  }
}

}  // namespace
}  // namespace gpuphys
