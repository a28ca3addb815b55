// Aligned vectors of rows that begin and end anywhere, as those of odd sizes and of slices do. Included by *.cu files.
//
//   vectors          | . . a b | c d e f | g h i j | k . . . |
//   row                    a b   c d e f   g h i j   k           body: c ... j; a, b and k are peeled
//
// Kernels of several tensors use them where all rows have the same alignment. Otherwise, adjacent threads take adjacent
// elements (P = 1): a warp accesses the elements of at most two cache lines at a time wherever rows begin. A thread
// then takes several elements at once, and those of a warp are near each other, so that the parts of a sector that
// different accesses write meet in the cache.
#pragma once

#include "launch.cuh"

namespace kv {

// Whether vectors of P elements that are aligned in one image are so in the other, pixel by pixel.
template <int P, class A, class B>
inline bool are_equally_aligned(Planes<A> const& a, Planes<B> const& b) {
  static_assert(sizeof(A) == sizeof(B));
  int64_t const apart = int64_t(reinterpret_cast<uintptr_t>(a.data) - reinterpret_cast<uintptr_t>(b.data));
  int64_t const elements = (a.outer > 1 ? a.outer_stride - b.outer_stride : 0) |
                           (a.inner > 1 ? a.inner_stride - b.inner_stride : 0) |
                           (a.height > 1 ? a.row_stride - b.row_stride : 0);
  return a.step == 1 && b.step == 1 && apart % int64_t(P * sizeof(A)) == 0 && elements % P == 0;
}

// The part of the elements [first, last) of a row that is aligned vectors of P elements, [begin, end).
template <int P, class I>
struct AlignedBody {
  I first, last, begin, end;

  template <class T>
  __device__ __forceinline__ AlignedBody(T const* row, I first, I last) : first(first), last(last) {
    int const before = int(reinterpret_cast<uintptr_t>(row + first) % alignof(Vector<T, P>)) / int(sizeof(T));
    begin = min(first + I((P - before) & (P - 1)), last);
    end = begin + (last - begin) / P * P;
  }
  // Calls f with each peeled element, in one of the first threads of a block.
  template <class F>
  __device__ __forceinline__ void for_each_peeled(F f) const {
    if constexpr (P > 1) {
      I const t = I(threadIdx.x);
      if (t < begin - first) f(first + t);
      if (t < last - end) f(end + t);
    }
  }
};

// Calls f with the number of elements of a thread's vectors as a constant: P, or 1 unless all rows have the same
// alignment.
template <int P, class F>
void with_row_vectors(bool equally_aligned, F f) {
  if (P > 1 && equally_aligned)
    f(std::integral_constant<int, P>{});
  else
    f(std::integral_constant<int, 1>{});
}

}  // namespace kv
