// The rows that a warp walks down, on CUDA: copied to a ring in shared memory some rows ahead of their use, by
// asynchronous copies that take no registers. Each thread finds there its window of pixels:
//
//   a row         16 pixels | P of thread 0 | P of thread 1 | ...           | P of thread 31 | 16 pixels
//   along x          ...<------------ window of thread 1 ------------>...
//
// What limits small kernels is how many instructions a warp spends on a row besides the arithmetic, so there is no
// border rule in the loop: a thread knows the row of one of 32 positions, and which pixel beside the image it fills in.
#pragma once

#include <cuda_pipeline.h>

#include "core/launch.cuh"

namespace kv::cuda {
namespace {

constexpr int kHalo = 16;  // pixels beside a strip, one for each thread

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

// The row y of an image whose rows are `stride` bytes apart: one instruction.
template <class T>
__device__ __forceinline__ T* row_below(T* first_row, int y, int stride) {
  return reinterpret_cast<T*>(reinterpret_cast<uintptr_t>(first_row) + int64_t(y) * stride);
}

// Rows from `first` on, `count` of them, for 32 P pixels from `left` on and `Radius` beside them. `Rows` is the size of
// the ring; all but one are on their way. What is outside follows the borders `across` and `down`. `aligned`: rows are
// vectors of P pixels, `left` at one of them; as std::true_type or std::false_type it costs no branches.
template <class T, int P, int Radius, int Rows, class Aligned>
struct StripRows {
  using Ring = T[Rows][32 * P + 2 * kHalo];
  T (*const ring)[32 * P + 2 * kHalo];
  T const* const in;
  Border const across, down;
  int const in_width, in_height, left, first, count, in_stride, lane;
  int own, filled, source, next = 0, known;
  Aligned const aligned;
  bool has_beside, has_own, fills, near;
  int beside;
  uint32_t own_to, beside_to;
  T const *own_from, *beside_from;

  static constexpr uint32_t kRowBytes = sizeof(Ring) / Rows;

  __device__ __forceinline__ StripRows(Ring& memory, Planes<T const> const& x, int64_t plane, Border across,
                                       Border down, Aligned aligned, int left, int first, int count)
      : ring(memory),
        in(x.plane(plane)),
        across(across),
        down(down),
        in_width(int(x.width)),
        in_height(int(x.height)),
        left(left),
        first(first),
        count(count),
        in_stride(int(x.row_stride * sizeof(T))),
        lane(threadIdx.x % 32),
        aligned(aligned) {
    // The thread's part of copying a row: P neighbours if aligned, else every 32nd pixel; and of the 16 pixels on
    // either side, P of them or one. What is outside the image stays zero, or is filled in from its source.
    int const side = lane < 16 ? left - kHalo : left + 32 * P;
    beside = side + lane % 16 * (aligned ? P : 1), own = left + lane * (aligned ? P : 1);
    has_beside = (!aligned || lane % 16 < kHalo / P) && beside >= 0 && beside < in_width;
    has_own = own < in_width;
    auto const place = [&](int x) { return uint32_t(__cvta_generic_to_shared(ring[0] + kHalo - left + x)); };
    own_to = place(own), beside_to = place(beside);
    own_from = in + own, beside_from = in + beside;
    for (int i = lane; i < Rows * (32 * P + 2 * kHalo); i += 32) ring[0][i] = T{};
    __syncwarp();

    filled = lane < 16 ? min(left, 0) - 1 - lane : max(min(left + 32 * P, in_width), left) + lane - 16;
    bool const reached =
        filled >= left - Radius && filled < left + 32 * P + Radius && (filled < 0 || filled >= in_width);
    source = reached ? border_index(across, filled, in_width) : -1;
    fills = __any_sync(0xffffffffu, source >= 0);
    near = source >= max(left - kHalo, 0) && source < left + 32 * P + kHalo;
#pragma unroll 1
    for (int i = 0; i < Rows - 1; ++i) fetch();
  }

  // Asks for one row more. Each thread knows the row of one of the next 32 positions, -1 for the constant.
  __device__ __forceinline__ void fetch() {
    if (next % 32 == 0) known = border_index(down, first + next + lane, in_height);
    int const y = __shfl_sync(0xffffffffu, known, next);
    bool const more = next < count, zero = y < 0;
    uint32_t const slot = next & (Rows - 1), to = slot * kRowBytes;
    ++next;
    T const* const from = row_below(own_from, max(y, 0), in_stride);
    T const* const from_beside = row_below(beside_from, max(y, 0), in_stride);
    if (aligned) {
      copy_later<P * sizeof(T)>(own_to + to, from, more && has_own, zero);
      copy_later<P * sizeof(T)>(beside_to + to, from_beside, more && has_beside, zero);
    } else {
      auto const inside = [&](int i) { return more && own + 32 * i >= 0 && own + 32 * i < in_width; };
      if constexpr (sizeof(T) == 4) {
#pragma unroll
        for (int i = 0; i < P; ++i) copy_later<4>(own_to + to + 128 * i, from + 32 * i, inside(i), zero);
        copy_later<4>(beside_to + to, from_beside, more && has_beside, zero);
      } else {  // too small for an asynchronous copy
        T* const row = ring[slot] + kHalo - left;
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
  }

  // Row i, the one after that of the call before; pixel `left` is at kHalo.
  __device__ __forceinline__ T const* row(int i) {
    T* const row = ring[i & (Rows - 1)];
    __pipeline_wait_prior(Rows - 2);
    __syncwarp();
    fetch();
    if (fills) {
      if (near) {
        row[kHalo + filled - left] = row[kHalo + source - left];
      } else if (source >= 0) {
        int const from = border_index(down, first + i, in_height);
        row[kHalo + filled - left] = from < 0 ? T{} : *(row_below(in, from, in_stride) + source);
      }
      __syncwarp();
    }
    return row;
  }
};

// What the windows of K pixels around a thread's P pixels read of a row, whose pixel 0 is v[kBefore].
template <int K, int P>
constexpr int kBefore = (K / 2 + P - 1) / P * P;
template <int K, int P, class T>
__device__ __forceinline__ void read_windows(T const* row, float (&v)[P + 2 * kBefore<K, P>]) {
  T const* const first = row + kHalo + P * (threadIdx.x % 32) - kBefore<K, P>;
#pragma unroll
  for (int j = 0; j < P + 2 * kBefore<K, P>; j += P) {
    Vector<T, P> const vector = *reinterpret_cast<Vector<T, P> const*>(first + j);
#pragma unroll
    for (int k = 0; k < P; ++k) v[j + k] = read(vector.v[k]);
  }
}

// Stores a thread's P pixels, those at x ... of a row of `width`, to `to`. `aligned`: as in StripRows.
template <class T, int P, class Aligned>
__device__ __forceinline__ void store_pixels(T* to, float const (&v)[P], int x, int width, Aligned aligned) {
  if (aligned) {
    if (x < width) store_vector(to, v);
  } else {
#pragma unroll
    for (int j = 0; j < P; ++j)
      if (x + j < width) to[j] = round_to<T>(v[j]);
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

}  // namespace
}  // namespace kv::cuda
