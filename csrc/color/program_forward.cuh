// The forward kernel of color programs on CUDA, which also computes means.
#pragma once

#include "program.cuh"
#include "program_step.h"

namespace kv::color::cuda {
namespace {

// What a block does of a sample whose pixels begin at elements `from` of x and `to` of y: it is one of `blocks`. Where
// the program measures a mean, the block's part of it goes to `part`.
template <class F, int C, bool Elements>
__device__ __forceinline__ void run_block(Program<F> const& p, Sample<F>& sample, Pixels const& x, Pixels const& y,
                                          int64_t b, int64_t from, int64_t to, int64_t pixels, int block, int blocks,
                                          F* part, MeanParts<F> const& mean) {
  constexpr int P = kPixelsPerThread<F>;
  F partial_mean = 0;
  ThreadPixels<P, Elements> const own(x, from);
  int64_t const stride = blocks * kChunk<F>;
  int64_t chunk = block * kChunk<F> - own.skew;
  // The next pixels are fetched before the steps work on these.
  bool const prefetches = PrefetchedPixels<F, C, P, Elements>::supports(x);
  PrefetchedPixels<F, C, P, Elements> ahead;
  if (prefetches) ahead.fetch(x, from, chunk + own.position, pixels);
  sample.prepare(p, b, false, mean);
  for (; chunk < pixels; chunk += stride) {
    int64_t const i = chunk + own.position;
    F c[C][P];
    if (prefetches) {
      ahead.convert(x, c);
      ahead.fetch(x, from, i + stride, pixels);
    } else {
      load_pixels<Elements>(x, from, i, pixels, F(0), c);
    }
    for (int s = 0; s < sample.length; ++s) {
      auto const entry = sample.order[s];
      if (p.measures_mean && entry.step == Step::contrast) break;
      EvaluateStep<F, C, P> values{c, sample.p + entry.first};
      run_step(entry.step, values);
    }
    if (!p.measures_mean) {
      store_pixels<Elements>(y, to, i, pixels, c);
      continue;
    }
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (is_in(i + j * own.apart, pixels)) partial_mean += c[k][j] * p.gray_weights[k];
  }
  if (p.measures_mean) {
    partial_mean = block_sum_to_all(partial_mean, sample.sums);
    if (threadIdx.x == 0) *part = partial_mean;
  } else if (p.contrast >= 0 && block == 0 && threadIdx.x == 0) {
    p.means[b] = sample.mean;
  }
}

template <class F, int C, bool Elements>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Program<F> const p) {
  __shared__ Sample<F> sample;
  for (int64_t n = blockIdx.y; n < p.samples; n += gridDim.y) {
    int64_t const b = sample_of(p, n), from = p.x.offset(b), to = p.measures_mean ? 0 : p.y.offset(b);
    run_block<F, C, Elements>(p, sample, p.x, p.y, b, from, to, p.pixels, int(blockIdx.x), int(gridDim.x),
                              p.parts + b * gridDim.x + blockIdx.x, parts_of(p, b));
  }
}

}  // namespace

template <class F>
int program(Program<F> const& params, CUstream_st* stream) {
  if constexpr (sizeof(F) == 4) {
    if (takes_step(params)) return program_of_step(params, stream);
    if (takes_bytes(params)) return program_of_bytes(params, stream);
  }
  Program<F> p = params;
  constexpr int P = kPixelsPerThread<F>;
  set_access<F, P>({&p.x, &p.y}, p.samples);
  dim3 const grid = grid_of(p.samples, p.measures_mean ? p.parts_count : blocks_per_sample<F>(p.samples, p.pixels));
  with_access<F>(p.x, [&](auto channels, auto elements) {
    run<F, channels.value, elements.value><<<grid, kThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

}  // namespace kv::color::cuda
