// What device code may call: barriers, warp intrinsics, atomics, loads and stores with hints, arithmetic.
#pragma once

#include <bit>
#include <cfloat>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>

#include "tests/emulation/fibers.hpp"

#define __global__
#define __device__
#define __host__
#define __constant__
#define __managed__
#define __grid_constant__
#define __forceinline__ inline
#define __align__(n) __attribute__((aligned(n)))
#define __launch_bounds__(...)
// Blocks run one after the other: one instance will do. That it is local to the thread puts all of them, and
// nothing else, into one segment of the module, which every block finds poisoned.
#define __shared__ static thread_local

using uint = unsigned;

#define EMULATION_SITE const char *file_ = __builtin_FILE(), int line_ = __builtin_LINE()
#define EMULATION_HERE(what) (::emulation::Site{what, file_, line_})

// ---- Barriers ----

inline void __syncthreads(EMULATION_SITE) {
  ::emulation::running_block->barrier(EMULATION_HERE("__syncthreads"), 0);
}
inline int __syncthreads_count(int p, EMULATION_SITE) {
  return ::emulation::running_block->barrier(EMULATION_HERE("__syncthreads_count"), p).count;
}
inline int __syncthreads_or(int p, EMULATION_SITE) {
  return ::emulation::running_block->barrier(EMULATION_HERE("__syncthreads_or"), p).any;
}
inline int __syncthreads_and(int p, EMULATION_SITE) {
  return ::emulation::running_block->barrier(EMULATION_HERE("__syncthreads_and"), p).all;
}

// Memory is coherent here. A thread that looks for what another writes does so around a fence or an atomic:
// now and then the others get a turn.
namespace emulation {
inline void look_around() {
  static unsigned looks = 0;
  if (++looks % 4096 == 0 && running_block != nullptr) running_block->pause();
}
}  // namespace emulation
inline void __threadfence() {
  ::emulation::look_around();
}
inline void __threadfence_block() {
  ::emulation::look_around();
}
inline void __threadfence_system() {
  ::emulation::look_around();
}
inline void __nanosleep(unsigned) {
  ::emulation::running_block->pause();
}
[[noreturn]] inline void __trap() {
  throw std::runtime_error("__trap()");
}
inline long long clock64() {
  static long long now = 0;
  return now += 100;
}
// ---- Warp intrinsics ----

namespace emulation {

template <class T>
std::uint64_t to_bits(T v) {
  static_assert(sizeof(T) <= 8 && std::is_trivially_copyable_v<T>);
  std::uint64_t bits = 0;
  std::memcpy(&bits, &v, sizeof v);
  return bits;
}
template <class T>
T from_bits(std::uint64_t bits) {
  T v;
  std::memcpy(&v, &bits, sizeof v);
  return v;
}
// What a lane gets from one that takes no part: unspecified, so nothing sensible.
constexpr std::uint64_t kNobody = std::uint64_t{kPoison} << 32 | kPoison;

template <class Source>
void shuffle(const Lanes& lanes) {
  for (int l = 0; l < 32; ++l) {
    Fiber* f = lanes[static_cast<std::size_t>(l)];
    if (!f) continue;
    const int from = Source::of(l, f->argument, f->width);
    const Fiber* g = lanes[static_cast<std::size_t>(from & 31)];
    f->result = g ? g->value : kNobody;
  }
}
struct FromLane {
  static int of(int l, int a, int w) { return (l & ~(w - 1)) + (a & (w - 1)); }
};
struct FromBelow {
  static int of(int l, int a, int w) { return (l & (w - 1)) - a < 0 ? l : l - a; }
};
struct FromAbove {
  static int of(int l, int a, int w) { return (l & (w - 1)) + a >= w ? l : l + a; }
};
struct FromXor {
  static int of(int l, int a, int w) { return (l ^ a) < (l & ~(w - 1)) + w ? l ^ a : l; }
};
template <class Source, class T>
T shuffled(const Site& site, unsigned mask, T v, int argument, int width) {
  return from_bits<T>(running_block->warp(site, mask, to_bits(v), argument, width, &shuffle<Source>));
}

template <class T, class Combine>
void reduce(const Lanes& lanes) {
  bool first = true;
  T all{};
  for (Fiber* f : lanes) {
    if (!f) continue;
    const T v = from_bits<T>(f->value);
    all = first ? v : Combine::of(all, v);
    first = false;
  }
  for (Fiber* f : lanes)
    if (f) f->result = to_bits(all);
}
struct Add {
  template <class T>
  static T of(T a, T b) {
    return static_cast<T>(static_cast<unsigned>(a) + static_cast<unsigned>(b));
  }
};
struct Min {
  template <class T>
  static T of(T a, T b) {
    return b < a ? b : a;
  }
};
struct Max {
  template <class T>
  static T of(T a, T b) {
    return a < b ? b : a;
  }
};
struct And {
  template <class T>
  static T of(T a, T b) {
    return a & b;
  }
};
struct Or {
  template <class T>
  static T of(T a, T b) {
    return a | b;
  }
};
struct Xor {
  template <class T>
  static T of(T a, T b) {
    return a ^ b;
  }
};
template <class Combine, class T>
T reduced(const Site& site, unsigned mask, T v) {
  return from_bits<T>(running_block->warp(site, mask, to_bits(v), 0, 32, &reduce<T, Combine>));
}

inline void meet(const Lanes&) {}
inline void ballot(const Lanes& lanes) {
  unsigned votes = 0;
  for (int l = 0; l < 32; ++l)
    if (lanes[static_cast<std::size_t>(l)] && lanes[static_cast<std::size_t>(l)]->value != 0)
      votes |= 1u << l;
  for (Fiber* f : lanes)
    if (f) f->result = votes;
}
inline void all_of(const Lanes& lanes) {
  bool all = true;
  for (Fiber* f : lanes) all = all && (!f || f->value != 0);
  for (Fiber* f : lanes)
    if (f) f->result = all;
}
inline void match_any(const Lanes& lanes) {
  for (Fiber* f : lanes) {
    if (!f) continue;
    unsigned same = 0;
    for (int l = 0; l < 32; ++l) {
      const Fiber* g = lanes[static_cast<std::size_t>(l)];
      if (g && g->value == f->value) same |= 1u << l;
    }
    f->result = same;
  }
}
inline void match_all(const Lanes& lanes) {
  unsigned mask = 0;
  bool same = true;
  const Fiber* first = nullptr;
  for (int l = 0; l < 32; ++l) {
    const Fiber* f = lanes[static_cast<std::size_t>(l)];
    if (!f) continue;
    mask |= 1u << l;
    if (!first) first = f;
    same = same && f->value == first->value;
  }
  for (Fiber* f : lanes)
    if (f) f->result = same ? mask : 0;
}

}  // namespace emulation

template <class T>
T __shfl_sync(unsigned mask, T v, int lane, int width = 32, EMULATION_SITE) {
  return ::emulation::shuffled<::emulation::FromLane>(EMULATION_HERE("__shfl_sync"), mask, v, lane, width);
}
template <class T>
T __shfl_up_sync(unsigned mask, T v, unsigned by, int width = 32, EMULATION_SITE) {
  return ::emulation::shuffled<::emulation::FromBelow>(EMULATION_HERE("__shfl_up_sync"), mask, v,
                                                       static_cast<int>(by), width);
}
template <class T>
T __shfl_down_sync(unsigned mask, T v, unsigned by, int width = 32, EMULATION_SITE) {
  return ::emulation::shuffled<::emulation::FromAbove>(EMULATION_HERE("__shfl_down_sync"), mask, v,
                                                       static_cast<int>(by), width);
}
template <class T>
T __shfl_xor_sync(unsigned mask, T v, int by, int width = 32, EMULATION_SITE) {
  return ::emulation::shuffled<::emulation::FromXor>(EMULATION_HERE("__shfl_xor_sync"), mask, v, by, width);
}
inline void __syncwarp(unsigned mask = 0xffffffffu, EMULATION_SITE) {
  ::emulation::running_block->warp(EMULATION_HERE("__syncwarp"), mask, 0, 0, 32, &::emulation::meet);
}
inline unsigned __ballot_sync(unsigned mask, int p, EMULATION_SITE) {
  return static_cast<unsigned>(::emulation::running_block->warp(EMULATION_HERE("__ballot_sync"), mask, p != 0,
                                                                0, 32, &::emulation::ballot));
}
inline int __any_sync(unsigned mask, int p, EMULATION_SITE) {
  return ::emulation::running_block->warp(EMULATION_HERE("__any_sync"), mask, p != 0, 0, 32,
                                          &::emulation::ballot) != 0;
}
inline int __all_sync(unsigned mask, int p, EMULATION_SITE) {
  return ::emulation::running_block->warp(EMULATION_HERE("__all_sync"), mask, p != 0, 0, 32,
                                          &::emulation::all_of) != 0;
}
template <class T>
unsigned __match_any_sync(unsigned mask, T v, EMULATION_SITE) {
  return static_cast<unsigned>(::emulation::running_block->warp(
      EMULATION_HERE("__match_any_sync"), mask, ::emulation::to_bits(v), 0, 32, &::emulation::match_any));
}
template <class T>
unsigned __match_all_sync(unsigned mask, T v, int* pred, EMULATION_SITE) {
  const auto all = static_cast<unsigned>(::emulation::running_block->warp(
      EMULATION_HERE("__match_all_sync"), mask, ::emulation::to_bits(v), 0, 32, &::emulation::match_all));
  *pred = all != 0;
  return all;
}
#define EMULATION_REDUCE(name, Combine)                                                \
  inline unsigned name(unsigned mask, unsigned v, EMULATION_SITE) {                    \
    return ::emulation::reduced<::emulation::Combine>(EMULATION_HERE(#name), mask, v); \
  }                                                                                    \
  inline int name(unsigned mask, int v, EMULATION_SITE) {                              \
    return ::emulation::reduced<::emulation::Combine>(EMULATION_HERE(#name), mask, v); \
  }
EMULATION_REDUCE(__reduce_add_sync, Add)
EMULATION_REDUCE(__reduce_min_sync, Min)
EMULATION_REDUCE(__reduce_max_sync, Max)
EMULATION_REDUCE(__reduce_and_sync, And)
EMULATION_REDUCE(__reduce_or_sync, Or)
EMULATION_REDUCE(__reduce_xor_sync, Xor)
// Which lanes happen to run together is not specified: each is alone here.
inline unsigned __activemask() {
  return 1u << (::emulation::running->number % 32);
}

// ---- Atomics: nothing runs at the same time ----

namespace emulation {
template <class T, class Change>
T change(T* p, const Change& f) {
  look_around();
  const T old = *p;
  *p = f(old);
  return old;
}
template <class T>
using As = std::type_identity_t<T>;
}  // namespace emulation

template <class T>
T atomicAdd(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) -> T {
    if constexpr (std::is_same_v<T, float2>) {
      return {old.x + v.x, old.y + v.y};
    } else if constexpr (std::is_same_v<T, float4>) {
      return {old.x + v.x, old.y + v.y, old.z + v.z, old.w + v.w};
    } else if constexpr (std::is_integral_v<T>) {
      return static_cast<T>(static_cast<std::make_unsigned_t<T>>(old) +
                            static_cast<std::make_unsigned_t<T>>(v));
    } else {
      return old + v;
    }
  });
}
template <class T>
T atomicSub(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return static_cast<T>(old - v); });
}
template <class T>
T atomicMin(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return v < old ? v : old; });
}
template <class T>
T atomicMax(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return old < v ? v : old; });
}
template <class T>
T atomicAnd(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return static_cast<T>(old & v); });
}
template <class T>
T atomicOr(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return static_cast<T>(old | v); });
}
template <class T>
T atomicXor(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return static_cast<T>(old ^ v); });
}
template <class T>
T atomicExch(T* p, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T) { return v; });
}
template <class T>
T atomicCAS(T* p, ::emulation::As<T> expected, ::emulation::As<T> v) {
  return ::emulation::change(p, [&](T old) { return old == expected ? v : old; });
}
inline unsigned atomicInc(unsigned* p, unsigned v) {
  return ::emulation::change(p, [&](unsigned old) { return old >= v ? 0u : old + 1u; });
}
inline unsigned atomicDec(unsigned* p, unsigned v) {
  return ::emulation::change(p, [&](unsigned old) { return old == 0u || old > v ? v : old - 1u; });
}
#define EMULATION_BLOCK_ATOMIC(name) \
  template <class T, class... V>     \
  T name##_block(T* p, V... v) {     \
    return name(p, v...);            \
  }                                  \
  template <class T, class... V>     \
  T name##_system(T* p, V... v) {    \
    return name(p, v...);            \
  }
EMULATION_BLOCK_ATOMIC(atomicAdd)
EMULATION_BLOCK_ATOMIC(atomicSub)
EMULATION_BLOCK_ATOMIC(atomicMin)
EMULATION_BLOCK_ATOMIC(atomicMax)
EMULATION_BLOCK_ATOMIC(atomicAnd)
EMULATION_BLOCK_ATOMIC(atomicOr)
EMULATION_BLOCK_ATOMIC(atomicXor)
EMULATION_BLOCK_ATOMIC(atomicExch)
EMULATION_BLOCK_ATOMIC(atomicCAS)

// ---- Loads and stores with hints; misaligned ones are errors, as on the device ----

namespace emulation {
template <class T>
void require_alignment(const T* p) {
  if (reinterpret_cast<std::uintptr_t>(p) % alignof(T) != 0) throw std::runtime_error("misaligned address");
}
template <class T>
T load(const T* p) {
  require_alignment(p);
  return *p;
}
}  // namespace emulation
#define EMULATION_LOAD(name)     \
  template <class T>             \
  T name(const T* p) {           \
    return ::emulation::load(p); \
  }
EMULATION_LOAD(__ldg)
EMULATION_LOAD(__ldca)
EMULATION_LOAD(__ldcg)
EMULATION_LOAD(__ldcs)
EMULATION_LOAD(__ldlu)
EMULATION_LOAD(__ldcv)
#define EMULATION_STORE(name)             \
  template <class T>                      \
  void name(T* p, ::emulation::As<T> v) { \
    ::emulation::require_alignment(p);    \
    *p = v;                               \
  }
EMULATION_STORE(__stwb)
EMULATION_STORE(__stcg)
EMULATION_STORE(__stcs)
EMULATION_STORE(__stwt)

// ---- Asynchronous copies: they happen as late as they may ----

namespace emulation {
inline void copy_later(void* to, const void* from, std::size_t size, std::size_t zeros) {
  if (reinterpret_cast<std::uintptr_t>(to) % size != 0 || reinterpret_cast<std::uintptr_t>(from) % size != 0)
    throw std::runtime_error("asynchronous copy: misaligned address");
  running->copies.push_back([=] {
    std::memcpy(to, from, size - zeros);
    std::memset(static_cast<char*>(to) + size - zeros, 0, zeros);
  });
}
inline void commit_copies() {
  running->copy_groups.push_back(running->copies.size());
}
/// All but the last `left` groups are done.
inline void finish_copies(std::size_t left) {
  Fiber& f = *running;
  if (f.copy_groups.size() <= left) return;
  const std::size_t groups = f.copy_groups.size() - left, copies = f.copy_groups[groups - 1];
  for (std::size_t i = 0; i < copies; ++i) f.copies[i]();
  f.copies.erase(f.copies.begin(), f.copies.begin() + static_cast<std::ptrdiff_t>(copies));
  f.copy_groups.erase(f.copy_groups.begin(), f.copy_groups.begin() + static_cast<std::ptrdiff_t>(groups));
  for (std::size_t& end : f.copy_groups) end -= copies;
}
inline void finish_all_copies() {
  commit_copies();
  finish_copies(0);
}
}  // namespace emulation
inline void __pipeline_memcpy_async(void* to, const void* from, std::size_t size, std::size_t zeros = 0) {
  ::emulation::copy_later(to, from, size, zeros);
}
inline void __pipeline_commit() {
  ::emulation::commit_copies();
}
inline void __pipeline_wait_prior(std::size_t left) {
  ::emulation::finish_copies(left);
}

// ---- Bits ----

inline int __float_as_int(float v) {
  return std::bit_cast<int>(v);
}
inline unsigned __float_as_uint(float v) {
  return std::bit_cast<unsigned>(v);
}
inline float __int_as_float(int v) {
  return std::bit_cast<float>(v);
}
inline float __uint_as_float(unsigned v) {
  return std::bit_cast<float>(v);
}
inline long long __double_as_longlong(double v) {
  return std::bit_cast<long long>(v);
}
inline double __longlong_as_double(long long v) {
  return std::bit_cast<double>(v);
}
inline int __popc(unsigned v) {
  return std::popcount(v);
}
inline int __popcll(unsigned long long v) {
  return std::popcount(v);
}
inline int __clz(int v) {
  return std::countl_zero(static_cast<unsigned>(v));
}
inline int __clzll(long long v) {
  return std::countl_zero(static_cast<unsigned long long>(v));
}
inline int __ffs(int v) {
  return v == 0 ? 0 : std::countr_zero(static_cast<unsigned>(v)) + 1;
}
inline int __ffsll(long long v) {
  return v == 0 ? 0 : std::countr_zero(static_cast<unsigned long long>(v)) + 1;
}
inline unsigned __brev(unsigned v) {
  unsigned r = 0;
  for (int i = 0; i < 32; ++i) r |= (v >> i & 1u) << (31 - i);
  return r;
}
inline int __umulhi_s(int a, int b) {
  return static_cast<int>(static_cast<long long>(a) * b >> 32);
}
inline int __mulhi(int a, int b) {
  return __umulhi_s(a, b);
}
inline unsigned __umulhi(unsigned a, unsigned b) {
  return static_cast<unsigned>(static_cast<unsigned long long>(a) * b >> 32);
}
inline unsigned long long __umul64hi(unsigned long long a, unsigned long long b) {
  return static_cast<unsigned long long>(static_cast<unsigned __int128>(a) * b >> 64);
}
inline int __mul24(int a, int b) {
  return (a << 8 >> 8) * (b << 8 >> 8);
}
inline unsigned __funnelshift_l(unsigned low, unsigned high, unsigned by) {
  by &= 31u;
  return by == 0 ? high : high << by | low >> (32u - by);
}
inline unsigned __funnelshift_r(unsigned low, unsigned high, unsigned by) {
  by &= 31u;
  return by == 0 ? low : high << (32u - by) | low >> by;
}
inline unsigned __funnelshift_lc(unsigned low, unsigned high, unsigned by) {
  return by >= 32u ? low : __funnelshift_l(low, high, by);
}
inline unsigned __funnelshift_rc(unsigned low, unsigned high, unsigned by) {
  return by >= 32u ? high : __funnelshift_r(low, high, by);
}
inline unsigned __byte_perm(unsigned a, unsigned b, unsigned s) {
  const unsigned long long both = static_cast<unsigned long long>(b) << 32 | a;
  unsigned r = 0;
  for (int i = 0; i < 4; ++i) {
    const unsigned pick = s >> (4 * i) & 0xfu;
    unsigned byte = static_cast<unsigned>(both >> (8 * (pick & 7u))) & 0xffu;
    if (pick & 8u) byte = byte & 0x80u ? 0xffu : 0u;
    r |= byte << (8 * i);
  }
  return r;
}
inline int __dp4a(int a, int b, int c) {
  for (int i = 0; i < 4; ++i)
    c += static_cast<int>(static_cast<signed char>(a >> (8 * i))) *
         static_cast<int>(static_cast<signed char>(b >> (8 * i)));
  return c;
}
inline unsigned __dp4a(unsigned a, unsigned b, unsigned c) {
  for (int i = 0; i < 4; ++i) c += (a >> (8 * i) & 0xffu) * (b >> (8 * i) & 0xffu);
  return c;
}
// ---- Arithmetic ----

#define EMULATION_MIN_MAX(R, A, B)                                                        \
  inline constexpr R min(A a, B b) {                                                      \
    return static_cast<R>(b) < static_cast<R>(a) ? static_cast<R>(b) : static_cast<R>(a); \
  }                                                                                       \
  inline constexpr R max(A a, B b) {                                                      \
    return static_cast<R>(a) < static_cast<R>(b) ? static_cast<R>(b) : static_cast<R>(a); \
  }
EMULATION_MIN_MAX(int, int, int)
EMULATION_MIN_MAX(unsigned, unsigned, unsigned)
EMULATION_MIN_MAX(unsigned, int, unsigned)
EMULATION_MIN_MAX(unsigned, unsigned, int)
EMULATION_MIN_MAX(long, long, long)
EMULATION_MIN_MAX(unsigned long, unsigned long, unsigned long)
EMULATION_MIN_MAX(unsigned long, long, unsigned long)
EMULATION_MIN_MAX(unsigned long, unsigned long, long)
EMULATION_MIN_MAX(long long, long long, long long)
EMULATION_MIN_MAX(unsigned long long, unsigned long long, unsigned long long)
EMULATION_MIN_MAX(unsigned long long, long long, unsigned long long)
EMULATION_MIN_MAX(unsigned long long, unsigned long long, long long)
inline float min(float a, float b) {
  return fminf(a, b);
}
inline float max(float a, float b) {
  return fmaxf(a, b);
}
inline double min(double a, double b) {
  return fmin(a, b);
}
inline double max(double a, double b) {
  return fmax(a, b);
}
inline double min(float a, double b) {
  return fmin(a, b);
}
inline double max(float a, double b) {
  return fmax(a, b);
}
inline double min(double a, float b) {
  return fmin(a, b);
}
inline double max(double a, float b) {
  return fmax(a, b);
}
using std::abs;

inline float rsqrtf(float x) {
  return static_cast<float>(1.0 / std::sqrt(static_cast<double>(x)));
}
inline double rsqrt(double x) {
  return 1.0 / std::sqrt(x);
}
inline float rcbrtf(float x) {
  return static_cast<float>(1.0 / std::cbrt(static_cast<double>(x)));
}
inline float norm3df(float a, float b, float c) {
  return static_cast<float>(std::sqrt(double(a) * a + double(b) * b + double(c) * c));
}
inline float rnorm3df(float a, float b, float c) {
  return static_cast<float>(1.0 / std::sqrt(double(a) * a + double(b) * b + double(c) * c));
}
inline void sincospif(float x, float* s, float* c) {
  *s = static_cast<float>(std::sin(M_PI * x));
  *c = static_cast<float>(std::cos(M_PI * x));
}
inline float sinpif(float x) {
  return static_cast<float>(std::sin(M_PI * x));
}
inline float cospif(float x) {
  return static_cast<float>(std::cos(M_PI * x));
}
inline float __saturatef(float x) {
  return x > 0.0f ? (x < 1.0f ? x : 1.0f) : 0.0f;  // NaN gives 0
}
inline float __fdividef(float a, float b) {
  // As documented: 0 for 2^126 < |b| < 2^128, NaN if a is infinite there.
  if (std::fabs(b) > 0x1p126f && std::fabs(b) <= FLT_MAX) return a * 0.0f;
  return a / b;
}
inline float __frcp_rn(float x) {
  return 1.0f / x;
}
inline float __fsqrt_rn(float x) {
  return std::sqrt(x);
}
inline float __frsqrt_rn(float x) {
  return rsqrtf(x);
}
inline float __fadd_rn(float a, float b) {
  return a + b;
}
inline float __fsub_rn(float a, float b) {
  return a - b;
}
inline float __fmul_rn(float a, float b) {
  return a * b;
}
inline float __fdiv_rn(float a, float b) {
  return a / b;
}
inline float __fmaf_rn(float a, float b, float c) {
  return std::fma(a, b, c);
}
inline double __dadd_rn(double a, double b) {
  return a + b;
}
inline double __dmul_rn(double a, double b) {
  return a * b;
}
namespace emulation {
// The nearest result r and the sign of exact - r give the directed ones.
inline float down(float r, double below) {
  return below < 0.0 ? std::nextafter(r, -INFINITY) : r;
}
inline float up(float r, double above) {
  return above > 0.0 ? std::nextafter(r, INFINITY) : r;
}
inline double sum_error(float a, float b, float r) {
  // Knuth's two-sum in double, of floats: exact.
  const double x = a, y = b, s = x + y, t = s - x, e = (x - (s - t)) + (y - t);
  return std::isfinite(r) ? (s - static_cast<double>(r)) + e : 0.0;
}
inline double product_error(float a, float b, float r) {
  return std::isfinite(r) ? static_cast<double>(a) * b - static_cast<double>(r) : 0.0;
}
}  // namespace emulation
inline float __fadd_rd(float a, float b) {
  return ::emulation::down(a + b, ::emulation::sum_error(a, b, a + b));
}
inline float __fadd_ru(float a, float b) {
  return ::emulation::up(a + b, ::emulation::sum_error(a, b, a + b));
}
inline float __fsub_rd(float a, float b) {
  return __fadd_rd(a, -b);
}
inline float __fsub_ru(float a, float b) {
  return __fadd_ru(a, -b);
}
inline float __fmul_rd(float a, float b) {
  return ::emulation::down(a * b, ::emulation::product_error(a, b, a * b));
}
inline float __fmul_ru(float a, float b) {
  return ::emulation::up(a * b, ::emulation::product_error(a, b, a * b));
}
// Fast functions: their errors (documented: a few units) are not imitated.
inline float __expf(float x) {
  return std::exp(x);
}
inline float __exp10f(float x) {
  return std::pow(10.0f, x);
}
inline float __logf(float x) {
  return std::log(x);
}
inline float __log2f(float x) {
  return std::log2(x);
}
inline float __log10f(float x) {
  return std::log10(x);
}
inline float __powf(float x, float y) {
  return std::pow(x, y);
}
inline float __sinf(float x) {
  return std::sin(x);
}
inline float __cosf(float x) {
  return std::cos(x);
}
inline float __tanf(float x) {
  return std::tan(x);
}
inline void __sincosf(float x, float* s, float* c) {
  *s = std::sin(x), *c = std::cos(x);
}

// Conversions saturate and take NaN for 0, as the device's do.
namespace emulation {
template <class I>
I saturated(double v) {
  if (std::isnan(v)) return 0;
  if (v <= static_cast<double>(std::numeric_limits<I>::min())) return std::numeric_limits<I>::min();
  if (v >= static_cast<double>(std::numeric_limits<I>::max())) return std::numeric_limits<I>::max();
  return static_cast<I>(v);
}
}  // namespace emulation
#define EMULATION_CONVERT(name, I)                       \
  inline I name##_rn(float v) {                          \
    return ::emulation::saturated<I>(std::nearbyint(v)); \
  }                                                      \
  inline I name##_rd(float v) {                          \
    return ::emulation::saturated<I>(std::floor(v));     \
  }                                                      \
  inline I name##_ru(float v) {                          \
    return ::emulation::saturated<I>(std::ceil(v));      \
  }                                                      \
  inline I name##_rz(float v) {                          \
    return ::emulation::saturated<I>(std::trunc(v));     \
  }
EMULATION_CONVERT(__float2int, int)
EMULATION_CONVERT(__float2uint, unsigned)
EMULATION_CONVERT(__float2ll, long long)
EMULATION_CONVERT(__float2ull, unsigned long long)
inline float __int2float_rn(int v) {
  return static_cast<float>(v);
}
inline float __uint2float_rn(unsigned v) {
  return static_cast<float>(v);
}
inline float __ll2float_rn(long long v) {
  return static_cast<float>(v);
}
inline float __double2float_rn(double v) {
  return static_cast<float>(v);
}
