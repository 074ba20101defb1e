// The threads of one block as fibers: each has a stack of its own and runs until it waits for others.
//
// Blocks run one after the other, and so do threads between two waits: nothing here is concurrent. A block's
// warps take turns; within a warp its lanes do. A lane stops at a barrier and at a warp intrinsic, until
// those it waits for have come. When nobody can go on although somebody waits, the block is stuck: an error
// that says who waits where.
#pragma once

#include <sys/mman.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/common_interface_defs.h>
#endif
#ifndef __x86_64__
#include <ucontext.h>
#endif

#include "tests/emulation/vector_types.hpp"

// What a kernel reads about itself: those of the thread that runs.
inline uint3 threadIdx{}, blockIdx{};
inline dim3 blockDim{}, gridDim{};
constexpr int warpSize = 32;

namespace emulation {

/// What memory holds before anybody writes it: a NaN, and an index far outside of anything.
constexpr std::uint32_t kPoison = 0x7fbadbadu;
inline void poison(void* p, std::size_t bytes) {
  auto* to = static_cast<unsigned char*>(p);
  for (std::size_t i = 0; i + 4 <= bytes; i += 4) std::memcpy(to + i, &kPoison, 4);
  for (std::size_t i = bytes / 4 * 4; i < bytes; ++i) to[i] = 0x7f;
}

/// Where in the source a thread waits.
struct Site {
  const char* what = "";
  const char* file = "";
  int line = 0;

  bool operator==(const Site& o) const {
    return line == o.line && std::strcmp(file, o.file) == 0 && std::strcmp(what, o.what) == 0;
  }
  std::string text() const {
    const char* slash = std::strrchr(file, '/');
    return std::string(what) + " in " + (slash ? slash + 1 : file) + ":" + std::to_string(line);
  }
};

enum class State : unsigned char { ready, paused, at_barrier, at_warp, at_named, done };

struct Fiber;
using Lanes = std::array<Fiber*, 32>;  ///< of a warp intrinsic; null where a lane takes no part

struct Fiber {
  void* stack_pointer = nullptr;
  void* stack = nullptr;
  State state = State::ready;
  bool started = false;
  uint3 index{};
  int number = 0;  // in the block
  Site site;
  int named_barrier = 0;
  // A warp intrinsic: what this lane brings, whom it waits for, what it gets.
  unsigned mask = 0;
  std::uint64_t value = 0, result = 0;
  int argument = 0, width = 32;
  void (*finish)(const Lanes&) = nullptr;
#if defined(__SANITIZE_ADDRESS__)
  void* fake_stack = nullptr;
#endif
#ifndef __x86_64__
  ucontext_t context;
#endif
  std::vector<std::function<void()>> copies;  // asynchronous copies that have not been waited for
  std::vector<std::size_t> copy_groups;
};

#ifdef __x86_64__
// Saves the callee-saved registers on the present stack, and its pointer in *from; goes on at `to`.
__attribute__((naked, noinline)) inline void switch_stack([[maybe_unused]] void** from,
                                                          [[maybe_unused]] void* to) {
  asm volatile(
      "pushq %rbp\n pushq %rbx\n pushq %r12\n pushq %r13\n pushq %r14\n pushq %r15\n"
      "movq %rsp, (%rdi)\n movq %rsi, %rsp\n"
      "popq %r15\n popq %r14\n popq %r13\n popq %r12\n popq %rbx\n popq %rbp\n ret\n");
}
#endif

/// In which order warps and lanes take turns, and blocks run: forward (seed 0), backward (1), or shuffled.
struct Order {
  std::uint64_t seed = 0;

  std::vector<int> of(int n, std::uint64_t salt) const {
    std::vector<int> order(static_cast<std::size_t>(n));
    for (int i = 0; i < n; ++i) order[static_cast<std::size_t>(i)] = seed == 1 ? n - 1 - i : i;
    if (seed < 2) return order;
    std::uint64_t state = seed * 0x9e3779b97f4a7c15ull + salt * 0xbf58476d1ce4e5b9ull + 1;
    for (int i = n - 1; i > 0; --i) {
      state ^= state << 13, state ^= state >> 7, state ^= state << 17;
      std::swap(order[static_cast<std::size_t>(i)],
                order[static_cast<std::size_t>(state % static_cast<std::uint64_t>(i + 1))]);
    }
    return order;
  }
};

class Block;
inline Block* running_block = nullptr;
inline Fiber* running = nullptr;

class Block {
 public:
  /// `body` is the kernel with its arguments.
  template <class Body>
  void run(dim3 shape, const Body& body, const Order& order, std::uint64_t number) {
    threads_ = static_cast<int>(shape.x * shape.y * shape.z);
    reserve(threads_);
    for (int t = 0; t < threads_; ++t) {
      Fiber& f = *fibers_[static_cast<std::size_t>(t)];
      const unsigned u = static_cast<unsigned>(t);
      f.state = State::ready;
      f.started = false;
      f.number = t;
      f.index = {u % shape.x, u / shape.x % shape.y, u / shape.x / shape.y};
      f.copies.clear();
      f.copy_groups.clear();
    }
    body_ = [&body] { body(); };
    failure_ = nullptr;
    done_ = waiting_ = 0;
    for (auto& b : named_) b = {};
    barrier_ = {};
    running_block = this;
    blockDim = shape;
    const int warps = (threads_ + 31) / 32;
    const std::vector<int> warp_order = order.of(warps, number), lane_order = order.of(32, number);
    std::uint64_t idle = 0;
    while (done_ < threads_) {
      bool moved = false, paused = false;
      for (const int w : warp_order) {
        const int first = 32 * w, count = std::min(32, threads_ - first);
        for (bool again = true; again;) {
          again = false;
          for (const int lane : lane_order) {
            if (lane >= count) continue;
            Fiber& f = *fibers_[static_cast<std::size_t>(first + lane)];
            if (f.state != State::ready) continue;
            resume(f);
            if (failure_) std::rethrow_exception(failure_);
            again = moved = true;
          }
        }
      }
      for (int t = 0; t < threads_; ++t) {
        Fiber& f = *fibers_[static_cast<std::size_t>(t)];
        if (f.state == State::paused) f.state = State::ready, paused = true;
      }
      if (paused) {
        if (++idle > 2'000'000) throw std::runtime_error("threads spin for ever: " + who_waits());
        continue;
      }
      if (!moved && done_ < threads_) throw std::runtime_error("the block is stuck: " + who_waits());
    }
    running_block = nullptr;
  }

  /// All threads of the block that have not ended; returns sum, or, and of what each brings.
  struct Votes {
    int count = 0, any = 0, all = 1;
  };
  Votes barrier(const Site& site, int vote) {
    if (waiting_ == 0) {
      barrier_ = {};
    } else if (!(site == barrier_site_)) {
      throw std::runtime_error("barrier divergence: thread " + std::to_string(running->number) + " is at " +
                               site.text() + ", thread " + std::to_string(barrier_thread_) + " at " +
                               barrier_site_.text());
    }
    barrier_site_ = site;
    barrier_thread_ = running->number;
    barrier_.count += vote != 0;
    barrier_.any |= vote != 0;
    barrier_.all &= vote != 0;
    ++waiting_;
    running->site = site;
    running->state = State::at_barrier;
    release_barrier();
    if (running->state != State::ready) leave();
    return result_;
  }

  /// `count` threads at barrier `number` (bar.sync).
  void named_barrier(int number, int count, const Site& site) {
    auto& waiting = named_.at(static_cast<std::size_t>(number));
    running->site = site;
    running->named_barrier = number;
    if (++waiting == count) {
      waiting = 0;
      for (auto& f : fibers_)
        if (f->state == State::at_named && f->named_barrier == number) f->state = State::ready;
      return;
    }
    running->state = State::at_named;
    leave();
  }

  /// Waits until every lane of `mask` that has not ended has come here with the same mask. The last one calls
  /// finish(lanes), which fills in `result` of each.
  std::uint64_t warp(const Site& site, unsigned mask, std::uint64_t value, int argument, int width,
                     void (*finish)(const Lanes&)) {
    Fiber& f = *running;
    const int first = f.number / 32 * 32;
    if (!(mask >> (f.number % 32) & 1u))
      throw std::runtime_error(site.text() + ": thread " + std::to_string(f.number) +
                               " is not in its own mask");
    f.site = site;
    f.mask = mask;
    f.value = value;
    f.argument = argument;
    f.width = width;
    f.finish = finish;
    f.state = State::at_warp;
    finish_warp(first, f);
    if (f.state != State::ready) leave();
    return f.result;
  }

  /// Lets the others go on.
  void pause() {
    running->state = State::paused;
    leave();
  }

  /// Lanes of the running warp that have not ended.
  unsigned present() const {
    const int first = running->number / 32 * 32;
    unsigned mask = 0;
    for (int l = 0; l < 32 && first + l < threads_; ++l)
      if (fibers_[static_cast<std::size_t>(first + l)]->state != State::done) mask |= 1u << l;
    return mask;
  }

 private:
  static constexpr std::size_t kStack = 256 * 1024;

  void reserve(int n) {
    while (static_cast<int>(fibers_.size()) < n) {
      auto f = std::make_unique<Fiber>();
      f->stack =
          mmap(nullptr, kStack, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
      if (f->stack == MAP_FAILED) throw std::runtime_error("emulation: no memory for stacks");
      mprotect(f->stack, 4096, PROT_NONE);
      fibers_.push_back(std::move(f));
    }
  }

  static void entry() {
    Block& b = *running_block;
#if defined(__SANITIZE_ADDRESS__)
    __sanitizer_finish_switch_fiber(nullptr, &b.main_bottom_, &b.main_size_);
#endif
    try {
      b.body_();
    } catch (...) {
      b.failure_ = std::current_exception();
    }
    running->state = State::done;
    ++b.done_;
    b.release_after_end();
    b.leave();
    std::abort();
  }

  void resume(Fiber& f) {
    running = &f;
    threadIdx = f.index;
#if defined(__SANITIZE_ADDRESS__)
    __sanitizer_start_switch_fiber(&main_fake_, f.stack, kStack);
#endif
#ifdef __x86_64__
    if (!f.started) {
      f.started = true;
      // Stacks begin at different places within a page, or all threads' locals would share cache sets.
      auto* top =
          static_cast<unsigned char*>(f.stack) + kStack - 64 * static_cast<std::size_t>(f.number % 61) - 64;
      auto** frame = reinterpret_cast<void**>(top);
      *--frame = nullptr;  // where entry() would return to; also aligns the stack
      *--frame = reinterpret_cast<void*>(&Block::entry);
      for (int r = 0; r < 6; ++r) *--frame = nullptr;
      f.stack_pointer = frame;
    }
    switch_stack(&main_stack_, f.stack_pointer);
#else
    if (!f.started) {
      f.started = true;
      getcontext(&f.context);
      f.context.uc_stack.ss_sp = f.stack;
      f.context.uc_stack.ss_size = kStack;
      f.context.uc_link = nullptr;
      makecontext(&f.context, &Block::entry, 0);
    }
    swapcontext(&main_context_, &f.context);
#endif
#if defined(__SANITIZE_ADDRESS__)
    __sanitizer_finish_switch_fiber(main_fake_, nullptr, nullptr);
#endif
  }

  // Back to run(), until resumed.
  void leave() {
    Fiber& f = *running;
#if defined(__SANITIZE_ADDRESS__)
    __sanitizer_start_switch_fiber(f.state == State::done ? nullptr : &f.fake_stack, main_bottom_,
                                   main_size_);
#endif
#ifdef __x86_64__
    switch_stack(&f.stack_pointer, main_stack_);
#else
    swapcontext(&f.context, &main_context_);
#endif
#if defined(__SANITIZE_ADDRESS__)
    __sanitizer_finish_switch_fiber(f.fake_stack, &main_bottom_, &main_size_);
#endif
  }

  void release_barrier() {
    if (waiting_ == 0 || waiting_ < threads_ - done_) return;
    waiting_ = 0;
    result_ = barrier_;
    for (int t = 0; t < threads_; ++t) {
      Fiber& f = *fibers_[static_cast<std::size_t>(t)];
      if (f.state == State::at_barrier) f.state = State::ready;
    }
  }

  // A thread has ended: others may have waited for it alone.
  void release_after_end() {
    release_barrier();
    const int first = running->number / 32 * 32;
    for (int l = 0; l < 32 && first + l < threads_; ++l) {
      const Fiber& f = *fibers_[static_cast<std::size_t>(first + l)];
      if (f.state == State::at_warp) finish_warp(first, f);
    }
  }

  // Completes what `f` waits for if all its lanes have come.
  void finish_warp(int first, const Fiber& f) {
    Lanes lanes{};
    for (int l = 0; l < 32 && first + l < threads_; ++l) {
      if (!(f.mask >> l & 1u)) continue;
      Fiber& g = *fibers_[static_cast<std::size_t>(first + l)];
      if (g.state == State::done) continue;
      if (g.state != State::at_warp || g.mask != f.mask || g.finish != f.finish) return;
      lanes[static_cast<std::size_t>(l)] = &g;
    }
    f.finish(lanes);
    for (Fiber* g : lanes)
      if (g) g->state = State::ready;
  }

  std::string who_waits() const {
    std::string text;
    int named = 0;
    for (int t = 0; t < threads_ && named < 4; ++t) {
      const Fiber& f = *fibers_[static_cast<std::size_t>(t)];
      if (f.state == State::done) continue;
      bool same = false;
      if (t > 0) {
        const Fiber& g = *fibers_[static_cast<std::size_t>(t - 1)];
        same = g.state == f.state && g.site == f.site && g.mask == f.mask;
      }
      if (same) continue;
      char mask[32] = "";
      if (f.state == State::at_warp) std::snprintf(mask, sizeof mask, " (mask %08x)", f.mask);
      text += (named++ ? "; from thread " : "from thread ") + std::to_string(t) + " on at " + f.site.text() +
              mask;
    }
    return text + "; " + std::to_string(done_) + " of " + std::to_string(threads_) + " threads have ended";
  }

  std::vector<std::unique_ptr<Fiber>> fibers_;
  std::function<void()> body_;
  std::exception_ptr failure_;
  int threads_ = 0, done_ = 0, waiting_ = 0;
  Votes barrier_, result_;
  Site barrier_site_;
  int barrier_thread_ = 0;
  std::array<int, 16> named_{};
#ifdef __x86_64__
  void* main_stack_ = nullptr;
#else
  ucontext_t main_context_;
#endif
#if defined(__SANITIZE_ADDRESS__)
  void* main_fake_ = nullptr;
  const void* main_bottom_ = nullptr;
  std::size_t main_size_ = 0;
#endif
};

}  // namespace emulation
