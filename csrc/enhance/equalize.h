// Histogram equalization of whole planes. Included by equalize_cpu.cpp, equalize.cu and equalize_op.cpp.
#pragma once

#include "byte_histogram.h"
#include "core/isa.h"

namespace kv {

// What became of a plane: it stays as it is, or changes, but for pixels that are NaN where it has such.
enum class Change : int { none, all, but_nan };

template <class T>
struct Equalize {
  Planes<T const> x;  // flat: a plane is a row
  Planes<T> y;
  T* changed;  // a Change for each plane
  bool opencv;
  int32_t* counts;  // working memory, kLevels a plane, on CUDA only
};

// Levels have no gradient; pixels that come back as they are have their own.
template <class T>
struct EqualizeBackward {
  Planes<T const> grad, output;  // flat
  Planes<T> grad_x;
  T const* changed;  // a Change for each plane, or null where all may have NaN
};

KV_KERNEL(equalize, Equalize)
KV_KERNEL(equalize_backward, EqualizeBackward)

// From level to level. As PIL does it: a whole number of pixels makes one output level, and the brightest level that is
// not empty is left out of the count; where there are less pixels than levels, the plane stays as it is. As OpenCV does
// it: the darkest one is left out, and levels are rounded; a plane of one level stays.
struct Curve {
  bool opencv;
  int32_t pixels, darkest, brightest;  // in all, and in the darkest and the brightest level

  KV_HD int32_t counted() const { return pixels - (opencv ? darkest : brightest); }
  KV_HD bool changes() const { return counted() >= (opencv ? 1 : 255); }
  // Of a level with `count` pixels, `up_to` in it and in darker ones.
  KV_HD int operator()(int32_t up_to, int32_t count) const {
    if (opencv) return int(__builtin_rintf(float(max(up_to - darkest, 0)) * (255.f / float(counted()))));
    int64_t const step = counted() / 255;
    return int(min((up_to - count + step / 2) / step, int64_t(255)));
  }
};

}  // namespace kv
