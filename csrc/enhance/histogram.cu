// Sums of Gaussians on CUDA: each block counts a chunk of a row. Moments are fixed-point sums in shared memory, so that
// the order of atomic additions does not change the result.
#include "core/block_reduce.cuh"
#include "histogram.h"
#include "row_chunks.cuh"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 1024, kWarps = kThreads / 32, kMaxParts = 4;
constexpr int kCells = 3968;  // with what is not dynamic, their sums fit the 64 KiB that every GPU has
template <class T>
constexpr int kBytes = sizeof(T) == sizeof(float) ? 4 * kCells * int(sizeof(int)) : 0;  // of shared memory
constexpr unsigned kAll = 0xffffffffu;

// The grid of a row; it has no cells if they do not fit. `sorted`: centers ascend.
__device__ __forceinline__ MomentGrid grid_of(float const* centers, int bins, float h, bool& sorted) {
  bool finite = true;
  float lowest = centers[0], highest = centers[0];
  sorted = true;
  for (int k = threadIdx.x; k < bins; k += kThreads) {
    float const c = centers[k];
    finite = finite && c - c == 0;
    sorted = sorted && (k == 0 || centers[k - 1] <= c);
    lowest = c < lowest ? c : lowest, highest = c > highest ? c : highest;
  }
  finite = __syncthreads_and(finite);
  sorted = __syncthreads_and(sorted);
  float ends[2] = {-lowest, highest};
  block_reduce<kThreads>(ends, NanMax{});
  return MomentGrid(-ends[0], ends[1], h, finite ? kCells * kMaxParts : 0);
}

// One warp per center.
template <class T>
__device__ __forceinline__ void count_directly(T const* x, int samples, T const* centers, T h, int bins, T* counts) {
  for (int k = threadIdx.x / 32; k < bins; k += kWarps) {
    T const center = centers[k];
    T sum = 0;
    for (int i = threadIdx.x % 32; i < samples; i += 32) {
      T const u = (x[i] - center) / h, g = fast_exp2(u * u * T(-kHalfLog2E));
      sum += x[i] == x[i] ? g : T(0);
    }
    sum = warp_reduce(sum, Sum());
    if (threadIdx.x % 32 == 0) counts[k] = sum;
  }
}

// Moments of kCells cells, a part of the grid.
struct Moments {
  int* sums;
  static constexpr float kScale1 = 1 << 15, kScale2 = 1 << 16,
                         kScale3 = 1 << 17;  // |t| <= 1/2: no scaled term exceeds 2^14

  // Called by all threads of a warp; a thread without a sample passes a negative cell. Equal samples have equal cells,
  // and atomic additions to one cell are serialized: then one thread adds for the whole warp.
  __device__ __forceinline__ void add(int cell, float t) const {
    bool const uniform = __all_sync(kAll, cell == __shfl_sync(kAll, cell, 0));
    if (cell < 0) return;
    float const square = t * t;
    int m0 = 1, m1 = __float2int_rn(t * kScale1), m2 = __float2int_rn(square * kScale2),
        m3 = __float2int_rn(square * t * kScale3);
    if (uniform) {
      m0 = 32, m1 = warp_reduce(m1, Sum()), m2 = warp_reduce(m2, Sum()), m3 = warp_reduce(m3, Sum());
      if (threadIdx.x % 32 != 0) return;
    }
    atomicAdd(sums + cell, m0);
    atomicAdd(sums + cell + kCells, m1);
    atomicAdd(sums + cell + 2 * kCells, m2);
    atomicAdd(sums + cell + 3 * kCells, m3);
  }
  __device__ __forceinline__ float weighted(int cell, float u, float w) const {
    return enhance::weighted(u, w, float(sums[cell]), float(sums[cell + kCells]) * (1 / kScale1),
                             float(sums[cell + 2 * kCells]) * (1 / kScale2),
                             float(sums[cell + 3 * kCells]) * (1 / kScale3));
  }
};

__device__ __forceinline__ void count_by_cells(float const* x, int samples, float const* centers, int bins,
                                               MomentGrid const& grid, float* counts) {
  extern __shared__ __align__(16) int memory[];
  Moments const moments{memory};
  float const per = 1 / grid.bandwidth, w = grid.width * per;
  int const lane = threadIdx.x % 32;
  for (int part = 0; part < grid.cells; part += kCells) {
    int const cells = min(kCells, grid.cells - part);
    __syncthreads();
    for (int i = threadIdx.x; i < 4 * kCells; i += kThreads) memory[i] = 0;
    __syncthreads();
    constexpr int kAtOnce = 4;
    float const first = float(grid.first + part);
    for (int i = int(threadIdx.x); i - lane < samples; i += kThreads * kAtOnce) {
      float v[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        int const at = i + k * kThreads;
        v[k] = at < samples ? x[at] : __int_as_float(0x7fffffff);  // NaN, which is in no cell
      }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        float const position = v[k] * grid.inverse, whole = floorf(position), at = whole - first;
        moments.add(at >= 0 && at < float(cells) ? int(at) : -1, position - whole - 0.5f);
      }
    }
    __syncthreads();
    for (int k = threadIdx.x / 32; k < bins; k += kWarps) {
      float const center = centers[k];
      int const end = min(grid.end(center) - part, cells);
      float sum = 0;
      for (int i = max(grid.begin(center) - part, 0) + lane; i < end; i += 32) {
        float const u = (grid.middle(part + i) - center) * per;
        sum += fast_exp2(u * u * float(-kHalfLog2E)) * moments.weighted(i, u, w);
      }
      sum = warp_reduce(sum, Sum());
      if (lane == 0) counts[k] = part == 0 ? sum : counts[k] + sum;
    }
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) count_chunk(Histogram<T> p) {
  int64_t const row = blockIdx.x / p.chunks, chunk = blockIdx.x - row * p.chunks;
  T const *const x = p.x + row * p.samples + chunk * p.chunk, *const centers = p.centers + row * p.center_stride;
  int const samples = int(min(p.chunk, p.samples - chunk * p.chunk)), bins = int(p.bins);
  T const h = p.bandwidth[row * p.bandwidth_stride];
  T* const counts = p.partial + int64_t(blockIdx.x) * p.bins;
  if constexpr (sizeof(T) == sizeof(float)) {
    bool sorted;
    MomentGrid const grid = grid_of(centers, bins, h, sorted);
    if (grid.cells > 0) return count_by_cells(x, samples, centers, bins, grid, counts);
  }
  count_directly(x, samples, centers, h, bins, counts);
}

// One thread per sample.
template <class T>
__device__ __forceinline__ void differentiate_directly(T const* x, int samples, T const* centers, T h, int bins,
                                                       T const* grad, T* grad_x) {
  for (int i = threadIdx.x; i < samples; i += kThreads) {
    T sum = 0;
    for (int k = 0; k < bins; ++k) {
      T const u = (x[i] - centers[k]) / h;
      sum -= fast_exp2(u * u * T(-kHalfLog2E)) * u * grad[k];
    }
    grad_x[i] = x[i] == x[i] ? sum / h : T(0);
  }
}

// The index of the first of the ascending centers that is not below x.
__device__ __forceinline__ int first_from(float const* centers, int bins, float x) {
  int begin = 0, end = bins;
  while (begin < end) {
    int const middle = (begin + end) / 2;
    if (centers[middle] < x)
      begin = middle + 1;
    else
      end = middle;
  }
  return begin;
}

__device__ __forceinline__ void differentiate_by_cells(float const* x, int samples, float const* centers, int bins,
                                                       bool sorted, MomentGrid const& grid, float const* grad,
                                                       float* grad_x) {
  extern __shared__ __align__(16) int memory[];
  float4* const table = reinterpret_cast<float4*>(memory);
  float const per = 1 / grid.bandwidth, w = grid.width * per, reach = kReach * grid.bandwidth + grid.width;
  for (int part = 0; part < grid.cells; part += kCells) {
    int const cells = min(kCells, grid.cells - part);
    __syncthreads();
    for (int i = threadIdx.x; i < cells; i += kThreads) {
      float const middle = grid.middle(part + i);
      float sum[4] = {};
      for (int k = sorted ? first_from(centers, bins, middle - reach) : 0; k < bins; ++k) {
        float const center = centers[k];
        if (sorted && center > middle + reach) break;
        float const u = (middle - center) * per, g = fast_exp2(u * u * float(-kHalfLog2E)) * (grad[k] * per);
        float c[4];
        derivative(u, w, c);
#pragma unroll
        for (int j = 0; j < 4; ++j) sum[j] += g * c[j];
      }
      table[i] = {sum[0], sum[1], sum[2], sum[3]};
    }
    __syncthreads();
    float const first = float(grid.first + part);
#pragma unroll 4
    for (int i = threadIdx.x; i < samples; i += kThreads) {
      float const position = x[i] * grid.inverse, whole = floorf(position), at = whole - first;
      if (at >= 0 && at < float(cells)) {
        float4 const c = table[int(at)];
        float const t = position - whole - 0.5f;
        grad_x[i] = c.x + t * (c.y + t * (c.z + t * c.w));
      } else if (part == 0) {
        grad_x[i] = 0;
      }
    }
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) differentiate_chunk(HistogramBackward<T> b) {
  Histogram<T> const& p = b.forward;
  int64_t const row = blockIdx.x / p.chunks, chunk = blockIdx.x - row * p.chunks,
                at = row * p.samples + chunk * p.chunk;
  T const *const x = p.x + at, *const centers = p.centers + row * p.center_stride, *const grad = b.grad + row * p.bins;
  int const samples = int(min(p.chunk, p.samples - chunk * p.chunk)), bins = int(p.bins);
  T const h = p.bandwidth[row * p.bandwidth_stride];
  if constexpr (sizeof(T) == sizeof(float)) {
    bool sorted;
    MomentGrid const grid = grid_of(centers, bins, h, sorted);
    if (grid.cells > 0) return differentiate_by_cells(x, samples, centers, bins, sorted, grid, grad, b.grad_x + at);
  }
  differentiate_directly(x, samples, centers, h, bins, grad, b.grad_x + at);
}

// One block a row.
constexpr int kNormalizeThreads = 256;
template <class T>
__global__ void __launch_bounds__(kNormalizeThreads) normalize(NormalizeCounts<T> p) {
  __shared__ T memory[kNormalizeThreads / 32];
  int64_t const first = int64_t(blockIdx.x) * p.bins;
  T sum = 0;
  for (int64_t k = threadIdx.x; k < p.bins; k += kNormalizeThreads) sum += p.counts[first + k];
  sum = block_sum_to_all(sum, memory) + p.eps;
  for (int64_t k = threadIdx.x; k < p.bins; k += kNormalizeThreads) p.y[first + k] = p.counts[first + k] / sum;
}

template <class T>
__global__ void __launch_bounds__(kNormalizeThreads) differentiate_normalized(NormalizeCountsBackward<T> p) {
  __shared__ T memory[kNormalizeThreads / 32];
  int64_t const first = int64_t(blockIdx.x) * p.bins;
  T sum = 0, product = 0;
  for (int64_t k = threadIdx.x; k < p.bins; k += kNormalizeThreads) {
    sum += p.counts[first + k];
    product += p.grad[first + k] * p.counts[first + k];
  }
  sum = block_sum_to_all(sum, memory) + p.eps;
  T const mean = block_sum_to_all(product, memory) / sum;
  for (int64_t k = threadIdx.x; k < p.bins; k += kNormalizeThreads)
    p.grad_counts[first + k] = (p.grad[first + k] - mean) / sum;
}

}  // namespace

template <class T>
int histogram(Histogram<T> const& p, CUstream_st* stream) {
  if (int const error = cudaFuncSetAttribute(count_chunk<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, kBytes<T>))
    return error;
  count_chunk<<<unsigned(p.rows * p.chunks), kThreads, kBytes<T>, stream>>>(p);
  if (p.chunks > 1)
    add_chunks<<<unsigned(ceil_div(p.rows * p.bins, 256)), 256, 0, stream>>>(p.partial, p.rows, p.chunks, p.bins,
                                                                             p.counts);
  return cudaGetLastError();
}

template <class T>
int histogram_backward(HistogramBackward<T> const& p, CUstream_st* stream) {
  if (int const error =
          cudaFuncSetAttribute(differentiate_chunk<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, kBytes<T>))
    return error;
  differentiate_chunk<<<unsigned(p.forward.rows * p.forward.chunks), kThreads, kBytes<T>, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int normalize_counts(NormalizeCounts<T> const& p, CUstream_st* stream) {
  normalize<<<unsigned(p.rows), kNormalizeThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int normalize_counts_backward(NormalizeCountsBackward<T> const& p, CUstream_st* stream) {
  differentiate_normalized<<<unsigned(p.rows), kNormalizeThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(histogram, Histogram)
KV_INSTANTIATE_COMPUTED(histogram_backward, HistogramBackward)
KV_INSTANTIATE_COMPUTED(normalize_counts, NormalizeCounts)
KV_INSTANTIATE_COMPUTED(normalize_counts_backward, NormalizeCountsBackward)

}  // namespace kv::enhance::cuda
