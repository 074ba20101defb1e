// A module that has been opened and whose table makes sense. Only the runner, and tests, load modules.
#pragma once

#include <string>

#include "core/contract/module_abi.h"

namespace gpuphys {

class LoadedModule {
 public:
  /// Opens `path`. Throws Error(unknown_name) when the file is missing, Error(module_fault) when it is not a
  /// module of this ABI version or its table is not one.
  explicit LoadedModule(const std::string& path);
  LoadedModule(const LoadedModule&) = delete;
  LoadedModule& operator=(const LoadedModule&) = delete;
  // Never unloaded: CUDA modules register kernels with the runtime, and unloading them while a context lives
  // is not safe.

  const gpuphys_module& table() const { return table_; }
  const std::string& task() const { return task_; }
  const std::string& path() const { return path_; }
  bool on_device() const { return table_.space == GPUPHYS_DEVICE; }

 private:
  std::string path_, task_;
  gpuphys_module table_{};
};

}  // namespace gpuphys
