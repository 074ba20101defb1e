// Serial baseline of fem_newtonian_implicit, written from cases/global_solve/fem_newtonian_implicit.md alone.
// Built in FP64 and as FP32 variants (Real).
#include "cases/global_solve/fem_newtonian_implicit.hpp"

#include <limits>

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/newton.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"

namespace gpuphys::fem_newtonian_implicit {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    Tets tets(in);
    serial::write_step(in, serial::newton<Real>(in, tets), out);
  }

 private:
  using Vec = serial::Vector3<Real>;
  using Mat = serial::Matrix3<Real>;
  using Corners = std::array<Vec, 4>;

  struct Tets {
    const Inputs& in;
    std::vector<Mat> inverse;
    std::vector<Real> volume;
    struct Linear {
      Mat inverse_transposed;  // F^-T
      Real twist, pressure;    // mu - lambda ln J, and lambda
    };
    std::vector<Linear> linear{};

    explicit Tets(const Inputs& inputs) : in(inputs) {
      for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
        const Mat rest = serial::edges<Real>(in.X, in.tets, t);
        inverse.push_back(serial::inverse(rest));
        volume.push_back(serial::determinant(rest) / 6);
      }
    }

    // Differences of a field from the first corner, as columns.
    Mat differences(std::int64_t t, const serial::Vectors<Real>& u) const {
      Mat d;
      for (std::size_t k = 0; k < 3; ++k) {
        for (std::size_t c = 0; c < 3; ++c)
          d[c][k] = u[static_cast<std::size_t>(in.tets(t, k + 1))][c] -
                    u[static_cast<std::size_t>(in.tets(t, 0))][c];
      }
      return d;
    }
    Mat deformation(std::int64_t t, const serial::Vectors<Real>& u) const {
      Mat now = serial::edges<Real>(in.x, in.tets, t);
      const Mat moved = differences(t, u);
      for (std::size_t e = 0; e < 9; ++e) now[e / 3][e % 3] += moved[e / 3][e % 3];
      return serial::product(now, inverse[static_cast<std::size_t>(t)]);
    }

    double energy(const serial::Vectors<Real>& u) const {
      double sum = 0;
      for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
        const Mat f = deformation(t, u);
        const double j = static_cast<double>(serial::determinant(f)), log_j = std::log(j);
        if (!(j > 0)) return std::numeric_limits<double>::infinity();
        double square = 0;
        for (const Vec& row : f) {
          for (const Real e : row) square += static_cast<double>(e) * static_cast<double>(e);
        }
        sum += static_cast<double>(volume[static_cast<std::size_t>(t)]) *
               (static_cast<double>(in.mu) * (0.5 * (square - 3) - log_j) +
                0.5 * static_cast<double>(in.lambda) * log_j * log_j);
      }
      return sum;
    }

    // Sum of the forces of stress(t) over the tetrahedra, with the sign of a gradient.
    template <class Stress>
    serial::Vectors<Real> sum_over_tets(Stress&& stress) const {
      serial::Vectors<Real> g(static_cast<std::size_t>(in.mass.shape[0]), {0, 0, 0});
      for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
        const Corners force = serial::tet_forces(stress(t), inverse[static_cast<std::size_t>(t)],
                                                 volume[static_cast<std::size_t>(t)]);
        for (std::size_t a = 0; a < 4; ++a) {
          for (std::size_t c = 0; c < 3; ++c) g[static_cast<std::size_t>(in.tets(t, a))][c] -= force[a][c];
        }
      }
      return g;
    }

    serial::Vectors<Real> gradient(const serial::Vectors<Real>& u) const {
      return sum_over_tets([&](std::int64_t t) {
        return serial::neo_hookean_stress(deformation(t, u), static_cast<Real>(in.mu),
                                          static_cast<Real>(in.lambda));
      });
    }

    void linearise(const serial::Vectors<Real>& u) {
      linear.clear();
      for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
        const Mat f = deformation(t, u), cofactor = serial::cofactors(f);
        const Real j = serial::determinant(f), lambda = in.lambda;
        Linear l{cofactor, static_cast<Real>(in.mu) - lambda * std::log(j), lambda};
        for (Vec& row : l.inverse_transposed) {
          for (Real& e : row) e /= j;
        }
        linear.push_back(l);
      }
    }

    // dP = mu dF + (mu - lambda ln J) F^-T dF^T F^-T + lambda tr(F^-1 dF) F^-T.
    Mat stress_change(const Linear& l, const Mat& df) const {
      const Mat& b = l.inverse_transposed;
      Mat transposed;
      Real trace = 0;
      for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t k = 0; k < 3; ++k) {
          transposed[i][k] = df[k][i];
          trace += b[i][k] * df[i][k];
        }
      }
      const Mat turned = serial::product(b, serial::product(transposed, b));
      Mat change;
      for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t k = 0; k < 3; ++k)
          change[i][k] =
              static_cast<Real>(in.mu) * df[i][k] + l.twist * turned[i][k] + l.pressure * trace * b[i][k];
      }
      return change;
    }

    serial::Vectors<Real> times(const serial::Vectors<Real>& p) const {
      return sum_over_tets([&](std::int64_t t) {
        const auto at = static_cast<std::size_t>(t);
        return stress_change(linear[at], serial::product(differences(t, p), inverse[at]));
      });
    }

    serial::Vectors<Real> diagonal() const {
      serial::Vectors<Real> sum(static_cast<std::size_t>(in.mass.shape[0]), {0, 0, 0});
      for (std::int64_t t = 0; t < in.tets.shape[0]; ++t) {
        const auto at = static_cast<std::size_t>(t);
        for (std::size_t a = 0; a < 4; ++a) {
          Vec slope;  // of the corner's barycentric coordinate
          for (std::size_t c = 0; c < 3; ++c)
            slope[c] =
                a > 0 ? inverse[at][a - 1][c] : -inverse[at][0][c] - inverse[at][1][c] - inverse[at][2][c];
          for (std::size_t c = 0; c < 3; ++c) {
            Mat df{};
            df[c] = slope;
            const Mat change = stress_change(linear[at], df);
            sum[static_cast<std::size_t>(in.tets(t, a))][c] +=
                volume[at] * (change[c][0] * slope[0] + change[c][1] * slope[1] + change[c][2] * slope[2]);
          }
        }
      }
      return sum;
    }
  };
};

}  // namespace gpuphys::fem_newtonian_implicit

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(fem_newtonian_implicit, fem_newtonian_implicit::Baseline)
}
