// Included by program.cu and program_double.cu: colour programs on CUDA, and the mean that goes into one.
#pragma once

#include "program.cuh"

namespace kv::cuda {
namespace {

template <class F, int C>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Program<F> const p) {
  __shared__ Sample<F> sample;
  for (int64_t b = blockIdx.y; b < p.samples; b += gridDim.y) {
    F measured = 0;
    int64_t const first = blockIdx.x * kChunk<F> + threadIdx.x * kTaken<F>, stride = gridDim.x * kChunk<F>;
    F ahead[C][kTaken<F>];
    load_pixels(p.x, b, first, p.pixels, F(0), ahead);
    sample.prepare(p, b, false);
    for (int64_t i = first; i - threadIdx.x * kTaken<F> < p.pixels; i += stride) {
      F c[C][kTaken<F>];
#pragma unroll
      for (int k = 0; k < C; ++k)
#pragma unroll
        for (int j = 0; j < kTaken<F>; ++j) c[k][j] = ahead[k][j];
      load_pixels(p.x, b, i + stride, p.pixels, F(0), ahead);
      for (int s = 0; s < sample.length; ++s) {
        int const at = sample.order[s];
        if (p.measures && at == p.contrast) break;
        Values<F, C> values{c, sample.p + p.first[at]};
        run_step(p.step[at], values);
      }
      if (!p.measures) {
        store_pixels(p.y, b, i, p.pixels, c);
        continue;
      }
#pragma unroll
      for (int k = 0; k < C; ++k)
#pragma unroll
        for (int j = 0; j < kTaken<F>; ++j)
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
int program(Program<F> const& p, CUstream_st* stream) {
  dim3 const grid = grid_of(p.samples, p.measures ? parts_of(p.pixels) : shares_of<F>(p.samples, p.pixels));
  if (p.x.channels == 1)
    run<F, kValue<F>><<<grid, kThreads, 0, stream>>>(p);
  else
    run<F, 3><<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::cuda
