// Dominant orientations on CUDA: one block for each patch. Each thread has a histogram of its pixels, a column in
// shared memory; the columns are added up in order. There are no atomics.
#include "orientation.h"
#include "patch_gradient.cuh"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 64;

// The arrays of a block.
template <class F>
struct OrientationPatch {
  int n, bins;
  SharedPatch<F> patch;
  F* columns;  // (bins, threads)
  F *histogram, *smoothed, *weights;

  static size_t bytes(int n, int bins, bool backward) {
    return ((backward ? 3 : 1) * n * n + n + (kThreads + 2) * bins) * sizeof(F);
  }
  __device__ __forceinline__ OrientationPatch(int n, int bins, F* memory) : n(n), bins(bins), patch{memory, n} {
    columns = memory + n * n, histogram = columns + kThreads * bins, smoothed = histogram + bins;
    weights = smoothed + bins;
  }
  __device__ __forceinline__ F* rest() const { return weights + n; }

  // Called by all threads, returned to all of them.
  template <class T, class Params>
  __device__ __forceinline__ Peaks<F> find_peaks(T const* from, Params const& p) {
    __shared__ int peak;
    patch.read_from(from);
    for (int i = threadIdx.x; i < n; i += kThreads) weights[i] = centered_gaussian(i, n, F(n) / 6);
    F* const own = columns + threadIdx.x;
    for (int b = 0; b < bins; ++b) own[b * kThreads] = 0;
    __syncthreads();
    for_each_pixel(n, [&](int, int y, int x) {
      auto const polar = to_polar(patch_gradient(sobel_stencil<F>(), patch.around(y, x)), p.eps);
      auto const vote = angular_vote(polar.angle, bins, F(bins) / 2);
      F const m = polar.magnitude * (weights[y] * weights[x]);
      own[vote.first * kThreads] += m * (1 - vote.t);
      own[vote.second * kThreads] += m * vote.t;
    });
    __syncthreads();
    int const lane = threadIdx.x % 32;
    for (int b = threadIdx.x / 32; b < bins; b += kThreads / 32) {
      F sum = 0;
      for (int i = lane; i < kThreads; i += 32) sum += columns[b * kThreads + i];
      sum = warp_reduce(sum, Sum());
      if (lane == 0) histogram[b] = sum;
    }
    __syncthreads();
    for (int b = threadIdx.x; b < bins; b += kThreads) smoothed[b] = smoothed_bin(histogram, b, bins);
    __syncthreads();
    if (threadIdx.x < 32) {  // the first of the largest bins
      F own = -1;
      int at = bins;
      for (int b = lane; b < bins; b += 32)
        if (smoothed[b] > own) own = smoothed[b], at = b;
      F const largest = warp_reduce(own, Max());
      at = warp_reduce(own == largest ? at : bins, Min());
      if (lane == 0) peak = at < bins ? at : 0;
    }
    __syncthreads();
    return Peaks<F>(smoothed, peak, bins, p.threshold);
  }
};

extern __shared__ double shared_memory[];

template <class T>
__global__ void __launch_bounds__(kThreads) orient_patch(__grid_constant__ Orientation<T> const p) {
  using F = Compute<T>;
  OrientationPatch<F> s(p.n, p.bins, reinterpret_cast<F*>(shared_memory));
  Peaks<F> peaks = s.find_peaks(p.patches + int64_t(blockIdx.x) * p.n * p.n, p);
  if (threadIdx.x > 0) return;
  T* const angles = p.angles + int64_t(blockIdx.x) * p.peaks;
  for (int k = 0; k < p.peaks; ++k) angles[k] = round_to<T>(peaks.next().angle(p.bins));
}

template <class T>
__global__ void __launch_bounds__(kThreads) orient_patch_backward(__grid_constant__ OrientationBackward<T> const p) {
  using F = Compute<T>;
  int const n = p.n, bins = p.bins;
  int64_t const first = int64_t(blockIdx.x) * n * n;
  OrientationPatch<F> s(n, bins, reinterpret_cast<F*>(shared_memory));
  Peaks<F> peaks = s.find_peaks(p.patches + first, p);
  F* const grad_bins = s.histogram;  // nobody reads the histogram any more
  for (int b = threadIdx.x; b < bins; b += kThreads) grad_bins[b] = 0;
  for (int k = 0; k < p.peaks; ++k) {
    Peak<F> const peak = peaks.next();
    F d[3];
    peak.derivatives(bins, d);
    F const grad = read(p.grad[int64_t(blockIdx.x) * p.peaks + k]);
    for (int b = threadIdx.x; b < bins; b += kThreads) grad_bins[b] += grad * angle_derivative(peak, d, b, bins);
  }
  __syncthreads();
  F const per_radian = F(bins) / F(2 * kPi);
  SharedPatch<F> const u{s.rest(), n}, v{u.data + n * n, n};
  for_each_pixel(n, [&](int i, int y, int x) {
    auto const gradient = patch_gradient(sobel_stencil<F>(), s.patch.around(y, x));
    auto const polar = to_polar(gradient, p.eps);
    auto const vote = angular_vote(polar.angle, bins, F(bins) / 2);
    F const weight = s.weights[y] * s.weights[x], a = grad_bins[vote.first], b = grad_bins[vote.second];
    auto const back = to_polar_vjp(gradient, polar.magnitude, weight * (a + vote.t * (b - a)),
                                   weight * (b - a) * polar.magnitude * per_radian);
    u.data[i] = back.x, v.data[i] = back.y;
  });
  __syncthreads();
  write_patch_gradient(p.grad_patches + first, sobel_stencil<F>(), u, v);
}

}  // namespace

template <class T>
int orientation(Orientation<T> const& p, CUstream_st* stream) {
  size_t const bytes = OrientationPatch<Compute<T>>::bytes(p.n, p.bins, false);
  if (int const error = allow_shared(orient_patch<T>, bytes)) return error;
  orient_patch<<<unsigned(p.count), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int orientation_backward(OrientationBackward<T> const& p, CUstream_st* stream) {
  size_t const bytes = OrientationPatch<Compute<T>>::bytes(p.n, p.bins, true);
  if (int const error = allow_shared(orient_patch_backward<T>, bytes)) return error;
  orient_patch_backward<<<unsigned(p.count), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(orientation, Orientation)
KV_INSTANTIATE(orientation_backward, OrientationBackward)

}  // namespace kv::feature::cuda
