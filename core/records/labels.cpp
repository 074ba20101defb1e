#include "core/records/labels.hpp"

namespace gpuphys {

std::string module_of(const std::string& label) {
  const std::string base = label.substr(0, label.find('@'));
  if (base.starts_with("mutant.") || base.starts_with("serial_mutant.")) return base;
  return role_of(base) == "user" ? base : base.substr(0, base.find('.'));
}

std::string role_of(const std::string& label) {
  const std::string base = label.substr(0, label.find('@'));
  if (base.starts_with("mutant.") || base.starts_with("serial_mutant.")) return "mutant";
  if (base == "reference" || base == kOtherBlocks || base == kRunAgain || base == kPermuted)
    return "reference";
  if (base == "fmad" || base == kFastMath) return base;
  for (const char* build : {"baseline_f64", "baseline_f32", "baseline_f32_fma", "baseline_f32.permuted"}) {
    if (base == build) return "baseline";
  }
  return "user";
}

std::string lane_of(const std::string& label) {
  const std::string role = role_of(label);
  if (role == "user") return "user";
  if (role == "baseline" || label.starts_with("serial_mutant.")) return "cpu";
  return "gpu";
}

}  // namespace gpuphys
