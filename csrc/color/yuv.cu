// YUV 4:2:2 and 4:2:0 on CUDA: a thread takes the cells of four adjacent columns.
#include "vectors.cuh"
#include "yuv.h"

namespace kv::color::cuda {
namespace {

constexpr int kPixelsPerThread = 4, kRows = 8;

// N elements of a row, of which the first `count` exist.
template <int N, class T>
__device__ __forceinline__ void load_elements(T const* from, bool vectorized, int count, Compute<T> (&v)[N]) {
  if (vectorized) {
    auto const vector = *reinterpret_cast<Vector<T, N> const*>(from);
#pragma unroll
    for (int j = 0; j < N; ++j) v[j] = read(vector.v[j]);
  } else {
#pragma unroll
    for (int j = 0; j < N; ++j) v[j] = j < count ? read(from[j]) : Compute<T>(0);
  }
}
template <int N, class T>
__device__ __forceinline__ void store_elements(T* to, bool vectorized, int count, Compute<T> const (&v)[N]) {
  if (vectorized) {
    store_vector(to, v);
  } else {
#pragma unroll
    for (int j = 0; j < N; ++j)
      if (j < count) to[j] = round_to<T>(v[j]);
  }
}

template <class T>
__global__ void __launch_bounds__(32 * kRows) split(__grid_constant__ SplitChroma<T> const p, bool vectorized) {
  using F = Compute<T>;
  int const x = int(blockIdx.x * 32 + threadIdx.x) * kPixelsPerThread, y = int(blockIdx.y * kRows + threadIdx.y);
  int const width = int(p.colors.width), num_pixels = min(width - x, kPixelsPerThread);
  if (num_pixels <= 0 || y >= p.chroma.height) return;
  for (int64_t b = blockIdx.z; b < p.luma.count(); b += gridDim.z) {
    F c[2][3][kPixelsPerThread];
#pragma unroll
    for (int r = 0; r < 2; ++r)
#pragma unroll
      for (int k = 0; k < 3; ++k)
        if (r < p.rows)
          load_elements(p.colors.row(3 * b + k, int64_t(y) * p.rows + r) + x, vectorized, num_pixels, c[r][k]);
        else
#pragma unroll
          for (int j = 0; j < kPixelsPerThread; ++j) c[r][k][j] = 0;
#pragma unroll
    for (int r = 0; r < 2; ++r) {
      if (r >= p.rows) break;
      F luma[kPixelsPerThread];
#pragma unroll
      for (int j = 0; j < kPixelsPerThread; ++j) luma[j] = dot3(p.m, c[r][0][j], c[r][1][j], c[r][2][j]);
      store_elements(p.luma.row(b, int64_t(y) * p.rows + r) + x, vectorized, num_pixels, luma);
    }
    F sums[3][kPixelsPerThread / 2];
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int j = 0; j < kPixelsPerThread; j += 2)
        sums[k][j / 2] = (c[0][k][j] + c[0][k][j + 1]) + (c[1][k][j] + c[1][k][j + 1]);
#pragma unroll
    for (int k = 0; k < 2; ++k) {
      F chroma[kPixelsPerThread / 2];
#pragma unroll
      for (int j = 0; j < kPixelsPerThread / 2; ++j)
        chroma[j] = dot3(p.m + 3 + 3 * k, sums[0][j], sums[1][j], sums[2][j]);
      store_elements(p.chroma.row(2 * b + k, y) + x / 2, vectorized, num_pixels / 2, chroma);
    }
  }
}

template <class T>
__global__ void __launch_bounds__(32 * kRows) join(__grid_constant__ JoinChroma<T> const p, bool vectorized) {
  using F = Compute<T>;
  int const x = int(blockIdx.x * 32 + threadIdx.x) * kPixelsPerThread, y = int(blockIdx.y * kRows + threadIdx.y);
  int const width = int(p.colors.width), num_pixels = min(width - x, kPixelsPerThread);
  if (num_pixels <= 0 || y >= p.chroma.height) return;
  for (int64_t b = blockIdx.z; b < p.luma.count(); b += gridDim.z) {
    F luma[2][kPixelsPerThread], chroma[2][kPixelsPerThread / 2];
#pragma unroll
    for (int k = 0; k < 2; ++k) {
      load_elements(p.chroma.row(2 * b + k, y) + x / 2, vectorized, num_pixels / 2, chroma[k]);
      if (k < p.rows) load_elements(p.luma.row(b, int64_t(y) * p.rows + k) + x, vectorized, num_pixels, luma[k]);
    }
#pragma unroll
    for (int r = 0; r < 2; ++r) {
      if (r >= p.rows) break;
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        F c[kPixelsPerThread];
#pragma unroll
        for (int j = 0; j < kPixelsPerThread; ++j)
          c[j] = dot3(p.m + 3 * k, luma[r][j], chroma[0][j / 2], chroma[1][j / 2]);
        store_elements(p.colors.row(3 * b + k, int64_t(y) * p.rows + r) + x, vectorized, num_pixels, c);
      }
    }
  }
}

template <class P>
bool are_vectorized(P const& p) {
  return has_whole_vectors<kPixelsPerThread>(p.colors) && has_whole_vectors<kPixelsPerThread>(p.luma) &&
         has_whole_vectors<kPixelsPerThread / 2>(p.chroma);
}
template <class P>
dim3 blocks_of(P const& p) {
  return blocks_of_vectors<kPixelsPerThread>(p.colors.width, p.chroma.height, kRows, p.luma.count());
}

}  // namespace

template <class T>
int split_chroma(SplitChroma<T> const& p, CUstream_st* stream) {
  split<<<blocks_of(p), dim3(32, kRows), 0, stream>>>(p, are_vectorized(p));
  return cudaGetLastError();
}
template <class T>
int join_chroma(JoinChroma<T> const& p, CUstream_st* stream) {
  join<<<blocks_of(p), dim3(32, kRows), 0, stream>>>(p, are_vectorized(p));
  return cudaGetLastError();
}

KV_INSTANTIATE(split_chroma, SplitChroma)
KV_INSTANTIATE(join_chroma, JoinChroma)

}  // namespace kv::color::cuda
