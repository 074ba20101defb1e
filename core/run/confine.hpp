// What the runner may touch once a module is loaded: no file may be written, and none read but the system's
// own, the module and the libraries beside it. By Landlock; a kernel without it leaves that to bubblewrap,
// which the judge starts the runner in.
#pragma once

#include <string>
#include <vector>

namespace gpuphys {

/// Confines this process and all that it starts. `readable`: files and folders besides the system's that it
/// may read and map. Returns "" or why it could not be done (nothing is confined then).
std::string confine(const std::vector<std::string>& readable, bool own_namespace);

/// Limits that every runner gets: no core files, no file written beyond 1 MiB (a pipe or a device is none),
/// and on the host at most `memory_bytes` of private memory (0: none, for CUDA reserves far more than it
/// uses).
void limit_resources(unsigned long long memory_bytes);

}  // namespace gpuphys
