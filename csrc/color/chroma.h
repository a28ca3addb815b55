// Colours whose chroma is shared by cells of one or two rows of two pixels: YUV 4:2:2 and 4:2:0. Included by
// chroma_cpu.cpp, chroma.cu and chroma_op.cpp.
//
// A matrix m makes luma of a pixel's colours c, m[0] . c, and chroma of their sums over the cell, m[1] . s and m[2] .
// s; or colours of a pixel's luma and its cell's chroma. Each is the transpose of the other with the transposed matrix.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct SplitChroma {
  Planes<T const> colors;  // three planes an image
  Planes<T> luma, chroma;  // one, and two of half the width and 1 / rows of the height
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
KV_HD V weighted(F const* m, V const& a, V const& b, V const& c) {
  return a * m[0] + b * m[1] + c * m[2];
}

}  // namespace kv
