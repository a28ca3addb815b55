// Included by program.cu and program_double.cu: colour programs on CUDA, and the mean that goes into one.
#pragma once

#include "program.cuh"

namespace kv::cuda {
namespace {

template <class F, int C>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Program<F> const p) {
  constexpr int P = kTaken<F>;
  __shared__ Sample<F> sample;
  for (int64_t n = blockIdx.y; n < p.samples; n += gridDim.y) {
    int64_t const b = sample_of(p, n), from = p.x.offset(b), to = p.measures ? 0 : p.y.offset(b);
    F measured = 0;
    int64_t const first = (blockIdx.x * int64_t(kThreads) + threadIdx.x) * P,
                  stride = gridDim.x * int64_t(kThreads * P);
    // The next pixels are asked for before the steps go over these.
    bool const asks = Asked<F, C, P>::of(p.x);
    Asked<F, C, P> ahead;
    if (asks) ahead.ask(p.x, from, first, p.pixels);
    sample.prepare(p, b, false);
    for (int64_t i = first; i - threadIdx.x * P < p.pixels; i += stride) {
      F c[C][P];
      if (asks) {
        ahead.take(p.x, c);
        ahead.ask(p.x, from, i + stride, p.pixels);
      } else {
        load_pixels(p.x, from, i, p.pixels, F(0), c);
      }
      for (int s = 0; s < sample.length; ++s) {
        auto const place = sample.order[s];
        if (p.measures && place.step == Step::contrast) break;
        Values<F, C, P> values{c, sample.p + place.first};
        run_step(place.step, values);
      }
      if (!p.measures) {
        store_pixels(p.y, to, i, p.pixels, c);
        continue;
      }
#pragma unroll
      for (int k = 0; k < C; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j)
          if (i + j < p.pixels) measured += c[k][j] * p.grey[k];
    }
    if (p.measures) {
      measured = sample.sum_of_block(measured);
      if (threadIdx.x == 0) p.parts[b * gridDim.x + blockIdx.x] = measured;
    } else if (p.contrast >= 0 && blockIdx.x == 0 && threadIdx.x == 0) {
      p.means[b] = sample.mean;
    }
  }
}

}  // namespace

template <class F>
int program(Program<F> const& given, CUstream_st* stream) {
  Program<F> p = given;
  constexpr int P = kTaken<F>;
  for (Pixels* x : {&p.x, &p.y}) set_access<F, P>(*x, p.pixels);
  dim3 const grid = grid_of(p.samples, p.measures ? p.parts_count : shares_of<F>(p.samples, p.pixels));
  if (p.x.channels == 1)
    run<F, kValue<F>><<<grid, kThreads, 0, stream>>>(p);
  else
    run<F, 3><<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::cuda
