// Color programs around a mean in one launch. The blocks of a sample are a cluster. They keep in shared memory the
// pixels up to the contrast step until the mean is known; in the backward pass, the gradients until that of the mean is
// known.
#include "program_clusters.cuh"

namespace kv::color::cuda {
namespace {

template <bool Plain>
__global__ void __launch_bounds__(kClusterThreads, 2)
    run_clusters(__grid_constant__ Program<float> const p, int part_pixels) {
  __shared__ Sample<float> sample;
  extern __shared__ __align__(16) float kept[];
  int64_t const b = cluster_of_block();
  run_cluster<Plain>(p, sample, kept, p.x, p.y, b, p.x.offset(b), p.y.offset(b), p.pixels, part_pixels);
}

// Stores the inputs of steps [begin, end) and runs these steps. c is the input of the first step, and then the result
// of the last one.
using Inputs = Values[kMaxSteps - 1];
__device__ __forceinline__ void keep_inputs(Sample<float> const& sample, int begin, int end, Values& c,
                                            Inputs& inputs) {
#pragma unroll 1
  for (int s = begin; s < end; ++s) {
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) inputs[s][k][j] = c[k][j];
    run_steps(sample, s, s + 1, c);
  }
}
// The gradient of the input of step `begin` from that of the result of step `end - 1`. c is the input of step `last`.
__device__ __forceinline__ void run_vjps(Sample<float> const& sample, int begin, int end, int last, Values& c,
                                         Values& g, Inputs const& inputs) {
#pragma unroll 1
  for (int s = end; s-- > begin;) {
    if (s < last)
#pragma unroll
      for (int k = 0; k < 3; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j) c[k][j] = inputs[s][k][j];
    auto const entry = sample.order[s];
    StepInputGradient<float, 3, P, true> gradient{c, g, sample.p + entry.first};
    run_entry(entry, gradient);
  }
}

__global__ void __launch_bounds__(kClusterThreads, 2)
    run_backward_clusters(__grid_constant__ ProgramBackward<float> const p, int part_pixels) {
  Program<float> const& q = p.forward;
  __shared__ Sample<float> sample;
  __shared__ float grad_mean;
  extern __shared__ __align__(16) float kept[];
  ClusterPart const part(int(q.pixels), part_pixels);
  int64_t const b = cluster_of_block(), plane_x = q.x.channel_stride, plane_grad = p.grad.channel_stride;
  float const* const x = static_cast<float const*>(q.x.data) + q.x.offset(b) + part.begin;
  float const* const grad = static_cast<float const*>(p.grad.data) + p.grad.offset(b) + part.begin * p.grad.step;
  float* const grad_x = static_cast<float*>(p.grad_x.data) + p.grad_x.offset(b) + part.begin;
  bool const is_scalar = p.grad.step == 0;
  float const scalar = is_scalar ? *grad : 0;
  sample.prepare(q, b, true);
  int const before = sample.steps_before_mean;
  bool const waits = before < sample.length;
  auto const step_at = [&](int s) { return sample.order[s].index; };
  int const last = max(p.last_input(sample.length, step_at), 0), last_before = max(p.last_input(before, step_at), 0);
  float const factor = waits ? sample.p[sample.mean_parameter - 1] : 0, mean = sample.mean;
  float sum = 0;
#pragma unroll 1
  for (int i = P * int(threadIdx.x); i < part.pixels; i += P * kClusterThreads) {
    Values c, g;
    Inputs inputs;
    load(x + i, plane_x, c);
    if (is_scalar) {
#pragma unroll
      for (int k = 0; k < 3; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j) g[k][j] = scalar;
    } else {
      load(grad + i, plane_grad, g);
    }
    int const begin = waits ? before : 0;
    run_steps(sample, 0, min(begin, last), c);
    keep_inputs(sample, begin, last, c, inputs);
    run_vjps(sample, waits ? before + 1 : 0, sample.length, last, c, g, inputs);
    if (!waits) {
      store(grad_x + i, p.grad_x.channel_stride, g);
      continue;
    }
    if (before < last)
#pragma unroll
      for (int k = 0; k < 3; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j) c[k][j] = inputs[before][k][j];
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) {
        float const of_blend = clip_vjp((c[k][j] - mean) * factor + mean, g[k][j], true);
        sum += of_blend * (1 - factor);
        g[k][j] = of_blend * factor;
      }
    keep(kept + i, part_pixels, g);
  }
  float const total = cluster_sum(sum);
  if (threadIdx.x == 0) grad_mean = total / float(q.mean_pixels);
  __syncthreads();
  if (waits)
#pragma unroll 1
    for (int i = P * int(threadIdx.x); i < part.pixels; i += P * kClusterThreads) {
      Values c, g;
      Inputs inputs;
      if (before > 0) load(x + i, plane_x, c);
      load(kept + i, part_pixels, g);
#pragma unroll
      for (int k = 0; k < 3; ++k)
#pragma unroll
        for (int j = 0; j < P; ++j) g[k][j] += grad_mean * q.gray_weights[k];
      keep_inputs(sample, 0, min(last_before, before), c, inputs);
      run_vjps(sample, 0, before, last_before, c, g, inputs);
      store(grad_x + i, p.grad_x.channel_stride, g);
    }
  cluster_wait();  // shared memory exists until all blocks have read it
}

template <class Params>
int launch(void (*kernel)(Params, int), Params const& p, Program<float> const& q, cudaStream_t stream) {
  size_t const bytes = bytes_of(q.pixels);
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch_clusters(kernel, unsigned(q.samples * kMaxClusterSize), kClusterThreads, bytes, kMaxClusterSize, stream,
                         p, int(part_pixels_of(q.pixels)));
}

Program<float> with_access(Program<float> p) {
  set_access<float, P>({&p.x, &p.y}, p.samples);
  p.measures_mean = true;  // no other kernel has
  invert_deviations(p);
  return p;
}
ProgramBackward<float> with_access(ProgramBackward<float> p) {
  set_access<float, P>({&p.forward.x, &p.grad, &p.grad_x}, p.forward.samples);
  p.forward.measures_mean = true;
  invert_deviations(p.forward);
  return p;
}

}  // namespace

bool takes_clusters(Program<float> const& params) {
  Program<float> const p = with_access(params);
  // Results begin at vectors, and so do images that are accessed by vectors with them.
  return p.y.channels == 3 && p.y.access != Access::elements && takes_clusters(run_clusters<false>, p);
}
bool takes_clusters(ProgramBackward<float> const& params) {
  ProgramBackward<float> const p = with_access(params);
  bool const plain = p.grad.step == 0 || p.grad.access == Access::plain_vectors;
  return p.needs_grad_x && !p.partial_grads && p.grad.type == DType::float32 && plain &&
         p.grad_x.access == Access::plain_vectors && p.forward.x.access == Access::plain_vectors &&
         takes_clusters(run_backward_clusters, p.forward);
}

int program_by_clusters(Program<float> const& params, CUstream_st* stream) {
  Program<float> const p = with_access(params);
  bool const plain = p.x.access == Access::plain_vectors && p.y.access == Access::plain_vectors;
  return launch(plain ? run_clusters<true> : run_clusters<false>, p, p, stream);
}
int program_backward_by_clusters(ProgramBackward<float> const& params, CUstream_st* stream) {
  ProgramBackward<float> const p = with_access(params);
  return launch(run_backward_clusters, p, p.forward, stream);
}

}  // namespace kv::color::cuda
