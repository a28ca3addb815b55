// YUV 4:2:2 and 4:2:0: colors whose chroma is common to a cell of one or two rows of two pixels.
//
// split_chroma computes the luma of a pixel's color c as m[0] . c, and the chroma of the sum s of the colors in a cell
// as m[1] . s and m[2] . s. join_chroma computes the color of a pixel from its luma and the chroma of its cell. Each is
// the transpose of the other with the transposed matrix.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::color {

template <class T>
struct SplitChroma {
  Planes<T const> colors;  // three planes per image
  Planes<T> luma, chroma;  // one plane, and two of half the width and 1 / rows of the height
  int rows;                // of a cell
  Compute<T> m[9];
};
template <class T>
struct JoinChroma {
  Planes<T const> luma, chroma;
  Planes<T> colors;
  int rows;
  Compute<T> m[9];
};

KV_KERNEL(split_chroma, SplitChroma)
KV_KERNEL(join_chroma, JoinChroma)

template <class V, class F>
KV_HD V dot3(F const* m, V const& a, V const& b, V const& c) {
  return a * m[0] + b * m[1] + c * m[2];
}

}  // namespace kv::color
