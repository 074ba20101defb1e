#include "core/base/error.hpp"

namespace gpuphys {

std::string exit_code_table() {
  return "  0  everything as it should be\n"
         "  2  bad command line\n"
         "  3  a check exceeded its tolerance, or a mutant survived\n"
         "  4  the module broke a rule of the harness (the fault is named)\n"
         "  5  bad input: missing, corrupt, truncated or wrongly shaped file\n"
         "  6  unknown task, input set, check or module\n"
         "  7  a CUDA call failed\n"
         "  8  out of host or device memory\n"
         "  9  the module's process crashed or ran out of time\n"
         " 10  timing gate: slower than the record\n"
         " 11  timing gate: no record for this GPU\n"
         " 12  timing gate: faster than physically possible\n"
         " 13  a GPU record is older than its sources, or incomplete\n"
         " 14  standard output could not be written: the verdict was not seen\n"
         " 15  timing gate: the timed calls scatter too much to say anything\n"
         " 70  a bug in the suite\n"
         " 77  skipped: needs an NVIDIA GPU\n";
}

}  // namespace gpuphys
