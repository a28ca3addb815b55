// Cross-correlation of images and volumes with any kernel, its transpose, and the gradient to the kernel. A volume is
// read plane by plane; an image is a volume of depth 1. Included by filter2d*.cpp, filter2d*.cu and their headers.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/stencils/filter_list.h"
#include "core/view.h"

namespace kv::filters {

// A kernel along one axis: tap k of output i reads pixel i + k - before. Pixels out of bounds follow a border rule.
struct KernelAxis {
  int size, before;
};

// y = sum over taps of kernel[tap] * x[pixel + tap].
//
// The transpose is the same sum over the gradient, with the kernel flipped, zeros out of bounds and before' = size - 1
// - before. Then the border is accumulated: each pixel also receives the sums of all positions out of bounds whose
// border pixel it is. With the circular border the gradient is read circularly instead.
template <class T>
struct Filter2d {
  Planes<T const> x;
  Planes<T> y;
  Compute<T> const* kernel;  // (samples, z, y, x)
  int64_t kernel_stride;     // from a sample's kernel to the next one's, 0 where they share one
  int64_t sample_planes;     // planes of a sample, all channels and depths
  int depth;                 // planes of a volume
  KernelAxis axis_z, axis_y, axis_x;
  bool flip;
  Border border, accumulation;  // accumulation: of the result's border; constant for none
  bool clamps;                  // results to [0, 1]; bytes always are to theirs

  KV_HD int taps() const { return axis_z.size * axis_y.size * axis_x.size; }
  KV_HD Compute<T> const* kernel_of(int64_t plane) const { return kernel + plane / sample_planes * kernel_stride; }
  KV_HD void select(int64_t sample) { kernel += sample * kernel_stride; }
  template <class V>
  KV_HD V clamped(V const& x) const {
    V const zero = V{}, one = V{} + Compute<T>(1), above = x < zero ? zero : x;  // NaN stays
    return above > one ? one : above;
  }
};

// Of images.
template <class T>
struct Filter2dList : FilterList<Filter2d<T>, T> {};

// The gradient to the kernel: for each tap the sum of the gradient's pixels times the pixels that the tap reads. Planes
// are divided into parts of a few rows of the gradient. The partial sums of a sample are then added in a fixed order.
template <class T>
struct Filter2dKernelBackward {
  Planes<T const> grad, x;
  Compute<T>* parts;  // (part, z, y, x)
  int64_t part_rows;
  int depth;
  KernelAxis axis_z, axis_y, axis_x;
  Border border;

  KV_HD int taps() const { return axis_z.size * axis_y.size * axis_x.size; }
  KV_HD int64_t parts_down() const { return (grad.height + part_rows - 1) / part_rows; }
  KV_HD int64_t count() const { return grad.count() * parts_down(); }
};

// sums[i] is the sum over `parts` of terms[i / size, part, i % size], for `count` sums.
template <class F>
struct SumPartials {
  F const* terms;
  F* sums;
  int64_t count, parts, size;
};

KV_KERNEL(filter2d, Filter2d)
KV_KERNEL(filter2d_list, Filter2dList)
KV_KERNEL(filter2d_kernel_backward, Filter2dKernelBackward)
KV_KERNEL(sum_partials, SumPartials)

}  // namespace kv::filters
