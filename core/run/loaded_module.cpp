#include "core/run/loaded_module.hpp"

#include <dlfcn.h>
#include <fmt/format.h>

#include <filesystem>

#include "core/base/error.hpp"
#include "core/base/text.hpp"

namespace gpuphys {

LoadedModule::LoadedModule(const std::string& path) : path_(path) {
  if (!std::filesystem::exists(path))
    throw Error(ExitCode::unknown_name, fmt::format("module '{}' does not exist", printable(path)));
  void* handle = dlopen(std::filesystem::absolute(path).c_str(), RTLD_NOW | RTLD_LOCAL);
  if (handle == nullptr)
    throw Error(ExitCode::module_fault, fmt::format("cannot load module: {}", printable(dlerror())));
  const auto refuse = [&](const std::string& why) {
    throw Error(ExitCode::module_fault,
                fmt::format("'{}' is not a gpuphys module: {}", printable(path), why));
  };
  using Entry = const gpuphys_module* (*)();
  const auto entry = reinterpret_cast<Entry>(dlsym(handle, "gpuphys_get_module"));
  if (entry == nullptr) refuse("it does not export gpuphys_get_module");
  const gpuphys_module* table = entry();
  if (table == nullptr) refuse("gpuphys_get_module returned null");
  table_ = *table;
  if (table_.abi_version != GPUPHYS_ABI_VERSION) {
    refuse(fmt::format("its interface version is {}, this suite speaks {}", table_.abi_version,
                       GPUPHYS_ABI_VERSION));
  }
  if (table_.allocate == nullptr || table_.compute == nullptr || table_.release == nullptr ||
      table_.task == nullptr)
    refuse("a function of its table is missing");
  if (table_.space != GPUPHYS_HOST && table_.space != GPUPHYS_DEVICE)
    refuse(fmt::format("its data lie in space {}, which is neither host (0) nor device (1)", table_.space));
  if (table_.output_real != GPUPHYS_F32 && table_.output_real != GPUPHYS_F64)
    refuse(fmt::format("its outputs are of type {}, which is neither float32 (1) nor float64 (2)",
                       table_.output_real));
  task_ = printable(bounded(table_.task, 64));
}

}  // namespace gpuphys
