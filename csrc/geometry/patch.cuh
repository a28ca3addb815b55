// The part of an image that a tile of places looks at, in shared memory. Included by sample*.cu.
//
// Pixels come there once, in packs of 16 bytes where rows allow, with what the padding puts around the image; taps are
// then at offsets known to the compiler. From global memory a turned tile would ask for as many lines as it has rows,
// once for each tap.
#pragma once

#include <cuda_pipeline.h>

#include <climits>

#include "sample.cuh"

namespace kv::cuda {

// Columns and rows, ends included.
struct Box {
  int left, top, right, bottom;

  static __device__ __forceinline__ Box empty() { return {INT_MAX, INT_MAX, -INT_MAX, -INT_MAX}; }
  static __device__ __forceinline__ Box all() { return {-INT_MAX / 4, -INT_MAX / 4, INT_MAX / 4, INT_MAX / 4}; }
  // That of a place's taps.
  template <int K, class T, class F>
  __device__ __forceinline__ void add(Sampling<T> const& p, F u, F v) {
    F t;
    int const x = first_tap<K, F>(clamped(p.x_axis, u), t), y = first_tap<K, F>(clamped(p.y_axis, v), t);
    left = min(left, x);
    top = min(top, y);
    right = max(right, x + K - 1);
    bottom = max(bottom, y + K - 1);
  }
  // The box around those of N neighbouring threads.
  template <int N>
  __device__ __forceinline__ void join() {
#pragma unroll
    for (int lane = N / 2; lane > 0; lane /= 2) {
      left = min(left, __shfl_xor_sync(0xffffffffu, left, lane));
      top = min(top, __shfl_xor_sync(0xffffffffu, top, lane));
      right = max(right, __shfl_xor_sync(0xffffffffu, right, lane));
      bottom = max(bottom, __shfl_xor_sync(0xffffffffu, bottom, lane));
    }
  }
};

// What threads look at before they look at the image: their tiles and the taps of these.
template <class F>
struct View : Tile<F> {
  Box taps[kTileRow];

  // By all threads of a block, of an output of that size. By a matrix, taps lie between those of a tile's corners, but
  // for rounding, unless the horizon runs through it.
  template <int K, class T>
  __device__ __forceinline__ void open(Tiles const& tiles, Sampling<T> const& p, int width, int height) {
    if (threadIdx.x < 32) {
      if (threadIdx.x == 0) Tile<F>::open(tiles, p.places);
      __syncwarp();
      int const tile = threadIdx.x / 4 % kTileRow, x0 = this->x + tile * kTile;
      Box box = Box::empty();
      if (p.places.matrices) {
        F const x = F(threadIdx.x & 1 ? min(x0 + kTile, width) - 1 : x0);
        F const y = F(threadIdx.x & 2 ? min(this->y + kTile, height) - 1 : this->y);
        F u, v;
        this->map.at(x, y, u, v);
        box.add<K>(p, u, v);
        box.join<4>();
        unsigned const before = __ballot_sync(0xffffffffu, this->map.weight(x, y) > 0) >> 4 * tile & 15;
        if (before != 0 && before != 15) box = Box::all();
      }
      if (threadIdx.x % 4 == 0) taps[tile] = box;
    }
    __syncthreads();
  }
  // By maps, the taps are those of places that are looked at one by one.
  template <int K, class T>
  __device__ __forceinline__ Box taps_of(int tile, Sampling<T> const& p, int width, int height) {
    if (!p.places.matrices) {
      PlacesOf<F> const places(p.places, *this);
      int const x = this->x + tile * kTile + column_in_tile();
      Box box = Box::empty();
#pragma unroll 1
      for (int y = this->y + row_in_tile(); x < width && y < min(this->y + kTile, height); y += kRunRows) {
        F u, v;
        places.at(y, x, u, v);
        box.add<K>(p, u, v);
      }
      box.join<32>();
      if (threadIdx.x % 32 == 0) {
        atomicMin(&taps[tile].left, box.left);
        atomicMin(&taps[tile].top, box.top);
        atomicMax(&taps[tile].right, box.right);
        atomicMax(&taps[tile].bottom, box.bottom);
      }
      __syncthreads();
    }
    return taps[tile];
  }
};

template <class T>
struct Patch {
  static constexpr int kPack = 16 / int(sizeof(T));
  // Room for a tile of kTile x kTile, turned by any angle. Four rows one below the other are in different banks.
  static constexpr int kPitch = sizeof(T) == 1 ? 80 : 56, kRows = 52;
  static constexpr int kSize = kPitch * kRows;
  static constexpr int kChannels = sizeof(T) == 8 ? 1 : 3;                        // at a time
  static constexpr int kColumns = sizeof(T) == 8 ? 32 : sizeof(T) == 4 ? 16 : 8;  // threads that take packs of one row

  T* pixels;
  int left, top, columns, rows;
  bool fits;

  // Of a box that has something in it.
  __device__ __forceinline__ Patch(void* pixels, Box const& box)
      : pixels(static_cast<T*>(pixels)),
        left(box.left & -kPack),
        top(box.top),
        columns(box.right - left + 1),
        rows(box.bottom - top + 1),
        fits(columns <= kPitch && rows <= kRows) {}
  // Of the taps in the box; where these leave the image, that they can be put there.
  template <class F>
  __device__ __forceinline__ Patch(void* pixels, Box const& box, Sampling<T> const& p, F) : Patch(pixels, box) {
    bool const inside = box.left >= 0 && box.top >= 0 && box.right < p.x_axis.size && box.bottom < p.y_axis.size;
    // Reflected places are in no order, and what fills the outside may be no number of the image's type.
    fits = fits && (inside || (p.x_axis.padding != Padding::reflection && (sizeof(T) == sizeof(F) || !p.fill)));
  }
  static size_t bytes(int channels) { return size_t(min(channels, kChannels)) * kSize * sizeof(T); }

  // Where the first of the K x K taps at (x, y) is, or -1 where they are not all there.
  template <int K>
  __device__ __forceinline__ int find(int x, int y) const {
    unsigned const column = unsigned(x - left), row = unsigned(y - top);
    return column <= unsigned(columns - K) && row <= unsigned(rows - K) ? int(row * kPitch + column) : -1;
  }

  // Brings N channels from `first` on; fill(channel) is what stands where there is no pixel.
  template <int N, class F, class Fill>
  __device__ __forceinline__ void load(Images<T const> const& x, int64_t b, int first, Axis<F> const& x_axis,
                                       Axis<F> const& y_axis, bool aligned, Fill fill) const {
    __syncthreads();  // for those who read what is there now
    int const column = threadIdx.x % kColumns * kPack, from = left + column;
    bool const within = from >= 0 && from + kPack <= x_axis.size, whole = aligned && within;
    bool const filled = y_axis.padding == Padding::fill, beside = from + kPack <= 0 || from >= x_axis.size;
    int const row_stride = int(x.row_stride), step = int(x.step);  // a plane has less than 2^31 elements
    T const* planes[N];
#pragma unroll
    for (int k = 0; k < N; ++k) planes[k] = x.row(b, first + k, 0);
    T* to = pixels + threadIdx.x / kColumns * kPitch + column;
    if (column < columns)
#pragma unroll 1
      for (int row = threadIdx.x / kColumns; row < rows;
           row += kThreads / kColumns, to += kThreads / kColumns * kPitch) {
        int const y = pixel_at(y_axis, top + row);
        bool const exists = unsigned(y) < unsigned(y_axis.size);
        if (whole && exists) {
          int const at = y * row_stride + from;
#pragma unroll
          for (int k = 0; k < N; ++k) __pipeline_memcpy_async(to + k * kSize, planes[k] + at, 16);
        } else if (filled && (beside || !exists)) {
#pragma unroll
          for (int k = 0; k < N; ++k) {
            Pack<T, kPack> pack;
            T const value = fill(first + k);
#pragma unroll
            for (int i = 0; i < kPack; ++i) pack.v[i] = value;
            *reinterpret_cast<Pack<T, kPack>*>(to + k * kSize) = pack;
          }
        } else {
#pragma unroll 1
          for (int i = 0; i < kPack; ++i) {
            int const column = within ? from + i : pixel_at(x_axis, from + i);
            bool const is = exists && unsigned(column) < unsigned(x_axis.size);
            int const at = y * row_stride + column * step;
#pragma unroll
            for (int k = 0; k < N; ++k) to[k * kSize + i] = is ? planes[k][at] : fill(first + k);
          }
        }
      }
    __pipeline_commit();
    __pipeline_wait_prior(0);
    __syncthreads();
  }
};

// Calls take(first, number) for all channels, some at a time, the number as a type.
template <int N, class Take>
__device__ __forceinline__ void in_groups(int channels, Take take) {
  int first = 0;
#pragma unroll 1
  for (; first + N <= channels; first += N) take(first, std::integral_constant<int, N>{});
  if constexpr (N > 1)
#pragma unroll 1
    for (; first < channels; ++first) take(first, std::integral_constant<int, 1>{});
}

// Whether rows begin at whole packs, of images one pixel after the other.
template <class T>
bool in_packs(Images<T const> const& x) {
  int64_t const pack = 16 / int64_t(sizeof(T));
  return reinterpret_cast<uintptr_t>(x.data) % 16 == 0 && x.step == 1 && x.row_stride % pack == 0 &&
         x.channel_stride % pack == 0 && x.batch_stride % pack == 0;
}

}  // namespace kv::cuda
