#include "core/generators/fourier_velocity.hpp"

#include <cmath>
#include <numbers>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys {
namespace {

// A unit vector perpendicular to k, from a random vector with its component along k removed.
std::array<double, 3> random_perpendicular(std::uint64_t seed, std::uint64_t mode,
                                           const std::array<int, 3>& k) {
  const double kk = k[0] * k[0] + k[1] * k[1] + k[2] * k[2];
  for (std::uint64_t attempt = 0;; ++attempt) {
    std::array<double, 3> v;
    for (std::uint64_t d = 0; d < 3; ++d) v[d] = uniform11(seed, 1, 3 * (mode + 1000003 * attempt) + d);
    const double along = (v[0] * k[0] + v[1] * k[1] + v[2] * k[2]) / kk;
    double square = 0;
    for (int d = 0; d < 3; ++d) {
      v[d] -= along * k[d];
      square += v[d] * v[d];
    }
    if (square < 0.01) continue;  // nearly parallel to k: the direction would be mostly rounding
    for (double& c : v) c /= std::sqrt(square);
    return v;
  }
}

}  // namespace

FourierVelocity FourierVelocity::random(std::uint64_t seed, int n_modes, int k_max, double rms,
                                        double period) {
  FourierVelocity field;
  field.period = period;
  field.k_max = k_max;
  const std::uint64_t side = static_cast<std::uint64_t>(2 * k_max + 1);
  for (int m = 0; m < n_modes; ++m) {
    const auto item = static_cast<std::uint64_t>(m);
    Mode mode{};
    // Redraw with a shifted counter until the wave vector is not zero.
    for (std::uint64_t attempt = 0; mode.k == std::array<int, 3>{0, 0, 0}; ++attempt) {
      for (std::uint64_t d = 0; d < 3; ++d) {
        const double u = uniform01(seed, 0, 3 * (item + 1000003 * attempt) + d);
        mode.k[d] = static_cast<int>(std::floor(u * static_cast<double>(side))) - k_max;
      }
    }
    mode.amplitude = random_perpendicular(seed, item, mode.k);
    for (double& a : mode.amplitude) a *= rms * std::sqrt(6.0 / n_modes);
    mode.phase = 2 * std::numbers::pi * uniform01(seed, 2, item);
    field.modes.push_back(mode);
  }
  return field;
}

double FourierVelocity::at(int c, double x, double y, double z) const {
  double sum = 0;
  for (const Mode& m : modes) {
    const double angle = 2 * std::numbers::pi * (m.k[0] * x + m.k[1] * y + m.k[2] * z) / period + m.phase;
    sum += m.amplitude[static_cast<std::size_t>(c)] * std::cos(angle);
  }
  return sum;
}

void FourierVelocity::fill(int c, double dx, HostArray& array) const {
  using Complex = std::complex<double>;
  const Shape& n = array.shape();
  const int side = 2 * k_max + 1;

  // table[d][k + k_max][i] = exp(2 pi i k x_i / L) at the sample positions along axis d.
  std::array<std::vector<std::vector<Complex>>, 3> table;
  for (std::size_t d = 0; d < 3; ++d) {
    table[d].resize(static_cast<std::size_t>(side));
    for (int k = -k_max; k <= k_max; ++k) {
      auto& row = table[d][static_cast<std::size_t>(k + k_max)];
      for (std::int64_t i = 0; i < n[d]; ++i) {
        const double position = (static_cast<double>(i) + (static_cast<int>(d) == c ? 0.0 : 0.5)) * dx;
        row.push_back(std::polar(1.0, 2 * std::numbers::pi * k * position / period));
      }
    }
  }

  const auto out = array.as<float>();
  parallel_for(n[0], [&](std::int64_t i) {
    const auto at = [&](std::size_t d, int k, std::int64_t index) {
      return table[d][static_cast<std::size_t>(k + k_max)][static_cast<std::size_t>(index)];
    };
    std::vector<Complex> row(
        static_cast<std::size_t>(side));  // coefficient of exp(2 pi i k z / L) along this row
    for (std::int64_t j = 0; j < n[1]; ++j) {
      std::fill(row.begin(), row.end(), Complex{});
      for (const Mode& m : modes) {
        row[static_cast<std::size_t>(m.k[2] + k_max)] += m.amplitude[static_cast<std::size_t>(c)] *
                                                         std::polar(1.0, m.phase) * at(0, m.k[0], i) *
                                                         at(1, m.k[1], j);
      }
      for (std::int64_t k = 0; k < n[2]; ++k) {
        double sum = 0;
        for (int kz = -k_max; kz <= k_max; ++kz) {
          const Complex w = row[static_cast<std::size_t>(kz + k_max)];
          const Complex e = at(2, kz, k);
          sum += w.real() * e.real() - w.imag() * e.imag();
        }
        out[static_cast<std::size_t>((i * n[1] + j) * n[2] + k)] = static_cast<float>(sum);
      }
    }
  });
}

}  // namespace gpuphys
