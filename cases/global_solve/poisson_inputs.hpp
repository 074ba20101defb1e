// Input sets that the Poisson tasks have in common: active cells, conductances and right-hand sides of the
// hard cases, and how the paper's sets and the checks are put together. A task's own file says what is its
// own.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "cases/global_solve/poisson_system.hpp"

namespace gpuphys::poisson {

constexpr double kTolerance = 1e-6;

using Extents = std::array<std::int64_t, 3>;

/// Flat index of cell (i,j,k).
std::uint64_t flat(const Extents& n, std::int64_t i, std::int64_t j, std::int64_t k);

/// U01 of a face between two cells, from random stream 1, 2, 3 for faces normal to x, y, z, at the flat index
/// of the cell on its low side.
double inner_face_uniform01(const Extents& n, std::uint64_t seed, int axis, std::int64_t i, std::int64_t j,
                            std::int64_t k);
/// The same for a face anywhere, on the outside of the box as well: faces normal to an axis are numbered as
/// an array with one more entry along that axis. Indices as in FaceConductance.
double face_uniform01(const Extents& n, std::uint64_t seed, int axis, std::int64_t i, std::int64_t j,
                      std::int64_t k);
/// U01 of a cell, from stream 4.
double cell_uniform01(const Extents& n, std::uint64_t seed, std::int64_t i, std::int64_t j, std::int64_t k);

bool everywhere(std::int64_t i, std::int64_t j, std::int64_t k);
double unit_conductance(int axis, std::int64_t i, std::int64_t j, std::int64_t k);
/// Layers three cells thick along y of conductance 1 and 2^-20 in turn; a face is strong if both its cells
/// are. Powers of two make every diagonal exact in float32. With 1e-6 its rounding would rival the weak
/// couplings, and the matrix would no longer be that of the layers.
double layer_conductance(int axis, std::int64_t i, std::int64_t j, std::int64_t k);
/// Whether a face (indices as in FaceConductance) lies on the outside of the box.
bool on_outside(const Extents& n, int axis, std::int64_t i, std::int64_t j, std::int64_t k);

/// Cells with U01 < share, flat.
std::vector<char> random_cells(const Extents& n, std::uint64_t seed, double share);
/// The cells of the largest face-connected component of `active` (first found wins a tie).
std::vector<char> largest_component(const Extents& n, const std::vector<char>& active);
/// A random spanning tree of a coarse lattice, carved one cell wide: rooms at even indices, passages between
/// them in the order of random streams 1, 2, 3.
std::vector<char> maze_cells(const Extents& rooms, std::uint64_t seed);
/// Looks cells up in an array as the ones above. Keeps a reference.
ActiveCell cells_in(const Extents& n, const std::vector<char>& active);

/// x* = ramp + 0.5 U. The noise share keeps || |A| |x*| || / ||b|| near 3, so that FP32 can reach 1e-6.
std::vector<double> rough_solution(const Problem&, std::uint64_t seed);

/// A system with tolerance kTolerance whose right-hand side is `scale` A x*.
Problem system_with_rough_solution(const Extents& n, Boundary, std::uint64_t seed, const ActiveCell&,
                                   const FaceConductance&, double scale = 1);
/// The same without a right-hand side: b = 0.
Problem system_without_source(const Extents& n, Boundary, const ActiveCell&, const FaceConductance&);

/// One of the paper's sets: `make(n)` builds it for the grid of its size, 256^3 or 36 x 36 x 33, from the
/// solution rough_solution(seed). The smoke grid leaves partial blocks of 8 on every axis and a cell count
/// that is no multiple of 32.
InputSet paper_set(const std::string& name, SetKind, Size, std::uint64_t seed, const std::string& about,
                   std::function<Problem(const Extents&)> make);

/// A hard case held to the task's checks and to finite values.
InputSet finite_hard_case(const std::string& stress, const std::string& about, std::function<Problem()> make);
/// A hard case whose only answer is x = 0.
InputSet zero_hard_case(const std::string& stress, const std::string& about, std::function<Problem()> make,
                        const std::string& why);

/// The paper's bound on the residual.
Check paper_residual_check();
/// The suite's own bound on a single equation's residual.
Check single_equation_check();

/// `tol`, swept for the plot of speed against error.
AccuracyKnob tolerance_knob();

}  // namespace gpuphys::poisson
