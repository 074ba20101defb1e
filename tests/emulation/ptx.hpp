// The few PTX instructions that references write as inline assembly. One that is missing here does not
// compile; add it, or give the code a plain C++ form under #ifdef GPUPHYS_EMULATED.
#pragma once

#include <string_view>

#include "tests/emulation/runtime.hpp"

namespace emulation {

template <std::size_t N>
struct Text {
  char text[N]{};
  constexpr Text(const char (&t)[N]) {
    for (std::size_t i = 0; i < N; ++i) text[i] = t[i];
  }
  constexpr std::string_view view() const { return {text, N - 1}; }
  /// Up to the first blank or semicolon.
  constexpr std::string_view mnemonic() const { return view().substr(0, view().find_first_of(" ;")); }
};

inline float without_subnormals(float v) {
  return std::fabs(v) < FLT_MIN ? std::copysign(0.0f, v) : v;
}
template <class P>
char* address(P p) {
  if constexpr (std::is_pointer_v<P>)
    return reinterpret_cast<char*>(const_cast<std::remove_const_t<std::remove_pointer_t<P>>*>(p));
  else
    return reinterpret_cast<char*>(static_cast<std::uintptr_t>(p));
}
template <class T>
T* aligned(char* p) {
  require_alignment(reinterpret_cast<T*>(p));
  return reinterpret_cast<T*>(p);
}
template <Text T>
constexpr bool unknown = false;

template <Text T, class... O>
void ptx(O&&... o) {
  constexpr std::string_view m = T.mnemonic();
  [[maybe_unused]] auto all = std::forward_as_tuple(o...);
  [[maybe_unused]] auto at = [&]<std::size_t I>(std::integral_constant<std::size_t, I>) -> decltype(auto) {
    return std::get<I>(all);
  };
#define O_(i) at(std::integral_constant<std::size_t, i>{})
  if constexpr (m == "sqrt.approx.ftz.f32" || m == "sqrt.approx.f32") {
    O_(0) = without_subnormals(std::sqrt(without_subnormals(O_(1))));
  } else if constexpr (m == "rsqrt.approx.ftz.f32" || m == "rsqrt.approx.f32") {
    O_(0) = without_subnormals(rsqrtf(without_subnormals(O_(1))));
  } else if constexpr (m == "rcp.approx.ftz.f32") {
    O_(0) = without_subnormals(1.0f / without_subnormals(O_(1)));
  } else if constexpr (m == "rcp.approx.f32") {
    O_(0) = 1.0f / O_(1);
  } else if constexpr (m == "ex2.approx.ftz.f32" || m == "ex2.approx.f32") {
    O_(0) = std::exp2(O_(1));
  } else if constexpr (m == "lg2.approx.ftz.f32" || m == "lg2.approx.f32") {
    O_(0) = std::log2(O_(1));
  } else if constexpr (m == "bfind.u32") {
    const auto v = static_cast<unsigned>(O_(1));
    O_(0) = static_cast<std::decay_t<decltype(O_(0))>>(
        v == 0 ? 0xffffffffu : 31u - static_cast<unsigned>(std::countl_zero(v)));
  } else if constexpr (T.view() == "mov.u32 %0, %%laneid;") {
    O_(0) = static_cast<std::decay_t<decltype(O_(0))>>(running->number % 32);
  } else if constexpr (m == "mov.u64" || m == "cvt.u32.u64" || m == "mov.u32") {
    using To = std::decay_t<decltype(O_(0))>;
    if constexpr (std::is_pointer_v<To>)
      O_(0) = reinterpret_cast<To>(address(O_(1)));
    else if constexpr (std::is_pointer_v<std::decay_t<decltype(O_(1))>>)
      O_(0) = static_cast<std::decay_t<decltype(O_(0))>>(reinterpret_cast<std::uintptr_t>(O_(1)));
    else
      O_(0) = static_cast<std::decay_t<decltype(O_(0))>>(O_(1));
  } else if constexpr (m == "" || m == "griddepcontrol.launch_dependents" || m == "griddepcontrol.wait" ||
                       m == "fence.acq_rel.gpu" || m == "prefetch.global.L2" || m == "membar.gl") {
    look_around();
  } else if constexpr (m == "st.shared.v2.b32") {
    *shared_pointer<int2>(O_(0)) = {static_cast<int>(O_(1)), static_cast<int>(O_(2))};
  } else if constexpr (m == "ld.shared.v2.b32") {
    const int2 v = *shared_pointer<int2>(O_(2));
    O_(0) = v.x, O_(1) = v.y;
  } else if constexpr (m == "st.global.v2.f32") {
    *aligned<float2>(address(O_(0))) = {O_(1), O_(2)};
  } else if constexpr (m == "st.global.v4.f32") {
    *aligned<float4>(address(O_(0))) = {O_(1), O_(2), O_(3), O_(4)};
  } else if constexpr (m == "red.global.add.v2.f32") {
    atomicAdd(aligned<float2>(address(O_(0))), float2{O_(1), O_(2)});
  } else if constexpr (m == "red.global.add.v4.f32") {
    atomicAdd(aligned<float4>(address(O_(0))), float4{O_(1), O_(2), O_(3), O_(4)});
  } else if constexpr (m == "cp.async.cg.shared.global" || m == "cp.async.ca.shared.global") {
    constexpr std::size_t size = T.view().find("], 16") != std::string_view::npos  ? 16
                                 : T.view().find("], 8") != std::string_view::npos ? 8
                                                                                   : 4;
    std::size_t bytes = size;
    if constexpr (sizeof...(O) > 2) bytes = static_cast<std::size_t>(O_(2));
    copy_later(shared_pointer<char>(static_cast<unsigned>(O_(0))), address(O_(1)), size, size - bytes);
  } else if constexpr (m == "cp.async.commit_group") {
    commit_copies();
  } else if constexpr (m == "cp.async.wait_all") {
    finish_all_copies();
  } else if constexpr (m == "cp.async.wait_group") {
    finish_copies(static_cast<std::size_t>(O_(0)));
  } else if constexpr (m == "bar.sync") {
    // "bar.sync 1, %0;"
    running_block->named_barrier(T.view()[9] - '0', static_cast<int>(O_(0)), Site{"bar.sync", "", 0});
  } else {
    static_assert(unknown<T>, "this PTX is not emulated");
  }
#undef O_
}

}  // namespace emulation
