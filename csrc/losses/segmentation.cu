// Losses of segmentations on CUDA: a thread takes whole pixels, so that a warp reads neighbouring logits of one class
// after the other. What is read twice is in the cache the second time.
#include "core/launch.cuh"
#include "enhance/pieces.cuh"
#include "segmentation.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32, kEach = 8;  // pixels of a thread at once

struct Math {
  __device__ __forceinline__ float exp(float x) const { return __expf(x); }
  __device__ __forceinline__ double exp(double x) const { return ::exp(x); }
  __device__ __forceinline__ float log(float x) const { return logf(x); }
  __device__ __forceinline__ double log(double x) const { return ::log(x); }
};

// The largest logit of a pixel. `at`: its logit of class 0. The loop has nothing to wait for but memory; what comes
// after it reads the logits again, from the cache, which is cheaper than to rescale sums whenever a larger one is
// found.
template <class T>
__device__ __forceinline__ Compute<T> largest(Logits<T> const& logits, T const* at) {
  Compute<T> most = read(at[0]);
#pragma unroll 4
  for (int64_t c = 1; c < logits.classes; ++c) {
    Compute<T> const x = read(at[c * logits.pixels]);
    most = x > most ? x : most;
  }
  return most;
}

// A thread's pixel: its label, and how much it counts.
template <class T>
struct Pixel {
  using F = Compute<T>;
  int64_t sample, place, label;
  F counts;
  bool there;
  __device__ __forceinline__ explicit Pixel(Logits<T> const& logits) {
    int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
    sample = i / logits.pixels, place = i - sample * logits.pixels, there = sample < logits.batch;
    label = there ? logits.labels(sample)[place] : -1;
    counts = there ? logits.counts(label) : F(0);
  }
  template <class P>
  __device__ __forceinline__ P* logit(Logits<T> const& logits, P* all) const {
    return all + sample * logits.classes * logits.pixels + place;
  }
};

// A block makes the sums of a piece, some of its pixels after the other: few enough for their logits to be in the cache
// when they are read again.
template <class T>
__global__ void __launch_bounds__(kThreads) sum_classes(ClassSums<T> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char bytes[];
  F* const sums = reinterpret_cast<F*>(bytes);  // (warps, 3, classes)
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32, classes = int(p.logits.classes);
  int64_t const sample = blockIdx.x / p.pieces, pixels = p.logits.pixels;
  int64_t const piece = (blockIdx.x - sample * p.pieces) * kPiece, end = min(piece + kPiece, pixels);
  T const* const logits = p.logits.data + sample * classes * pixels;
  int64_t const* const target = p.logits.labels(sample);

#pragma unroll 1
  for (int64_t at = piece; at < end; at += kEach * kThreads) {
    // Class by class all of the thread's pixels, whose memory is asked for at once.
    T const* const own = logits + at + threadIdx.x;
    F most[kEach], scale[kEach], counts[kEach];
    int label[kEach];
#pragma unroll
    for (int k = 0; k < kEach; ++k) {
      int64_t const i = at + threadIdx.x + k * kThreads;
      counts[k] = i < end ? p.logits.counts(target[i]) : F(0), label[k] = counts[k] == 1 ? int(target[i]) : -1;
      most[k] = -F(INFINITY), scale[k] = 0;
    }
    auto const for_each_logit = [&](int c, auto f) {
#pragma unroll
      for (int k = 0; k < kEach; ++k)
        if (counts[k] != 0) f(k, read(own[c * pixels + k * kThreads]));
    };
#pragma unroll 1
    for (int c = 0; c < classes; ++c) for_each_logit(c, [&](int k, F x) { most[k] = x > most[k] ? x : most[k]; });
#pragma unroll 1
    for (int c = 0; c < classes; ++c) for_each_logit(c, [&](int k, F x) { scale[k] += Math{}.exp(x - most[k]); });
#pragma unroll
    for (int k = 0; k < kEach; ++k) scale[k] = counts[k] / scale[k];
#pragma unroll 1
    for (int c = 0; c < classes; ++c) {
      F both = 0, all = 0, labelled = 0;
      for_each_logit(c, [&](int k, F x) {
        F const share = Math{}.exp(x - most[k]) * scale[k];
        all += share;
        if (label[k] == c) both += share, labelled += 1;
      });
      both = warp_sum(both), all = warp_sum(all), labelled = warp_sum(labelled);
      if (lane == 0) {
        F* const to = sums + warp * 3 * classes + c;
        bool const begins = at == piece;
        to[0] = (begins ? F(0) : to[0]) + both;
        to[classes] = (begins ? F(0) : to[classes]) + all;
        to[2 * classes] = (begins ? F(0) : to[2 * classes]) + labelled;
      }
    }
  }
  __syncthreads();
  for (int i = threadIdx.x; i < 3 * classes; i += kThreads) {
    F sum = 0;
    for (int w = 0; w < kWarps; ++w) sum += sums[w * 3 * classes + i];
    p.partial[blockIdx.x * int64_t(3 * classes) + i] = sum;
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) sum_classes_backward(ClassSumsBackward<T> const p) {
  using F = Compute<T>;
  Logits<T> const& logits = p.logits;
  Pixel<T> const pixel(logits);
  if (!pixel.there) return;
  T const* const at = pixel.logit(logits, logits.data);
  T* const to = pixel.logit(logits, p.grad_logits);
  if (pixel.counts == 0) {
    for (int64_t c = 0; c < logits.classes; ++c) to[c * logits.pixels] = round_to<T>(F(0));
    return;
  }
  F const* const of_both = p.grad + pixel.sample * 3 * logits.classes;
  F const* const of_all = of_both + logits.classes;
  F const most = largest(logits, at);
  auto const exponential = [&](int64_t c) { return Math{}.exp(read(at[c * logits.pixels]) - most); };
  auto const grad = [&](int64_t c) { return of_all[c] + (c == pixel.label ? of_both[c] : F(0)); };
  F sum = 0, dot = 0;
#pragma unroll 4
  for (int64_t c = 0; c < logits.classes; ++c) {
    F const e = exponential(c);
    sum += e, dot += e * grad(c);
  }
  F const scale = pixel.counts / sum;
  dot /= sum;
#pragma unroll 4
  for (int64_t c = 0; c < logits.classes; ++c)
    to[c * logits.pixels] = round_to<T>(exponential(c) * scale * (grad(c) - dot));
}

// The focal loss of a pixel that counts, and its slope by log p.
template <class T>
__device__ __forceinline__ void evaluate(Logits<T> const& logits, FocalTerms<Compute<T>> const& terms,
                                         Pixel<T> const& pixel, T const* at, Compute<T>& most, Compute<T>& loss,
                                         Compute<T>& slope, Compute<T>& scale) {
  using F = Compute<T>;
  int64_t const c = pixel.counts == 1 ? pixel.label : 0;
  F const label = read(at[c * logits.pixels]);
  F rest = 0;  // of the other classes
  most = largest(logits, at);
#pragma unroll 4
  for (int64_t k = 0; k < logits.classes; ++k) {
    F const e = Math{}.exp(read(at[k * logits.pixels]) - most);
    rest += k == c ? F(0) : e;
  }
  F const factor = pixel.counts * (c == 0 ? terms.first : terms.other) * (terms.weight ? terms.weight[c] : F(1));
  focal_of_pixels(factor, terms.gamma, label, most, rest, Math{}, loss, slope, scale);
}

template <class T>
__global__ void __launch_bounds__(kThreads) find_focal(Focal<T> const p) {
  using F = Compute<T>;
  Pixel<T> const pixel(p.logits);
  if (!pixel.there) return;
  F most, loss = 0, slope, scale;
  if (pixel.counts != 0)
    evaluate(p.logits, p.terms, pixel, pixel.logit(p.logits, p.logits.data), most, loss, slope, scale);
  p.loss[pixel.sample * p.logits.pixels + pixel.place] = loss;
}

template <class T>
__global__ void __launch_bounds__(kThreads) find_focal_backward(FocalBackward<T> const p) {
  using F = Compute<T>;
  Logits<T> const& logits = p.logits;
  Pixel<T> const pixel(logits);
  if (!pixel.there) return;
  T const* const at = pixel.logit(logits, logits.data);
  T* const to = pixel.logit(logits, p.grad_logits);
  F most = 0, loss, slope = 0, scale = 0;
  if (pixel.counts != 0) {
    evaluate(logits, p.terms, pixel, at, most, loss, slope, scale);
    slope *= p.grad[pixel.sample * logits.pixels + pixel.place];
  }
#pragma unroll 4
  for (int64_t c = 0; c < logits.classes; ++c) {
    F const own = c == pixel.label ? F(1) : F(0);
    F const d = slope * (own - Math{}.exp(read(at[c * logits.pixels]) - most) * scale);
    to[c * logits.pixels] = round_to<T>(pixel.counts == 0 ? F(0) : d);
  }
}

template <class T>
unsigned blocks_of(Logits<T> const& logits) {
  return unsigned(ceil_div(logits.batch * logits.pixels, kThreads));
}

}  // namespace

template <class T>
int class_sums(ClassSums<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  int const bins = int(3 * p.logits.classes), bytes = kWarps * bins * int(sizeof(F));
  if (int error = cudaFuncSetAttribute(sum_classes<T>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  sum_classes<<<unsigned(p.logits.batch * p.pieces), kThreads, bytes, stream>>>(p);
  unsigned const blocks = unsigned(ceil_div(p.logits.batch * bins, 256));
  add_pieces<<<blocks, 256, 0, stream>>>(p.partial, p.logits.batch, p.pieces, int64_t(bins), p.sums);
  return cudaGetLastError();
}

template <class T>
int class_sums_backward(ClassSumsBackward<T> const& p, CUstream_st* stream) {
  sum_classes_backward<<<blocks_of(p.logits), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int focal(Focal<T> const& p, CUstream_st* stream) {
  find_focal<<<blocks_of(p.logits), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int focal_backward(FocalBackward<T> const& p, CUstream_st* stream) {
  find_focal_backward<<<blocks_of(p.logits), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(class_sums, ClassSums)
KV_INSTANTIATE(class_sums_backward, ClassSumsBackward)
KV_INSTANTIATE(focal, Focal)
KV_INSTANTIATE(focal_backward, FocalBackward)

}  // namespace kv::cuda
