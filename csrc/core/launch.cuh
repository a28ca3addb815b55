// What every CUDA kernel needs: 16-bit storage, vectors of four pixels, grid arithmetic. Included by *.cu files.
#pragma once

#include <cuda_bf16.h>
#include <cuda_fp16.h>
#include <cuda_runtime.h>

#include "border.h"
#include "half.h"
#include "view.h"

namespace kv {

constexpr int64_t ceil_div(int64_t a, int64_t b) { return (a + b - 1) / b; }

// --- storage <-> compute type
// ------------------------------------------------------------------------------------------

__device__ __forceinline__ float read(float x) { return x; }
__device__ __forceinline__ double read(double x) { return x; }
__device__ __forceinline__ float read(uint8_t x) { return float(x); }
__device__ __forceinline__ float read(Half x) { return __half2float(__ushort_as_half(x.bits)); }
__device__ __forceinline__ float read(BFloat16 x) { return __uint_as_float(uint32_t(x.bits) << 16); }

template <class T>
__device__ __forceinline__ T round_to(Compute<T> x) {
  if constexpr (sizeof(T) >= 4)
    return x;
  else if constexpr (sizeof(T) == 1)
    return uint8_t(min(max(__float2int_rn(x), 0), 255));  // saturates; NaN is 0
  else if constexpr (__is_same(T, Half))
    return {__half_as_ushort(__float2half_rn(x))};
  else
    return {__bfloat16_as_ushort(__float2bfloat16_rn(x))};
}

// --- four neighbouring elements
// ----------------------------------------------------------------------------------------

// One access where the address allows it: 16 bytes of float, 8 of the half types, 4 of bytes.
template <class T>
struct alignas(4 * sizeof(T) > 16 ? 16 : 4 * sizeof(T)) Four {
  T v[4];
};

template <class T>
__host__ __device__ inline bool is_aligned(Planes<T> const& p) {
  constexpr int64_t bytes = alignof(Four<std::remove_const_t<T>>), size = sizeof(T);
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.outer_stride * size % bytes == 0 &&
         p.inner_stride * size % bytes == 0 && p.row_stride * size % bytes == 0;
}

// `aligned`: rows start at multiples of the vector's size (is_aligned), and x is a multiple of 4.
template <class T>
__device__ __forceinline__ void load_four(Compute<T> (&v)[4], T const* row, int x, int size, bool aligned) {
  if (aligned && x + 4 <= size) {
    Four<T> const four = *reinterpret_cast<Four<T> const*>(row + x);
#pragma unroll
    for (int i = 0; i < 4; ++i) v[i] = read(four.v[i]);
  } else {
#pragma unroll
    for (int i = 0; i < 4; ++i) v[i] = x + i < size ? read(row[x + i]) : Compute<T>(0);
  }
}

template <class T>
__device__ __forceinline__ void store_four(T* row, int x, int size, bool aligned, Compute<T> const (&v)[4]) {
  if (aligned && x + 4 <= size) {
    Four<T> four;
#pragma unroll
    for (int i = 0; i < 4; ++i) four.v[i] = round_to<T>(v[i]);
    *reinterpret_cast<Four<T>*>(row + x) = four;
  } else {
#pragma unroll
    for (int i = 0; i < 4; ++i)
      if (x + i < size) row[x + i] = round_to<T>(v[i]);
  }
}

// --- strips: a warp's row of 128 elements, each thread's four with R neighbours on either side
// --------------------------

// The values at elements x - R ... x + 3 + R of a row into v, x being four times the thread's place in the row, for
// planar images (step 1). Neighbours come from the neighbouring threads; only a warp's ends and the image's rim read
// memory again. All 32 threads must call it, those beyond the row included; R <= 4. With border constant, what is
// outside is 0.
template <int R, class T>
__device__ __forceinline__ void load_strip(Compute<T> (&v)[4 + 2 * R], T const* row, int x, int width, bool aligned,
                                           Border border) {
  static_assert(R <= 4, "a neighbour holds four elements");
  int const lane = threadIdx.x % 32;
  auto const outside = [&](int i) {
    int const inside = border_index(border, i, width);
    return inside < 0 ? Compute<T>(0) : read(row[inside]);
  };
  Compute<T> four[4];
  if (x + 4 <= width)
    load_four<T>(four, row, x, width, aligned);
  else
#pragma unroll
    for (int i = 0; i < 4; ++i) four[i] = x + i < width + R ? outside(x + i) : Compute<T>(0);
#pragma unroll
  for (int i = 0; i < 4; ++i) v[R + i] = four[i];
#pragma unroll
  for (int i = 0; i < R; ++i) {
    v[i] = __shfl_up_sync(0xffffffffu, four[4 - R + i], 1);
    v[R + 4 + i] = __shfl_down_sync(0xffffffffu, four[i], 1);
  }
  if (lane == 0 && x < width)
#pragma unroll
    for (int i = 0; i < R; ++i) v[i] = outside(x - R + i);
  if (lane == 31)
#pragma unroll
    for (int i = 0; i < R; ++i) v[R + 4 + i] = x + 4 + i < width + R ? outside(x + 4 + i) : Compute<T>(0);
}

// Splits planes into strips of 128 elements by `Rows` rows, one a warp, x fastest: whole warps of one block read
// neighbouring memory. Blocks of 256 threads.
struct Strips {
  int64_t across, down, count;
  KV_HD Strips(int64_t planes, int64_t height, int64_t width, int rows)
      : across((width + 127) / 128), down((height + rows - 1) / rows), count(planes * across * down) {}
  unsigned blocks() const { return unsigned((count + 7) / 8); }
  // The warp's strip: false beyond the last one.
  __device__ __forceinline__ bool place(int rows, int64_t& plane, int& x, int& y) const {
    int64_t const warp = int64_t(blockIdx.x) * 8 + threadIdx.x / 32;
    if (warp >= count) return false;
    int64_t const q = warp / across;
    x = int(warp - q * across) * 128 + (threadIdx.x % 32) * 4;
    plane = q / down;
    y = int(q - plane * down) * rows;
    return true;
  }
};

}  // namespace kv
