// Inputs and judging that the fluid steps on a MAC grid share: obstacles, velocities, and what viscosity and
// projection promise of their results, in FP64. Modules never use this.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "cases/global_solve/mac_fluid.hpp"
#include "core/contract/task.hpp"
#include "core/judge/checks.hpp"

namespace gpuphys::mac_fluid {

using Extents = std::array<std::int64_t, 3>;

/// Fractions below this are closed: a solver must be able to tell them from 0.
constexpr double kLeastOpen = 0x1p-20;

/// Open fraction of face (i,j,k) normal to `axis`, between cell i-1 and cell i along it. Called for faces
/// inside the box only; those on its outside are closed.
using Open = std::function<double(int axis, std::int64_t i, std::int64_t j, std::int64_t k)>;

Open all_open();
/// A solid cylinder along z through the middle of the box (core/generators/cut_cell_cylinder.hpp), radius in
/// parts of nx.
Open cylinder(Extents, double radius);
/// A solid ball: the fraction of a face is that of its four corners' distances, averaged as edges are.
Open ball(std::array<double, 3> centre, double radius);
/// Every face closed with this probability, else open by U01 (stream 30 + axis, item = flat face index).
Open random_faces(Extents, std::uint64_t seed, double closed);

/// Velocity before it is set to zero on closed faces; every face of the box.
using Velocity = std::function<double(int axis, std::int64_t i, std::int64_t j, std::int64_t k)>;

/// Zeroed inputs of a contract with these open fractions.
Problem make_fluid(const Contract&, Extents, const Open&);
void set_velocity(Problem&, const Velocity&);
/// Uniform in [-size, size): stream 40 + axis, item = flat face index.
void set_noise(Problem&, std::uint64_t seed, double size);

/// Taylor-Green modes in the closed box: of velocity without divergence, amplitude per mode a unit vector,
/// half wave numbers 1 to `most` along each axis, one common factor so that the rms over the open faces is 1
/// m/s.
struct Modes {
  std::uint64_t seed;
  int count;
  int most = 16;
};
void set_taylor_green(Problem&, const Modes&);
/// Multiplies every sample.
void scale_velocity(Problem&, double factor);

/// A public, hidden or smoke set: Taylor-Green modes around the cylinder.
InputSet cylinder_set(const std::string& name, SetKind, Size, const Contract&, Extents, double radius,
                      const Modes&, std::vector<std::pair<std::string, double>> scalars);

// ---- judging ----

/// Is face (i,j,k) open: w > 0 and not on the outside of the box?
bool is_open(const Inputs&, int axis, std::int64_t i, std::int64_t j, std::int64_t k);

/// Per component ||b - A u|| / ||b|| of implicit viscosity, with u* the input velocity, over
/// max(tol + 1e-5, what FP32 can reach): passes up to 1.
Check viscous_residual_check();

/// ||div u|| / ||u|| of the result, both unscaled sums over cells and faces: at most `tolerance`.
Check divergence_check(const std::string& name, CheckKind, double tolerance, const std::string& why);

/// Faces that are closed and not at rest.
Check closed_faces_check();

}  // namespace gpuphys::mac_fluid
