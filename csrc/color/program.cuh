// Included by program_<type>.cu. Colour programs on CUDA: a thread takes a few pixels, by packs of 16 bytes. Programs
// of one step are compiled for it; the others read their steps one by one.
#pragma once

#include "core/launch.cuh"

namespace kv {

// What steps.h needs of numbers; for the CPU it is in core/lanes.h.
template <class F, int N>
__device__ __forceinline__ F vexp2(F x) {
  return fast_exp2(x);
}
template <class F, int N>
__device__ __forceinline__ F vlog2(F x) {
  return fast_log2(x);
}
__device__ __forceinline__ float vfloor(float x) { return floorf(x); }
__device__ __forceinline__ double vfloor(double x) { return floor(x); }

}  // namespace kv

#include "steps.h"

namespace kv::cuda {
namespace {

// P pixels of C channels, as C packs: one of each channel, or one after the other with channels inside.
template <class T, int C, int P, bool Inside>
struct Group {
  Pack<T, P> pack[C];

  template <class U>
  static __device__ __forceinline__ U* address(Pixels<U> const& x, int64_t b, int64_t i, int k) {
    return x.sample(b) + (Inside ? C * i + k * P : i + k * x.channel_stride);
  }
  __device__ __forceinline__ void load(Pixels<T const> const& x, int64_t b, int64_t i) {
#pragma unroll
    for (int k = 0; k < C; ++k) pack[k] = *reinterpret_cast<Pack<T, P> const*>(address(x, b, i, k));
  }
  __device__ __forceinline__ void store(Pixels<T> const& y, int64_t b, int64_t i) const {
#pragma unroll
    for (int k = 0; k < C; ++k) *reinterpret_cast<Pack<T, P>*>(address(y, b, i, k)) = pack[k];
  }
  __device__ __forceinline__ void get(int j, Compute<T> (&c)[3]) const {
#pragma unroll
    for (int k = 0; k < C; ++k) c[k] = read(Inside ? pack[(C * j + k) / P].v[(C * j + k) % P] : pack[k].v[j]);
  }
  __device__ __forceinline__ void put(int j, Compute<T> const (&c)[3]) {
#pragma unroll
    for (int k = 0; k < C; ++k) (Inside ? pack[(C * j + k) / P].v[(C * j + k) % P] : pack[k].v[j]) = round_to<T>(c[k]);
  }
};

// Calls f(sample, first pixel) for the groups of P pixels.
template <int P, class F>
__device__ __forceinline__ void for_each_group(int64_t samples, int64_t pixels, F f) {
  int64_t const i = (int64_t(blockIdx.x) * blockDim.x + threadIdx.x) * P;
  if (i >= pixels) return;
  for (int64_t b = blockIdx.y; b < samples; b += gridDim.y) f(b, i);
}

template <class T, int C, int P, bool Inside, Step Only>
__global__ void __launch_bounds__(256) program_groups(__grid_constant__ Program<T> const p) {
  for_each_group<P>(p.x.samples, p.x.pixels, [&](int64_t b, int64_t i) {
    Group<T, 3, P, Inside> from;
    Group<T, C, P, Inside> to;
    from.load(p.x, b, i);
#pragma unroll
    for (int j = 0; j < P; ++j) {
      Compute<T> c[3];
      from.get(j, c);
      run_program<Only>(p, c);
      to.put(j, c);
    }
    to.store(p.y, b, i);
  });
}

template <class T, int C, int P, bool Inside, Step Only>
__global__ void __launch_bounds__(256) program_backward_groups(__grid_constant__ ProgramBackward<T> const p) {
  for_each_group<P>(p.grad.samples, p.grad.pixels, [&](int64_t b, int64_t i) {
    Group<T, 3, P, Inside> x;
    Group<T, C, P, Inside> grad;
    x.load(p.forward.x, b, i);
    grad.load(p.grad, b, i);
#pragma unroll
    for (int j = 0; j < P; ++j) {
      Compute<T> c[3], g[3]{};
      x.get(j, c);
      grad.get(j, g);
      run_program_backward<Only>(p.forward, c, C, g);
      x.put(j, g);
    }
    x.store(p.grad_x, b, i);
  });
}

// Whether groups of P pixels are packs in memory.
template <int P, class T>
bool is_packed(Pixels<T> const& x) {
  constexpr int64_t bytes = alignof(Pack<std::remove_const_t<T>, P>);
  return reinterpret_cast<uintptr_t>(x.data) % bytes == 0 && x.pixels % P == 0;
}

template <int P>
dim3 grid_of(int64_t samples, int64_t pixels) {
  return dim3(unsigned(ceil_div(pixels, int64_t(256) * P)), unsigned(min(samples, int64_t(65535))));
}

template <auto value>
struct Constant {
  static constexpr auto v = value;
};

// Calls launch(C, P, Inside, Only as Constants) for the kernel that fits.
template <class T, Step Only = Step(0), class F>
void choose(Program<T> const& p, int channels, bool packed, bool inside, F launch) {
  if constexpr (Only == Step::count || sizeof(T) == 8) {
    auto const of_channels = [&](auto c) {
      inside ? launch(c, Constant<1>{}, Constant<true>{}, Constant<Step::count>{})
             : launch(c, Constant<1>{}, Constant<false>{}, Constant<Step::count>{});
    };
    channels == 1 ? of_channels(Constant<1>{}) : of_channels(Constant<3>{});
  } else {
    if (!packed || p.steps != 1) return choose<T, Step::count>(p, channels, packed, inside, launch);
    if (p.step[0] != Only) return choose<T, Step(int(Only) + 1)>(p, channels, packed, inside, launch);
    constexpr Constant<Only == Step::weighted_sum ? 1 : 3> c{};
    inside ? launch(c, Constant<kPixels<T>>{}, Constant<true>{}, Constant<Only>{})
           : launch(c, Constant<kPixels<T>>{}, Constant<false>{}, Constant<Only>{});
  }
}

}  // namespace

template <class T>
int program(Program<T> const& p, CUstream_st* stream) {
  bool const packed = is_packed<kPixels<T>>(p.x) && is_packed<kPixels<T>>(p.y);
  choose(p, p.y.channels, packed, p.x.step != 1, [&](auto c, auto pixels, auto inside, auto only) {
    program_groups<T, c.v, pixels.v, inside.v, only.v>
        <<<grid_of<pixels.v>(p.x.samples, p.x.pixels), 256, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

template <class T>
int program_backward(ProgramBackward<T> const& p, CUstream_st* stream) {
  Pixels<T const> const& x = p.forward.x;
  bool const packed = is_packed<kPixels<T>>(x) && is_packed<kPixels<T>>(p.grad) && is_packed<kPixels<T>>(p.grad_x);
  choose(p.forward, p.grad.channels, packed, x.step != 1, [&](auto c, auto pixels, auto inside, auto only) {
    program_backward_groups<T, c.v, pixels.v, inside.v, only.v>
        <<<grid_of<pixels.v>(x.samples, x.pixels), 256, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

}  // namespace kv::cuda
