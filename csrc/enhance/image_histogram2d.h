// Histograms whose kernel reaches exactly one bandwidth, the distance of the bins: a sample between the centers of two
// bins counts for these two only.
#pragma once

#include "core/isa.h"

namespace kv::enhance {

// Exported graphs contain these numbers.
enum class HistogramKernel : int { triangular, epanechnikov, uniform };

template <class T>
struct ImageHistogram2d {
  T const* x;
  int64_t rows, samples, bins;
  T low, inverse;  // lower bound of the first bin; 1 / the width of a bin
  HistogramKernel kernel;
  T* counts;
  int64_t chunk, chunks;  // samples of a row per CUDA block; the number of such chunks in a row
  T* partial;             // CUDA: the counts of all chunks
};

template <class T>
struct ImageHistogram2dBackward {
  ImageHistogram2d<T> forward;  // its counts are unused
  T const* grad;
  T* grad_x;
};

KV_KERNEL(image_histogram2d, ImageHistogram2d)
KV_KERNEL(image_histogram2d_backward, ImageHistogram2dBackward)

// The weights of a sample for two adjacent bins; t in [0, 1) is its distance from the center of bin `first` towards the
// next center, in bins. At t = 0 the sample is also on the boundary of the previous bin's uniform kernel.
template <class T>
struct Between {
  T t, first_weight, next_weight;
  KV_HD Between(T t, HistogramKernel kernel) : t(t) {
    T const s = 1 - t;
    bool const uniform = kernel == HistogramKernel::uniform, square = kernel == HistogramKernel::epanechnikov;
    first_weight = uniform ? 1 : square ? 1 - t * t : s;
    next_weight = uniform ? 1 : square ? 1 - s * s : t;
  }
};

// The derivative with respect to the sample's position, from the gradients of the counts of the previous bin, `first`
// and `next`. At t = 0 the triangular kernel has its peak and the support of the previous bin's kernel ends; the
// one-sided derivatives are added there.
template <class T>
KV_HD T between_backward(T t, HistogramKernel kernel, T before, T first, T next) {
  if (kernel == HistogramKernel::uniform) return 0;
  T const ends = t == 0 ? before : T(0);
  if (kernel == HistogramKernel::epanechnikov) return 2 * ((1 - t) * next - t * first - ends);
  return next - (t == 0 ? ends : first);
}

}  // namespace kv::enhance
