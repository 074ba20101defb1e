#include "cases/grid_lattice/drops.hpp"

#include <algorithm>
#include <cmath>

#include "core/base/parallel.hpp"
#include "core/generators/random.hpp"

namespace gpuphys::drops {
namespace {

// Distance along one axis of n cells to the nearest image.
double axis_distance(double a, double b, std::int64_t n) {
  const double period = static_cast<double>(n), d = std::abs(a - b);
  return std::abs(d - period * std::round(d / period));
}

}  // namespace

std::vector<Drop> random_drops(const Layout& layout, Grid g) {
  std::vector<Drop> all;
  for (std::int64_t m = 0; m < layout.count; ++m) {
    const auto item = static_cast<std::uint64_t>(m);
    const auto place = [&](std::uint64_t stream, std::int64_t n) {
      return static_cast<double>(n) * uniform01(layout.seed, stream, item);
    };
    all.push_back({{place(60, g.nx), place(61, g.ny), place(62, g.nz)},
                   layout.smallest + (layout.largest - layout.smallest) * uniform01(layout.seed, 63, item)});
  }
  return all;
}

double profile(double distance, double width) {
  const double phi = 1 / (1 + std::exp(-4 * distance / width));
  return phi < 0x1p-40 ? 0 : phi;
}

std::vector<float> field(Grid g, const std::vector<Drop>& all, double width) {
  std::vector<float> phi(static_cast<std::size_t>(g.nx * g.ny * g.nz));
  constexpr std::int64_t piece = 16;
  parallel_for(g.nx * g.ny, [&](std::int64_t row) {
    const std::int64_t i = row / g.ny, j = row % g.ny;
    const auto depth = [&](const Drop& d, double k) {
      const double x = axis_distance(static_cast<double>(i), d.centre[0], g.nx);
      const double y = axis_distance(static_cast<double>(j), d.centre[1], g.ny);
      const double z = axis_distance(k, d.centre[2], g.nz);
      return d.radius - std::sqrt(x * x + y * y + z * z);
    };
    // Within half a piece the depth changes by no more than that: most drops cannot be the deepest there.
    std::vector<double> middle(all.size());
    for (std::int64_t first = 0; first < g.nz; first += piece) {
      const std::int64_t end = std::min(first + piece, g.nz);
      double deepest = -1e300;
      for (std::size_t m = 0; m < all.size(); ++m) {
        middle[m] = depth(all[m], static_cast<double>(first) + piece / 2.0);
        deepest = std::max(deepest, middle[m]);
      }
      std::vector<Drop> near;
      for (std::size_t m = 0; m < all.size(); ++m) {
        if (middle[m] >= deepest - piece) near.push_back(all[m]);
      }
      for (std::int64_t k = first; k < end; ++k) {
        double best = -1e300;
        for (const Drop& d : near) best = std::max(best, depth(d, static_cast<double>(k)));
        phi[static_cast<std::size_t>(row * g.nz + k)] = static_cast<float>(profile(best, width));
      }
    }
  });
  return phi;
}

std::vector<float> noise(Grid g, std::uint64_t seed, double low, double high) {
  std::vector<float> phi(static_cast<std::size_t>(g.nx * g.ny * g.nz));
  for (std::size_t cell = 0; cell < phi.size(); ++cell) {
    phi[cell] =
        static_cast<float>(low + (high - low) * uniform01(seed, 64, static_cast<std::uint64_t>(cell)));
  }
  return phi;
}

}  // namespace gpuphys::drops
