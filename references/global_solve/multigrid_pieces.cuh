// Which part of the fine grid a pass visits: tile columns are cut into pieces along x that leave out the
// planes without an active cell, and so that the processors, with one piece at a time each, end together.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <queue>
#include <vector>

namespace gpuphys::multigrid {

struct PiecePolicy {
  static constexpr int granule_rows = 8;      // divides the rows of every tile
  static constexpr int granule_columns = 64;  // columns of a tile
  static constexpr int start_up = 8;   // planes' worth of time that a piece takes beyond its own: filling the
                                       // pipeline, and the halo along x
  static constexpr int longest = 128;  // planes of a piece
  static constexpr int choices = 4;    // of how often to cut, at most
};

/// Planes [begin, end) of tile (y, z). `begin` is even and `end` even or the end of the grid, so that the
/// children of a coarse cell belong to one piece.
struct Piece {
  int y, z, begin, end;
};

/// live[(y * tiles_z + z) * nx + i]: whether any of granule (y, z)'s cells in plane i is active. Where none
/// is, x0 and x1 are cleared: passes look at the rim of what they do not visit. A warp each; a lane looks at
/// 16 columns of a row.
__global__ void __launch_bounds__(256)
    mark_live(const bool* active, int nx, int ny, int nz, int pitch, int tiles_z, int granules,
              unsigned char* live, float* x0, float* x1) {
  using P = PiecePolicy;
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const int warp = static_cast<int>(blockIdx.x * (blockDim.x / 32) + threadIdx.x / 32);
  if (warp >= granules * nx) return;
  const int granule = warp / nx, i = warp - granule * nx;
  const int j = granule / tiles_z * P::granule_rows + lane / 4;
  const int k0 = granule % tiles_z * P::granule_columns, k = k0 + 16 * (lane % 4);
  const int row = i * ny + j;
  bool any = false;
  if (j < ny && k + 16 <= nz && reinterpret_cast<std::uintptr_t>(active + row * nz + k) % 16 == 0) {
    const uint4 flags = __ldg(reinterpret_cast<const uint4*>(active + row * nz + k));
    any = (flags.x | flags.y | flags.z | flags.w) != 0;
  } else if (j < ny) {
    for (int e = k; e < min(k + 16, nz); ++e) any = any || active[row * nz + e];
  }
  any = __any_sync(0xffffffffu, any);
  if (lane == 0) live[warp] = any;
  if (any || j >= ny) return;
  // Four neighbouring lanes write 64 bytes of a row at a time; rows are padded to four entries.
  for (int e = k0 + 4 * (lane % 4), q = 0; q < P::granule_columns / 16; ++q, e += 16) {
    if (e >= pitch) break;
    *reinterpret_cast<float4*>(x0 + row * pitch + e) = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
    *reinterpret_cast<float4*>(x1 + row * pitch + e) = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
  }
}

/// Runs of live planes of every tile column of `granules_per_tile` granules, widened to even bounds; gaps
/// that cost less than a start are closed.
inline std::vector<Piece> live_runs(const unsigned char* live, int nx, int granules_y, int tiles_z,
                                    int granules_per_tile) {
  std::vector<Piece> runs;
  std::vector<unsigned char> column(static_cast<std::size_t>(nx));
  for (int y = 0; y * granules_per_tile < granules_y; ++y) {
    for (int z = 0; z < tiles_z; ++z) {
      std::fill(column.begin(), column.end(), static_cast<unsigned char>(0));
      for (int g = y * granules_per_tile; g < std::min(granules_y, (y + 1) * granules_per_tile); ++g) {
        const unsigned char* from = live + (static_cast<long long>(g) * tiles_z + z) * nx;
        for (int i = 0; i < nx; ++i) column[static_cast<std::size_t>(i)] |= from[i];
      }
      const std::size_t before = runs.size();
      for (int i = 0; i < nx; ++i) {
        if (!column[static_cast<std::size_t>(i)]) continue;
        if (runs.size() == before || i - runs.back().end >= PiecePolicy::start_up)
          runs.push_back({y, z, i & ~1, i + 1});
        runs.back().end = std::min(nx, (i + 2) & ~1);
      }
    }
  }
  return runs;
}

/// The runs cut into pieces of at most `planes` planes, longest first.
inline std::vector<Piece> cut(const std::vector<Piece>& runs, int planes) {
  std::vector<Piece> pieces;
  for (const Piece& r : runs)
    for (int begin = r.begin; begin < r.end; begin += planes)
      pieces.push_back({r.y, r.z, begin, std::min(begin + planes, r.end)});
  std::stable_sort(pieces.begin(), pieces.end(),
                   [](const Piece& a, const Piece& b) { return a.end - a.begin > b.end - b.begin; });
  return pieces;
}

/// When the last of `processors` is done if each takes the next piece as soon as it is free.
inline int finish(const std::vector<Piece>& pieces, int processors) {
  std::priority_queue<int, std::vector<int>, std::greater<int>> busy;
  int last = 0;
  for (const Piece& p : pieces) {
    int start = 0;
    if (static_cast<int>(busy.size()) == processors) start = busy.top(), busy.pop();
    busy.push(start + p.end - p.begin + PiecePolicy::start_up);
    last = std::max(last, start + p.end - p.begin + PiecePolicy::start_up);
  }
  return last;
}

/// The pieces of a pass over a grid of nx planes; at least one, if only an empty one.
inline std::vector<Piece> plan_pieces(const unsigned char* live, int nx, int granules_y, int tiles_z,
                                      int granules_per_tile, int processors) {
  using P = PiecePolicy;
  const std::vector<Piece> runs = live_runs(live, nx, granules_y, tiles_z, granules_per_tile);
  std::vector<Piece> best{{0, 0, 0, 0}};
  int best_finish = 0;
  const int fewest = (nx + P::longest - 1) / P::longest;
  for (int cuts = fewest; cuts < fewest + P::choices && !runs.empty(); ++cuts) {
    int planes = (nx + cuts - 1) / cuts;
    planes += planes % 2;
    if (best_finish > 0 && planes < 4) break;
    // The host's time counts: no schedule is tried that cannot be the best.
    int work = 0;
    for (const Piece& r : runs)
      work += r.end - r.begin + (r.end - r.begin + planes - 1) / planes * P::start_up;
    if (best_finish > 0 && work >= best_finish * processors) continue;
    std::vector<Piece> pieces = cut(runs, planes);
    const int now = finish(pieces, processors);
    if (best_finish > 0 && now >= best_finish) continue;
    best = std::move(pieces);
    best_finish = now;
  }
  return best;
}

/// Most pieces that plan_pieces() can return.
inline std::size_t most_pieces(int nx, int columns) {
  using P = PiecePolicy;
  const int cuts = (nx + P::longest - 1) / P::longest + P::choices, runs = nx / (P::start_up + 1) + 1;
  return static_cast<std::size_t>(columns) * static_cast<std::size_t>(cuts + runs);
}

}  // namespace gpuphys::multigrid
