// Serial baseline of mass_spring_newtonian_implicit, written from
// cases/global_solve/mass_spring_newtonian_implicit.md alone. Built in FP64 and as FP32 variants (Real).
#include "cases/global_solve/mass_spring_newtonian_implicit.hpp"

#include "core/contract/module.hpp"
#include "serial_baselines/global_solve/newton.hpp"
#include "serial_baselines/local_interaction/elastic_forces.hpp"

namespace gpuphys::mass_spring_newtonian_implicit {

template <class Real>
class Baseline {
 public:
  void allocate(const Inputs&, const Outputs<Real>&) {}

  void compute(const Inputs& in, const Outputs<Real>& out) {
    Springs springs{in};
    serial::write_step(in, serial::newton<Real>(in, springs), out);
  }

 private:
  using Vec = serial::Vector3<Real>;

  struct Springs {
    const Inputs& in;
    struct Linear {
      Vec direction;
      Real across;  // stiffness across the direction over that along it
    };
    std::vector<Linear> linear{};

    Vec between(std::int64_t j, const serial::Vectors<Real>& u) const {
      const std::int32_t a = in.springs(j, 0), b = in.springs(j, 1);
      Vec d = serial::difference<Real>(in.x, a, b);
      for (std::size_t c = 0; c < 3; ++c)
        d[c] += u[static_cast<std::size_t>(a)][c] - u[static_cast<std::size_t>(b)][c];
      return d;
    }
    static Real length(const Vec& d) { return std::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]); }

    double energy(const serial::Vectors<Real>& u) const {
      double sum = 0;
      for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
        const double stretch = static_cast<double>(length(between(j, u)) - static_cast<Real>(in.rest(j)));
        sum += 0.5 * static_cast<double>(in.k) * stretch * stretch;
      }
      return sum;
    }

    template <class Pull>
    serial::Vectors<Real> sum_over_springs(Pull&& pull) const {
      serial::Vectors<Real> g(static_cast<std::size_t>(in.mass.shape[0]), {0, 0, 0});
      for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
        const Vec f = pull(j);
        for (std::size_t c = 0; c < 3; ++c) {
          g[static_cast<std::size_t>(in.springs(j, 0))][c] += static_cast<Real>(in.k) * f[c];
          g[static_cast<std::size_t>(in.springs(j, 1))][c] -= static_cast<Real>(in.k) * f[c];
        }
      }
      return g;
    }

    serial::Vectors<Real> gradient(const serial::Vectors<Real>& u) const {
      return sum_over_springs([&](std::int64_t j) {
        Vec f = serial::spring_pull(between(j, u), static_cast<Real>(in.rest(j)));
        for (Real& component : f) component = -component;
        return f;
      });
    }

    // k (n n^T + max(0, 1 - L/l) (I - n n^T)): the Hessian without its negative part.
    void linearise(const serial::Vectors<Real>& u) {
      linear.resize(static_cast<std::size_t>(in.rest.shape[0]));
      for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
        const Vec d = between(j, u);
        const Real l = length(d);
        Linear& spring = linear[static_cast<std::size_t>(j)];
        spring = {{0, 0, 0}, in.rest(j) == 0 ? Real(1) : Real(0)};
        if (l == 0) continue;
        for (std::size_t c = 0; c < 3; ++c) spring.direction[c] = d[c] / l;
        spring.across = std::max(Real(0), 1 - static_cast<Real>(in.rest(j)) / l);
      }
    }
    serial::Vectors<Real> times(const serial::Vectors<Real>& p) const {
      return sum_over_springs([&](std::int64_t j) {
        const Linear& spring = linear[static_cast<std::size_t>(j)];
        const auto &pa = p[static_cast<std::size_t>(in.springs(j, 0))],
                   &pb = p[static_cast<std::size_t>(in.springs(j, 1))];
        Real along = 0;
        for (std::size_t c = 0; c < 3; ++c) along += spring.direction[c] * (pa[c] - pb[c]);
        Vec f;
        for (std::size_t c = 0; c < 3; ++c)
          f[c] = spring.across * (pa[c] - pb[c]) + (1 - spring.across) * along * spring.direction[c];
        return f;
      });
    }
    serial::Vectors<Real> diagonal() const {
      serial::Vectors<Real> sum(static_cast<std::size_t>(in.mass.shape[0]), {0, 0, 0});
      for (std::int64_t j = 0; j < in.rest.shape[0]; ++j) {
        if (in.springs(j, 0) == in.springs(j, 1)) continue;
        const Linear& spring = linear[static_cast<std::size_t>(j)];
        for (std::size_t e = 0; e < 2; ++e) {
          for (std::size_t c = 0; c < 3; ++c)
            sum[static_cast<std::size_t>(in.springs(j, e))][c] +=
                static_cast<Real>(in.k) *
                (spring.across + (1 - spring.across) * spring.direction[c] * spring.direction[c]);
        }
      }
      return sum;
    }
  };
};

}  // namespace gpuphys::mass_spring_newtonian_implicit

namespace gpuphys {
GPUPHYS_BASELINE_MODULE(mass_spring_newtonian_implicit, mass_spring_newtonian_implicit::Baseline)
}
