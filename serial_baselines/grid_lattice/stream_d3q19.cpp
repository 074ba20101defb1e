// Serial baseline of stream_d3q19, written from cases/grid_lattice/stream_d3q19.md alone: no cell changes its
// populations, which then move. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/stream_d3q19.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/grid_lattice/lattice.hpp"

namespace gpuphys::stream_d3q19 {

template <class Real>
using Baseline = serial::LatticeStep<19, Real, serial::Cell::keeps, serial::Populations::move>;

}  // namespace gpuphys::stream_d3q19

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(stream_d3q19, stream_d3q19::Baseline)
}
