// The backward kernel of color programs on CUDA. The input of each step is computed again and kept by the thread. The
// input of the last step is still in registers, so a program of one step keeps nothing.
//
// Contrast around a mean takes two runs. The first one computes the gradient of the contrast's result and sums that of
// the mean. It stores the former in the result, if it can, and the second run begins there.
#pragma once

#include "program.cuh"

namespace kv::color::cuda {
namespace {

template <class F>
using PartialGrads = F[kThreads / 32][kMaxParameters];

// What a block does of a sample whose pixels begin at elements `from` of x, `from_grad` of its gradient and `to` of
// that of x: it is one of `blocks`. The block's part of the gradient of the mean goes to `part`, and those of the
// parameters to `parameter_parts`.
template <class F, int C, bool Elements>
__device__ __forceinline__ void run_backward_block(ProgramBackward<F> const& p, Sample<F>& sample,
                                                   PartialGrads<F>& partial_grads, Pixels const& x, Pixels const& grad,
                                                   Pixels const& grad_x, int64_t b, int64_t from, int64_t from_grad,
                                                   int64_t to, int64_t pixels, int block, int blocks, F* part,
                                                   F* parameter_parts, MeanParts<F> const& mean) {
  constexpr int P = kPixelsPerThread<F>;
  Program<F> const& q = p.forward;
  using Prefetched = PrefetchedPixels<F, C, P, Elements>;
  bool const prefetches = Prefetched::supports(x) && Prefetched::supports(grad) && x.type == grad.type;
  ThreadPixels<P, Elements> const own(x, from);
  F partial_mean = 0;
  sample.prepare(q, b, true, mean);
  bool const has_contrast = sample.steps_before_mean < sample.length;
  if (p.resumes && !q.measures_mean && !has_contrast) return;  // the first run has done it all
  int const length = p.resumes && !q.measures_mean ? sample.steps_before_mean + 1 : sample.length;
  int const first_kept = q.measures_mean && has_contrast ? sample.steps_before_mean : 0;  // the first run ends there
  int const last = p.last_input(length, [&](int s) { return sample.order[s].index; });
  for (int k = int(threadIdx.x % 32); k < kMaxParameters; k += 32) partial_grads[threadIdx.x / 32][k] = 0;
  __syncwarp();
  int64_t const stride = blocks * kChunk<F>;
  for (int64_t chunk = block * kChunk<F> - own.skew; chunk < pixels; chunk += stride) {
    int64_t const i = chunk + own.position, i_input = p.reads_input ? i : pixels;
    F c[C][P], g[C][P], inputs[kMaxSteps - 1][C][P];
    auto const load_both = [&](auto stored) {  // issues all loads before it waits for any
      using T = decltype(stored);
      Prefetched of_x, of_grad;
      of_x.fill(of_x.kOrdinaryBits);
      of_grad.fill(0);
      of_x.template fetch_as<T>(x, from, i_input, pixels);
      of_grad.template fetch_as<T>(grad, from_grad, i, pixels);
      of_x.template convert_from<T>(x, c);
      of_grad.template convert_from<T>(grad, g);
    };
    if (!prefetches) {
      load_pixels<Elements>(x, from, i_input, pixels, F(0.5), c);
      load_pixels<Elements>(grad, from_grad, i, pixels, F(0), g);
    } else if (x.type == DType::float16) {
      load_both(Half{});
    } else if (x.type == DType::bfloat16) {
      load_both(BFloat16{});
    } else {
      load_both(F{});
    }
    for (int s = 0; s < last; ++s) {
      if (s >= first_kept)
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) inputs[s][k][j] = c[k][j];
      auto const entry = sample.order[s];
      EvaluateStep<F, C, P> values{c, sample.p + entry.first};
      run_step(entry.step, values);
    }
    for (int s = length; s-- > 0;) {
      auto const [index, step, first, _] = sample.order[s];
      F const* const parameters = sample.p + first;
      if (q.measures_mean && step == Step::contrast) {  // a StepParameterGradient would spill its pixels to memory
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) partial_mean += blend_vjp_gray(c[k][j], g[k][j], sample.mean, parameters[0]);
        break;
      }
      for (int i_parameter = 0; p.partial_grads && takes_tensors(step) && i_parameter < parameters_of(step);
           ++i_parameter) {
        int const column = q.column[first + i_parameter];
        if (column < 0) continue;
        StepParameterGradient<F, C, P> gradient{c, g, parameters, i_parameter, 0};
        run_step(step, gradient);
        F const sum = warp_reduce(gradient.sum, Sum());
        if (threadIdx.x % 32 == 0) partial_grads[threadIdx.x / 32][column] += sum;
      }
      StepInputGradient<F, C, P> input_gradient{c, g, parameters};
      run_step(step, input_gradient);
      if (step == Step::contrast)
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (is_in(i + j * own.apart, pixels))  // pixels that do not exist add nothing to gradients of parameters
              g[k][j] += sample.grad_mean * q.gray_weights[k];
      if (s > 0 && s <= last)
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = inputs[s - 1][k][j];
    }
    if (p.needs_grad_x && (p.resumes || !q.measures_mean)) store_pixels<Elements>(grad_x, to, i, pixels, g);
  }
  if (q.measures_mean) {
    partial_mean = block_sum_to_all(partial_mean, sample.sums);
    if (threadIdx.x == 0) *part = partial_mean;
  } else if (p.partial_grads) {
    __syncthreads();
    if (int(threadIdx.x) < p.columns) {
      F sum = 0;
      for (int warp = 0; warp < kThreads / 32; ++warp) sum += partial_grads[warp][threadIdx.x];
      parameter_parts[threadIdx.x] = sum;
    }
  }
}

template <class F, int C, bool Elements>
__global__ void __launch_bounds__(kThreads, 3) run_backward(__grid_constant__ ProgramBackward<F> const p) {
  __shared__ Sample<F> sample;
  __shared__ PartialGrads<F> partial_grads;
  Program<F> const& q = p.forward;
  for (int64_t n = blockIdx.y; n < q.samples; n += gridDim.y) {
    int64_t const b = sample_of(q, n), to = p.needs_grad_x ? p.grad_x.offset(b) : 0;
    int64_t const part = b * gridDim.x + blockIdx.x;
    run_backward_block<F, C, Elements>(p, sample, partial_grads, q.x, p.grad, p.grad_x, b, q.x.offset(b),
                                       p.grad.offset(b), to, q.pixels, int(blockIdx.x), int(gridDim.x), q.parts + part,
                                       p.partial_grads + part * p.columns, parts_of(q, b));
  }
}

// A block computes one number of the result.
template <class F>
__global__ void __launch_bounds__(kThreads) reduce(ProgramReduce<F> const p) {
  __shared__ Sample<F> sample;
  F sum = 0;
  for (int64_t k = threadIdx.x; k < p.summands; k += kThreads) sum += p.first(blockIdx.x)[k * p.columns];
  sum = block_sum_to_all(sum, sample.sums);
  if (threadIdx.x == 0) p.sums[blockIdx.x] = sum;
}

}  // namespace

template <class F>
int program_backward(ProgramBackward<F> const& params, CUstream_st* stream) {
  ProgramBackward<F> p = params;
  Program<F> const& q = p.forward;
  set_access<F, kPixelsPerThread<F>>({&p.forward.x, &p.grad, &p.grad_x}, q.samples);
  dim3 const grid = grid_of(q.samples, q.measures_mean ? q.parts_count : blocks_per_sample<F>(q.samples, q.pixels));
  with_access<F>(q.x, [&](auto channels, auto elements) {
    run_backward<F, channels.value, elements.value><<<grid, kThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

template <class F>
int program_reduce(ProgramReduce<F> const& p, CUstream_st* stream) {
  reduce<<<unsigned(p.count), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::color::cuda
