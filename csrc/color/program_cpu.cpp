// Colour programs on the CPU: chunks [begin, end) of all samples in order. Compiled once per instruction set.
#include "core/lanes.h"
#include "steps.h"

namespace kv::KV_ISA {
namespace {

template <int N, class T>
KV_HD void load_pixels(Pixels<T const> const& x, T const* sample, int64_t i, Lanes<Compute<T>, N> (&c)[3]) {
  for (int k = 0; k < x.channels; ++k) {
    T const* const from = sample + k * x.channel_stride + i * x.step;
    if (x.step == 1) {
      c[k] = load<N>(from);
    } else if constexpr (N == 1) {
      c[k] = load<1>(from);
    } else {
      for (int j = 0; j < N; ++j) c[k][j] = load<1>(from + j * x.step);
    }
  }
}
template <int N, class T>
KV_HD void store_pixels(Pixels<T> const& y, T* sample, int64_t i, Lanes<Compute<T>, N> const (&c)[3]) {
  for (int k = 0; k < y.channels; ++k) {
    T* const to = sample + k * y.channel_stride + i * y.step;
    if (y.step == 1) {
      store<N>(to, c[k]);
    } else if constexpr (N == 1) {
      store<1>(to, c[k]);
    } else {
      for (int j = 0; j < N; ++j) store<1>(to + j * y.step, Compute<T>(c[k][j]));
    }
  }
}

// Calls f(width, sample, pixel) for the pixels of chunks [begin, end).
template <class T, class F>
KV_HD void for_each_pixel(int64_t pixels, int64_t begin, int64_t end, F f) {
  int64_t const chunks = chunks_of(pixels);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / chunks, first = (r - b * chunks) * kChunk;
    for_each_vector<T>(first, min(first + kChunk, pixels), [&](auto width, int64_t i) { f(width, b, i); });
  }
}

}  // namespace

template <class T>
void program(Program<T> const& p, int64_t begin, int64_t end) {
  for_each_pixel<T>(p.x.pixels, begin, end, [&](auto width, int64_t b, int64_t i) {
    constexpr int N = decltype(width)::value;
    Lanes<Compute<T>, N> c[3];
    load_pixels<N>(p.x, p.x.sample(b), i, c);
    run_program<Step::count>(p, c);
    store_pixels<N>(p.y, p.y.sample(b), i, c);
  });
}

template <class T>
void program_backward(ProgramBackward<T> const& p, int64_t begin, int64_t end) {
  for_each_pixel<T>(p.grad.pixels, begin, end, [&](auto width, int64_t b, int64_t i) {
    constexpr int N = decltype(width)::value;
    Lanes<Compute<T>, N> c[3], g[3]{};
    load_pixels<N>(p.forward.x, p.forward.x.sample(b), i, c);
    load_pixels<N>(p.grad, p.grad.sample(b), i, g);
    run_program_backward<Step::count>(p.forward, c, p.grad.channels, g);
    store_pixels<N>(p.grad_x, p.grad_x.sample(b), i, g);
  });
}

KV_INSTANTIATE(program, Program)
KV_INSTANTIATE(program_backward, ProgramBackward)

}  // namespace kv::KV_ISA
