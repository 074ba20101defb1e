// Serial baseline of lbm_d3q19, written from cases/grid_lattice/lbm_d3q19.md alone: every cell collides, then
// its populations move. Built as FP64 truth and as FP32 variants (Real).
#include "cases/grid_lattice/lbm_d3q19.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/grid_lattice/lattice.hpp"

namespace gpuphys::lbm_d3q19 {

template <class Real>
using Baseline = serial::LatticeStep<19, Real, serial::Cell::collides, serial::Populations::move>;

}  // namespace gpuphys::lbm_d3q19

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(lbm_d3q19, lbm_d3q19::Baseline)
}
