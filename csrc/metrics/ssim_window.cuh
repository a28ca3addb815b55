// Window sums of any size along one axis of images or volumes on CUDA: a thread computes eight adjacent sums and reads
// each element of their windows once.
#pragma once

#include "ssim.cuh"

namespace kv::metrics::cuda {
namespace {

constexpr int kSide = 8;  // adjacent sums of a thread; also the rows and slices of a tile

template <class F>
using Double4 = Vector<F, 4>;

// The offset of a row or slice, in bytes in the images and in elements in the result, and whether it exists.
struct __align__(16) Row {
  unsigned x, y;
  int in_bounds;
};

// sums[m][j] += weight(t) * read(j + t).v[m] over all t < taps, for eight adjacent j.
template <int M, class F, class Weight, class Read>
__device__ __forceinline__ void sum_window(int taps, Weight weight, Read read, F (&sums)[M][kSide]) {
  constexpr int N = kSide;
  auto const add = [&](int j, F w, Vector<F, M> const& v) {
#pragma unroll
    for (int m = 0; m < M; ++m) sums[m][j] += w * v.v[m];
  };
  F near[N];  // the weights of the last taps, and whether a small window has them: it has an odd number
  bool const has[] = {true, taps > 1, taps > 3, taps > 5, taps > 7};
#pragma unroll
  for (int i = 0; i < N; ++i) near[i] = weight(i);
#pragma unroll
  for (int i = 0; i < N; ++i) {
    Vector<F, M> const v = read(i);
#pragma unroll
    for (int j = 0; j <= i; ++j)
      if (has[(i - j + 1) / 2]) add(j, near[i - j], v);
  }
  int i = N;
#pragma unroll 1
  for (; i < taps && (taps - i) % N != 0; ++i) {
#pragma unroll
    for (int k = 0; k + 1 < N; ++k) near[k] = near[k + 1];
    near[N - 1] = weight(i);
    Vector<F, M> const v = read(i);
#pragma unroll
    for (int j = 0; j < N; ++j) add(j, near[N - 1 - j], v);
  }
#pragma unroll 1
  for (; i < taps; i += N) {
    F next[N];
#pragma unroll
    for (int k = 0; k < N; ++k) next[k] = weight(i + k);
#pragma unroll
    for (int e = 0; e < N; ++e) {
      Vector<F, M> const v = read(i + e);
#pragma unroll
      for (int j = 0; j < N; ++j) add(j, j <= e ? next[e - j] : near[N + e - j], v);
    }
#pragma unroll
    for (int k = 0; k < N; ++k) near[k] = next[k];
  }
#pragma unroll
  for (int e = 0; e + 1 < N; ++e) {
    Vector<F, M> const v = read(min(i + e, taps + N - 2));
#pragma unroll
    for (int j = e + 1; j < N; ++j)
      if (has[(N + e - j + 1) / 2]) add(j, near[N + e - j], v);
  }
}

}  // namespace
}  // namespace kv::metrics::cuda
