// Cross-correlation of images and volumes with any kernel, its transpose, and the gradient to the kernel. A volume is
// read plane by plane; an image is one of depth 1. Included by filter2d_cpu.cpp, filter2d.cu and filter2d_op.cpp.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/view.h"

namespace kv {

// How a kernel lies on the pixels along one axis: tap k of pixel i on pixel i + k - before. Pixels that this reaches
// beyond the image are read by a border rule.
struct KernelAxis {
  int size, before;
};

// y = sum over taps of kernel[tap] * x[pixel + tap].
//
// The transpose is the same sum over the gradient, with the kernel flipped, zeros outside and before' = size - 1 -
// before, and then folded: each pixel also receives what its other positions under the border rule receive. With the
// circular border, reading the gradient circularly folds it already.
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
  Border border, fold;  // fold: constant for none

  KV_HD int taps() const { return axis_z.size * axis_y.size * axis_x.size; }
  KV_HD Compute<T> const* kernel_of(int64_t plane) const { return kernel + plane / sample_planes * kernel_stride; }
};

// The gradient to the kernel: the products of the gradient's pixels with the pixels that a tap lays on them. Planes are
// cut into parts of a few rows of the gradient; the parts of a sample are then summed, always in the same order.
template <class T>
struct Filter2dTaps {
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

// sums[i] = the sum over `parts` of terms[i / size, part, i % size], for `count` sums.
template <class F>
struct SumParts {
  F const* terms;
  F* sums;
  int64_t count, parts, size;
};

KV_KERNEL(filter2d, Filter2d)
KV_KERNEL(filter2d_taps, Filter2dTaps)
KV_KERNEL(sum_parts, SumParts)

}  // namespace kv
