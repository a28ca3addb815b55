// Sampling: the value of an image at coordinates between its pixels, and its derivative along both axes. This file and
// taps.h define it for warps and maps, CPU and CUDA, values and gradients.
//
// Along an axis a coordinate x has 1, 2 or 4 taps, the pixels around it, with weights of t = x - floor(x):
//
//   nearest    round(x), half to even, of x in multiples of 2^-12 (double: 2^-30)
//   bilinear   floor(x), floor(x) + 1                       1 - t, t
//   bicubic    floor(x) - 1 ... floor(x) + 2                Keys' cubic with a = -3/4, as OpenCV and torch have it
//
// Taps out of bounds follow the padding; memory out of bounds is never read:
//
//   fill         f f | a b c d | f f     one number a channel, or 0
//   border       a a | a b c d | d d
//   reflection   c b | a b c d | c b     with align_corners, about the centers of the outermost pixels
//                b a | a b c d | d c     without, about their edges
//
// Values and gradients are those of torch's grid_sample, which applies the same rules to coordinates instead of taps.
// With border padding there is a kink at the center of an outermost pixel; the gradient there is that of the inner
// side.
#pragma once

#include "core/images.h"
#include "core/isa.h"
#include "geometry/formula.h"
#include "geometry/transform/warp_matrix.h"

namespace kv::geometry {

enum class Interpolation : int { nearest = 1, bilinear = 2, bicubic = 4 };  // the number of taps along an axis
enum class Padding : int { fill, border, reflection };

template <class F>
struct Axis {
  int size;
  Padding padding;
  bool align_corners;
};

// The source of sampling coordinates: a matrix for each sample, or a map with coordinates for each pixel of the output.
template <class F>
struct SampleCoords {
  F const* matrices;      // or null, also for matrices that a formula computes
  int64_t matrix_stride;  // 0 where one serves the batch
  MatrixUse use;
  Images<F const> x, y;  // maps of one channel
  // x in pixels is scale * n + offset + own * the pixel's own x: maps are in pixels or in [-1, 1], and hold
  // coordinates or displacements from the pixel's own position.
  F scale[2], offset[2], own;

  KV_HD bool has_map() const { return x.data; }
};

template <class T>
struct Sampling {
  Interpolation interpolation;
  Axis<Compute<T>> x_axis, y_axis;
  SampleCoords<Compute<T>> coords;
  Compute<T> const* fill;                          // or null for 0
  int64_t fill_batch_stride, fill_channel_stride;  // 0 where one number serves all
  // Samples may outnumber the images: `image_index` has the image that each of them reads. Without it one image serves
  // all samples, or sample b reads image b.
  int64_t const* image_index = nullptr;
  int64_t images = 0;

  // Indices are checked on the CPU. On CUDA that would take a synchronization; there they are clamped.
  KV_HD int64_t image_of(int64_t b) const {
    if (image_index) return clamp(image_index[b], int64_t(0), images - 1);
    return images == 1 ? 0 : b;
  }
  KV_HD Compute<T> fill_value(int64_t b, int c) const {
    return fill ? fill[b * fill_batch_stride + c * fill_channel_stride] : Compute<T>(0);
  }
};

template <class T>
struct Sample : Sampling<T> {
  Images<T const> x;
  Images<T> y;
  MatrixFormula formula{};
};

// The gradients of the coordinates. They are written to the maps or, times the derivatives of the coordinates by the
// matrix, added to `parts` of nine sums per sample.
template <class T>
struct SampleCoordsBackward : Sampling<T> {
  Images<T const> x, grad;
  Images<Compute<T>> grad_x, grad_y;
  double* sums;
  int64_t parts;
};

// Adds up the sums and computes the gradients of the matrices from them.
template <class T>
struct WarpMatrixBackward {
  SampleCoords<T> coords;
  double const* sums;
  int64_t parts, batch;
  T* grad;  // (B, rows, 3)
};

// The gradient of the images: `grad` has the samples, `grad_x` the images, to which the samples that read them add up.
template <class T>
struct SampleImageBackward : Sampling<T> {
  Images<T const> grad;
  Images<T> grad_x;  // dense
  // The buffer, of the same size, that CUDA kernels add to unless they write every pixel once.
  Compute<T>* sums;

  KV_HD bool is_one_sample_per_image() const { return !this->image_index && this->images == grad.batch; }
};

// On CUDA a block of threads takes tiles of the output, up to kMaxTilesPerBlock adjacent ones: fewer where
// there are few tiles, so that every multiprocessor has some.
constexpr int kTile = 32, kMaxTilesPerBlock = 4;
inline int tiles_per_block(int64_t batch, int64_t height, int64_t width) {
  int64_t const tiles = batch * ((height + kTile - 1) / kTile) * ((width + kTile - 1) / kTile);
  return tiles >= 16384 ? kMaxTilesPerBlock : tiles >= 4096 ? kMaxTilesPerBlock / 2 : 1;
}
// Of bytes by a matrix it takes kByteAnchor x kByteAnchor pixels, or kTile x kTile where there are few.
constexpr int kByteAnchor = 64;
inline int byte_side(int64_t anchors) { return anchors < 2048 ? kTile : kByteAnchor; }

KV_KERNEL(sample, Sample)
KV_KERNEL(sample_coords_backward, SampleCoordsBackward)
KV_KERNEL(sample_image_backward, SampleImageBackward)
KV_KERNEL(warp_matrix_backward, WarpMatrixBackward)

}  // namespace kv::geometry
