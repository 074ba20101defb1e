#include "core/driver/context.hpp"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <filesystem>

#include "core/base/files.hpp"
#include "core/base/sha256.hpp"
#include "core/base/text.hpp"
#include "core/judge/judge.hpp"
#include "core/records/results_json.hpp"

namespace gpuphys {

std::string Context::module_path(const std::string& task, const std::string& name) const {
  if (is_module_path(name)) {
    if (!std::filesystem::exists(name))
      throw Error(ExitCode::unknown_name, fmt::format("module '{}' does not exist", name));
    return name;
  }
  const std::filesystem::path folder = std::filesystem::path(modules_root) / task;
  const std::filesystem::path path = folder / (name + ".so");
  if (std::filesystem::exists(path)) return path.string();
  std::string built;
  if (std::filesystem::is_directory(folder)) {
    for (const auto& entry : std::filesystem::directory_iterator(folder))
      built += " " + entry.path().stem().string();
  }
  throw Error(ExitCode::unknown_name, fmt::format("no module '{}' of task '{}' in {}; built are:{}", name,
                                                  task, folder.string(), built.empty() ? " none" : built));
}

Workplace Context::workplace(double baseline_timeout_s) const {
  return {store_root, runner_options(baseline_timeout_s), modules_root};
}

RunnerOptions Context::runner_options(double timeout_s) const {
  return {.program = runner, .timeout_s = timeout_s, .under_tool = false, .build_root = build_root};
}

ModuleStamp Context::stamp_of(const std::string& module_path) const {
  const std::string path = std::filesystem::path(module_path).replace_extension(".stamp.json").string();
  if (!std::filesystem::exists(path)) return {};
  const auto j = parse_json_file(path);
  // A module that was replaced after the build is not what the stamp speaks of.
  if (json_text(j, "sha256", path) != sha256_hex(read_file(module_path))) return {};
  return stamp_from(j, path);
}

std::map<std::string, double> parse_scalars(const std::vector<std::string>& assignments) {
  std::map<std::string, double> values;
  for (const std::string& assignment : assignments) {
    const std::size_t equals = assignment.find('=');
    const std::string text = equals == std::string::npos ? "" : assignment.substr(equals + 1);
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (text.empty() || error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
      throw Error(ExitCode::usage,
                  fmt::format("--scalar wants NAME=NUMBER, not '{}'", printable(assignment)));
    }
    values[assignment.substr(0, equals)] = value;
  }
  return values;
}

}  // namespace gpuphys
