// The forward kernel of color programs on CUDA, which also computes means. Included by program.cu and
// program_double.cu.
#pragma once

#include "program.cuh"

namespace kv::color::cuda {
namespace {

template <class F, int C, bool Elements>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Program<F> const p) {
  constexpr int P = kPixelsPerThread<F>;
  __shared__ Sample<F> sample;
  for (int64_t n = blockIdx.y; n < p.samples; n += gridDim.y) {
    int64_t const b = sample_of(p, n), from = p.x.offset(b), to = p.measures_mean ? 0 : p.y.offset(b);
    F partial_mean = 0;
    ThreadPixels<P, Elements> const own(p.x, b);
    int64_t const stride = gridDim.x * kChunk<F>;
    int64_t chunk = blockIdx.x * kChunk<F> - own.skew;
    // The next pixels are fetched before the steps work on these.
    bool const prefetches = PrefetchedPixels<F, C, P, Elements>::supports(p.x);
    PrefetchedPixels<F, C, P, Elements> ahead;
    if (prefetches) ahead.fetch(p.x, from, chunk + own.position, p.pixels);
    sample.prepare(p, b, false);
    for (; chunk < p.pixels; chunk += stride) {
      int64_t const i = chunk + own.position;
      F c[C][P];
      if (prefetches) {
        ahead.convert(p.x, c);
        ahead.fetch(p.x, from, i + stride, p.pixels);
      } else {
        load_pixels<Elements>(p.x, from, i, p.pixels, F(0), c);
      }
      for (int s = 0; s < sample.length; ++s) {
        auto const entry = sample.order[s];
        if (p.measures_mean && entry.step == Step::contrast) break;
        EvaluateStep<F, C, P> values{c, sample.p + entry.first};
        run_step(entry.step, values);
      }
      if (!p.measures_mean) {
        store_pixels<Elements>(p.y, to, i, p.pixels, c);
        continue;
      }
#pragma unroll
      for (int k = 0; k < C; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j)
          if (is_in(i + j * own.apart, p.pixels)) partial_mean += c[k][j] * p.gray_weights[k];
    }
    if (p.measures_mean) {
      partial_mean = block_sum_to_all(partial_mean, sample.sums);
      if (threadIdx.x == 0) p.parts[b * gridDim.x + blockIdx.x] = partial_mean;
    } else if (p.contrast >= 0 && blockIdx.x == 0 && threadIdx.x == 0) {
      p.means[b] = sample.mean;
    }
  }
}

}  // namespace

template <class F>
int program(Program<F> const& params, CUstream_st* stream) {
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
