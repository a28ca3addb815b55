// Histograms with compact kernels on CUDA: each block counts a chunk of a row in shared memory. Counts are fixed-point
// sums, so that the order of atomic additions does not change the result. Bins that do not fit shared memory are
// counted in several parts.
#include "image_histogram2d.h"
#include "row_chunks.cuh"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 256, kBytes = 32 << 10;

// Fixed point: the sum of 2^14 samples, each at most 1, fits.
template <class T>
struct Fixed {
  using type = unsigned;
  static constexpr T kScale = T(1 << 17);
};
template <>
struct Fixed<double> {
  using type = unsigned long long;
  static constexpr double kScale = double(1ll << 48);
};

template <class T>
__device__ __forceinline__ void bin_of(ImageHistogram2d<T> const& p, T x, int& bin, T& t) {
  T const position = (x - p.low) * p.inverse + T(0.5), whole = floor(position);
  t = position - whole;
  bin = whole >= 0 && whole <= T(p.bins + 1) ? int(whole) - 1 : -2;  // NaN is in no bin
}

// Counts in shared memory, in several copies where they fit, a power of two: neighboring threads often have equal
// samples, and add to different copies.
template <class T>
__global__ void __launch_bounds__(kThreads) count_chunk(ImageHistogram2d<T> p, int part, int copies) {
  using Sum = typename Fixed<T>::type;
  __shared__ __align__(16) unsigned char memory[kBytes];
  Sum* const counts = reinterpret_cast<Sum*>(memory);
  int64_t const row = blockIdx.x / p.chunks, chunk = blockIdx.x - row * p.chunks;
  T const* const x = p.x + row * p.samples + chunk * p.chunk;
  int const samples = int(min(p.chunk, p.samples - chunk * p.chunk)), bins = int(p.bins);
  for (int first = 0; first < bins; first += part) {
    __syncthreads();
    int const vectors = (part * copies * int(sizeof(Sum)) + 15) / 16;
    for (int i = threadIdx.x; i < vectors; i += kThreads) reinterpret_cast<uint4*>(memory)[i] = uint4{};
    __syncthreads();
    auto const add = [&](int bin, T weight) {
      if (bin < first || bin >= min(first + part, bins)) return;
      Sum const fixed = sizeof(T) == 4 ? Sum(__float2uint_rn(float(weight * Fixed<T>::kScale)))
                                       : Sum(weight * Fixed<T>::kScale + T(0.5));
      atomicAdd(counts + (bin - first) * copies + (threadIdx.x & (copies - 1)), fixed);
    };
    constexpr int kAtOnce = 4;
    for (int i = threadIdx.x; i < samples; i += kThreads * kAtOnce) {
      T v[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k)
        if (i + k * kThreads < samples) v[k] = x[i + k * kThreads];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k) {
        if (i + k * kThreads >= samples) break;
        int bin;
        T t;
        bin_of(p, v[k], bin, t);
        if (bin < -1) continue;
        Between<T> const b(t, p.kernel);
        add(bin, b.first_weight);
        add(bin + 1, b.next_weight);
        if (t == 0 && p.kernel == HistogramKernel::uniform) add(bin - 1, 1);
      }
    }
    __syncthreads();
    for (int k = threadIdx.x; k < min(part, bins - first); k += kThreads) {
      Sum sum = 0;
      int const start = k * copies / 32;  // threads with adjacent bins read different banks at a time
      for (int i = 0; i < copies; ++i) sum += counts[k * copies + ((start + i) & (copies - 1))];
      p.partial[int64_t(blockIdx.x) * p.bins + first + k] = T(sum) * (1 / Fixed<T>::kScale);
    }
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) differentiate(ImageHistogram2dBackward<T> b) {
  ImageHistogram2d<T> const& p = b.forward;
  int64_t const row = blockIdx.x / p.chunks, chunk = blockIdx.x - row * p.chunks,
                at = row * p.samples + chunk * p.chunk;
  int const samples = int(min(p.chunk, p.samples - chunk * p.chunk)), bins = int(p.bins);
  T const* const grad = b.grad + row * p.bins;
  auto const grad_of = [&](int bin) { return bin >= 0 && bin < bins ? grad[bin] : T(0); };
#pragma unroll 4
  for (int i = threadIdx.x; i < samples; i += kThreads) {
    int bin;
    T t;
    bin_of(p, p.x[at + i], bin, t);
    T const before = t == 0 ? grad_of(bin - 1) : T(0);
    b.grad_x[at + i] =
        bin < -1 ? T(0) : p.inverse * between_backward(t, p.kernel, before, grad_of(bin), grad_of(bin + 1));
  }
}

}  // namespace

template <class T>
int image_histogram2d(ImageHistogram2d<T> const& p, CUstream_st* stream) {
  int const fit = kBytes / int(sizeof(typename Fixed<T>::type)), part = int(min(p.bins, int64_t(fit)));
  int copies = 1;
  while (copies < 32 && 2 * copies * part <= fit) copies *= 2;
  count_chunk<<<unsigned(p.rows * p.chunks), kThreads, 0, stream>>>(p, part, copies);
  if (p.chunks > 1)
    add_chunks<<<unsigned(ceil_div(p.rows * p.bins, 256)), 256, 0, stream>>>(p.partial, p.rows, p.chunks, p.bins,
                                                                             p.counts);
  return cudaGetLastError();
}

template <class T>
int image_histogram2d_backward(ImageHistogram2dBackward<T> const& p, CUstream_st* stream) {
  differentiate<<<unsigned(p.forward.rows * p.forward.chunks), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(image_histogram2d, ImageHistogram2d)
KV_INSTANTIATE_COMPUTED(image_histogram2d_backward, ImageHistogram2dBackward)

}  // namespace kv::enhance::cuda
