// Shared by all CUDA kernels: conversion of storage types, vector accesses, grid arithmetic. Included
// by *.cu files.
#pragma once

#include <cuda_runtime.h>

#include <cmath>
#include <type_traits>

#include "border.h"
#include "ceil_div.h"
#include "half.h"
#include "shared_memory.h"
#include "view.h"
#include "warp_reduce.cuh"

namespace kv {

// --- storage <-> compute type ----------------------------------------------------------------------------------------

__device__ __forceinline__ float read(float x) { return x; }
__device__ __forceinline__ double read(double x) { return x; }
__device__ __forceinline__ float read(uint8_t x) { return float(x); }
// Byte k of four, as a floating-point number.
template <class F>
__device__ __forceinline__ F byte_of(uint32_t four, int k) {
  if constexpr (sizeof(F) == 4)  // 2^23 plus the byte, as bits: a conversion instruction takes four times as long
    return __uint_as_float(__byte_perm(four, 0x4b000000u, 0x7440 + k)) - F(1 << 23);
  else
    return F(four >> 8 * k & 255);
}
// The same times `scale`, rounded once: 2^23 times scale is exact.
__device__ __forceinline__ float scaled_byte_of(uint32_t four, int k, float scale) {
  return fmaf(__uint_as_float(__byte_perm(four, 0x4b000000u, 0x7440 + k)), scale, -scale * float(1 << 23));
}
// Inline assembly because CUDA's headers of 16-bit types add a second to the compilation of every file.
__device__ __forceinline__ float read(Half x) {
  float y;
  asm("cvt.f32.f16 %0, %1;" : "=f"(y) : "h"(x.bits));
  return y;
}
__device__ __forceinline__ float read(BFloat16 x) { return __uint_as_float(uint32_t(x.bits) << 16); }

__device__ __forceinline__ Half round_to_half(float x) {
  Half y;
  asm("cvt.rn.f16.f32 %0, %1;" : "=h"(y.bits) : "f"(x));
  return y;
}
__device__ __forceinline__ BFloat16 round_to_bfloat16(float x) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return to_bfloat16(x);
#else
  BFloat16 y;
  asm("cvt.rn.bf16.f32 %0, %1;" : "=h"(y.bits) : "f"(x));
  return y;
#endif
}
// Saturates; NaN is 0.
__device__ __forceinline__ uint8_t round_to_byte(float x) {
  uint32_t byte;
  asm("cvt.rni.sat.u8.f32 %0, %1;" : "=r"(byte) : "f"(x));
  return uint8_t(byte);
}

template <class T>
__device__ __forceinline__ T round_to(Compute<T> x) {
  if constexpr (sizeof(T) >= 4)
    return x;
  else if constexpr (sizeof(T) == 1)
    return round_to_byte(x);
  else if constexpr (__is_same(T, Half))
    return round_to_half(x);
  else
    return round_to_bfloat16(x);
}

// Four numbers as bytes of a word, rounded and saturated as by round_to.
__device__ __forceinline__ uint32_t round_to_bytes(float a, float b, float c, float d) {
  uint32_t bytes;  // two instructions, as ptxas merges the conversions to integers with those to bytes
  asm("{ .reg .u32 upper; cvt.pack.sat.u8.s32.b32 upper, %4, %3, 0; cvt.pack.sat.u8.s32.b32 %0, %2, %1, upper; }"
      : "=r"(bytes)
      : "r"(__float2int_rn(a)), "r"(__float2int_rn(b)), "r"(__float2int_rn(c)), "r"(__float2int_rn(d)));
  return bytes;
}

// --- vectors ---------------------------------------------------------------------------------------------------------

// P adjacent elements, read or written in as few accesses as possible: 16 bytes each.
template <class T, int P>
struct alignas(P * sizeof(T) > 16 ? 16 : P * sizeof(T)) Vector {
  T v[P];
};

// Stores P elements. The address is a multiple of their size. Vectors of 8 and 16 bytes are streamed: results are not
// read again soon and must not evict inputs from L2. Vectors of bytes and of half types are stored as words: nvcc may
// split them into elements where another path of the kernel stores elements.
template <class T, int P>
__device__ __forceinline__ void store_vector(T* to, Vector<T, P> const& vector) {
  if constexpr (sizeof(vector) == 16)
    __stcs(reinterpret_cast<uint4*>(to), *reinterpret_cast<uint4 const*>(&vector));
  else if constexpr (sizeof(vector) == 8)
    __stcs(reinterpret_cast<uint2*>(to), *reinterpret_cast<uint2 const*>(&vector));
  else if constexpr (sizeof(vector) == 4 && P > 1)
    *reinterpret_cast<uint32_t*>(to) = *reinterpret_cast<uint32_t const*>(&vector);
  else
    *reinterpret_cast<Vector<T, P>*>(to) = vector;
}
template <class T, int P, class F>
__device__ __forceinline__ Vector<T, P> rounded(F const (&v)[P]) {
  Vector<T, P> vector;
  if constexpr (sizeof(T) == 1 && P % 4 == 0) {
    uint32_t words[P / 4];
#pragma unroll
    for (int i = 0; i < P / 4; ++i) words[i] = round_to_bytes(v[4 * i], v[4 * i + 1], v[4 * i + 2], v[4 * i + 3]);
    __builtin_memcpy(&vector, words, sizeof(vector));
  } else {
#pragma unroll
    for (int i = 0; i < P; ++i) vector.v[i] = round_to<T>(v[i]);
  }
  return vector;
}
// The same of P numbers, which are rounded first.
template <class T, int P, class F>
__device__ __forceinline__ void store_vector(T* to, F const (&v)[P]) {
  store_vector(to, rounded<T>(v));
}

// Pixels per thread: 16 bytes of types with 2 or 4 bytes.
template <class T>
constexpr int kPixels = sizeof(T) == 2 ? 8 : 4;

// --- fast math -------------------------------------------------------------------------------------------------------

// Approximate instructions, an order of magnitude cheaper than the rounded functions, with an error of about 2^-22.
__device__ __forceinline__ float fast_sqrt(float x) {
  float y;
  asm("sqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ double fast_sqrt(double x) { return ::sqrt(x); }
__device__ __forceinline__ float fast_rsqrt(float x) {
  float y;
  asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ double fast_rsqrt(double x) { return 1 / ::sqrt(x); }

__device__ __forceinline__ float fast_exp2(float x) {
  float y;
  asm("ex2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ double fast_exp2(double x) { return ::exp2(x); }
__device__ __forceinline__ float fast_log2(float x) { return __log2f(x); }
__device__ __forceinline__ double fast_log2(double x) { return ::log2(x); }

// --- strips ---
//
// A warp reads a row of 32 P elements of a planar image (step 1), each thread the elements x - R ... x + P - 1 + R.
// Elements out of bounds follow the border rule, where constant is 0. R <= P.
//
// Reading a row has two steps, so that loads of the next row are in flight while this one is processed: fetch, and
// spread, which like store is called by all 32 threads, also by those out of bounds.

constexpr int kStripWarps = 8;  // of a block at most, unless a kernel says otherwise

// Aligned: rows start at multiples of the vector's size and their width is a multiple of P (is_vectorizable), so a
// thread is in bounds or out of bounds as a whole. The neighbors come from adjacent threads by shuffles; only the first
// and the last thread of a warp and those at the image border read memory again.
template <int R, bool Aligned, int P = 4, int Warps = kStripWarps>
struct Strip {
  static_assert(R >= 0 && R <= P, "an adjacent thread holds P elements");
  int x, width;
  Border border;
  bool inside, left_end, right_end;
  int left[R > 0 ? R : 1], right[R > 0 ? R : 1];  // columns that the end threads read, -1 for the constant

  __device__ __forceinline__ Strip(int x, int width, Border border)
      : x(x),
        width(width),
        border(border),
        inside(x < width),
        left_end(inside && threadIdx.x % 32 == 0),
        right_end(inside && (threadIdx.x % 32 == 31 || x + P >= width)) {
#pragma unroll
    for (int i = 0; i < R; ++i) {
      left[i] = border_index(border, x - R + i, width);
      right[i] = border_index(border, x + P + i, width);
    }
  }

  template <class T>
  struct FetchedRow {
    Vector<T, P> own;
    T left[R > 0 ? R : 1], right[R > 0 ? R : 1];
  };
  template <class T>
  __device__ __forceinline__ FetchedRow<T> fetch(T const* row) const {
    FetchedRow<T> f{};
    if (inside) f.own = *reinterpret_cast<Vector<T, P> const*>(row + x);
#pragma unroll
    for (int i = 0; i < R; ++i) {
      if (left_end && left[i] >= 0) f.left[i] = row[left[i]];
      if (right_end && right[i] >= 0) f.right[i] = row[right[i]];
    }
    return f;
  }
  template <class T>
  __device__ __forceinline__ void spread(FetchedRow<T> const& f, Compute<T> (&v)[P + 2 * R]) const {
#pragma unroll
    for (int i = 0; i < P; ++i) v[R + i] = read(f.own.v[i]);
#pragma unroll
    for (int i = 0; i < R; ++i) {
      Compute<T> const from_left = __shfl_up_sync(0xffffffffu, v[P + i], 1);
      Compute<T> const from_right = __shfl_down_sync(0xffffffffu, v[R + i], 1);
      v[i] = left_end ? read(f.left[i]) : from_left;
      v[R + P + i] = right_end ? read(f.right[i]) : from_right;
    }
  }
  template <class T>
  __device__ __forceinline__ void load(Compute<T> (&v)[P + 2 * R], T const* row) const {
    spread(fetch(row), v);
  }
  template <class T>
  __device__ __forceinline__ void store(T* row, Compute<T> const (&v)[P]) const {
    if (inside) store_vector(row + x, v);
  }
  // As `store`; other rows in stripes, which costs less where rows are read ahead, too.
  template <class T>
  __device__ __forceinline__ void store_in_stripes(T* row, Compute<T> const (&v)[P]) const {
    store(row, v);
  }
};

// N elements of shared memory for each warp of a block.
template <class T, int N, int Warps>
__device__ __forceinline__ T* warp_memory() {
  __shared__ __align__(16) T memory[Warps][N];
  return memory[threadIdx.x / 32];
}

// Rows that are no vectors are accessed by words of 4 bytes. Elements of 1 or 2 bytes may begin within a word: then the
// first word of a row's part begins with elements that precede it.
template <class T>
constexpr int kPerWord = sizeof(T) < 4 ? 4 / sizeof(T) : 1;
template <class T>
__device__ __forceinline__ int preceding_elements(T const* at) {
  return kPerWord<T> == 1 ? 0 : int(reinterpret_cast<uintptr_t>(at) % 4 / sizeof(T));
}

// Stores the P elements of each thread of a warp, from its address `to` on, to any address. Called by all 32 threads,
// which exchange them in shared memory: adjacent threads store adjacent elements, those for which stores(distance from
// `to`) holds.
template <int P, int Warps, class T, class Stores>
__device__ __forceinline__ void store_striped_if(T* to, Vector<T, P> const& vector, Stores stores) {
  T* const memory = warp_memory<T, 32 * P, Warps>();
  int const lane = threadIdx.x % 32, ahead = lane - P * lane;
  __syncwarp();
  *reinterpret_cast<Vector<T, P>*>(memory + P * lane) = vector;
  __syncwarp();
#pragma unroll
  for (int i = 0; i < P; ++i)
    if (stores(ahead + 32 * i)) to[ahead + 32 * i] = memory[32 * i + lane];
}
// Those at x ... of a row of `width`.
template <int P, int Warps, class T>
__device__ __forceinline__ void store_striped(T* to, Vector<T, P> const& vector, int x, int width) {
  store_striped_if<P, Warps>(to, vector, [&](int ahead) { return x + ahead < width; });
}
template <int P, int Warps, class T>
__device__ __forceinline__ void store_striped(T* to, Compute<T> const (&v)[P], int x, int width) {
  store_striped<P, Warps>(to, rounded<T>(v), x, width);
}

// Stores the P elements of each thread of a warp, those at x ... of a row of `width`, to any address. Called by all 32
// threads: a word with elements of two threads is stored by the second one.
template <class T, int P>
__device__ __forceinline__ void store_words(T* to, Vector<T, P> const& vector, int x, int width) {
  if constexpr (kPerWord<T> == 1 || P % kPerWord<T> != 0) {
#pragma unroll
    for (int i = 0; i < P; ++i)
      if (i < width - x) to[i] = vector.v[i];
  } else {
    constexpr int W = kPerWord<T>, N = P / W;
    uint32_t own[N], words[N];
    __builtin_memcpy(own, &vector, sizeof(own));
    int const lane = threadIdx.x % 32, preceding = preceding_elements(to), begin = lane == 0 ? preceding : 0;
    uint32_t const previous = __shfl_up_sync(0xffffffffu, own[N - 1], 1);
#pragma unroll
    for (int k = 0; k < N; ++k)
      words[k] = __funnelshift_rc(k > 0 ? own[max(k - 1, 0)] : previous, own[k], 32 - 8 * int(sizeof(T)) * preceding);
    Vector<T, P> shifted;
    __builtin_memcpy(&shifted, words, sizeof(words));
    char* const first = reinterpret_cast<char*>(to) - preceding * int(sizeof(T));
    auto const word_at = [&](int k) { return reinterpret_cast<uint32_t*>(first + 4 * k); };
    auto const element_at = [&](int i) { return reinterpret_cast<T*>(first + i * int(sizeof(T))); };
    int const count = width - x + preceding;  // elements from the first word to the end of the row
    if (count >= P) {
      if (begin == 0) *word_at(0) = words[0];
#pragma unroll
      for (int k = 1; k < N; ++k) *word_at(k) = words[k];
#pragma unroll
      for (int i = 1; i < W; ++i)
        if (begin > 0 && i >= begin) *element_at(i) = shifted.v[i];
      // The last elements of the last thread.
#pragma unroll
      for (int i = 1; i < W; ++i)
        if (lane == 31 && i <= preceding && x + P - i < width) to[P - i] = vector.v[P - i];
    } else if (count > 0) {
#pragma unroll
      for (int i = 0; i < P; ++i)
        if (i >= begin && i < count) *element_at(i) = shifted.v[i];
    }
  }
}
template <class T, int P>
__device__ __forceinline__ void store_words(T* to, Compute<T> const (&v)[P], int x, int width) {
  store_words(to, rounded<T>(v), x, width);
}

// As store_striped, elements of less than a word by words.
// Special case, H200: 1.02 (299x299) to 1.03 (375x500) times as fast as single elements, rgb_to_hsv of float16.
template <int P, int Warps, class T>
__device__ __forceinline__ void store_anywhere(T* to, Vector<T, P> const& vector, int x, int width) {
  if constexpr (sizeof(T) >= 4)
    store_striped<P, Warps>(to, vector, x, width);
  else
    store_words(to, vector, x, width);
}

// Any address and width. Of the words of a row each thread reads every 32nd, so that those of a warp are adjacent. The
// P elements that it computes, and their neighbors, it gets by way of shared memory.
template <int R, int P, int Warps>
struct Strip<R, false, P, Warps> {
  static_assert(R >= 0 && R <= P);
  int x, width;
  Border border;
  bool inside, left_end, right_end;
  int first;              // column of the strip
  int halo, halo_source;  // an element that the thread reads besides its words, and from where; -1: the constant
  bool has_halo;

  __device__ __forceinline__ Strip(int x, int width, Border border)
      : x(x),
        width(width),
        border(border),
        inside(x < width),
        left_end(inside && threadIdx.x % 32 == 0),
        right_end(inside && (threadIdx.x % 32 == 31 || x + P >= width)),
        first(x - P * int(threadIdx.x % 32)) {
    // R elements to the left of the strip, its last element, and R after it. The last one is part of a word that is not
    // read where a row ends within a word: that may be the end of the memory.
    int const lane = threadIdx.x % 32, last = min(first + 32 * P, width) - 1;
    halo = lane < 16 ? first - 1 - lane : last + lane - 16;
    has_halo = first < width && (lane < 16 ? lane < R : lane - 16 <= R);
    halo_source = has_halo ? border_index(border, halo, width) : -1;
  }

  template <class T>
  static constexpr bool kByWords = sizeof(T) == 2;
  template <class T>
  using Word = std::conditional_t<kByWords<T>, uint32_t, T>;
  template <class T>
  struct FetchedRow {
    static constexpr int kCount = kByWords<T> ? P / 2 : P;
    Word<T> words[kCount];
    T halo;
    int preceding;  // elements in the first word
  };
  template <class T>
  __device__ __forceinline__ FetchedRow<T> fetch(T const* row) const {
    FetchedRow<T> f{};
    constexpr int W = kByWords<T> ? 2 : 1;
    T const* const from = row + first;
    f.preceding = kByWords<T> ? preceding_elements(from) : 0;
    auto const* const words = reinterpret_cast<Word<T> const*>(from - f.preceding) + threadIdx.x % 32;
    int const count = width - first + f.preceding - W * int(threadIdx.x % 32);
#pragma unroll
    for (int i = 0; i < FetchedRow<T>::kCount; ++i)
      if (count >= 32 * W * i + W) f.words[i] = words[32 * i];
    if (halo_source >= 0) f.halo = row[halo_source];
    return f;
  }
  template <class T>
  __device__ __forceinline__ void spread(FetchedRow<T> const& f, Compute<T> (&v)[P + 2 * R]) const {
    constexpr int kPad = 16 / sizeof(T), kCount = FetchedRow<T>::kCount;
    static_assert(R + (kByWords<T> ? 1 : 0) <= kPad);
    int const lane = threadIdx.x % 32;
    T* const row = warp_memory<T, 32 * P + 2 * kPad, Warps>() + kPad;
    T* const elements = row + f.preceding;
    __syncwarp();
#pragma unroll
    for (int i = 0; i < kCount; ++i)
      if (kByWords<T> || first + 32 * i + lane < width) reinterpret_cast<Word<T>*>(row)[32 * i + lane] = f.words[i];
    if constexpr (kByWords<T>) __syncwarp();  // the ends of words are not those of the row
    if (has_halo) elements[halo - first] = f.halo;
    __syncwarp();
    if constexpr (kByWords<T>) {
      // The thread's words and the adjacent ones, whose element i is element i + R - 2 kBefore - preceding of the
      // result.
      uint32_t const* const around = reinterpret_cast<uint32_t const*>(row + P * lane);
      constexpr int kBefore = (R + 1) / 2, kWords = kBefore + P / 2 + R / 2 + 1;
      uint32_t words[kWords];
#pragma unroll
      for (int k = 0; k < kBefore; ++k) words[k] = around[k - kBefore];
      auto const own = *reinterpret_cast<Vector<uint32_t, P / 2> const*>(around);
#pragma unroll
      for (int k = 0; k < P / 2; ++k) words[kBefore + k] = own.v[k];
#pragma unroll
      for (int k = kBefore + P / 2; k < kWords; ++k) words[k] = around[k - kBefore];
      constexpr int kSkip = 2 * kBefore - R;  // elements, 0 or 1
#pragma unroll
      for (int k = 0; k < (P + 2 * R + 1 + kSkip) / 2; ++k) {
        uint32_t const word = k + 1 < kWords
                                  ? __funnelshift_r(words[k], words[min(k + 1, kWords - 1)], 16 * f.preceding)
                                  : words[k] >> 16 * f.preceding;
        Vector<T, 2> pair;
        __builtin_memcpy(&pair, &word, 4);
#pragma unroll
        for (int i = 0; i < 2; ++i) {
          int const at = 2 * k + i - kSkip;
          if (at >= 0 && at < P + 2 * R) v[at] = read(pair.v[i]);
        }
      }
    } else {
      auto const own = *reinterpret_cast<Vector<T, P> const*>(row + P * lane);
#pragma unroll
      for (int i = 0; i < P; ++i) v[R + i] = read(own.v[i]);
#pragma unroll
      for (int i = 0; i < R; ++i) {
        v[i] = read(row[P * lane - R + i]);
        v[R + P + i] = read(row[P * lane + P + i]);
      }
    }
  }
  // Rows that are not read ahead do not wait for the other threads: each reads its elements one by one.
  template <class T>
  __device__ __forceinline__ void load(Compute<T> (&v)[P + 2 * R], T const* row) const {
#pragma unroll
    for (int i = 0; i < P + 2 * R; ++i) {
      int const at = inside && x - R + i < width + R ? border_index(border, x - R + i, width) : -1;
      v[i] = at >= 0 ? read(row[at]) : Compute<T>(0);
    }
  }
  template <class T>
  __device__ __forceinline__ void store(T* row, Compute<T> const (&v)[P]) const {
    store_words(row + x, v, x, width);
  }
  template <class T>
  __device__ __forceinline__ void store_in_stripes(T* row, Compute<T> const (&v)[P]) const {
    store_anywhere<P, Warps>(row + x, rounded<T>(v), x, width);
  }
};

// Whether Strip<R, true, P> can read and write these images: launchers check each of their tensors.
template <int P, class T>
inline bool is_vectorizable(Planes<T> const& p) {
  constexpr int64_t bytes = alignof(Vector<std::remove_const_t<T>, P>), size = sizeof(T);
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.outer_stride * size % bytes == 0 &&
         p.inner_stride * size % bytes == 0 && p.row_stride * size % bytes == 0 && p.width % P == 0 && p.step == 1;
}

// Calls f with std::true_type or std::false_type, so that alignment is known at compile time. float64 has the unaligned
// form only, which serves all images: each form costs compile time.
template <class T, class F>
void with_alignment(bool aligned, F f) {
  if constexpr (sizeof(T) == 8)
    f(std::false_type{});
  else
    aligned ? f(std::true_type{}) : f(std::false_type{});
}

// The rows of a plane from `first` on, in order. Rows out of bounds are the first or the last row.
template <class T>
struct RowCursor {
  T const* at;
  int64_t stride;
  int y, last;
  __device__ __forceinline__ RowCursor(Planes<T const> const& p, int64_t plane, int first)
      : at(p.row(plane, clamp(first, 0, int(p.height) - 1))), stride(p.row_stride), y(first), last(int(p.height) - 1) {}
  __device__ __forceinline__ T const* next() {
    T const* const row = at;
    if (y >= 0 && y < last) at += stride;
    ++y;
    return row;
  }
};

// The number of multiprocessors of the current device.
inline int multiprocessors() {
  int device = 0, count = 1;
  cudaGetDevice(&device);
  cudaDeviceGetAttribute(&count, cudaDevAttrMultiProcessorCount, device);
  return count;
}

// How many blocks of a kernel the current device runs at a time. Launchers ask once for each kernel.
template <class Kernel>
int resident_blocks(Kernel* kernel, int threads) {
  int each = 1;
  cudaOccupancyMaxActiveBlocksPerMultiprocessor(&each, kernel, threads, 0);
  return max(each, 1) * multiprocessors();
}

// The height of strips, `fewest` to `most` rows, that takes the least time. A strip reads `taps` - 1 rows more than it
// completes. `columns` strips side by side go through the GPU in waves of `resident` strips; a wave takes less time the
// fewer strips it has, down to `busy` strips, which keep the GPU busy alone.
inline int strip_height(int64_t columns, int64_t height, int taps, int64_t resident, int64_t busy, int64_t fewest,
                        int64_t most) {
  double best = INFINITY;
  int64_t rows = height;
  for (int64_t down = ceil_div(height, most); down <= ceil_div(height, fewest) && down <= 256; ++down) {
    int64_t const each = ceil_div(height, down), strips = columns * ceil_div(height, each), rest = strips % resident;
    double const work = double(strips - rest + (rest > 0 ? max(rest, busy) : 0)) * double(each + taps - 1);
    if (work < best) best = work, rows = each;
  }
  return int(rows);
}
inline int strip_height(int64_t columns, int64_t height, int taps, int64_t resident, int64_t busy) {
  return strip_height(columns, height, taps, resident, busy, 8, 16 * taps);
}
// About `rows` of them, but for waves: with the usual rows a few strips may make a wave of their own.
inline int height_near(int rows, int64_t columns, int64_t height, int taps, int64_t resident) {
  constexpr int kManyWaves = 8;
  if (columns * ceil_div(height, rows) > kManyWaves * resident) return rows;
  return strip_height(columns, height, taps, resident, resident, max(rows / 2, min(rows, 8)), 2 * rows);
}

// Splits planes into strips of 32 P columns and `rows` rows, one for each warp, x fastest: the warps of a block read
// adjacent memory.
template <int P = 4>
struct Strips {
  unsigned across, down, count, rows;
  KV_HD Strips(int64_t planes, int64_t height, int64_t width, int rows)
      : across(unsigned(ceil_div(width, 32 * P))),
        down(unsigned(ceil_div(int(height), rows))),
        count(unsigned(planes * across * down)),
        rows(rows) {}
  KV_HD unsigned blocks(unsigned warps = 8) const { return (count + warps - 1) / warps; }
  // Of about so many rows, for a kernel of blocks of `warps`; see height_near.
  static Strips near(int rows, int64_t planes, int64_t height, int64_t width, int taps, int resident, int warps) {
    int64_t const columns = planes * ceil_div(width, 32 * P);
    return {planes, height, width, height_near(rows, columns, height, taps, int64_t(resident) * warps)};
  }
  // The plane of the warp's strip, the first column of the thread, the first row. False after the last strip.
  __device__ __forceinline__ bool locate(int64_t& plane, int& x, int& y) const {
    return locate(blockIdx.x, plane, x, y);
  }
  __device__ __forceinline__ bool locate(unsigned block, int64_t& plane, int& x, int& y) const {
    unsigned const warp = block * (blockDim.x / 32) + threadIdx.x / 32;
    if (warp >= count) return false;
    unsigned const q = warp / across, p = q / down;
    x = int(warp - q * across) * 32 * P + (threadIdx.x % 32) * P;
    y = int((q - p * down) * rows);
    plane = p;
    return true;
  }
};

}  // namespace kv
