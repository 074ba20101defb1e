// placeholder
#include "cases/particle_grid/velocity_gradient_mpm.hpp"
#include "core/module.hpp"
namespace gpuphys::velocity_gradient_mpm { namespace { struct Reference { void allocate(const Inputs&, const Outputs<float>&) {} void compute(const Inputs&, const Outputs<float>&) {} }; } }
namespace gpuphys { GPUPHYS_DEVICE_MODULE(velocity_gradient_mpm, velocity_gradient_mpm::Reference) }
