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

// The 16 bytes from `from` on, wherever they begin, of the two aligned vectors that contain them.
template <class T>
__device__ __forceinline__ Vector<uint32_t, 4> load_shifted(T const* from) {
  unsigned const bytes = unsigned(reinterpret_cast<uintptr_t>(from) % 16);
  auto const* const around = reinterpret_cast<uint4 const*>(from - bytes / sizeof(T));
  uint4 const low = around[0], high = around[1];
  uint32_t words[] = {low.x, low.y, low.z, low.w, high.x, high.y, high.z, high.w};
  bool const by_two = bytes & 8, by_one = bytes & 4;
#pragma unroll
  for (int i = 0; i < 6; ++i) words[i] = by_two ? words[i + 2] : words[i];
#pragma unroll
  for (int i = 0; i < 5; ++i) words[i] = by_one ? words[i + 1] : words[i];
  if constexpr (sizeof(T) < 4)
#pragma unroll
    for (int i = 0; i < 4; ++i) words[i] = __funnelshift_r(words[i], words[i + 1], 8 * (bytes & 3));
  return {words[0], words[1], words[2], words[3]};
}
// Whether the two vectors are before `end`, where the memory may end.
template <int P, class T>
__device__ __forceinline__ bool is_within(T const* from, T const* end) {
  static_assert(P * sizeof(T) == 16);
  return from - reinterpret_cast<uintptr_t>(from) % 16 / sizeof(T) + 2 * P <= end;
}
// The P elements from `from` on. Of vectors that reach behind `end`, elements are read one by one.
template <int P, class T>
__device__ __forceinline__ Vector<T, P> load_unaligned(T const* from, T const* end) {
  Vector<T, P> vector;
  if (is_within<P>(from, end)) {
    auto const words = load_shifted(from);
    __builtin_memcpy(&vector, words.v, sizeof(vector));
  } else {
#pragma unroll
    for (int i = 0; i < P; ++i) vector.v[i] = from + i < end ? from[i] : T{};
  }
  return vector;
}

// Elements of a warp, of which those of each thread follow those of the previous one: the thread has `count` of them, P
// at most, from element `offset` on. All 32 threads make it and store; those behind the last element have a count of 0.
// As in store_striped, adjacent threads store adjacent elements, to any address.
template <int P, int Warps>
struct AdjacentElements {
  int64_t first;       // of the warp
  int at, count, all;  // the thread's first element and the number of all, from there on

  __device__ __forceinline__ AdjacentElements(int64_t offset, int count)
      : first(__shfl_sync(0xffffffffu, offset, 0)), at(count > 0 ? int(offset - first) : 0), count(count) {
    int const last = 31 - __clz(int(__ballot_sync(0xffffffffu, count > 0)));
    all = __shfl_sync(0xffffffffu, at + count, last & 31);
  }
  // Of 33 words of shared memory the last one is unused, so that threads write to different banks.
  template <class T>
  static __device__ __forceinline__ unsigned place(unsigned i) {
    return i + i / (32 * kPerWord<T>)*kPerWord<T>;
  }
  template <class T>
  __device__ __forceinline__ void store(T* to, Compute<T> const (&v)[P]) const {
    T* const memory = warp_memory<T, 33 * P, Warps>();
    unsigned const lane = threadIdx.x % 32;
    to += first;
    __syncwarp();
#pragma unroll
    for (int i = 0; i < P; ++i)
      if (i < count) memory[place<T>(at + i)] = round_to<T>(v[i]);
    __syncwarp();
#pragma unroll
    for (int i = 0; i < P; ++i)
      if (int(32 * i + lane) < all) to[32 * i + lane] = memory[place<T>(32 * i + lane)];
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
