// What the device backend tells about itself besides the Backend interface (core/harness.hpp).
#pragma once

namespace gpuphys {

/// Whether allocate() is watched for device work: CUPTI was there when the suite was built and can be loaded
/// here. Without it Fault::work_in_allocate cannot be named (one line on stderr says so).
bool allocate_is_watched();

}  // namespace gpuphys
