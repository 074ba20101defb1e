// Serial baseline of trt_collision_d3q27, written from cases/grid_lattice/trt_collision_d3q27.md alone: every
// cell collides, and its populations stay. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/trt_collision_d3q27.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/grid_lattice/lattice.hpp"

namespace gpuphys::trt_collision_d3q27 {

template <class Real>
using Baseline = serial::LatticeStep<27, Real, serial::Cell::collides, serial::Populations::stay>;

}  // namespace gpuphys::trt_collision_d3q27

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(trt_collision_d3q27, trt_collision_d3q27::Baseline)
}
