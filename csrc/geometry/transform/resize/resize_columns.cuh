// Antialiased bilinear resizing of bytes and half types on CUDA, of images that shrink to no less than a quarter. A
// lane goes down a column of the result, in some planes at once, which have its weights in common. It reads the words
// of memory that the column's window is in:
//
//   words of memory of a row  | . . a b | c d e . |       bytes
//   window                        a b   c d e
//
// and adds the weighted row to the two rows of the result at most that have it. Adjacent lanes read adjacent windows.
// Included by resize_columns.cu and lists/resize_columns_list.cu.
#pragma once

#include "core/image_list.h"
#include "core/launch.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kColumnThreads = 128;
// Rows of a strip at most, rows of the source in flight, and blocks that run at once at least. Half types hold more
// words of a row in registers.
template <class T>
constexpr int kMostRows = sizeof(T) == 1 ? 64 : 32;
template <class T>
constexpr int kRowsAhead = sizeof(T) == 1 ? 4 : 3;
template <class T>
constexpr int kColumnBlocks = sizeof(T) == 1 ? 5 : 3;
constexpr int kMostTaps = 8, kFewTaps = 5;  // along an axis, and those of images that shrink to about a half

// Columns of a lane's warp beside each other, and strips of rows below each other.
struct ColumnStrips {
  unsigned across, down;
  int rows;
  template <class T>
  KV_HD static ColumnStrips of(Planes<T> const& y, int rows) {
    return {unsigned(ceil_div(int(y.width), 32)), unsigned(ceil_div(int(y.height), rows)), rows};
  }
  // A warp has `planes` of an image's planes.
  KV_HD unsigned blocks(int64_t count, int planes) const {
    return unsigned(ceil_div(count / planes * across, int64_t(kColumnThreads / 32))) * down;
  }
};

// A row of the source: its weights in the first row of the result that is not complete and in the next one, and whether
// it completes the former.
struct alignas(16) SourceRow {
  float weights[2];
  unsigned completes;
};
// The window of a pixel of the result, along an axis.
struct ColumnWindow {
  int64_t center;
  int first, end;
  float norm;

  static __device__ __forceinline__ ColumnWindow of(ResizeAxis const& axis, int i) {
    Band<float> const band = window_band<float>(axis, i);
    ColumnWindow window{axis.center(i), band.first, band.last + 1, 1};
    float sum = 0;
#pragma unroll
    for (int k = 0; k < kMostTaps; ++k) sum += window.weight(axis, window.first + k);
    window.norm = 1 / sum;
    return window;
  }
  // Of pixel j, from the first one on.
  __device__ __forceinline__ float weight(ResizeAxis const& axis, int j) const {
    float const distance = float(double(j * axis.den - center) * axis.per_unit);
    return j < end ? norm * filter_at(ResizeFilter::bilinear, true, distance) : 0;
  }
};

template <int MostRows>
struct SourceRows {
  ColumnWindow windows[MostRows];
  SourceRow rows[(MostRows + 2) * kMostTaps / 2 + 1];
  int begin, end;

  // Those of `count` rows of the result from y0 on, by all threads. Weights are multiples of `unit`.
  __device__ __forceinline__ void init(ResizeAxis const& axis, int y0, int count, float unit) {
    for (int i = int(threadIdx.x); i < count; i += int(blockDim.x)) windows[i] = ColumnWindow::of(axis, y0 + i);
    __syncthreads();
    int const first = windows[0].first, last = windows[count - 1].end;
    if (threadIdx.x == 0) begin = first, end = last;
    for (int y = first + int(threadIdx.x); y < last; y += int(blockDim.x)) {
      int const at = entry_of_item(count, y, [&](int i) { return i > 0 ? windows[i - 1].end : first; });
      SourceRow row{{}, y + 1 == windows[at].end};
#pragma unroll
      for (int s = 0; s < 2; ++s)
        if (at + s < count && y >= windows[at + s].first) row.weights[s] = unit * windows[at + s].weight(axis, y);
      rows[y - first] = row;
    }
    __syncthreads();
  }
};

// Column x of N planes, from row y0 of the result on. K: taps, some of weight 0.
template <class T, int N, int K>
__device__ __forceinline__ void resize_column(Resize<T> const& p, SourceRows<kMostRows<T>> const& source, int64_t plane,
                                              int x, int y0) {
  // Bytes are weighted along x as integers, two pixels and two weights at a time: their rows are units of 2^-15.
  constexpr bool kByInteger = sizeof(T) == 1;
  constexpr int kWords = (K + 2 * (kPerWord<T> - 1)) / kPerWord<T>, kPacked = ceil_div(K, kPerWord<T>);
  constexpr int kPairs = (K + 1) / 2, kAhead = kRowsAhead<T>;
  int const width = int(p.y.width), column = min(x, width - 1);
  auto const window = ColumnWindow::of(p.columns, column);
  float weights[2 * kPairs];
#pragma unroll
  for (int k = 0; k < 2 * kPairs; ++k) weights[k] = window.weight(p.columns, window.first + k);
  [[maybe_unused]] uint32_t pairs[kPairs];
#pragma unroll
  for (int k = 0; k < kPairs; ++k)
    pairs[k] = __float2uint_rn(weights[2 * k] * 0x1p15f) | __float2uint_rn(weights[2 * k + 1] * 0x1p15f) << 16;

  auto const address = [](T const* at) { return int64_t(reinterpret_cast<uintptr_t>(at)); };
  unsigned const stride = unsigned(p.x.row_stride * int64_t(sizeof(T)));
  T const* from[N];
  T* out[N];
  // The memory of the image may end within a word, which is put together once.
  int64_t const memory_end = address(p.x.row(p.x.count() - 1, p.x.height - 1) + p.x.width);
  auto const* const last_word = reinterpret_cast<uint32_t const*>(uintptr_t(memory_end & ~int64_t(3)));
  uint32_t tail = 0;
#pragma unroll
  for (int k = 0; k + 1 < kPerWord<T>; ++k)
    if (auto const* const at = reinterpret_cast<T const*>(last_word) + k; address(at) < memory_end) {
      uint32_t bits = 0;
      __builtin_memcpy(&bits, at, sizeof(T));
      tail |= bits << 8 * int(sizeof(T)) * k;
    }
  int64_t past_end = INT64_MIN;  // of the words of row 0
#pragma unroll
  for (int c = 0; c < N; ++c) {
    from[c] = p.x.plane(plane + c) + window.first;
    out[c] = p.y.row(plane + c, y0) + column;
    past_end = max(past_end, address(from[c]) + 4 * kWords - memory_end);
  }
  int const begin = source.begin, end = source.end;
  int safe_rows = end;  // whose words are whole
  while (safe_rows > 0 && past_end + int64_t(safe_rows - 1) * stride > 0) --safe_rows;

  struct Fetched {
    uint32_t words[N][kWords];
    unsigned shift[N];  // modulo 32: bits of the first word that precede the window
  };
  auto const fetch = [&](int y) {
    Fetched f;
    y = min(y, end - 1);  // those below are not used
    auto const read_words = [&](auto word_at) {
#pragma unroll
      for (int c = 0; c < N; ++c) {
        uint64_t const first = reinterpret_cast<uintptr_t>(from[c]) + uint64_t(unsigned(y)) * stride;
        auto const* const words = reinterpret_cast<uint32_t const*>(uintptr_t(first & ~uint64_t(3)));
        f.shift[c] = 8 * unsigned(first);
#pragma unroll
        for (int i = 0; i < kWords; ++i) f.words[c][i] = word_at(words + i);
      }
    };
    if (y < safe_rows)
      read_words([](uint32_t const* at) { return __ldg(at); });
    else
      read_words([&](uint32_t const* at) { return at < last_word ? __ldg(at) : tail; });
    return f;
  };

  int y = begin;
  Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y + i);
  float sums[2][N] = {};  // of the rows of the result that are not complete
#pragma unroll 1
  while (y < end) {
#pragma unroll
    for (int slot = 0; slot < kAhead; ++slot, ++y) {
      if (slot > 0 && y >= end) break;
      SourceRow const row = source.rows[y - begin];
      uint32_t packed[N][kPacked];
#pragma unroll
      for (int c = 0; c < N; ++c)
#pragma unroll
        for (int i = 0; i < kPacked; ++i)
          packed[c][i] = __funnelshift_r(ahead[slot].words[c][i], i + 1 < kWords ? ahead[slot].words[c][i + 1] : 0u,
                                         ahead[slot].shift[c]);
      ahead[slot] = fetch(y + kAhead);
      float h[N];
      bool finite = true;
      if constexpr (kByInteger) {
#pragma unroll
        for (int c = 0; c < N; ++c) {
          uint32_t sum = 0x4b000000;  // as a float 2^23
#pragma unroll
          for (int k = 0; k < kPairs; ++k)
            sum = k % 2 ? __dp2a_hi(pairs[k], packed[c][k / 2], sum) : __dp2a_lo(pairs[k], packed[c][k / 2], sum);
          h[c] = __uint_as_float(sum) - float(1 << 23);
        }
      } else {
        auto const pixel = [&](int c, int k) {
          T pair[2];
          __builtin_memcpy(pair, &packed[c][k / 2], 4);
          return read(pair[k % 2]);
        };
        float poison = 0;
#pragma unroll
        for (int c = 0; c < N; ++c) {
#pragma unroll
          for (int k = 0; k < K; ++k) h[c] = k == 0 ? weights[0] * pixel(c, 0) : fmaf(weights[k], pixel(c, k), h[c]);
          poison += h[c] * 0;
        }
        finite = poison == 0;
        if (!finite) {  // inf and NaN with weight 0 contribute nothing
#pragma unroll
          for (int c = 0; c < N; ++c) {
            h[c] = 0;
#pragma unroll
            for (int k = 0; k < K; ++k)
              if (weights[k] != 0) h[c] = fmaf(weights[k], pixel(c, k), h[c]);
          }
        }
      }
#pragma unroll
      for (int s = 0; s < 2; ++s)
        if (finite || row.weights[s] != 0) {
#pragma unroll
          for (int c = 0; c < N; ++c) sums[s][c] = fmaf(row.weights[s], h[c], sums[s][c]);
        }
      if (row.completes) {
#pragma unroll
        for (int c = 0; c < N; ++c) {
          if (x < width) *out[c] = round_to<T>(sums[0][c]);
          out[c] += p.y.row_stride;
          sums[0][c] = sums[1][c], sums[1][c] = 0;
        }
      }
    }
  }
}

// The columns of block number `block`.
template <class T, int N>
__device__ __forceinline__ void resize_columns_of(Resize<T> const& p, ColumnStrips const& strips, unsigned block) {
  __shared__ SourceRows<kMostRows<T>> source;
  unsigned const q = block / strips.down;  // adjacent blocks are below each other
  int const y0 = int(block - q * strips.down) * strips.rows;
  source.init(p.rows, y0, min(strips.rows, int(p.y.height) - y0), sizeof(T) == 1 ? 0x1p-15f : 1.f);
  unsigned const warp = q * (kColumnThreads / 32) + threadIdx.x / 32, group = warp / strips.across;
  int64_t const plane = int64_t(group) * N;
  int const x = int(warp - group * strips.across) * 32 + int(threadIdx.x % 32);
  if (plane >= p.y.count()) return;
  if (p.columns.max_taps <= kFewTaps)
    resize_column<T, N, kFewTaps>(p, source, plane, x, y0);
  else
    resize_column<T, N, kMostTaps>(p, source, plane, x, y0);
}

template <class T>
bool serves_columns(Resize<T> const& p) {
  auto const serves = [](ResizeAxis const& axis) {
    return axis.filter == ResizeFilter::bilinear && axis.antialias && !axis.backward && axis.max_taps <= kMostTaps;
  };
  return serves(p.rows) && serves(p.columns) && p.rows.num >= p.rows.den && p.x.step == 1 && p.y.step == 1 &&
         !p.minuend && p.x.row_stride * int64_t(sizeof(T)) <= INT32_MAX;
}

// The rows of strips for so many warps side by side.
template <class T>
int rows_of_columns(int64_t warps, int64_t height, int resident) {
  int64_t const most = resident * int64_t(kColumnThreads / 32);
  return strip_height(warps, height, 6, most, most, min(height, int64_t(8)), kMostRows<T>);
}

}  // namespace
}  // namespace kv::geometry::cuda
