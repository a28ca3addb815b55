// Median blur: every pixel becomes the median of its window, for an even count the lower of the two in the middle.
//
// Windows of 3x3 and 5x5 pixels take a selection network over a value type that has a min and a max: lanes on the CPU,
// floats on CUDA. Windows that overlap share sorted rows:
//
//   row y - 2   . . . . .  ┐
//   row y - 1   . . . . .  │ ┐   1. Each row of a window is sorted. K windows below each other share it.
//   row y       . . o . .  │ │   2. The rows that the windows of two outputs o have in common are merged. Only the
//   row y + 1   . . o . .  │ │      ranks that can be a median of either window are kept.
//   row y + 2   . . . . .  ┘ │   3. Each output merges these with the one row that only its window has, and takes the
//   row y + 3   . . . . .    ┘      middle.
//
// That takes 16 and 54 operations a pixel. For larger windows the median is found bit by bit: it is the largest key
// that at most half of the window's keys are below.
#pragma once

#include "core/border.h"
#include "core/isa.h"
#include "core/stencils/filter_list.h"
#include "core/stencils/gradient_list.h"
#include "core/view.h"
#ifdef __CUDACC__
#include "core/nan_min_max.cuh"
#endif

namespace kv::filters {

template <class T>
struct MedianBlur {
  Planes<T const> x;
  Planes<T> y;
  int64_t ky, kx;
  Border border;

  KV_HD void select(int64_t) {}
};

template <class T>
struct MedianBlurList : FilterList<MedianBlur<T>, T> {};

template <class T>
struct MedianBlurBackward {
  Planes<T const> grad, x, y;  // y: the result of the forward pass
  Planes<T> grad_x;
  int64_t ky, kx;
  Border border;

  KV_HD void select(int64_t) {}
};

// With the results of the forward pass, which are stored as the gradients of images are.
template <class T>
struct MedianBlurBackwardList : GradientList<MedianBlurBackward<T>, T, true> {
  void const* medians[kMaxListedGradients];

  KV_HD MedianBlurBackward<T> sample(int b) const {
    auto one = GradientList<MedianBlurBackward<T>, T, true>::sample(b);
    auto const [data, outer, inner, outer_stride, inner_stride, row_stride, height, width, step] = one.grad_x;
    one.y = {
        static_cast<T const*>(medians[b]), outer, inner, outer_stride, inner_stride, row_stride, height, width, step};
    return one;
  }
};

KV_KERNEL(median_blur, MedianBlur)
KV_KERNEL(median_blur_list, MedianBlurList)
KV_KERNEL(median_blur_backward, MedianBlurBackward)
KV_KERNEL(median_blur_list_backward, MedianBlurBackwardList)

// Pixels of a window of size k before and after its center.
KV_HD int64_t median_before(int64_t k) { return (k - 1) / 2; }
KV_HD int64_t median_after(int64_t k) { return k / 2; }

// --- selection networks ----------------------------------------------------------------------------------------------

#if defined(__CUDACC__)
#define KV_UNROLL _Pragma("unroll")
#else
#define KV_UNROLL _Pragma("GCC unroll 32")
#endif

// On CUDA a NaN wins every exchange and so reaches the median, which depends on each value. Lanes drop NaN, and the CPU
// kernel marks the windows with NaN afterwards.
template <class V>
KV_HD V lower(V a, V b) {
#if defined(__CUDA_ARCH__)
  return a < b || a != a ? a : b;
#else
  return min(a, b);
#endif
}
template <class V>
KV_HD V upper(V a, V b) {
#if defined(__CUDA_ARCH__)
  return a > b || a != a ? a : b;
#else
  return max(a, b);
#endif
}
#if defined(__CUDA_ARCH__)
KV_HD float lower(float a, float b) { return nan_min(a, b); }
KV_HD float upper(float a, float b) { return nan_max(a, b); }
#endif

template <class V>
KV_HD void exchange(V& a, V& b) {
  V const low = lower(a, b);
  b = upper(a, b);
  a = low;
}

// A row of a window is sorted in two steps. The first sorts v[1 ... K - 1], which two adjacent windows share; the
// second inserts v[0].
template <int K, class V>
KV_HD void sort_common(V (&v)[K]) {
  static_assert(K == 3 || K == 5);
  exchange(v[1], v[2]);
  if constexpr (K == 5) {
    exchange(v[3], v[4]);
    exchange(v[1], v[3]);
    exchange(v[2], v[4]);
    exchange(v[2], v[3]);
  }
}
template <int K, class V>
KV_HD void insert_first(V (&v)[K]) {
  KV_UNROLL
  for (int i = 0; i + 1 < K; ++i) exchange(v[i], v[i + 1]);
}

// Merges sorted a and b into sorted z by Batcher's odd-even merge: it merges the elements of even index and those of
// odd index, and combines the two by one round of exchanges. The compiler removes results that are not used.
template <int N, int M, class V>
KV_HD void merge(V const (&a)[N], V const (&b)[M], V (&z)[N + M]) {
  if constexpr (N == 1 && M == 1) {
    z[0] = lower(a[0], b[0]);
    z[1] = upper(a[0], b[0]);
  } else {
    constexpr int N0 = (N + 1) / 2, N1 = N / 2, M0 = (M + 1) / 2, M1 = M / 2, even = N0 + M0, odd = N1 + M1;
    V a0[N0], a1[N1], b0[M0], b1[M1], v[even], w[odd];
    KV_UNROLL
    for (int i = 0; i < N; ++i) (i % 2 ? a1[i / 2] : a0[i / 2]) = a[i];
    KV_UNROLL
    for (int i = 0; i < M; ++i) (i % 2 ? b1[i / 2] : b0[i / 2]) = b[i];
    merge<N0, M0>(a0, b0, v);
    merge<N1, M1>(a1, b1, w);
    z[0] = v[0];
    KV_UNROLL
    for (int i = 1; i < even; ++i) {
      if (i <= odd) {
        z[2 * i - 1] = lower(w[i - 1], v[i]);
        z[2 * i] = upper(w[i - 1], v[i]);
      } else {
        z[odd + i] = v[i];
      }
    }
    if constexpr (odd == even) z[N + M - 1] = w[odd - 1];
  }
}

template <class V>
KV_HD V median_of_three(V a, V b, V c) {
  return upper(lower(a, b), lower(upper(a, b), c));
}

// The values that the windows of two outputs have in common, K (K - 1) of them, reduced to the K + 1 in the middle:
// only K values of a window are missing, so its median is one of these or of those.
template <int K, class V>
KV_HD void middle_of_two(V const (&a)[K], V const (&b)[K], V (&middle)[K + 1]) {
  static_assert(K == 3);
  V z[2 * K];
  merge<K, K>(a, b, z);
  KV_UNROLL
  for (int i = 0; i <= K; ++i) middle[i] = z[1 + i];
}
template <int K, class V>
KV_HD void middle_of_two(V const (&a)[2 * K], V const (&b)[2 * K], V (&middle)[K + 1]) {
  static_assert(K == 5);
  V z[4 * K];
  merge<2 * K, 2 * K>(a, b, z);
  KV_UNROLL
  for (int i = 0; i <= K; ++i) middle[i] = z[7 + i];
}

// The median of a window from the middle of the common values and its own sorted row.
template <int K, class V>
KV_HD V median_of(V const (&middle)[K + 1], V const (&row)[K]) {
  V median = middle[K];
  KV_UNROLL
  for (int i = 0; i < K; ++i) median = lower(median, upper(middle[i], row[K - 1 - i]));
  return median;
}

// --- keys: integers that are ordered like the numbers; NaN is the largest --------------------------------------------

template <class T>
struct median_key {
  using type = int32_t;
};
template <>
struct median_key<double> {
  using type = int64_t;
};
template <class T>
using MedianKey = typename median_key<T>::type;

template <class T>
constexpr int kMedianKeyBits = 8 * sizeof(T);
template <class T>
constexpr MedianKey<T> kMedianKeyOfNan = MedianKey<T>(~uint64_t(0) >> (65 - kMedianKeyBits<T>));

// Floats are ordered like their bits; negative ones in reverse.
template <class Int>
KV_HD Int flip_negative(Int bits, Int magnitude) {
  return bits < 0 ? Int(bits ^ magnitude) : bits;
}
KV_HD int32_t to_key(uint8_t x) { return x - 128; }
KV_HD int32_t to_key(float x) {
  return x != x ? kMedianKeyOfNan<float> : flip_negative(int32_t(float_to_bits(x)), 0x7fffffff);
}
KV_HD int32_t to_key(Half x) {
  return (x.bits & 0x7fff) > 0x7c00 ? kMedianKeyOfNan<Half> : flip_negative(int32_t(int16_t(x.bits)), 0x7fff);
}
KV_HD int32_t to_key(BFloat16 x) {
  return (x.bits & 0x7fff) > 0x7f80 ? kMedianKeyOfNan<BFloat16> : flip_negative(int32_t(int16_t(x.bits)), 0x7fff);
}
KV_HD int64_t to_key(double x) {
  int64_t bits;
  __builtin_memcpy(&bits, &x, 8);
  return x != x ? kMedianKeyOfNan<double> : flip_negative(bits, int64_t(0x7fffffffffffffff));
}

template <class T>
KV_HD T from_key(MedianKey<T> key) {
  if constexpr (sizeof(T) == 1) {
    return T(key + 128);
  } else {
    MedianKey<T> const bits = flip_negative(key, kMedianKeyOfNan<T>);
    T x;
    __builtin_memcpy(&x, &bits, sizeof(T));  // the low bytes
    return x;
  }
}

// The key of rank `rank`, where count(key) is the number of keys below `key`. V is one key or lanes of them.
template <class T, class V, class Count>
KV_HD V select_key(V lowest, MedianKey<T> rank, Count count) {
  V best = lowest;
  for (int bit = kMedianKeyBits<T> - 1; bit >= 0; --bit) {
    MedianKey<T> const below = MedianKey<T>((uint64_t(1) << bit) - 1);
    V const candidate = best + below + 1;  // added in two steps: the highest bit alone would overflow
    best = count(candidate) <= rank ? candidate : best;
  }
  return best;
}
template <class T>
constexpr MedianKey<T> kLowestMedianKey = -kMedianKeyOfNan<T> - 1;

// --- gradient --------------------------------------------------------------------------------------------------------

// How often the window of output q, [q - before, q + after], reads pixel j of n. With the circular border q may be out
// of bounds, because outputs repeat with the pixels.
template <class Int>
KV_HD Int median_read_count(Border border, Int q, Int j, Int n, Int before, Int after) {
  if (border == Border::circular) return j >= q - before && j <= q + after;
  Int count = 0;
  for_each_reader(border, j, n, before, after, [&](Int at) { count += at >= q - before && at <= q + after; });
  return count;
}

}  // namespace kv::filters
