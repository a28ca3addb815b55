// The fast separable filter on CUDA: planar images, kernels of equal odd sizes from 3 to 31. Included by
// separable_<type>.cu and symmetric_<type>.cu, which say for which types it is compiled.
//
// Each warp walks down a strip of 32 P columns. Its rows are copied to a ring in shared memory some rows ahead of their
// use, by asynchronous copies that take no registers, and each thread finds there its window of P + K - 1 pixels:
//
//   a row         16 pixels | P of thread 0 | P of thread 1 | ...           | P of thread 31 | 16 pixels
//   along x          ...<------------ window of thread 1 ------------>...
//
// Along y nothing is stored but running sums: of the K - 1 output rows that a row still belongs to, each has had its
// weighted share of the rows above. A new row adds to all of them, the first one is complete, and the others move up,
// which costs nothing: sum[i] = sum[i + 1] + weight * row.
//
// What limits small kernels is how many instructions a warp spends on a row besides the arithmetic, so the loop has no
// border rule in it: a thread knows the row of one of 32 positions, and which pixel beside the image it fills in.
#pragma once

#include <cuda_pipeline.h>

#include "box.h"
#include "core/launch.cuh"
#include "separable.h"

namespace kv::cuda {

// Launch kernels for the size of p.kx, which is that of p.ky. The result is divided by `divisor`.
//
//   separable_strips   forward passes and transposes of the like, by this file's kernel
//   separable_mirrors  transposes of a reflected border with symmetric weights, by this file's kernel, too
//   separable_folds    all transposes that fold the result at the border; separable_fold.cuh
template <class T>
int separable_strips(Separable<T> const& p, float divisor, CUstream_st* stream);
template <class T>
int separable_mirrors(Separable<T> const& p, float divisor, CUstream_st* stream);
template <class T>
int separable_folds(Separable<T> const& p, CUstream_st* stream);

// Whether strips serve images and a window of this size.
template <class T>
bool has_strips(Planes<T const> const& x, int64_t ky, int64_t kx) {
  return kx == ky && kx % 2 == 1 && kx >= 3 && kx <= 31 && x.step == 1 &&
         x.row_stride * int64_t(sizeof(T)) <= INT32_MAX && x.width <= INT32_MAX / 2;
}

namespace {

constexpr int kLargest = 31;  // has_strips
constexpr int kHalo = 16;     // pixels beside a strip, one for each thread
constexpr int kWarps = 4;     // of a block, which work alone

// Half types and bytes take 8 pixels a thread as long as the sums of 8 fit the registers.
template <class T, int K>
constexpr int kStripPixels = sizeof(T) < 4 && K <= 11 ? 8 : 4;

// Rows of the ring; all but one are on their way. Where the sums take most registers, a simple ring is worth more.
template <int K>
constexpr int kRing = K <= 15 ? 4 : 2;

// Blocks on a multiprocessor: what its registers, 512 for each thread of a block, have room for.
template <int K, int P>
constexpr int kRegisters = P * K + (K <= 7 ? 52 : 64);
template <int K, int P>
constexpr int kResident = 512 / (kRegisters<K, P> < 170 ? kRegisters<K, P> : 170);

template <class T, int K, int P, bool Mirrored>
struct alignas(16) WarpMemory {
  T rows[kRing<K>][32 * P + 2 * kHalo];
  float x[32], y[32];                  // weights; those of y first the one that completes a row
  float first[Mirrored ? 32 * P : 1];  // how often once more a pixel of the strip reads the first pixel of the row,
  float last[Mirrored ? 32 * P : 1];   // and the last
};

template <class F>
__device__ __forceinline__ F warp_sum(F x) {
#pragma unroll
  for (int lane = 16; lane > 0; lane /= 2) x += __shfl_xor_sync(0xffffffffu, x, lane);
  return x;
}

// The thread's weight, or 0.
template <class F>
__device__ __forceinline__ F weight_of_lane(Taps<F> const& taps, int64_t sample, int lane) {
  F const weight = lane < taps.size ? tap(taps, sample, lane) : F(0);
  return taps.gaussian ? weight / warp_sum(weight) : weight;
}

// Reads `weights` four at a time, in an unrolled loop over i.
__device__ __forceinline__ float weight_at(float const* weights, int i, float4& four) {
  if (i % 4 == 0) four = *reinterpret_cast<float4 const*>(weights + i);
  return i % 4 == 0 ? four.x : i % 4 == 1 ? four.y : i % 4 == 2 ? four.z : four.w;
}

// Copies `Bytes` to shared memory some time before the wait for them; zeros instead if `zero`, and nothing unless
// `wanted`. One instruction: the library's form has a branch for each of the two.
template <int Bytes>
__device__ __forceinline__ void copy_later(uint32_t to, void const* from, bool wanted, bool zero) {
  static_assert(Bytes == 4 || Bytes == 8 || Bytes == 16);
  if constexpr (Bytes == 16)
    asm volatile(
        "{.reg .pred w, z; setp.ne.s32 w, %2, 0; setp.ne.s32 z, %3, 0; @w cp.async.cg.shared.global [%0], [%1], 16, "
        "z;}" ::"r"(to),
        "l"(__cvta_generic_to_global(from)), "r"(int(wanted)), "r"(int(zero))
        : "memory");
  else
    asm volatile(
        "{.reg .pred w, z; setp.ne.s32 w, %2, 0; setp.ne.s32 z, %3, 0; @w cp.async.ca.shared.global [%0], [%1], %4, "
        "z;}" ::"r"(to),
        "l"(__cvta_generic_to_global(from)), "r"(int(wanted)), "r"(int(zero)), "n"(Bytes)
        : "memory");
}

// Aligned: rows of input and output are packs of P pixels, at the same places. Mirrored: the transpose of a reflected
// border with symmetric weights, D^-1 A D, where A is the forward pass and D doubles the first and the last pixel of an
// axis; box.h has the reason.
template <class T, int K, int P, bool Aligned, bool Mirrored>
__global__ void __launch_bounds__(32 * kWarps, kResident<K, P>)
    separable_strip(__grid_constant__ Separable<T> const p, __grid_constant__ Strips<P> const strips, float divisor) {
  constexpr int R = K / 2;
  __shared__ WarpMemory<T, K, P, Mirrored> memory[kWarps];
  WarpMemory<T, K, P, Mirrored>& shared = memory[threadIdx.x / 32];
  int const lane = threadIdx.x % 32;
  unsigned const warp = blockIdx.x * kWarps + threadIdx.x / 32;
  if (warp >= strips.count) return;
  unsigned const line = warp / strips.across, plane = line / strips.down;
  int const x0 = int(warp - line * strips.across) * 32 * P, y0 = int((line - plane * strips.down) * strips.rows);
  int const width = int(p.y.width), height = int(p.y.height), y1 = min(y0 + int(strips.rows), height);
  int const in_width = int(p.x.width), in_height = int(p.x.height);

  // The thread's part of copying a row: P neighbours if Aligned, else every 32nd pixel; and of the 16 pixels on either
  // side, P of them or one. What is outside the image stays zero, or is filled in from its source.
  int const left = x0 + R - p.kx.before;  // the strip's first pixel as windows see it
  int const side = lane < 16 ? left - kHalo : left + 32 * P;
  int const beside = side + lane % 16 * (Aligned ? P : 1), own = left + lane * (Aligned ? P : 1);
  bool const has_beside = (Aligned ? lane % 16 < kHalo / P : true) && beside >= 0 && beside < in_width;
  bool const has_own = Aligned && own < in_width;
  T const* const in = p.x.plane(plane);
  int const in_stride = int(p.x.row_stride * sizeof(T)), out_stride = int(p.y.row_stride * sizeof(T));
  auto const row_of = [](auto* of_first_row, int y, int stride) {  // one instruction
    return reinterpret_cast<decltype(of_first_row)>(reinterpret_cast<uintptr_t>(of_first_row) + int64_t(y) * stride);
  };
  constexpr uint32_t kRowBytes = sizeof(shared.rows[0]);
  auto const slot = [](int i) { return uint32_t(i & (kRing<K> - 1)) * kRowBytes; };
  auto const place = [&](int x) { return uint32_t(__cvta_generic_to_shared(shared.rows[0] + kHalo - left + x)); };
  uint32_t const own_to = place(own), beside_to = place(beside);
  T const *const own_from = in + own, *const beside_from = in + beside;
  for (int i = lane; i < kRing<K> * (32 * P + 2 * kHalo); i += 32) shared.rows[0][i] = T{};
  __syncwarp();

  int const filled = lane < 16 ? min(left, 0) - 1 - lane : max(min(left + 32 * P, in_width), left) + lane - 16;
  bool const reached = filled >= left - R && filled < left + 32 * P + R && (filled < 0 || filled >= in_width);
  int const source = reached ? border_index(p.border, filled, in_width) : -1;
  bool const fills = __any_sync(0xffffffffu, source >= 0);
  bool const near = source >= max(left - kHalo, 0) && source < left + 32 * P + kHalo;

  // Each thread knows the row of one of the next 32 positions, -1 for the constant.
  int const count = y1 - y0 + K - 1, first = y0 - p.ky.before;
  int next = 0, known;
  auto const fetch = [&] {
    if (next % 32 == 0) known = border_index(p.border, first + next + lane, in_height);
    int const y = __shfl_sync(0xffffffffu, known, next);
    bool const more = next < count, zero = y < 0;
    uint32_t const to = slot(next++);
    T const* const from = row_of(own_from, max(y, 0), in_stride);
    T const* const from_beside = row_of(beside_from, max(y, 0), in_stride);
    if constexpr (Aligned) {
      copy_later<P * sizeof(T)>(own_to + to, from, more && has_own, zero);
      copy_later<P * sizeof(T)>(beside_to + to, from_beside, more && has_beside, zero);
    } else {
      auto const inside = [&](int i) { return more && own + 32 * i >= 0 && own + 32 * i < in_width; };
      if constexpr (sizeof(T) == 4) {
#pragma unroll
        for (int i = 0; i < P; ++i) copy_later<4>(own_to + to + 128 * i, from + 32 * i, inside(i), zero);
        copy_later<4>(beside_to + to, from_beside, more && has_beside, zero);
      } else {  // too small for an asynchronous copy
        T* const row = shared.rows[(next - 1) & (kRing<K> - 1)] + kHalo - left;
        T pixels[P + 1];
#pragma unroll
        for (int i = 0; i < P; ++i) pixels[i] = inside(i) && !zero ? from[32 * i] : T{};
        pixels[P] = more && has_beside && !zero ? *from_beside : T{};
#pragma unroll
        for (int i = 0; i < P; ++i)
          if (inside(i)) row[own + 32 * i] = pixels[i];
        if (more && has_beside) row[beside] = pixels[P];
      }
    }
    __pipeline_commit();
  };
#pragma unroll 1
  for (int i = 0; i < kRing<K> - 1; ++i) fetch();

  int64_t const sample = plane / p.planes;
  shared.x[lane] = weight_of_lane(p.kx, sample, lane);
  float const weight_y = p.alpha * weight_of_lane(p.ky, sample, lane);
  shared.y[lane] = __shfl_sync(0xffffffffu, weight_y, (K - 1 - lane) & 31);
  __syncwarp();
  constexpr bool kHeld = K <= 7;  // in registers
  [[maybe_unused]] float held_x[kHeld ? K : 1], held_y[kHeld ? K : 1];
  if constexpr (kHeld) {
#pragma unroll
    for (int t = 0; t < K; ++t) held_x[t] = shared.x[t], held_y[t] = shared.y[t];
  }

  // The rim of a mirrored row counts twice. Pixel 0 also stands at position 2 (width - 1), and the last one at
  // -(width - 1), where the window of a narrow image may reach.
  bool const near_first = x0 == 0, near_last = x0 + 32 * P >= width - R;
  bool reads_first = false, reads_last = false, on_rim = false;
  if (Mirrored && (near_first || near_last)) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      int const i = P * lane + j, x = x0 + i, n = width - 1;
      auto const weight_for = [&](int at) { return at >= x - R && at <= x + R ? shared.x[at - x + R] : 0.f; };
      float const first = weight_for(0) + weight_for(2 * n), last = weight_for(n) + weight_for(-n);
      reads_first |= near_first && first != 0;
      reads_last |= near_last && last != 0;
      on_rim |= x == 0 || x == n;
      shared.first[Mirrored ? i : 0] = first;
      shared.last[Mirrored ? i : 0] = last;
    }
    __syncwarp();
  }
  auto const read_again = [&](float const* weights, T pixel, float(&h)[P]) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      float const weight = weights[P * lane + j], more = weight * read(pixel);
      h[j] += weight != 0 ? more : 0.f;  // 0 times an infinite pixel is not 0
    }
  };
  auto const is_end = [](int i, int n) { return i == 0 || i == n - 1; };

  int const x = x0 + P * lane;
  T* const out = p.y.plane(plane) + x;
  float const reciprocal = 1 / divisor;
  float sums[K - 1][P] = {};
#pragma unroll 1
  for (int i = 0; i < count; ++i) {
    int const y = y0 + i - (K - 1);  // the row that this one completes
    T* const row = shared.rows[i & (kRing<K> - 1)];
    __pipeline_wait_prior(kRing<K> - 2);
    __syncwarp();
    fetch();
    if (fills) {
      if (near) {
        row[kHalo + filled - left] = row[kHalo + source - left];
      } else if (source >= 0) {
        int const from = border_index(p.border, first + i, in_height);
        row[kHalo + filled - left] = from < 0 ? T{} : in[from * p.x.row_stride + source];
      }
      __syncwarp();
    }

    // Along x, from packs of P pixels.
    constexpr int kBefore = (R + P - 1) / P * P;
    float v[P + 2 * kBefore], h[P];
#pragma unroll
    for (int j = 0; j < P + 2 * kBefore; j += P) {
      Pack<T, P> const pack = *reinterpret_cast<Pack<T, P> const*>(row + kHalo + P * lane - kBefore + j);
#pragma unroll
      for (int k = 0; k < P; ++k) v[j + k] = read(pack.v[k]);
    }
    [[maybe_unused]] float4 four;
#pragma unroll
    for (int t = 0; t < K; ++t) {
      float const weight = kHeld ? held_x[kHeld ? t : 0] : weight_at(shared.x, t, four);
#pragma unroll
      for (int j = 0; j < P; ++j) {
        float const pixel = v[kBefore - R + t + j];
        h[j] = t == 0 ? weight * pixel : fmaf(weight, pixel, h[j]);
      }
    }
    if (reads_first) read_again(shared.first, row[kHalo], h);
    if (reads_last) read_again(shared.last, row[kHalo + width - 1 - x0], h);

    // Along y.
    [[maybe_unused]] bool const row_twice = Mirrored && is_end(border_index(Border::reflect, y + R, height), height);
    if (row_twice) {
#pragma unroll
      for (int j = 0; j < P; ++j) h[j] *= 2;
    }
    float result[P];
#pragma unroll
    for (int t = 0; t < K; ++t) {
      float const weight = kHeld ? held_y[kHeld ? t : 0] : weight_at(shared.y, t, four);
#pragma unroll
      for (int j = 0; j < P; ++j) {
        float const sum = t < K - 1 ? fmaf(weight, h[j], sums[t][j]) : weight * h[j];
        if (t == 0)
          result[j] = sum;
        else
          sums[t - 1][j] = sum;
      }
    }
    if (p.beta != 0) {
#pragma unroll
      for (int j = 0; j < P; ++j) {
        float pixel = v[kBefore + j];
        if (row_twice) pixel *= 2;
        if (on_rim && is_end(x + j, width)) pixel *= 2;
        sums[R - 1][j] = fmaf(p.beta, pixel, sums[R - 1][j]);
      }
    }
    if (i < K - 1) continue;
    if (on_rim || (Mirrored && is_end(y, height))) {
#pragma unroll
      for (int j = 0; j < P; ++j) {
        if (is_end(y, height)) result[j] /= 2;
        if (on_rim && is_end(x + j, width)) result[j] /= 2;
      }
    }
    if (divisor != 1) {
#pragma unroll
      for (int j = 0; j < P; ++j) result[j] = quotient<T>(result[j], divisor, reciprocal);
    }
    T* const to = row_of(out, y, out_stride);
    if constexpr (Aligned) {
      if (x < width) store_pack(to, result);
    } else {
#pragma unroll
      for (int j = 0; j < P; ++j)
        if (x + j < width) to[j] = round_to<T>(result[j]);
    }
  }
}

// Rows of a strip, which takes K - 1 rows more than it completes: the least work for the waves in which `lines` columns
// of strips go through the machine; a wave takes less time as it has fewer strips, down to `busy`, which keep the
// machine busy alone.
inline int rows_of_strips(int64_t lines, int64_t height, int taps, int64_t resident, int64_t busy) {
  double best = INFINITY;
  int64_t rows = height;
  for (int64_t down = ceil_div(height, 16 * taps); down <= (height + 7) / 8 && down <= 256; ++down) {
    int64_t const each = ceil_div(height, down), strips = lines * ceil_div(height, each), rest = strips % resident;
    double const work = double(strips - rest + (rest > 0 ? max(rest, busy) : 0)) * double(each + taps - 1);
    if (work < best) best = work, rows = each;
  }
  return int(rows);
}

template <int K, int P, class T>
int strip_rows(Planes<T> const& y, int64_t blocks_resident) {
  int device = 0, multiprocessors = 1;
  cudaGetDevice(&device);
  cudaDeviceGetAttribute(&multiprocessors, cudaDevAttrMultiProcessorCount, device);
  if (K <= 7) return (K <= 5 ? 3 : 4) * P;  // bound by memory, which likes the warps to be close together
  int64_t const resident = multiprocessors * blocks_resident * kWarps, lines = y.count() * ceil_div(y.width, 32 * P);
  return rows_of_strips(lines, y.height, K, resident, min(resident, int64_t(multiprocessors) * 10));
}

template <class T, int K, bool Mirrored>
void launch_strip(Separable<T> p, float divisor, CUstream_st* stream) {
  constexpr int P = kStripPixels<T, K>;
  if (Mirrored) p.border = Border::reflect;
  Strips<P> const strips(p.y.count(), p.y.height, p.y.width, strip_rows<K, P>(p.y, kResident<K, P>));
  unsigned const blocks = unsigned(ceil_div(strips.count, kWarps));
  if (is_strip<P>(p.x) && is_strip<P>(p.y) && p.kx.before == K / 2)
    separable_strip<T, K, P, true, Mirrored><<<blocks, 32 * kWarps, 0, stream>>>(p, strips, divisor);
  else
    separable_strip<T, K, P, false, Mirrored><<<blocks, 32 * kWarps, 0, stream>>>(p, strips, divisor);
}

template <class T, bool Mirrored, int K = 3>
void launch_strip_of_size(Separable<T> const& p, float divisor, CUstream_st* stream) {
  if constexpr (K <= kLargest) {
    if (p.kx.size != K) return launch_strip_of_size<T, Mirrored, K + 2>(p, divisor, stream);
    launch_strip<T, K, Mirrored>(p, divisor, stream);
  }
}

}  // namespace

}  // namespace kv::cuda
