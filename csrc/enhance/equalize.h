// Histogram equalization of whole planes.
#pragma once

#include "byte_histogram.h"
#include "core/isa.h"
#include "core/stencils/gradient_list.h"

namespace kv::enhance {

// The effect on a plane: it is unchanged, mapped, or mapped except for pixels that are NaN.
enum class Change : int { none, all, but_nan };

template <class T>
struct Equalize {
  Planes<T const> x;  // flat: each plane is one row
  Planes<T> y;
  T* changed;  // a Change per plane
  bool opencv;
  int32_t* counts;    // working memory, kLevels per plane; on the CPU per part of a plane, if there are parts
  int64_t parts = 1;  // CPU: parts that planes are divided into, so that more threads than planes can run
  int64_t sample_planes = 0;

  KV_HD int64_t first_of(int64_t part) const { return x.width * part / parts; }
  KV_HD void select(int64_t b) { changed += b * sample_planes, counts += b * sample_planes * kLevels; }
};

template <class T>
struct EqualizeList : FilterList<Equalize<T>, T> {};

// Levels have zero gradient; pixels that are returned unchanged pass theirs.
template <class T>
struct EqualizeBackward {
  Planes<T const> grad, x;  // flat; x: the image or the result, which have the same NaN
  Planes<T> grad_x;
  T const* changed;  // a Change per plane; null: any plane may have NaN
  int64_t sample_planes = 0;

  KV_HD void select(int64_t b) {
    if (changed) changed += b * sample_planes;
  }
};

template <class T>
struct EqualizeBackwardList : GradientList<EqualizeBackward<T>, T, true> {};

KV_KERNEL(equalize, Equalize)
KV_KERNEL(equalize_list, EqualizeList)
KV_KERNEL(equalize_counts, Equalize)  // CPU: the counts of each part
KV_KERNEL(equalize_backward, EqualizeBackward)
KV_KERNEL(equalize_list_backward, EqualizeBackwardList)

// The table from level to level. PIL: one output level takes a whole number of pixels, and the brightest level that is
// not empty is not counted; a plane with fewer pixels than levels stays unchanged. OpenCV: the darkest level is not
// counted, and levels are rounded; a plane of one level stays unchanged.
struct Curve {
  bool opencv;
  int32_t pixels, darkest, brightest;  // the total, and the counts of the darkest and of the brightest level

  KV_HD int32_t counted() const { return pixels - (opencv ? darkest : brightest); }
  KV_HD bool changes() const { return counted() >= (opencv ? 1 : 255); }
  // The new level of a level with `count` pixels; `up_to` is the cumulative count, itself included.
  KV_HD int operator()(int32_t up_to, int32_t count) const {
    if (opencv) return int(__builtin_rintf(float(max(up_to - darkest, 0)) * (255.f / float(counted()))));
    int64_t const step = counted() / 255;
    return int(min((up_to - count + step / 2) / step, int64_t(255)));
  }
};

}  // namespace kv::enhance
