// Flips, which reverse columns, rows or both, and crops of images. Pixels out of bounds are 0. The backward pass of a
// flip is the flip; that of a crop is the crop by the opposite corner.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::geometry {

template <class T>
struct Flip {
  Planes<T const> x;
  Planes<T> y;
  bool columns, rows;         // reversed
  int64_t top = 0, left = 0;  // of a crop: the position in x of the first pixel of y; neither axis is reversed then
};

KV_KERNEL(flip, Flip)

// Crops of planar images that lie between pixels, halfway along an axis or both: means of two pixels or four. On CUDA
// only; elsewhere they are warps.
namespace cuda {

template <class T>
struct CropBetween {
  Planes<T const> x;
  Planes<T> y;
  int top, left;  // of the first pixel of x that is read; all are in bounds
  bool rows, columns;
};

// Whether the crop of height x width whose first pixel lies at those coordinates of x is one.
template <class T>
bool is_crop_between(Planes<T const> const& x, int64_t height, int64_t width, double top, double left);

template <class T>
int crop_between(CropBetween<T> const& p, CUstream_st* stream);

}  // namespace cuda
}  // namespace kv::geometry
