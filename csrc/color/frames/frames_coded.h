// RGB to the codes of video frames: luma of each pixel, and chroma of one or two of each two pixels along an axis.
//
// Codes are affine in the colors. Chroma of two rows is a weighted sum of rows of chroma, and then of columns:
//
//   nearest  1 of the even pixel                 cosited  1/4, 1/2, 1/4 of the pixels around the even one
//   between  1/2, 1/2 of the even and the odd one
//
// where the border repeats the outermost pixels.
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "frames.h"

namespace kv::color {

// A plane of codes that is written, with any strides, in elements.
struct CodeTarget {
  void* data;
  int64_t frame_stride, row_stride, column_stride;

  template <class S>
  KV_HD S* row(int64_t frame, int64_t y) const {
    return static_cast<S*>(data) + frame * frame_stride + y * row_stride;
  }
};

template <class T>
struct CodedFrames {
  Planes<T const> rgb;   // three planes a frame
  CodeTarget planes[3];  // y, u, v
  int code_bytes;        // 1 and 2: unsigned integers, the latter with 10 bits at the top; 0: T
  FrameAxis x, y;
  Compute<T> matrix[9], offset[3];

  template <class V>
  KV_HD V code(int k, V const& red, V const& green, V const& blue) const {
    return red * matrix[3 * k] + (green * matrix[3 * k + 1] + (blue * matrix[3 * k + 2] + offset[k]));
  }
  KV_HD int rows_of_chroma() const { return y.is_halved() ? 2 : 1; }
};

KV_KERNEL(coded_frames, CodedFrames)

// The weight of pixel `at` of -1 to 1, where 0 is the even one, in the chroma of an axis.
template <class F>
KV_HD F subsampling_weight(FrameAxis const& a, int at) {
  if (!a.is_halved() || a.site == ChromaSite::nearest) return at == 0 ? F(1) : F(0);
  if (a.site == ChromaSite::between) return at < 0 ? F(0) : F(0.5);
  return at == 0 ? F(0.5) : F(0.25);
}

// Ten bits at the top of sixteen.
template <class F>
KV_HD uint16_t ten_bits(F code) {
  F const within = code > F(0) ? code < F(1023) ? code : F(1023) : F(0);
  return uint16_t(int(round_to_even(within)) << 6);
}

}  // namespace kv::color
