// Counts of a row's samples in bins one bandwidth apart, by a kernel that ends there: a sample between the middles of
// two bins counts for these two. Included by image_histogram2d_cpu.cpp, image_histogram2d.cu and
// image_histogram2d_op.cpp.
#pragma once

#include "core/isa.h"

namespace kv {

// Graphs contain the numbers; python/kvision/enhance/histogram.py has the same ones.
enum class HistogramKernel : int { triangular, epanechnikov, uniform };

template <class T>
struct ImageHistogram2d {
  T const* x;
  int64_t rows, samples, bins;
  T low, inverse;  // where the first bin begins; 1 / the width of a bin
  HistogramKernel kernel;
  T* counts;
  int64_t chunk, chunks;  // samples of a row that CUDA counts in one block; how many of these a row has
  T* partial;             // on CUDA, the counts of all chunks
};

template <class T>
struct ImageHistogram2dBackward {
  ImageHistogram2d<T> forward;  // without counts
  T const* grad;
  T* grad_x;
};

KV_KERNEL(image_histogram2d, ImageHistogram2d)
KV_KERNEL(image_histogram2d_backward, ImageHistogram2dBackward)

// At t in [0, 1) from the middle of bin `first` to that of the next one: what the sample counts for both. At t = 0 it
// is the end of the uniform kernel of the bin before them, too.
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

// The derivative to the place of the sample, from the gradients of the counts of the bin before both, and of both. At
// t = 0 the triangular kernel has its tip, and the bin before ends: both sides count there.
template <class T>
KV_HD T between_backward(T t, HistogramKernel kernel, T before, T first, T next) {
  if (kernel == HistogramKernel::uniform) return 0;
  T const ends = t == 0 ? before : T(0);
  if (kernel == HistogramKernel::epanechnikov) return 2 * ((1 - t) * next - t * first - ends);
  return next - (t == 0 ? ends : first);
}

}  // namespace kv
