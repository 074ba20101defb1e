#include "core/run/gpu/allocate_watch.hpp"

#include <cuda_runtime.h>
#include <dlfcn.h>
#include <fmt/format.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <map>
#include <mutex>
#include <string_view>
#include <vector>

#if __has_include(<cupti.h>)
#include <cupti.h>
#define GPUPHYS_HAS_CUPTI 1
#else
#define GPUPHYS_HAS_CUPTI 0
#endif

namespace gpuphys {

#if GPUPHYS_HAS_CUPTI
namespace {

struct Cupti {
  decltype(&cuptiSubscribe) subscribe = nullptr;
  decltype(&cuptiUnsubscribe) unsubscribe = nullptr;
  decltype(&cuptiEnableDomain) enable_domain = nullptr;
  std::string missing;  // why it cannot be used; empty when it can
};

// CUPTI lies beside the runtime library or in the toolkit's extras, rarely on the loader's path.
std::vector<std::string> candidates() {
  const std::string versioned = fmt::format("libcupti.so.{}", CUDART_VERSION / 1000);
  std::vector<std::string> paths{versioned, "libcupti.so"};
  std::vector<std::filesystem::path> folders;
  Dl_info runtime;
  if (dladdr(reinterpret_cast<const void*>(&cudaGetDeviceCount), &runtime) != 0 &&
      runtime.dli_fname != nullptr) {
    std::error_code ec;
    const auto library = std::filesystem::canonical(runtime.dli_fname, ec);
    if (!ec) folders.push_back(library.parent_path());
  }
  for (const char* variable : {"CUDA_HOME", "CUDA_PATH"}) {
    if (const char* home = std::getenv(variable)) folders.push_back(std::filesystem::path(home) / "lib64");
  }
  folders.push_back("/usr/local/cuda/lib64");
  for (const auto& folder : folders) {
    for (const auto& place :
         {folder, folder / "../extras/CUPTI/lib64", folder / "../../../extras/CUPTI/lib64"}) {
      paths.push_back((place / versioned).string());
      paths.push_back((place / "libcupti.so").string());
    }
  }
  return paths;
}

Cupti load() {
  Cupti cupti;
  // compute-sanitizer and the profilers hook the same driver interface; two hooks at a time are not
  // supported.
  const char* preload = std::getenv("LD_PRELOAD");
  if (std::getenv("CUDA_INJECTION64_PATH") != nullptr ||
      (preload != nullptr && (std::strstr(preload, "anitizer") != nullptr))) {
    cupti.missing = "another tool is attached to the driver";
    return cupti;
  }
  void* library = nullptr;
  for (const std::string& path : candidates()) {
    library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (library != nullptr) break;
  }
  if (library == nullptr) {
    cupti.missing = "libcupti was not found";
    return cupti;
  }
  cupti.subscribe = reinterpret_cast<decltype(cupti.subscribe)>(dlsym(library, "cuptiSubscribe"));
  cupti.unsubscribe = reinterpret_cast<decltype(cupti.unsubscribe)>(dlsym(library, "cuptiUnsubscribe"));
  cupti.enable_domain = reinterpret_cast<decltype(cupti.enable_domain)>(dlsym(library, "cuptiEnableDomain"));
  if (cupti.subscribe == nullptr || cupti.unsubscribe == nullptr || cupti.enable_domain == nullptr)
    cupti.missing = "libcupti lacks the callback interface";
  return cupti;
}

void say_unavailable(const std::string& why) {
  static std::once_flag once;
  std::call_once(
      once, [&] { fmt::print(stderr, "gpuphys: allocate() is not watched for device work ({})\n", why); });
}

const Cupti& cupti() {
  static const Cupti loaded = [] {
    Cupti c = load();
    if (!c.missing.empty()) say_unavailable(c.missing);
    return c;
  }();
  return loaded;
}

std::mutex count_mutex;
std::map<std::string, int>& counts() {
  static std::map<std::string, int> by_name;
  return by_name;
}

bool is_device_work(std::string_view function) {
  for (const std::string_view prefix : {"cuLaunch", "cuMemcpy", "cuMemset", "cuGraphLaunch"}) {
    if (function.starts_with(prefix)) return true;
  }
  return false;
}

void CUPTIAPI on_driver_call(void*, CUpti_CallbackDomain domain, CUpti_CallbackId, const void* data) {
  if (domain != CUPTI_CB_DOMAIN_DRIVER_API) return;
  const auto* call = static_cast<const CUpti_CallbackData*>(data);
  if (call->callbackSite != CUPTI_API_ENTER || call->functionName == nullptr) return;
  if (!is_device_work(call->functionName)) return;
  const std::lock_guard lock(count_mutex);
  ++counts()[call->functionName];
}

}  // namespace

bool AllocateWatch::available() {
  if (!cupti().missing.empty()) return false;
  AllocateWatch trial;
  if (!trial.start()) return false;
  trial.stop();
  return true;
}

bool AllocateWatch::start() {
  const Cupti& c = cupti();
  if (!c.missing.empty()) return false;
  {
    const std::lock_guard lock(count_mutex);
    counts().clear();
  }
  CUpti_SubscriberHandle handle = nullptr;
  if (const CUptiResult status = c.subscribe(&handle, on_driver_call, nullptr); status != CUPTI_SUCCESS) {
    say_unavailable(fmt::format("CUPTI refused with error {}", static_cast<int>(status)));
    return false;
  }
  if (const CUptiResult status = c.enable_domain(1, handle, CUPTI_CB_DOMAIN_DRIVER_API);
      status != CUPTI_SUCCESS) {
    c.unsubscribe(handle);
    say_unavailable(fmt::format("CUPTI refused with error {}", static_cast<int>(status)));
    return false;
  }
  subscriber_ = handle;
  return true;
}

std::string AllocateWatch::stop() {
  if (subscriber_ == nullptr) return "";
  cupti().unsubscribe(static_cast<CUpti_SubscriberHandle>(subscriber_));
  subscriber_ = nullptr;
  const std::lock_guard lock(count_mutex);
  std::string text;
  for (const auto& [name, n] : counts()) text += fmt::format("{}{} x {}", text.empty() ? "" : ", ", n, name);
  return text;
}

#else

bool AllocateWatch::available() {
  static const bool said = [] {
    fmt::print(stderr, "gpuphys: allocate() is not watched for device work (built without CUPTI)\n");
    return true;
  }();
  return !said;
}

bool AllocateWatch::start() {
  return available();
}

std::string AllocateWatch::stop() {
  return "";
}

#endif

}  // namespace gpuphys
