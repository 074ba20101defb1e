// A non-owning view of a dense C-order array, usable on host and device.
#pragma once

#include <cstdint>

#ifdef __CUDACC__
#define GPUPHYS_HD __host__ __device__
#else
#define GPUPHYS_HD
#endif

namespace gpuphys {

/// `data[i][j][k]` with the last index fastest; `shape[d]` is the extent along index d.
/// Indexing is unchecked: views live in inner loops.
template <class T, int Rank>
struct View {
  static constexpr int rank = Rank;
  using value_type = T;

  T* data = nullptr;
  std::int64_t shape[Rank] = {};

  GPUPHYS_HD std::int64_t size() const {
    std::int64_t n = 1;
    for (int d = 0; d < Rank; ++d) n *= shape[d];
    return n;
  }

  template <class... I>
  GPUPHYS_HD std::int64_t offset(I... index) const {
    static_assert(sizeof...(I) == Rank, "one index per dimension");
    const std::int64_t at[Rank] = {static_cast<std::int64_t>(index)...};
    std::int64_t o = at[0];
    for (int d = 1; d < Rank; ++d) o = o * shape[d] + at[d];
    return o;
  }

  template <class... I>
  GPUPHYS_HD T& operator()(I... index) const {
    return data[offset(index...)];
  }
};

}  // namespace gpuphys
