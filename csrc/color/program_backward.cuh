// Included by program_backward.cu and program_double.cu: gradients of colour programs on CUDA. What went into each step
// is computed again and kept by the thread, but for the last step, where it still is in registers: one step keeps
// nothing.
#pragma once

#include "program.cuh"

namespace kv::cuda {
namespace {

template <class F, int C>
__global__ void __launch_bounds__(kThreads, 3) run_backward(__grid_constant__ ProgramBackward<F> const p) {
  constexpr int P = kTaken<F>;
  Program<F> const& q = p.forward;
  __shared__ Sample<F> sample;
  using Vectors = Asked<F, C, P>;
  bool const asks = Vectors::of(q.x) && Vectors::of(p.grad) && q.x.type == p.grad.type;
  __shared__ F slopes[kThreads / 32][kMostParameters];
  for (int64_t n = blockIdx.y; n < q.samples; n += gridDim.y) {
    int64_t const b = sample_of(q, n), from = q.x.offset(b), from_grad = p.grad.offset(b);
    int64_t const to = p.wants_x ? p.grad_x.offset(b) : 0;
    F measured = 0;
    sample.prepare(q, b, true);
    int const last = p.last_input(sample.length, [&](int s) { return sample.order[s].at; });
    for (int k = int(threadIdx.x % 32); k < kMostParameters; k += 32) slopes[threadIdx.x / 32][k] = 0;
    __syncwarp();
    for (int64_t chunk = blockIdx.x; chunk < chunks_of<F>(q.pixels); chunk += gridDim.x) {
      int64_t const i = chunk * kChunk<F> + threadIdx.x * P, i_of_x = p.reads_x ? i : q.pixels;
      F c[C][P], g[C][P], kept[kMostSteps - 1][C][P];
      auto const take_both = [&](auto stored) {  // all that there is, before any of it is waited for
        using T = decltype(stored);
        Vectors x, grad;
        x.fill(x.kSome);
        grad.fill(0);
        if (i_of_x < q.pixels) x.template ask_for<T>(q.x, from + i);
        if (i < q.pixels) grad.template ask_for<T>(p.grad, from_grad + i);
        x.template take_as<T>(c);
        grad.template take_as<T>(g);
      };
      if (!asks) {
        load_pixels(q.x, from, i_of_x, q.pixels, F(0.5), c);
        load_pixels(p.grad, from_grad, i, q.pixels, F(0), g);
      } else if (q.x.type == DType::float16) {
        take_both(Half{});
      } else if (q.x.type == DType::bfloat16) {
        take_both(BFloat16{});
      } else {
        take_both(F{});
      }
      for (int s = 0; s < last; ++s) {
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) kept[s][k][j] = c[k][j];
        auto const place = sample.order[s];
        Values<F, C, P> values{c, sample.p + place.first};
        run_step(place.step, values);
      }
      for (int s = sample.length; s-- > 0;) {
        auto const [at, step, first] = sample.order[s];
        F const* const parameters = sample.p + first;
        if (q.measures && step == Step::contrast) {  // not by a Slope, whose pixels go through memory
#pragma unroll
          for (int k = 0; k < C; ++k)
#pragma unroll
            for (int j = 0; j < P; ++j) measured += pull_grey(c[k][j], g[k][j], sample.mean, parameters[0]);
          break;
        }
        for (int wanted = 0; p.slopes && takes_tensors(step) && wanted < parameters_of(step); ++wanted) {
          int const column = q.column[first + wanted];
          if (column < 0) continue;
          Slope<F, C, P> slope{c, g, parameters, wanted, 0};
          run_step(step, slope);
          F const sum = warp_sum(slope.sum);
          if (threadIdx.x % 32 == 0) slopes[threadIdx.x / 32][column] += sum;
        }
        Pullback<F, C, P> pullback{c, g, parameters};
        run_step(step, pullback);
        if (step == Step::contrast)
#pragma unroll
          for (int k = 0; k < C; ++k)
#pragma unroll
            for (int j = 0; j < P; ++j)
              if (i + j < q.pixels)  // what is beyond adds nothing to the gradients of parameters
                g[k][j] += sample.mean_slope * q.grey[k];
        if (s > 0 && s <= last)
#pragma unroll
          for (int k = 0; k < C; ++k)
#pragma unroll
            for (int j = 0; j < P; ++j) c[k][j] = kept[s - 1][k][j];
      }
      if (p.wants_x && !q.measures) store_pixels(p.grad_x, to, i, q.pixels, g);
    }
    if (q.measures) {
      measured = sample.sum_of_block(measured);
      if (threadIdx.x == 0) q.parts[b * gridDim.x + blockIdx.x] = measured;
    } else if (p.slopes) {
      __syncthreads();
      if (int(threadIdx.x) < p.columns) {
        F sum = 0;
        for (int warp = 0; warp < kThreads / 32; ++warp) sum += slopes[warp][threadIdx.x];
        p.slopes[(b * gridDim.x + blockIdx.x) * p.columns + threadIdx.x] = sum;
      }
    }
  }
}

// A block for each number of the result.
template <class F>
__global__ void __launch_bounds__(kThreads) reduce(ProgramReduce<F> const p) {
  __shared__ Sample<F> sample;
  F sum = 0;
  for (int64_t k = threadIdx.x; k < p.summands; k += kThreads) sum += p.first(blockIdx.x)[k * p.columns];
  sum = sample.sum_of_block(sum);
  if (threadIdx.x == 0) p.y[blockIdx.x] = sum;
}

}  // namespace

template <class F>
int program_backward(ProgramBackward<F> const& given, CUstream_st* stream) {
  ProgramBackward<F> p = given;
  Program<F> const& q = p.forward;
  for (Pixels* x : {&p.forward.x, &p.grad, &p.grad_x}) set_access<F, kTaken<F>>(*x, q.pixels);
  dim3 const grid = grid_of(q.samples, q.measures ? q.parts_count : shares_of<F>(q.samples, q.pixels));
  if (q.x.channels == 1)
    run_backward<F, kValue<F>><<<grid, kThreads, 0, stream>>>(p);
  else
    run_backward<F, 3><<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class F>
int program_reduce(ProgramReduce<F> const& p, CUstream_st* stream) {
  reduce<<<unsigned(p.count), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::cuda
