// Color programs around a mean in one launch. The blocks of a sample are a cluster. They keep in shared memory the
// pixels up to the contrast step until the mean is known; in the backward pass, the gradients until that of the mean is
// known.
#include "core/cluster.cuh"
#include "program.cuh"
#include "program_clusters.h"

namespace kv::color::cuda {
namespace {

constexpr int kClusterThreads = 512;
constexpr int P = 4;  // pixels of a thread at a time
using Values = float[3][P];

__device__ __forceinline__ void load(float const* at, int64_t plane, Values& c) {
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    auto const vector = *reinterpret_cast<Vector<float, P> const*>(at + k * plane);
#pragma unroll
    for (int j = 0; j < P; ++j) c[k][j] = vector.v[j];
  }
}
__device__ __forceinline__ void keep(float* at, int plane, Values const& c) {
#pragma unroll
  for (int k = 0; k < 3; ++k)
    *reinterpret_cast<Vector<float, P>*>(at + k * plane) = {c[k][0], c[k][1], c[k][2], c[k][3]};
}
__device__ __forceinline__ void store(float* at, int64_t plane, Values const& c) {
#pragma unroll
  for (int k = 0; k < 3; ++k) store_vector(at + k * plane, c[k]);
}

// Pixels i, ... of sample b: planes of floats, or whatever is stored, by vectors in both cases.
template <bool Plain>
__device__ __forceinline__ void load(Pixels const& x, int64_t offset, int i, int64_t pixels, Values& c) {
  if constexpr (Plain)
    load(static_cast<float const*>(x.data) + offset + i, x.channel_stride, c);
  else
    load_pixels<false>(x, offset, i, pixels, 0.f, c);
}
template <bool Plain>
__device__ __forceinline__ void store(Pixels const& y, int64_t offset, int i, int64_t pixels, Values const& c) {
  if constexpr (Plain)
    store(static_cast<float*>(y.data) + offset + i, y.channel_stride, c);
  else
    store_pixels<false>(y, offset, i, pixels, c);
}

// The part of a sample that a block of a cluster has.
struct ClusterPart {
  int64_t b;
  int begin, pixels;
  __device__ __forceinline__ ClusterPart(int all, int part_pixels) {
    b = blockIdx.x / unsigned(kMaxClusterSize);
    begin = int(blockIdx.x % kMaxClusterSize) * part_pixels;
    pixels = clamp(all - begin, 0, part_pixels);
  }
};

// The sum over the threads of a cluster, in the first thread of each block. Followed by cluster_wait, after which
// blocks may end.
__device__ __forceinline__ float cluster_sum(float x) {
  __shared__ float warp_sums[kClusterThreads / 32];
  __shared__ float part;
  x = warp_reduce(x, Sum());
  if (threadIdx.x % 32 == 0) warp_sums[threadIdx.x / 32] = x;
  __syncthreads();
  if (threadIdx.x == 0) {
    float sum = 0;
    for (float const of_warp : warp_sums) sum += of_warp;
    part = sum;
  }
  __syncthreads();
  cluster_arrive();
  cluster_wait();
  float total = 0;
  if (threadIdx.x == 0)
#pragma unroll
    for (int i = 0; i < kMaxClusterSize; ++i)
      total += __int_as_float(load_of_block(reinterpret_cast<int const*>(&part), unsigned(i)));
  __syncthreads();
  cluster_arrive();
  return total;
}

__device__ __forceinline__ void run_steps(Sample<float> const& sample, int begin, int end, Values& c) {
#pragma unroll 1
  for (int s = begin; s < end; ++s) {
    auto const entry = sample.order[s];
    EvaluateStep<float, 3, P, true> values{c, sample.p + entry.first};
    run_step(entry.step, values);
  }
}

template <bool Plain>
__global__ void __launch_bounds__(kClusterThreads, 2)
    run_clusters(__grid_constant__ Program<float> const p, int part_pixels) {
  __shared__ Sample<float> sample;
  extern __shared__ __align__(16) float kept[];
  ClusterPart const part(int(p.pixels), part_pixels);
  int64_t const b = part.b, from = p.x.offset(b), to = p.y.offset(b);
  Values ahead;
  int const first = P * int(threadIdx.x);
  if (first < part.pixels) load<Plain>(p.x, from, part.begin + first, p.pixels, ahead);
  sample.prepare(p, b, false);
  bool const around_mean = sample.steps_before_mean < sample.length;
  // Where the result overwrites the input, all of a sample is read before any of it is written.
  bool const waits = around_mean || p.overwrites;
  float sum = 0;
#pragma unroll 1
  for (int i = first; i < part.pixels; i += P * kClusterThreads) {
    Values c;
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) c[k][j] = ahead[k][j];
    int const next = i + P * kClusterThreads;
    if (next < part.pixels) load<Plain>(p.x, from, part.begin + next, p.pixels, ahead);
    run_steps(sample, 0, sample.steps_before_mean, c);
    if (!waits) {
      store<Plain>(p.y, to, part.begin + i, p.pixels, c);
      continue;
    }
    keep(kept + i, part_pixels, c);
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) sum += c[k][j] * p.gray_weights[k];
  }
  float const total = cluster_sum(sum);
  if (threadIdx.x == 0) {
    float const mean = around_mean ? total / float(p.mean_pixels) : 0;
    if (around_mean) sample.p[sample.mean_parameter] = mean;
    if (part.begin == 0) p.means[b] = mean;
  }
  __syncthreads();
  if (waits)
#pragma unroll 1
    for (int i = first; i < part.pixels; i += P * kClusterThreads) {
      Values c;
      load(kept + i, part_pixels, c);
      run_steps(sample, sample.steps_before_mean, sample.length, c);
      store<Plain>(p.y, to, part.begin + i, p.pixels, c);
    }
  cluster_wait();  // shared memory exists until all blocks have read it
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
    run_step(entry.step, gradient);
  }
}

__global__ void __launch_bounds__(kClusterThreads, 2)
    run_backward_clusters(__grid_constant__ ProgramBackward<float> const p, int part_pixels) {
  Program<float> const& q = p.forward;
  __shared__ Sample<float> sample;
  __shared__ float grad_mean;
  extern __shared__ __align__(16) float kept[];
  ClusterPart const part(int(q.pixels), part_pixels);
  int64_t const b = part.b, plane_x = q.x.channel_stride, plane_grad = p.grad.channel_stride;
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

int64_t part_pixels_of(int64_t pixels) { return ceil_div(ceil_div(pixels, int64_t(kMaxClusterSize)), int64_t(P)) * P; }
size_t bytes_of(int64_t pixels) { return size_t(part_pixels_of(pixels)) * 3 * sizeof(float); }

template <class Kernel>
bool takes_clusters(Kernel* kernel, Program<float> const& p) {
  constexpr int64_t kMaxShared = 112 << 10;  // two blocks on a multiprocessor
  constexpr int64_t kStaticShared = 2 << 10;
  // This does not depend on the number of samples. Two runs are faster for few samples, but they sum in another order,
  // and the result of a sample must not depend on the size of the batch.
  return p.contrast >= 0 && p.x.channels == 3 && p.pixels % P == 0 && has_frequent_steps_only(p) &&
         int64_t(bytes_of(p.pixels)) + kStaticShared <= max_shared_bytes(kMaxShared) && supports_clusters(kernel);
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
  return p;
}
ProgramBackward<float> with_access(ProgramBackward<float> p) {
  set_access<float, P>({&p.forward.x, &p.grad, &p.grad_x}, p.forward.samples);
  p.forward.measures_mean = true;
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
