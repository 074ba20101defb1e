// Solves a seven-point system by multigrid, with Krylov acceleration where multigrid alone is slow.
//
// The plain iteration x <- x + M (b - A x), M one V(1,1) cycle, needs only two passes over the fine grid per
// cycle and computes the true residual anyway. When a cycle reduces the residual by too little (strong jumps,
// walls thinner than a coarse cell), the same cycle becomes the preconditioner of a truncated flexible GCR
// iteration, whose residual never grows. The cycle is not symmetric (red before black on the way down and on
// the way up, which is what makes it fast), hence GCR rather than CG.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "core/contract/module.hpp"
#include "references/common/device_buffer.cuh"
#include "references/global_solve/multigrid_krylov.cuh"
#include "references/global_solve/multigrid_tail.cuh"

namespace gpuphys::multigrid {

struct SolverPolicy {
  static constexpr float safety = 0.9f;    // the iteration aims below the tolerance by this factor
  static constexpr float verdict = 0.98f;  // and is accepted below it by this one: norms are summed in FP32
  static constexpr float slow = 0.35f;     // a cycle that reduces the residual by less calls for acceleration
  static constexpr float useless = 0.9f;   // so does one that reduces it by less than this, from any cycle on
  static constexpr float stalls = 0.99f;   // a step of the accelerated iteration that reduces it by less
  static constexpr int max_cycles = 40;    // of the plain iteration
  static constexpr int max_steps = 400;    // of the accelerated one
  static constexpr int stagnation_steps = 30;  // within these the residual must halve
  static constexpr int refresh_steps = 40;     // after these the recurrence is replaced by the true residual
  static constexpr int least_planes = 2;       // of a block's march over a coarse level; even
  static constexpr int down_rows = 16;         // tile of the pass with a residual
  static_assert(down_rows % PiecePolicy::granule_rows == 0 &&
                SmoothPolicy::columns == PiecePolicy::granule_columns);
};

/// One cycle: over-relaxation of red and black cells, and a factor of the coarse correction.
struct Relaxation {
  float down[2], up[2];
  float correction = 1.0f;
};

/// What the cycle does best with depends on the coefficients; it converges for others too.
struct Tuning {
  /// Over-relaxation of red and black cells. 1.15 is best for red-black relaxation of a Laplacian.
  float omega_down[2] = {1.15f, 1.15f}, omega_up[2] = {1.15f, 1.15f};
  /// Coupling of the first coarse level over the sum of the fine ones. Half where conductances are smooth;
  /// where they vary from face to face with mean m and variance v, what conducts at length is m (1 - v / (3
  /// m^2)).
  float first_coupling = 0.5f;
  /// Share of a coarse diagonal beyond its couplings from which on its cell counts as held at zero: above
  /// that of a mass term, below that of a face held at zero.
  float held_share = kHeldShare;
  /// Passes over the fine grid leave out planes of tiles without an active cell. The host plans that while
  /// the device coarsens, which costs 0.1 ms and more: not worth it where nearly all planes hold one.
  bool leave_out_empty_planes = true;
  /// Residual after a cycle over that after the next way down, at most.
  float outlook = 2.0f;
  /// The first cycles of the plain iteration have relaxation of their own, on the fine grid
  /// schedule[cycle] and below it schedule_below. Later ones and the accelerated iteration go by the above.
  static constexpr int most_scheduled = 6;
  int scheduled = 0;
  Relaxation schedule[most_scheduled] = {};
  Relaxation schedule_below = {};
};

/// Outcome of a solve, for tests and reports.
struct SolveReport {
  int cycles = 0;               ///< multigrid cycles, of either phase
  int steps = 0;                ///< of these, accelerated ones
  float relative_residual = 0;  ///< true residual of the returned solution
  bool converged = false;
};

/// `UpRows`: rows of a tile of the pass with a correction. Less is read twice with more of them; with fewer,
/// more planes of tiles have no active cell.
template <int UpRows>
class TiledSolver {
  static_assert(UpRows % PiecePolicy::granule_rows == 0);

 public:
  /// Allocates for systems of this size. `singular` promises rows that sum to zero (pure Neumann): constants
  /// are then kept out of the coarse systems and the solution is returned with zero mean.
  void allocate(int nx, int ny, int nz, bool singular, const Tuning& tuning = {}) {
    // Entries, with rows padded to four, are counted in 32 bits.
    if (nx < 1 || ny < 1 || nz < 1 || static_cast<double>(nx) * ny * ((nz + 3) / 4 * 4) > 2.1e9) {
      throw std::runtime_error("multigrid: the grid has no cells or more than 2.1e9");
    }
    singular_ = singular;
    tuning_ = tuning;
    GPUPHYS_CUDA(cudaDeviceGetAttribute(&processors_, cudaDevAttrMultiProcessorCount, 0));
    levels_.resize(1);
    levels_[0].nx = nx, levels_[0].ny = ny, levels_[0].nz = nz, levels_[0].pitch = (nz + 3) / 4 * 4;
    const std::size_t cells = static_cast<std::size_t>(nx) * ny * levels_[0].pitch;
    if (levels_[0].pitch != nz) {
      for (auto* v : {&levels_[0].diag, &levels_[0].ax, &levels_[0].ay, &levels_[0].az, &levels_[0].rhs})
        *v = DeviceBuffer<float>(cells);
    }
    for (auto* v : {&x_[0], &x_[1], &r_}) *v = DeviceBuffer<float>(cells);
    for (int w = 0; w <= KrylovPolicy::window; ++w) {
      d_.emplace_back(cells);
      q_.emplace_back(cells);
    }
    const auto half = [](int n) { return (n + 1) / 2; };
    do {
      const Level& f = levels_.back();
      Level c;
      c.nx = half(f.nx), c.ny = half(f.ny), c.nz = half(f.nz), c.pitch = (c.nz + 15) / 16 * 16;
      const std::size_t size = static_cast<std::size_t>(c.nx) * c.ny * c.pitch;
      for (auto* v : {&c.diag, &c.ax, &c.ay, &c.az, &c.rhs, &c.mid, &c.x}) *v = DeviceBuffer<float>(size);
      c.gates = DeviceBuffer<Gates>(size);
      levels_.push_back(std::move(c));
    } while (levels_.back().nx * levels_.back().ny * levels_.back().nz > 1);
    tail_ = 1;
    while (tail_ + 1 < static_cast<int>(levels_.size()) && cells_of(tail_) > TailPolicy::cells) ++tail_;
    granules_y_ = (ny + PiecePolicy::granule_rows - 1) / PiecePolicy::granule_rows;
    tiles_z_ = (nz + PiecePolicy::granule_columns - 1) / PiecePolicy::granule_columns;
    const std::size_t granules = static_cast<std::size_t>(granules_y_) * tiles_z_ * nx;
    live_ = DeviceBuffer<unsigned char>(granules);
    host_live_ = PinnedBuffer<unsigned char>(granules);
    const std::size_t most = most_pieces(nx, granules_y_ * tiles_z_);
    for (Pieces* p : {&down_, &up_}) p->list = DeviceBuffer<Piece>(most), p->host = PinnedBuffer<Piece>(most);
    partials_ = DeviceBuffer<float>(std::max(most, static_cast<std::size_t>(KrylovPolicy::max_blocks)) *
                                    KrylovPolicy::sums);
    largest_ = DeviceBuffer<float>(scan_blocks());
    sums_ = DeviceBuffer<float>(scan_blocks());
    counts_ = DeviceBuffer<int>(scan_blocks());
    state_ = DeviceBuffer<State>(1);
    host_ = PinnedBuffer<State>(1);
  }

  /// Everything from the inputs to `out`, on the legacy default stream; returns when the solution is decided.
  const SolveReport& solve(const float* diag, const float* ax, const float* ay, const float* az,
                           const float* b, const bool* active, float tolerance, float* out) {
    if (!event_.handle) GPUPHYS_CUDA(cudaEventCreateWithFlags(&event_.handle, cudaEventDisableTiming));
    Level& fine = levels_[0];
    if (fine.pitch == fine.nz) {
      fine.view = {diag, ax, ay, az, fine.nx, fine.ny, fine.nz, fine.pitch};
      b_ = b;
    } else {
      // Rows that do not start on 16 bytes cannot be fetched by the copy engine.
      const int rows = fine.nx * fine.ny;
      const auto padded = [&](const float* from, const DeviceBuffer<float>& to) {
        pad_rows<<<vector_blocks(), KrylovPolicy::threads>>>(from, to.get(), rows, fine.nz, fine.pitch);
        return to.get();
      };
      fine.view = {padded(diag, fine.diag),
                   padded(ax, fine.ax),
                   padded(ay, fine.ay),
                   padded(az, fine.az),
                   fine.nx,
                   fine.ny,
                   fine.nz,
                   fine.pitch};
      b_ = padded(b, fine.rhs);
    }
    active_ = active;
    out_ = out;
    set_up(b);
    report_ = run(tolerance);
    return report_;
  }

  /// d = M r: one cycle of the solve's multigrid from zero, for the matrix of the last solve. Arrays in the
  /// layout of matrix(0); d is left alone where there are no active cells around.
  void apply_cycle(const float* r, float* d) {
    GPUPHYS_CUDA(cudaMemsetAsync(const_cast<int*>(done()), 0, sizeof(int)));
    precondition(r, d);
  }

  /// The matrices of the last solve: 0 is the one given, the last one has one cell.
  int levels() const { return static_cast<int>(levels_.size()); }
  const Matrix& matrix(int l) const { return levels_[static_cast<std::size_t>(l)].view; }
  const Gates* gates(int l) const { return levels_[static_cast<std::size_t>(l)].gates.get(); }

  /// What the last solve did.
  const SolveReport& report() const { return report_; }

 private:
  struct Level {
    int nx = 0, ny = 0, nz = 0, pitch = 0;
    DeviceBuffer<float> diag, ax, ay, az;  // of coarse levels; level 0 is the input
    DeviceBuffer<float> rhs, mid, x;       // mid: between the two passes of a cycle
    DeviceBuffer<Gates> gates;
    Matrix view;
  };
  // What a pass over the fine grid visits.
  struct Pieces {
    DeviceBuffer<Piece> list;
    PinnedBuffer<Piece> host;
    int count = 0;
  };
  struct Event {
    cudaEvent_t handle = nullptr;
    ~Event() {
      if (handle) cudaEventDestroy(handle);
    }
  };

  const int* done() const {
    return reinterpret_cast<const int*>(reinterpret_cast<char*>(state_.get()) + offsetof(State, done));
  }
  const float* scale() const { return &state_.get()->scale; }
  const float* shift() const { return &state_.get()->shift; }
  const float* one() const { return &state_.get()->one; }
  const float* zero() const { return &state_.get()->zero; }

  int cells_of(int l) const {
    const Level& v = levels_[static_cast<std::size_t>(l)];
    return v.nx * v.ny * v.nz;
  }
  int cells() const { return levels_[0].nx * levels_[0].ny * levels_[0].nz; }
  int vector_blocks() const {
    const int quads = levels_[0].nx * levels_[0].ny * ((levels_[0].nz + 3) / 4);
    return std::min(KrylovPolicy::max_blocks, (quads + KrylovPolicy::threads - 1) / KrylovPolicy::threads);
  }

  int scan_blocks() const {
    return std::min(1024, (cells() + 4 * KrylovPolicy::threads - 1) / (4 * KrylovPolicy::threads));
  }

  void plan(Pieces& p, int rows) {
    const std::vector<Piece> pieces = plan_pieces(host_live_.get(), levels_[0].nx, granules_y_, tiles_z_,
                                                  rows / PiecePolicy::granule_rows, processors_);
    std::copy(pieces.begin(), pieces.end(), p.host.get());
    p.count = static_cast<int>(pieces.size());
    GPUPHYS_CUDA(
        cudaMemcpyAsync(p.list.get(), p.host.get(), sizeof(Piece) * pieces.size(), cudaMemcpyHostToDevice));
  }

  void set_up(const float* b) {
    const Level& fine = levels_[0];
    const int granules = granules_y_ * tiles_z_;
    const std::size_t marks = static_cast<std::size_t>(granules) * fine.nx;
    if (tuning_.leave_out_empty_planes) {
      mark_live<<<static_cast<unsigned>((marks + 7) / 8), 256>>>(active_, fine.nx, fine.ny, fine.nz,
                                                                 fine.pitch, tiles_z_, granules, live_.get(),
                                                                 x_[0].get(), x_[1].get());
      GPUPHYS_CUDA(cudaMemcpyAsync(host_live_.get(), live_.get(), marks, cudaMemcpyDeviceToHost));
      GPUPHYS_CUDA(cudaEventRecord(event_.handle));
    }
    const int blocks = scan_blocks();
    scan_input<<<blocks, KrylovPolicy::threads>>>(b, active_, cells(), largest_.get(), sums_.get(),
                                                  counts_.get());
    begin_solve<<<1, 1024>>>(state_.get(), largest_.get(), sums_.get(), counts_.get(), blocks, singular_);
    for (std::size_t l = 1; l < levels_.size(); ++l) {
      Level& c = levels_[l];
      c.view = {c.diag.get(), c.ax.get(), c.ay.get(), c.az.get(), c.nx, c.ny, c.nz, c.pitch};
      const MutableMatrix to{c.diag.get(), c.ax.get(), c.ay.get(), c.az.get(), c.gates.get(), c.rhs.get()};
      const bool skip = l == 1 && tuning_.leave_out_empty_planes;
      const LiveMarks live{skip ? live_.get() : nullptr, PiecePolicy::granule_rows,
                           PiecePolicy::granule_columns, tiles_z_, fine.nx};
      coarsen<<<static_cast<unsigned>((c.view.size() + 127) / 128), 128>>>(
          levels_[l - 1].view, c.view, to,
          coarsening_to(static_cast<int>(l), singular_, tuning_.first_coupling, tuning_.held_share), live);
    }
    if (!tuning_.leave_out_empty_planes) return;
    // The host plans the passes while the device coarsens.
    GPUPHYS_CUDA(cudaEventSynchronize(event_.handle));
    plan(down_, SolverPolicy::down_rows);
    plan(up_, UpRows);
  }

  // Tiles of a level, marching far enough along x for one wave of blocks.
  template <bool kDown>
  dim3 smooth_grid(const Level& l, int* planes_per_block) const {
    const int rows = kDown ? SolverPolicy::down_rows : UpRows;
    const int bz = (l.nz + SmoothPolicy::columns - 1) / SmoothPolicy::columns, by = (l.ny + rows - 1) / rows;
    constexpr int least = SolverPolicy::least_planes;
    const int chunks = std::max(1, std::min(processors_ / (by * bz), (l.nx + least - 1) / least));
    int planes = (l.nx + chunks - 1) / chunks;
    planes = std::min(128, planes + planes % 2);
    if (planes_per_block) *planes_per_block = planes;
    return dim3(static_cast<unsigned>(bz), static_cast<unsigned>(by),
                static_cast<unsigned>((l.nx + planes - 1) / planes));
  }

  using EncodeTiled = CUresult(CUtensorMap*, CUtensorMapDataType, cuuint32_t, void*, const cuuint64_t*,
                               const cuuint64_t*, const cuuint32_t*, const cuuint32_t*, CUtensorMapInterleave,
                               CUtensorMapSwizzle, CUtensorMapL2promotion, CUtensorMapFloatOOBfill);

  // The description of an array of a level that the copy engine needs to fetch boxes of 1 x rows x columns.
  template <class T>
  void describe(CUtensorMap& map, const T* data, const Level& l, int columns, int rows) const {
    static const auto encode = [] {
      void* entry = nullptr;
      cudaDriverEntryPointQueryResult found;
      GPUPHYS_CUDA(cudaGetDriverEntryPointByVersion("cuTensorMapEncodeTiled", &entry, 12000,
                                                    cudaEnableDefault, &found));
      if (found != cudaDriverEntryPointSuccess)
        throw std::runtime_error("multigrid: the driver cannot describe tensors");
      return reinterpret_cast<EncodeTiled*>(entry);
    }();
    // Up to the next multiple of four columns arrays hold zeros; beyond, nothing need be defined.
    const cuuint64_t size[3] = {static_cast<cuuint64_t>((l.nz + 3) / 4 * 4), static_cast<cuuint64_t>(l.ny),
                                static_cast<cuuint64_t>(l.nx)};
    const cuuint64_t row = sizeof(T) * static_cast<cuuint64_t>(l.pitch);
    const cuuint64_t strides[2] = {row, row * static_cast<cuuint64_t>(l.ny)};
    const cuuint32_t box[3] = {static_cast<cuuint32_t>(columns), static_cast<cuuint32_t>(rows), 1};
    const cuuint32_t one[3] = {1, 1, 1};
    const CUresult status = encode(
        &map, sizeof(T) == 4 ? CU_TENSOR_MAP_DATA_TYPE_FLOAT32 : CU_TENSOR_MAP_DATA_TYPE_UINT8, 3,
        const_cast<T*>(data), size, strides, box, one, CU_TENSOR_MAP_INTERLEAVE_NONE,
        CU_TENSOR_MAP_SWIZZLE_NONE, CU_TENSOR_MAP_L2_PROMOTION_L2_128B, CU_TENSOR_MAP_FLOAT_OOB_FILL_NONE);
    if (status != CUDA_SUCCESS)
      throw std::runtime_error("multigrid: tensor description refused, driver error " +
                               std::to_string(status));
  }

  // x_in null: start from zero.
  template <bool kDown>
  int pass(int l, const float* x_in, float* x_out, const float* rhs, const float* rhs_scale,
           const float* rhs_shift, float* partials) {
    constexpr int rows = kDown ? SolverPolicy::down_rows : UpRows;
    using Tile = SmoothTile<rows, !kDown, kDown>;
    const Level &f = levels_[static_cast<std::size_t>(l)], &c = levels_[static_cast<std::size_t>(l) + 1];
    SmoothArgs g{};
    const auto box = [&](CUtensorMap& map, const float* data) {
      describe(map, data, f, SmoothPolicy::width, Tile::rows);
    };
    box(g.maps.ax, f.view.ax), box(g.maps.ay, f.view.ay), box(g.maps.az, f.view.az),
        box(g.maps.diag, f.view.diag);
    box(g.maps.rhs, rhs), box(g.maps.x, x_in ? x_in : rhs);
    if constexpr (!kDown) {
      describe(g.maps.e, c.x.get(), c, SmoothPolicy::e_width, Tile::e_rows);
      describe(g.maps.gates, c.gates.get(), c, SmoothPolicy::gates_width, Tile::e_rows);
    }
    g.nx = f.nx, g.ny = f.ny, g.nz = f.nz, g.pitch = f.pitch;
    g.from_zero = x_in == nullptr;
    g.x_out = x_out;
    g.rhs_scale = rhs_scale, g.rhs_shift = rhs_shift;
    g.coarse_rhs = c.rhs.get(), g.coarse_ny = c.ny, g.coarse_pitch = c.pitch;
    g.partials = partials;
    g.done = done();
    dim3 grid = smooth_grid<kDown>(f, &g.planes_per_block);
    if (l == 0 && tuning_.leave_out_empty_planes) {
      const Pieces& pieces = kDown ? down_ : up_;
      g.pieces = pieces.list.get();
      grid = dim3(static_cast<unsigned>(pieces.count));
    }
    const Relaxation& relaxation = l == 0 ? relaxation_ : relaxation_below_;
    std::copy_n(kDown ? relaxation.down : relaxation.up, 2, g.omega);
    g.correction = relaxation.correction;
    const auto kernel =
        kDown || singular_ ? smooth<rows, !kDown, kDown, false> : smooth<rows, !kDown, kDown, !kDown>;
    GPUPHYS_CUDA(
        cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, Tile::shared_bytes));
    kernel<<<grid, Tile::threads, Tile::shared_bytes>>>(g);
    return static_cast<int>(grid.x * grid.y * grid.z);
  }

  int pass_down(int l, const float* x_in, float* x_out, const float* rhs, bool is_input, float* partials) {
    return pass<true>(l, x_in, x_out, rhs, is_input ? scale() : one(), is_input ? shift() : zero(), partials);
  }
  int pass_up(int l, const float* x_in, float* x_out, const float* rhs, bool is_input, float* partials) {
    return pass<false>(l, x_in, x_out, rhs, is_input ? scale() : one(), is_input ? shift() : zero(),
                       partials);
  }

  // From the right-hand side of level 1 to its correction.
  void coarse_correction() {
    const auto level = [&](int l) -> Level& { return levels_[static_cast<std::size_t>(l)]; };
    for (int l = 1; l < tail_; ++l)
      pass_down(l, nullptr, level(l).mid.get(), level(l).rhs.get(), false, nullptr);
    TailArgs g{};
    g.done = done();
    g.solo = 0;
    std::copy_n(relaxation_below_.down, 2, g.omega[0]);
    std::copy_n(relaxation_below_.up, 2, g.omega[1]);
    for (int l = tail_; l < static_cast<int>(levels_.size()); ++l) {
      const Level& c = level(l);
      g.level[g.levels++] = {c.view, c.gates.get(), c.x.get(), c.rhs.get()};
      if (c.nx * c.ny * c.nz > TailPolicy::solo_cells) g.solo = g.levels;
    }
    solve_tail<<<TailPolicy::blocks, TailPolicy::threads>>>(g);
    for (int l = tail_ - 1; l >= 1; --l)
      pass_up(l, level(l).mid.get(), level(l).x.get(), level(l).rhs.get(), false, nullptr);
  }

  State wait() {
    GPUPHYS_CUDA(cudaEventRecord(event_.handle));
    GPUPHYS_CUDA(cudaEventSynchronize(event_.handle));
    return *host_.get();
  }

  /// The relaxation of cycle `n` of the plain iteration; of the accelerated one without `n`.
  void choose_relaxation(int n = Tuning::most_scheduled) {
    const Relaxation usual{{tuning_.omega_down[0], tuning_.omega_down[1]},
                           {tuning_.omega_up[0], tuning_.omega_up[1]}};
    const bool scheduled = n < tuning_.scheduled;
    relaxation_ = scheduled ? tuning_.schedule[n] : usual;
    relaxation_below_ = scheduled ? tuning_.schedule_below : usual;
  }

  SolveReport run(float tolerance) {
    SolveReport report;
    const float aim = SolverPolicy::safety * tolerance;
    const float early = aim / SolverPolicy::verdict;  // what accept() holds to `aim`
    bool from_zero = false, finished = false;
    float previous = std::numeric_limits<float>::infinity(), expected = previous;
    for (int n = 0; n < SolverPolicy::max_cycles; ++n) {
      choose_relaxation(n);
      const int blocks = pass_down(0, n == 0 ? nullptr : x_[0].get(), x_[1].get(), b_, true, partials_.get());
      ++report.cycles;
      // Where this way down should do, the rest of the cycle is not even launched. (In a singular system what
      // is accepted is not what the cycle reduces: the part of b that no x reaches counts.)
      const bool last = !singular_ && expected < aim;
      if (last && accept(x_[1].get(), early, report)) return report;
      if (!last) {
        judge_cycle<<<1, 1024>>>(state_.get(), host_.get(), partials_.get(), blocks, aim, singular_);
        GPUPHYS_CUDA(cudaEventRecord(event_.handle));
      }
      coarse_correction();
      const int up_blocks = pass_up(0, x_[1].get(), x_[0].get(), b_, true, partials_.get());
      if (!last) GPUPHYS_CUDA(cudaEventSynchronize(event_.handle));
      const State s = *host_.get();
      if (s.done) {
        if (s.rhs2 == 0) {
          GPUPHYS_CUDA(cudaMemsetAsync(out_, 0, sizeof(float) * static_cast<std::size_t>(cells())));
          report.converged = true;
          return report;
        }
        finished = true;
        break;
      }
      const float norm = std::sqrt(s.r2 / s.rhs2);
      if (!(norm < SolverPolicy::useless * previous)) {
        from_zero = !(norm < SolverPolicy::useless);  // x = 0 is as good
        break;
      }
      if (n > 0 && norm > SolverPolicy::slow * previous) break;
      // The cycle under way takes the residual down by the same factor again, short of the relaxation of its
      // successor's way down. Where that is expected to do, look before starting another one.
      if (n > 0 && tuning_.outlook * norm * (norm / previous) < aim) {
        judge_mean<<<1, 1024>>>(state_.get(), partials_.get(), up_blocks, singular_);
        if (accept(x_[0].get(), early, report)) return report;
      }
      if (n > 0) expected = norm * (norm / previous);
      previous = norm;
    }
    if (finished) {
      if (accept(x_[1].get(), tolerance, report)) return report;
      // What is left is the part of b that is constant on the active cells: no x does better.
      const State s = *host_.get();
      if (s.shift * s.shift * static_cast<float>(s.active) >= 0.25f * s.r2) return report;
    }
    accelerate(x_[1].get(), from_zero, tolerance, report);
    accept(x_[1].get(), tolerance, report);
    return report;
  }

  // Writes the solution and measures the residual of what was written.
  bool accept(const float* x, float tolerance, SolveReport& report) {
    const int blocks = vector_blocks();
    const auto write = tuning_.leave_out_empty_planes ? write_solution<true> : write_solution<false>;
    write<<<blocks, KrylovPolicy::threads>>>(levels_[0].view, b_, x, active_, out_, state_.get(),
                                             partials_.get());
    judge_solution<<<1, 1024>>>(state_.get(), host_.get(), partials_.get(), blocks,
                                SolverPolicy::verdict * tolerance);
    const State s = wait();
    report.relative_residual = s.rhs2 > 0 ? std::sqrt(s.r2 / s.rhs2) : 0.0f;
    report.converged = s.done != 0;
    return report.converged;
  }

  State true_residual(const float* x) {
    const int blocks = vector_blocks();
    replace_residual<<<blocks, KrylovPolicy::threads>>>(levels_[0].view, b_, x, r_.get(), state_.get(),
                                                        partials_.get());
    judge_residual<<<1, 1024>>>(state_.get(), host_.get(), partials_.get(), blocks, singular_);
    return wait();
  }

  // d: about A^-1 r by a cycle, or by the relaxation of its way down alone.
  void precondition(const float* r, float* d, bool cycle = true) {
    choose_relaxation();
    if (!cycle) {
      pass_down(0, nullptr, d, r, false, nullptr);
      return;
    }
    pass_down(0, nullptr, x_[0].get(), r, false, nullptr);
    coarse_correction();
    pass_up(0, x_[0].get(), d, r, false, nullptr);
  }

  void accelerate(float* x, bool from_zero, float tolerance, SolveReport& report) {
    const Matrix& a = levels_[0].view;
    const std::size_t bytes = sizeof(float) * static_cast<std::size_t>(a.size());
    if (from_zero) GPUPHYS_CUDA(cudaMemsetAsync(x, 0, bytes));
    for (auto& v : d_) GPUPHYS_CUDA(cudaMemsetAsync(v.get(), 0, bytes));  // passes do not visit all of it
    const int blocks = vector_blocks();
    const float aim = SolverPolicy::safety * tolerance;
    const auto relative = [](const State& s) { return std::sqrt(s.r2 / s.rhs2); };
    float replaced = relative(true_residual(x));  // norm at the last replacement
    float milestone = replaced, before = replaced;
    // Steps without progress, one after the other. Where what holds a strongly coupled part is about the
    // rounding errors of its couplings, corrections may be made up of its constant and lose all else in the
    // rounding, and so may all further ones; relaxation by itself gets on then. (What a singular system
    // cannot reach also stays, and is no reason.)
    int stalled = 0;
    int since_milestone = 0, since_replacement = 0, kept = 0, slot = 0;
    while (!(replaced < aim) && report.steps < SolverPolicy::max_steps) {
      Directions s{};
      s.kept = kept;
      for (int w = 0; w < KrylovPolicy::window; ++w) s.d[w] = d_[w].get(), s.q[w] = q_[w].get();
      float *d = d_[KrylovPolicy::window].get(), *q = q_[KrylovPolicy::window].get();
      precondition(r_.get(), d, singular_ || stalled % 2 == 0);
      apply_direction<<<blocks, KrylovPolicy::threads>>>(a, s, d, q, r_.get(), partials_.get());
      choose_step<<<1, 1024>>>(state_.get(), partials_.get(), blocks, kept);
      take_step<<<blocks, KrylovPolicy::threads>>>(a, s, d, q, x, r_.get(), state_.get(), partials_.get());
      judge_step<<<1, 1024>>>(state_.get(), host_.get(), partials_.get(), blocks, slot, singular_);
      std::swap(d_[slot], d_[KrylovPolicy::window]);
      std::swap(q_[slot], q_[KrylovPolicy::window]);
      kept = std::min(kept + 1, KrylovPolicy::window);
      slot = (slot + 1) % KrylovPolicy::window;
      ++report.steps, ++report.cycles, ++since_milestone, ++since_replacement;
      const float norm = relative(wait());
      stalled = norm > SolverPolicy::stalls * before ? stalled + 1 : 0;
      before = norm;
      if (norm < 0.5f * milestone) milestone = norm, since_milestone = 0;
      const bool stagnant = since_milestone >= SolverPolicy::stagnation_steps || !std::isfinite(norm);
      if (norm < aim || stagnant || since_replacement >= SolverPolicy::refresh_steps) {
        const float now = relative(true_residual(x));
        if (stagnant || (norm < aim && !(now < 0.7f * replaced))) break;
        replaced = now;
        since_replacement = kept = slot = 0;
      }
    }
  }

  SolveReport report_;
  bool singular_ = false;
  Tuning tuning_;
  Relaxation relaxation_{}, relaxation_below_{};  // of the cycle being launched
  int processors_ = 1, tail_ = 1, granules_y_ = 1, tiles_z_ = 1;
  DeviceBuffer<unsigned char> live_;
  PinnedBuffer<unsigned char> host_live_;
  Pieces down_, up_;
  std::vector<Level> levels_;
  DeviceBuffer<float> x_[2], r_, partials_, largest_, sums_;
  std::vector<DeviceBuffer<float>> d_, q_;
  DeviceBuffer<int> counts_;
  DeviceBuffer<State> state_;
  PinnedBuffer<State> host_;
  Event event_;
  const float* b_ = nullptr;
  const bool* active_ = nullptr;
  float* out_ = nullptr;
};

/// What suits a box that is mostly full.
using Solver = TiledSolver<24>;

}  // namespace gpuphys::multigrid
