// Prefetched rows on CUDA. A warp that goes down an image copies its rows to a ring in shared memory, some rows ahead
// of their use, by asynchronous copies that take no registers. Each thread finds its window of pixels there:
//
//   a row         16 pixels | P of thread 0 | P of thread 1 | ...           | P of thread 31 | 16 pixels
//   along x          ...<------------ window of thread 1 ------------>...
//
// Small kernels are limited by the instructions that a warp spends on a row besides the arithmetic. The loop over rows
// therefore evaluates no border rule: each thread holds the source row of one of 32 positions, and which pixel out of
// bounds it fills in. Included by *.cu files of filters and of resizing.
#pragma once

#include <cuda_pipeline.h>

#include "launch.cuh"
#include "with_constant.cuh"

namespace kv {
namespace {

constexpr int kHalo = 16;  // pixels on either side of a strip; lanes 0 to 15 serve the left side, the others the right

// Row y of an image whose rows are `stride` bytes apart, in one instruction.
template <class T>
__device__ __forceinline__ T* row_at(T* first_row, int y, int stride) {
  return reinterpret_cast<T*>(reinterpret_cast<uintptr_t>(first_row) + int64_t(y) * stride);
}

#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800

// Without asynchronous copies: copies `Bytes` to shared memory, of which those from `bytes` on are zeros and not read.
template <int Bytes>
__device__ __forceinline__ void copy_part_async_if(uint32_t to, void const* from, bool enabled, int bytes) {
  using Words = Vector<uint32_t, Bytes / 4>;
  if (!enabled) return;
  void* const shared = __cvta_shared_to_generic(to);
  if (bytes == Bytes)
    *static_cast<Words*>(shared) = *static_cast<Words const*>(from);
  else
    for (int i = 0; i < Bytes; ++i)
      static_cast<uint8_t*>(shared)[i] = i < bytes ? static_cast<uint8_t const*>(from)[i] : uint8_t(0);
}
template <int Bytes>
__device__ __forceinline__ void copy_async_if(uint32_t to, void const* from, int enabled, bool zero) {
  copy_part_async_if<Bytes>(to, from, enabled, zero ? 0 : Bytes);
}

#else

// Starts an asynchronous copy of `Bytes` to shared memory; it writes zeros instead if `zero`, and nothing unless
// `enabled`. Inline assembly makes it one instruction: the library's form has a branch for each of the two.
template <int Bytes>
__device__ __forceinline__ void copy_async_if(uint32_t to, void const* from, int enabled, bool zero) {
  static_assert(Bytes == 4 || Bytes == 8 || Bytes == 16);
  if constexpr (Bytes == 16)
    asm volatile(
        "{.reg .pred w, z; setp.ne.s32 w, %2, 0; setp.ne.s32 z, %3, 0; @w cp.async.cg.shared.global [%0], [%1], 16, "
        "z;}" ::"r"(to),
        "l"(__cvta_generic_to_global(from)), "r"(enabled), "r"(int(zero))
        : "memory");
  else
    asm volatile(
        "{.reg .pred w, z; setp.ne.s32 w, %2, 0; setp.ne.s32 z, %3, 0; @w cp.async.ca.shared.global [%0], [%1], %4, "
        "z;}" ::"r"(to),
        "l"(__cvta_generic_to_global(from)), "r"(enabled), "r"(int(zero)), "n"(Bytes)
        : "memory");
}

// The same, where the bytes from `bytes` on are zeros and not read.
template <int Bytes>
__device__ __forceinline__ void copy_part_async_if(uint32_t to, void const* from, bool enabled, int bytes) {
  if constexpr (Bytes == 16)
    asm volatile("{.reg .pred w; setp.ne.s32 w, %2, 0; @w cp.async.cg.shared.global [%0], [%1], 16, %3;}" ::"r"(to),
                 "l"(__cvta_generic_to_global(from)), "r"(int(enabled)), "r"(bytes)
                 : "memory");
  else
    asm volatile("{.reg .pred w; setp.ne.s32 w, %2, 0; @w cp.async.ca.shared.global [%0], [%1], %4, %3;}" ::"r"(to),
                 "l"(__cvta_generic_to_global(from)), "r"(int(enabled)), "r"(bytes), "n"(Bytes)
                 : "memory");
}

#endif

// Copies the first `count` of P elements at once, and zeros after them. An asynchronous copy of a part of a vector
// reads no more than that either, but tools that check accesses take it for one of the whole vector.
template <int P, class T>
__device__ __forceinline__ void copy_start(uint32_t to, T const* from, int count) {
  auto* const elements = static_cast<T*>(__cvta_shared_to_generic(to));
#pragma unroll 1
  for (int i = 0; i < P; ++i) elements[i] = i < count ? from[i] : T{};
}

// The first row of a plane whose last vector of P elements may reach behind the image: that vector needs copy_start.
template <int P, class T>
__device__ __forceinline__ int first_unsafe_row(Planes<T> const& x, std::remove_const_t<T> const* plane,
                                                int64_t row_size) {
  auto const row_end = [&](auto* plane, int64_t y) { return plane + y * x.row_stride + row_size; };
  auto* const end = row_end(x.plane(x.count() - 1), x.height - 1);
  int64_t y = x.height;
  while (y > 0 && row_end(plane, y - 1) + P > end) --y;
  return int(y);
}

// Whether rows may begin within a vector and are copied by vectors all the same.
template <class T, class Aligned>
constexpr bool kMayPrecede = sizeof(T) < 4 && !std::is_same_v<Aligned, std::true_type>;

// Pixels of a row of the ring.
template <class T, int P, class Aligned>
constexpr int kRingPitch = 32 * P + 2 * kHalo + (kMayPrecede<T, Aligned> ? 16 / int(sizeof(T)) : 0);

// Prefetches `count` rows from `first` on: 32 P pixels from `left` on, and `Radius` pixels on either side of them.
// `Rows` is the size of the ring; all rows but one are in flight. Pixels out of bounds follow the borders `across` and
// `down`. `aligned`: rows are vectors of P pixels, and `left` is the start of one; std::true_type or std::false_type
// decide this at compile time.
//
// Other rows of words are copied word by word, every 32nd one by a thread. Other rows of smaller pixels are copied by
// vectors all the same: the pixels that precede a row in its first vector are copied with it, so it begins as many
// pixels later in the ring, and row() points that much further. Those that follow it in its last vector are copied,
// too; row() overwrites them where windows read them.
template <class T, int P, int Radius, int Rows, class Aligned>
struct RowPrefetcher {
  static constexpr int kPitch = kRingPitch<T, P, Aligned>, kBytes = P * int(sizeof(T));
  static constexpr bool kPrecede = kMayPrecede<T, Aligned>;
  using Ring = T[Rows][kPitch];
  static constexpr uint32_t kRowBytes = sizeof(Ring) / Rows;
  static_assert(Radius < kHalo && Rows <= 4);

  T (*const ring)[kPitch];
  T const* const in;
  Border const across, down;
  int const in_width, in_height, left, first, count, in_stride, lane;
  int column, filled, source, next = 0, source_row;  // filled: the column out of bounds that the thread fills in
  Aligned const aligned;
  bool has_halo, has_filled, fills, source_in_ring;
  int halo;  // the first column that the thread copies of those on either side
  [[maybe_unused]] unsigned words =
      0;  // a bit for each word of a row that the thread copies, the last one for the halo
  uint32_t column_to, halo_to;
  [[maybe_unused]] int unsafe_from = 0;     // the first row whose last vector may reach behind the image
  [[maybe_unused]] uint32_t preceding = 0;  // pixels that precede the last four rows, the latest row's in the low byte
  [[maybe_unused]] int column_key, halo_key;  // see holds_pixel
  T const *column_from, *halo_from;

  __device__ __forceinline__ RowPrefetcher(Ring& memory, Planes<T const> const& x, int64_t plane, Border across,
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
    // A thread copies a vector of a row or every 32nd word, and one of the vectors or words on either side. Vectors may
    // hold pixels that are up to P - 1 further left. Pixels out of bounds stay zero, or are filled in from their
    // source.
    int const size = kPrecede || aligned ? P : 1, side = lane < 16 ? left - kHalo : left + 32 * P;
    int const late = kPrecede ? P - 1 : 0;
    halo = side + lane % 16 * size, column = left + lane * size;
    has_halo = halo < in_width + late && (lane < 16 ? halo < left && halo + size > left - Radius && halo + size > 0
                                                    : halo < left + 32 * P + Radius + late);
    auto const address = [&](int x) { return uint32_t(__cvta_generic_to_shared(ring[0] + kHalo - left + x)); };
    column_to = address(column), halo_to = address(halo);
    column_from = in + column, halo_from = in + halo;
    if constexpr (kPrecede) {
      unsafe_from = first_unsafe_row<P>(x, in, x.row_size());
      column_key = column + 1 - in_width, halo_key = has_halo ? halo + 1 - in_width : INT32_MAX / 2;
    }
    if constexpr (!kPrecede && sizeof(T) >= 4) {
#pragma unroll
      for (int i = 0; i < P; ++i) words |= column + 32 * i >= 0 && column + 32 * i < in_width ? 1u << i : 0;
      words |= has_halo ? 1u << P : 0;
    }
    for (int i = lane; i < Rows * kPitch; i += 32) ring[0][i] = T{};
    __syncwarp();

    filled = lane < 16 ? min(left, 0) - 1 - lane : max(min(left + 32 * P, in_width), left) + lane - 16;
    if (kPrecede && lane < 16 && left - 1 - lane >= in_width) filled = left - 1 - lane;
    has_filled = filled >= left - Radius && filled < left + 32 * P + Radius && (filled < 0 || filled >= in_width);
    // No result reads pixels that are further behind the row. Their sources may be out of the ring: every row would
    // wait for them.
    source = has_filled && filled < in_width + Radius ? border_index(across, filled, in_width) : -1;
    if (!kPrecede) has_filled = source >= 0;  // zeros stay
    fills = __any_sync(0xffffffffu, has_filled);
    source_in_ring = source >= max(left - Radius, 0) && source < left + 32 * P + Radius;
#pragma unroll 1
    for (int i = 0; i < Rows - 1; ++i) fetch();
  }

  // Starts the copy of one more row. Each thread holds the source row of one of the next 32 positions, -1 for the
  // constant.
  __device__ __forceinline__ void fetch() {
    if (next % 32 == 0) source_row = border_index(down, first + next + lane, in_height);
    int const y = __shfl_sync(0xffffffffu, source_row, next);
    bool const more = next < count, zero = y < 0;
    uint32_t const slot = next & (Rows - 1), to = slot * kRowBytes;
    ++next;
    T const* const from = row_at(column_from, max(y, 0), in_stride);
    T const* const from_halo = row_at(halo_from, max(y, 0), in_stride);
    if constexpr (kPrecede) {
      int const bytes = int(reinterpret_cast<uintptr_t>(from) % kBytes);  // before the row, the same for all threads
      int const before = bytes / int(sizeof(T));
      preceding = preceding << 8 | uint32_t(before);
      T const* const vector = row_at(from, -1, bytes);
      bool const copies = more && holds_pixel(column_key, before), copies_halo = more && holds_pixel(halo_key, before);
      if (max(y, 0) >= unsafe_from) {
        if (copies) copy_start<P>(column_to + to, vector, zero ? 0 : in_width - column + before);
        if (copies_halo) copy_start<P>(halo_to + to, vector + (halo - column), zero ? 0 : in_width - halo + before);
      } else {
        copy_async_if<kBytes>(column_to + to, vector, copies, zero);
        copy_async_if<kBytes>(halo_to + to, vector + (halo - column), copies_halo, zero);
      }
    } else {
      bool const by_vectors = kBytes <= 16 && aligned;  // float64 has no aligned form
      if constexpr (kBytes <= 16)
        if (by_vectors) {
          copy_async_if<kBytes>(column_to + to, from, more && column < in_width, zero);
          copy_async_if<kBytes>(halo_to + to, from_halo, more && has_halo, zero);
        }
      if constexpr (sizeof(T) >= 4)
        if (!by_vectors) {
          constexpr int kElement = sizeof(T);
          unsigned const copies = more ? words : 0;
#pragma unroll
          for (int i = 0; i < P; ++i)
            copy_async_if<kElement>(column_to + to + 32 * kElement * i, from + 32 * i, copies & 1u << i, zero);
          copy_async_if<kElement>(halo_to + to, from_halo, copies & 1u << P, zero);
        }
    }
    __pipeline_commit();
  }

  // Whether the vector of column x contains a pixel of a row before whose column x it holds `before` others; key =
  // x + 1 - in_width. It begins before the end of the row and ends behind its beginning.
  __device__ __forceinline__ bool holds_pixel(int key, int before) const {
    return unsigned(before - key) < unsigned(in_width + P - 1);
  }

  // Row i; calls are in order. Pixel `left` is at kHalo.
  __device__ __forceinline__ T const* row(int i) {
    T* row = ring[i & (Rows - 1)];
    __pipeline_wait_prior(Rows - 2);
    __syncwarp();
    fetch();
    if constexpr (kPrecede) row += preceding >> 8 * (Rows - 1) & 15;
    if constexpr (kPrecede)
      if (left < 0) {  // the first vector of the row may have brought pixels that precede it
        for (int x = left + lane; x < 0; x += 32) row[kHalo + x - left] = T{};
        __syncwarp();
      }
    if (fills) {
      if (source_in_ring) {
        row[kHalo + filled - left] = row[kHalo + source - left];
      } else if (has_filled) {
        int const from = source < 0 ? -1 : border_index(down, first + i, in_height);
        row[kHalo + filled - left] = from < 0 ? T{} : *(row_at(in, from, in_stride) + source);
      }
      __syncwarp();
    }
    return row;
  }
};

// Reads the windows of K pixels around a thread's P pixels from a row. The thread's first pixel is v[kBefore].
template <int K, int P>
constexpr int kBefore = (K / 2 + P - 1) / P * P;
template <int K, int P, class T, class Aligned = std::true_type>
__device__ __forceinline__ void read_windows(T const* row, Compute<T> (&v)[P + 2 * kBefore<K, P>], Aligned = {}) {
  constexpr int N = P + 2 * kBefore<K, P>, R = K / 2, kSkip = kBefore<K, P> - R, kWindows = P + 2 * R;
  T const* const pixels = row + kHalo + P * (threadIdx.x % 32);
  if constexpr (!kMayPrecede<T, Aligned>) {
#pragma unroll
    for (int j = 0; j < N; j += P) {
      auto const vector = *reinterpret_cast<Vector<T, P> const*>(pixels - kBefore<K, P> + j);
#pragma unroll
      for (int k = 0; k < P; ++k) v[j + k] = read(vector.v[k]);
    }
  } else if constexpr (kWindows <= 24) {
    // Aligned vectors, within the first of which the windows begin: at the same pixel of it in all threads.
    constexpr int kVectors = (kWindows + 2 * P - 2) / P;
    using V = Vector<T, P>;
    int const begin = int(__cvta_generic_to_shared(pixels - R) % sizeof(V)) / int(sizeof(T));
    auto const* const from = reinterpret_cast<V const*>(pixels - R - begin);
    V vectors[kVectors];
#pragma unroll
    for (int j = 0; j < kVectors; ++j) vectors[j] = from[j];
    with_constant<P>(begin, [&](auto begin) {
#pragma unroll
      for (int i = 0; i < kWindows; ++i) v[kSkip + i] = read(vectors[(i + begin) / P].v[(i + begin) % P]);
    });
  } else {  // words, within which the windows may begin: so many vectors would not fit into the registers
    constexpr int W = kPerWord<T>;
    T const* const first = pixels - kBefore<K, P>;
    int const preceding = preceding_elements(first);
    auto const* const words = reinterpret_cast<uint32_t const*>(first - preceding);
#pragma unroll
    for (int j = 0; j < N / W; ++j) {
      uint32_t const word = __funnelshift_r(words[j], words[j + 1], 8 * int(sizeof(T)) * preceding);
      Vector<T, W> shifted;
      __builtin_memcpy(&shifted, &word, 4);
#pragma unroll
      for (int k = 0; k < W; ++k) v[j * W + k] = read(shifted.v[k]);
    }
  }
}

// Stores a thread's P pixels, those at x ... of a row of `width`, to `to`. `aligned`: as in RowPrefetcher. Called by
// all 32 threads.
template <class T, int P, class Aligned>
__device__ __forceinline__ void store_pixels(T* to, Compute<T> const (&v)[P], int x, int width, Aligned aligned) {
  if (aligned) {
    if (x < width) store_vector(to, v);
  } else {
    store_words(to, v, x, width);
  }
}

}  // namespace
}  // namespace kv
