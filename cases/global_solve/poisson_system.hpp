// What the Poisson tasks share on the judging side: assembling systems from face conductances, manufactured
// solutions, A x in FP64, and the checks. Modules never use this: the baseline and the reference have their
// own operators.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "cases/global_solve/poisson.hpp"
#include "core/contract/arrays.hpp"
#include "core/contract/task.hpp"

namespace gpuphys::poisson {

/// Zeroed inputs of an nx x ny x nz system with the given tolerance.
Problem make_system(std::int64_t nx, std::int64_t ny, std::int64_t nz, double tol);

/// What a face without an active cell on its other side does to its cell's equation.
enum class Boundary {
  neumann,   ///< nothing: no flux, so the face also leaves the diagonal
  dirichlet  ///< value 0 beyond it: the face stays in the diagonal
};

/// Whether cell (i,j,k) is active. Called for cells inside the box only.
using ActiveCell = std::function<bool(std::int64_t i, std::int64_t j, std::int64_t k)>;
/// Conductance >= 0 of the face between cell (i,j,k) and its successor along `axis` (0, 1, 2). That index is
/// -1 for the face on the low side of the box. Called from several threads.
using FaceConductance = std::function<double(int axis, std::int64_t i, std::int64_t j, std::int64_t k)>;

/// Fills is_dof, the couplings (minus the conductance between two active cells, rounded to float32, else 0)
/// and the diagonal (the sum of the *rounded* conductances that the boundary condition keeps, itself rounded
/// once), so that a Neumann row sums to zero within one rounding.
void assemble(Problem& system, Boundary, const ActiveCell&, const FaceConductance&);

/// A smooth part that spans the box plus uncorrelated noise, with mean exactly zero (to FP64) over the active
/// cells; 0 elsewhere:  ramp (2/3 (X + Y + Z) - 1) + noise U  with X, Y, Z in (0, 1) the cell centre over the
/// box and U uniform in
/// [-1, 1) from random stream 0 of `seed` at the cell's flat index.
///
/// The noise sets how accurate FP32 can be: rounding x perturbs A x by about eps |A| |x|, and only an x that
/// is rough on the scale of a cell makes A x as large as |A| |x|.
std::vector<double> ramp_and_noise(const Problem& system, std::uint64_t seed, double ramp, double noise);

/// b = float32(scale A x), with the float32 coefficients and FP64 arithmetic.
void set_right_hand_side(Problem& system, const std::vector<double>& x, double scale = 1);

/// A x over the active cells, 0 elsewhere, in FP64.
std::vector<double> multiply(const Inputs&, const std::vector<double>& x);

/// || |A| |x| || / ||b||: what a relative change eps of every entry of x, or of every product in A x, may do
/// to the relative residual is at most eps times this. Needs b != 0.
double rounding_amplification(const Problem& system, const std::vector<double>& x);

/// The outputs of a Poisson task that hold `x` in FP64.
Arrays as_solution(const Contract&, const Problem&, const std::vector<double>& x);

/// Residual of the returned x over the active cells, judged in FP64 with the original inputs.
struct Residual {
  double relative_l2;  ///< ||b - A x|| / ||b||, or ||A x|| when b = 0; NaN when x is not finite
  double
      worst_over_rms;  ///< largest |b - A x| over the rms of b (over 1 when b = 0); NaN when x is not finite
  std::string worst_place;  ///< "x[3,4,5]"
  std::int64_t worst_cell;  ///< flat index
};
/// Throws Error(internal) when x has not the shape of the system.
Residual residual_of(const Problem& system, const HostArray& x);

/// Relative L2 residual against `tolerance`.
Check residual_check(double tolerance, const std::string& why);

/// Relative L2 residual over `bound`, which is a property of the data (evaluated once per judgement): passes
/// up to 1.
Check residual_over_bound_check(const std::string& name, const std::string& bound_text,
                                std::function<double(const Problem&)> bound, const std::string& why);

/// Largest residual of a single equation over rms(b).
Check local_residual_check(double tolerance, const std::string& why);

/// |mean(x)| / rms(x) over the active cells; 0 for x = 0.
Check mean_check(double tolerance, const std::string& why);

/// Number of inactive cells whose value is not zero.
Check zero_outside_check();

/// Number of values of x that are NaN or infinite.
Check finite_check(const std::string& why);

/// Number of values of x that are not zero.
Check zero_solution_check(const std::string& why);

}  // namespace gpuphys::poisson
