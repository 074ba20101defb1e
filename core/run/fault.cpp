#include "core/run/fault.hpp"

namespace gpuphys {

std::string to_string(Fault fault) {
  switch (fault) {
    case Fault::returned_error:
      return "returned_error";
    case Fault::launch_failed:
      return "launch_failed";
    case Fault::out_of_bounds_write:
      return "out_of_bounds_write";
    case Fault::input_modified:
      return "input_modified";
    case Fault::unwritten_output:
      return "unwritten_output";
    case Fault::non_finite_output:
      return "non_finite_output";
    case Fault::asynchronous_return:
      return "asynchronous_return";
    case Fault::work_in_allocate:
      return "work_in_allocate";
    case Fault::stale_output:
      return "stale_output";
    case Fault::zero_output:
      return "zero_output";
    case Fault::copied_input:
      return "copied_input";
    case Fault::below_floor:
      return "below_floor";
    case Fault::time_disagrees:
      return "time_disagrees";
  }
  return "unknown";
}

}  // namespace gpuphys
