#include "core/report/analysis.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace gpuphys {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A non-finite error is the worst there is, for whoever made it.
double as_ratio(double ratio) {
  return std::isfinite(ratio) ? ratio : kInfinity;
}

bool is_correct_variant(const RunResult& r) {
  return (r.role == "reference" || r.role == "fmad" || r.role == "baseline") && !r.is_knob_sweep();
}

// Did the run get as far as being judged? A crash, a timeout or a broken rule says nothing about a tolerance.
bool was_judged(const RunResult& r) {
  return !r.checks.empty() &&
         (r.state == RunState::pass || r.state == RunState::fail || r.state == RunState::killed ||
          r.state == RunState::survived || r.state == RunState::fault);
}

Extreme extreme_of(const RunResult& r, const CheckResult& c) {
  return {as_ratio(c.ratio), std::isfinite(c.error) ? c.error : kInfinity, r.label, r.lane, r.set, c.name};
}

void keep_largest(Extreme& kept, const Extreme& candidate) {
  if (!kept.exists() || candidate.ratio > kept.ratio) kept = candidate;
}

void keep_smallest(Extreme& kept, const Extreme& candidate) {
  if (!kept.exists() || candidate.ratio < kept.ratio) kept = candidate;
}

// The check with a run's largest ratio; the run must have checks.
const CheckResult& best_check(const RunResult& r) {
  return *std::max_element(r.checks.begin(), r.checks.end(), [](const CheckResult& a, const CheckResult& b) {
    return as_ratio(a.ratio) < as_ratio(b.ratio);
  });
}

std::string fault_of(const std::string& label) {
  const std::size_t dot = label.find('.');
  return dot == std::string::npos ? label : label.substr(dot + 1);
}

template <class F>
void for_each_run(const ResultSet& results, const std::string& task, F&& f) {
  for (const RunResult& r : results.runs) {
    if (r.task == task) f(r);
  }
}

int gravity(IssueKind kind) {
  switch (kind) {
    case IssueKind::failure:
      return 10;
    case IssueKind::fault:
      return 9;
    case IssueKind::survivor:
      return 8;
    case IssueKind::crash:
      return 7;
    case IssueKind::error:
      return 6;
    case IssueKind::unreadable:
      return 5;
    case IssueKind::stale:
      return 4;
    case IssueKind::timing:
      return 3;
    case IssueKind::missing:
      return 2;
    case IssueKind::skip:
      return 1;
  }
  return 0;
}

std::string detail_of(const RunResult& r) {
  if (!r.state_detail.empty()) return r.state_detail;
  if (!r.faults.empty()) return fmt::format("{}: {}", r.faults.front().fault, r.faults.front().detail);
  if (const CheckResult* c = r.worst_check()) {
    return fmt::format("{} = {:.3g}, tolerance {:.3g}", c->name, c->error, c->tolerance);
  }
  return "no detail";
}

IssueKind kind_of(const RunResult& r) {
  switch (r.state) {
    case RunState::survived:
      return IssueKind::survivor;
    case RunState::fail:
      return IssueKind::failure;
    case RunState::fault:
      return IssueKind::fault;
    case RunState::crashed:
    case RunState::timeout:
    case RunState::running:  // it never came to its end
      return IssueKind::crash;
    case RunState::skipped:
      return IssueKind::skip;
    default:
      return IssueKind::error;
  }
}

}  // namespace

std::string to_string(IssueKind kind) {
  switch (kind) {
    case IssueKind::survivor:
      return "SURVIVED";
    case IssueKind::failure:
      return "FAIL";
    case IssueKind::fault:
      return "FAULT";
    case IssueKind::crash:
      return "CRASHED";
    case IssueKind::error:
      return "ERROR";
    case IssueKind::skip:
      return "SKIPPED";
    case IssueKind::missing:
      return "MISSING";
    case IssueKind::timing:
      return "TIMING";
    case IssueKind::stale:
      return "STALE";
    case IssueKind::unreadable:
      return "UNREADABLE";
  }
  return "UNKNOWN";
}

std::string to_string(const Issue& issue) {
  std::string text = to_string(issue.kind);
  for (const std::string* part : {&issue.task, &issue.lane, &issue.label, &issue.set}) {
    if (!part->empty()) text += " " + *part;
  }
  return issue.detail.empty() ? text : text + ": " + issue.detail;
}

std::vector<std::string> issue_lines(const std::vector<Issue>& issues) {
  struct Group {
    std::string task, lane;
    std::vector<std::pair<std::string, std::vector<std::string>>>
        labels;  // label, sets ("a timing" for a timing)
  };
  std::vector<std::string> lines;
  std::vector<Group> groups;
  for (const Issue& i : issues) {
    if (i.kind != IssueKind::missing) {
      lines.push_back(to_string(i));
      continue;
    }
    auto group = std::find_if(groups.begin(), groups.end(),
                              [&](const Group& g) { return g.task == i.task && g.lane == i.lane; });
    if (group == groups.end()) group = groups.insert(groups.end(), {i.task, i.lane, {}});
    auto label = std::find_if(group->labels.begin(), group->labels.end(),
                              [&](const auto& l) { return l.first == i.label; });
    if (label == group->labels.end()) label = group->labels.insert(group->labels.end(), {i.label, {}});
    label->second.push_back(i.set.empty() ? i.detail : i.set);
  }
  // One line per task and lane: a list of every label would bury what else is wrong.
  for (const Group& g : groups) {
    std::size_t runs = 0;
    std::vector<std::string> labels;
    for (const auto& [label, sets] : g.labels) {
      runs += sets.size();
      if (labels.size() < 4) labels.push_back(label);
    }
    lines.push_back(fmt::format("{} {} {}: {} results of {}{}", to_string(IssueKind::missing), g.task, g.lane,
                                runs, fmt::join(labels, ", "),
                                g.labels.size() > 4 ? fmt::format(" and {} more", g.labels.size() - 4) : ""));
  }
  return lines;
}

double CheckWindow::separation() const {
  if (!correct.exists() || !mutant.exists()) return std::numeric_limits<double>::quiet_NaN();
  if (correct.ratio == 0) return kInfinity;
  if (std::isinf(correct.ratio)) return 0;
  return mutant.ratio / correct.ratio;
}

std::vector<CheckWindow> windows(const ResultSet& results, const std::string& task) {
  std::vector<CheckWindow> found;
  const auto window_of = [&](const CheckResult& c) -> CheckWindow& {
    for (CheckWindow& w : found) {
      if (w.check == c.name) return w;
    }
    CheckWindow w;
    w.task = task;
    w.check = c.name;
    w.kind = c.kind;
    w.quantity = c.quantity;
    w.norm = c.norm;
    w.tolerance = c.tolerance;
    return found.emplace_back(std::move(w));
  };
  for_each_run(results, task, [&](const RunResult& r) {
    if (is_correct_variant(r) && was_judged(r)) {
      for (const CheckResult& c : r.checks) keep_largest(window_of(c).correct, extreme_of(r, c));
    }
  });
  for_each_run(results, task, [&](const RunResult& r) {
    if (!r.is_mutant() || !was_judged(r)) return;
    for (const CheckResult& c : r.checks) {
      if (!c.pass) ++window_of(c).mutants_killed;
    }
    const CheckResult& best = best_check(r);
    CheckWindow& w = window_of(best);
    ++w.mutants_best;
    keep_smallest(w.mutant, extreme_of(r, best));
  });
  return found;
}

std::vector<MutantRow> kill_matrix(const ResultSet& results, const std::string& task) {
  std::vector<MutantRow> rows;
  const auto row_of = [&](const RunResult& r) -> MutantRow& {
    for (MutantRow& row : rows) {
      if (row.lane == r.lane && row.label == r.label) return row;
    }
    MutantRow row;
    row.task = task;
    row.lane = r.lane;
    row.label = r.label;
    row.mutant_class = r.mutant_class;
    row.expected_check = r.expected_check;
    row.sparse = r.sparse;
    row.killed_everywhere = true;
    row.expected_check_saw_it = true;
    return rows.emplace_back(std::move(row));
  };
  for_each_run(results, task, [&](const RunResult& r) {
    if (!r.is_mutant()) return;
    MutantRow& row = row_of(r);
    row.states[r.set] = to_string(r.state);
    row.killed_everywhere = row.killed_everywhere && r.state == RunState::killed;
    bool seen = false;
    if (was_judged(r)) {
      for (const CheckResult& c : r.checks) {
        const auto [it, fresh] = row.ratios.emplace(c.name, as_ratio(c.ratio));
        if (!fresh) it->second = std::max(it->second, as_ratio(c.ratio));
        seen = seen || (fmt::format(", {},", r.expected_check).find(fmt::format(" {},", c.name)) !=
                            std::string::npos &&
                        !c.pass);
      }
      keep_smallest(row.weakest, extreme_of(r, best_check(r)));
    }
    row.expected_check_saw_it = row.expected_check_saw_it && seen;
  });
  return rows;
}

std::vector<HardCase> hard_cases(const ResultSet& results, const std::string& task) {
  std::vector<HardCase> cases;
  for_each_run(results, task, [&](const RunResult& r) {
    if (r.set_kind != "hard" || r.is_mutant() || r.role == "user" || r.is_knob_sweep()) return;
    HardCase h{task, r.set, r.lane, r.label, to_string(r.state), r.state_detail};
    if (const CheckResult* c = r.worst_check()) h.worst_ratio = as_ratio(c->ratio);
    cases.push_back(std::move(h));
  });
  std::stable_sort(cases.begin(), cases.end(),
                   [](const HardCase& a, const HardCase& b) { return a.set < b.set; });
  return cases;
}

std::vector<Issue> missing_results(const ResultSet& results, const Expectation& expected, Lanes lanes) {
  std::vector<Issue> missing;
  const auto report = [&](const char* lane, const std::string& label, const std::string& set,
                          const std::string& why) {
    missing.push_back({IssueKind::missing, expected.task, lane, label, set, why});
  };
  const auto require = [&](const char* lane, const std::string& label, const std::string& set) {
    if (results.find_run(expected.task, lane, label, set) == nullptr) report(lane, label, set, "no result");
  };
  if (lanes.cpu) {
    for (const std::string& set : expected.cpu_sets) {
      require("cpu", "baseline_f32", set);
      require("cpu", "baseline_f32_fma", set);
    }
    for (const std::string& fault : expected.serial_mutants) {
      for (const std::string& set : expected.cpu_mutant_sets) require("cpu", "serial_mutant." + fault, set);
    }
  }
  if (lanes.gpu) {
    for (const std::string& set : expected.gpu_sets) {
      require("gpu", "reference", set);
      require("gpu", "fmad", set);
    }
    for (const auto& [label, sets] : expected.gpu_ensemble) {
      for (const std::string& set : sets) require("gpu", label, set);
    }
    for (const std::string& fault : expected.mutants) {
      for (const std::string& set : expected.gpu_mutant_sets) require("gpu", "mutant." + fault, set);
    }
    const bool timed =
        std::any_of(results.timings.begin(), results.timings.end(),
                    [&](const TimingResult& t) { return t.task == expected.task && t.label == "reference"; });
    if (!timed) report("gpu", "reference", "", "no timing");
  }
  return missing;
}

std::vector<Issue> issues(const ResultSet& results, const Expectation& expected, Lanes lanes) {
  std::vector<Issue> found;
  std::set<std::string> known;
  for (const std::string& fault : expected.mutants) known.insert("mutant." + fault);
  for (const std::string& fault : expected.serial_mutants) known.insert("serial_mutant." + fault);
  for_each_run(results, expected.task, [&](const RunResult& r) {
    if ((r.lane == "cpu" && !lanes.cpu) || (r.lane == "gpu" && !lanes.gpu)) return;
    if (r.role == "user") return;  // the suite's verdict is not about them
    if (r.is_mutant() && !known.contains(r.label)) {
      found.push_back({IssueKind::stale, r.task, r.lane, r.label, r.set, "there is no such patch any more"});
    }
    const auto add = [&](IssueKind kind, const std::string& detail) {
      found.push_back({kind, r.task, r.lane, r.label, r.set, detail});
    };
    if (!r.as_it_should_be() && !r.is_knob_sweep()) {
      add(kind_of(r), r.state == RunState::timeout ? "timed out: " + detail_of(r) : detail_of(r));
      return;
    }
    // The state is not taken on trust: it must be what the checks say.
    const bool exceeded = std::any_of(r.checks.begin(), r.checks.end(), [](const CheckResult& c) {
      return !(std::isfinite(c.error) && c.error <= c.tolerance);
    });
    if (r.checks.empty()) {
      add(IssueKind::error, fmt::format("{} without a single check", to_string(r.state)));
      return;
    }
    if (r.is_mutant() && !exceeded) {
      add(IssueKind::error, "KILLED although no check exceeds its tolerance");
    } else if (!r.is_mutant() && !r.is_knob_sweep() && r.role != "fast_math" && exceeded) {
      add(IssueKind::error, "PASS although a check exceeds its tolerance");
    }
    const auto declared = expected.tolerances.find(r.set);
    if (declared == expected.tolerances.end()) {
      add(IssueKind::stale, "there is no such input set any more");
      return;
    }
    for (const auto& [name, tolerance] : declared->second) {
      const auto check = std::find_if(r.checks.begin(), r.checks.end(),
                                      [&](const CheckResult& c) { return c.name == name; });
      if (check == r.checks.end()) {
        add(IssueKind::stale, fmt::format("check '{}' was not judged", name));
      } else if (check->tolerance != tolerance) {
        add(IssueKind::stale, fmt::format("check '{}' was judged with tolerance {:g}, the case now says {:g}",
                                          name, check->tolerance, tolerance));
      }
    }
  });
  if (lanes.gpu) {
    for (const TimingResult& t : results.timings) {
      if (t.task != expected.task || t.gate.state == "OK" || !t.scalar_overrides.empty()) continue;
      if (t.label != "reference" && t.label != "fmad") continue;  // a user's own
      // A record is a baseline: having had none before, or replacing a faster one on purpose, is no fault of
      // it.
      if ((t.gate.state == "UNBASELINED" || t.gate.state == "ACCEPTED") && t.origin != "live") continue;
      std::string detail = t.gate.state;
      if (t.gate.state != "UNBASELINED")
        detail += fmt::format(": {:.3g} x floor, limit {:.3g}", t.multiple, t.gate.limit);
      found.push_back({IssueKind::timing, t.task, "gpu", t.label, t.set, detail});
    }
  }
  const std::vector<Issue> missing = missing_results(results, expected, lanes);
  found.insert(found.end(), missing.begin(), missing.end());
  return found;
}

Verdict verdict(const ResultSet& results, const Expectation& expected, Lanes lanes) {
  Verdict v;
  v.task = expected.task;
  v.target_multiple = expected.target_multiple;
  double serial_gap = std::numeric_limits<double>::quiet_NaN(), reference_gap = serial_gap;
  std::string serial_gap_of;
  std::map<std::string, bool> killed;  // fault -> in every run of every lane
  for_each_run(results, expected.task, [&](const RunResult& r) {
    if ((r.lane == "cpu" && !lanes.cpu) || (r.lane == "gpu" && !lanes.gpu)) return;
    const bool judged = was_judged(r);
    if (r.is_mutant()) {
      const auto [it, fresh] = killed.emplace(fault_of(r.label), true);
      it->second = it->second && r.state == RunState::killed;
      if (judged) keep_smallest(v.weakest_mutant, extreme_of(r, best_check(r)));
      return;
    }
    if (!is_correct_variant(r)) return;
    if (r.set_kind == "hard") {
      ++v.hard_total;
      if (r.state == RunState::pass) ++v.hard_passed;
    }
    if (!judged) return;
    const Extreme worst = extreme_of(r, best_check(r));
    const bool serial_fp32 = r.label == "baseline_f32" || r.label == "baseline_f32_fma";
    if (r.label == "reference") keep_largest(v.reference, worst);
    if (r.label == "fmad") keep_largest(v.fmad, worst);
    if (serial_fp32) keep_largest(v.serial_fp32, worst);
    const double gap = r.worst_truth_gap();
    if (std::isnan(gap) || r.set_kind == "hard") return;  // hard cases answer to their invariants
    if (r.label == "reference" && !(reference_gap >= gap)) reference_gap = gap;
    if (serial_fp32 && !(serial_gap >= gap)) {
      serial_gap = gap;
      serial_gap_of = r.label;
    }
  });
  v.truth_gap = std::isnan(reference_gap) ? serial_gap : reference_gap;
  v.truth_gap_of = !std::isnan(reference_gap) ? "reference" : serial_gap_of;

  std::set<std::string> faults(expected.mutants.begin(), expected.mutants.end());
  faults.insert(expected.serial_mutants.begin(), expected.serial_mutants.end());
  v.mutants_total = static_cast<int>(faults.size());
  for (const std::string& fault : faults) {
    const auto it = killed.find(fault);
    if (it != killed.end() && it->second) ++v.mutants_killed;
  }
  ResultSet selected;
  for_each_run(results, expected.task, [&](const RunResult& r) {
    if ((r.lane == "cpu" && lanes.cpu) || (r.lane == "gpu" && lanes.gpu)) selected.runs.push_back(r);
  });
  for (const CheckWindow& w : windows(selected, expected.task)) {
    const double s = w.separation();
    if (!std::isnan(s) && !(v.separation <= s)) v.separation = s;
  }
  if (lanes.gpu) {
    for (const TimingResult& t : results.timings) {
      // The public set is the one that targets are stated for; another only if that was not timed.
      if (t.task != expected.task || t.label != "reference") continue;
      if (std::isnan(v.milliseconds) || t.set == "public") {
        v.milliseconds = t.median_ms;
        v.multiple = t.multiple;
      }
    }
  }
  v.issues = issues(results, expected, lanes);
  v.state = "OK";
  int worst = 0;
  for (const Issue& issue : v.issues) {
    if (gravity(issue.kind) > worst) {
      worst = gravity(issue.kind);
      v.state = issue.kind == IssueKind::timing ? issue.detail.substr(0, issue.detail.find(':'))
                                                : to_string(issue.kind);
    }
  }
  return v;
}

WhatIf what_if(const ResultSet& results, const std::string& task, const std::string& check, double proposed) {
  WhatIf w;
  w.task = task;
  w.check = check;
  w.proposed = proposed;
  bool known = false;
  std::set<std::string> names;
  const auto exceeds = [](double error, double tolerance) {
    return !(std::isfinite(error) && error <= tolerance);
  };
  for_each_run(results, task, [&](const RunResult& r) {
    for (const CheckResult& c : r.checks) {
      names.insert(c.name);
      if (c.name == check) {
        w.current = c.tolerance;
        known = true;
      }
    }
  });
  if (!known) {
    throw Error(
        ExitCode::unknown_name,
        fmt::format("no result of task '{}' has a check '{}'; there are: {}", task, check,
                    names.empty() ? "none (run the task first)" : fmt::format("{}", fmt::join(names, ", "))));
  }
  for_each_run(results, task, [&](const RunResult& r) {
    const bool correct = is_correct_variant(r);
    if (!correct && !r.is_mutant()) return;
    const auto it =
        std::find_if(r.checks.begin(), r.checks.end(), [&](const CheckResult& c) { return c.name == check; });
    if (!was_judged(r)) {
      w.unjudged.push_back({r.label, r.lane, r.set, std::numeric_limits<double>::quiet_NaN(), false});
      return;
    }
    const bool has = it != r.checks.end();
    const double error = has ? it->error : std::numeric_limits<double>::quiet_NaN();
    if (correct) {
      if (!has) return;  // a hard case with checks of its own
      ++w.correct_total;
      Extreme e = extreme_of(r, *it);
      if (!w.largest_correct.exists() || e.error > w.largest_correct.error) w.largest_correct = e;
      if (exceeds(error, proposed))
        w.failing.push_back({r.label, r.lane, r.set, error, !exceeds(error, w.current)});
      return;
    }
    ++w.mutants_total;
    const bool others = std::any_of(r.checks.begin(), r.checks.end(), [&](const CheckResult& c) {
      return c.name != check && exceeds(c.error, c.tolerance);
    });
    if (others) return;
    if (!has || !exceeds(error, proposed)) {
      w.escaping.push_back({r.label, r.lane, r.set, error, has && exceeds(error, it->tolerance)});
    }
    if (has) {
      const Extreme e = extreme_of(r, *it);
      if (!w.smallest_dependent.exists() || e.error < w.smallest_dependent.error) w.smallest_dependent = e;
    }
  });
  const Extreme &low = w.largest_correct, &high = w.smallest_dependent;
  const auto who = [](const Extreme& e) {
    return fmt::format("{:.3g} ({} on {}, {})", e.error, e.label, e.set, e.lane);
  };
  if (!low.exists()) {
    w.reason = "no correct variant was judged by this check, so nothing bounds the tolerance from below";
  } else if (!high.exists()) {
    w.reason = fmt::format(
        "no mutant depends on this check (others see every one), so nothing bounds it from above; the "
        "largest correct error is {}",
        who(low));
  } else if (low.error >= high.error) {
    w.reason = fmt::format(
        "there is no window: the largest correct error {} is not below the smallest error of a mutant "
        "that only this check sees, {}",
        who(low), who(high));
  } else if (low.error == 0 || std::isinf(high.error)) {
    w.reason = fmt::format("any value between {} and {} does; a geometric mean of them does not exist",
                           who(low), who(high));
  } else {
    w.suggested = std::sqrt(low.error) * std::sqrt(high.error);
    w.reason = fmt::format(
        "geometric mean of the largest correct error {} and the smallest error of a mutant that only "
        "this check sees, {}",
        who(low), who(high));
  }
  return w;
}

}  // namespace gpuphys
