// Source tiles: the pixels of an image that a tile of the output reads, in shared memory.
//
// Pixels are loaded once, in vectors of 16 bytes, together with their padding; the offsets of the taps are then known.
// From global memory, each tap of a rotated tile would load as many cache lines as the tile has rows.
#pragma once

#include <cuda_pipeline.h>

#include <climits>

#include "geometry/transform/sampling.cuh"

namespace kv::geometry::cuda {

// The first of the K taps of a coordinate below 2^21 in magnitude, and the fraction. The sum with a large constant has
// the integer in its last bits.
template <int K>
__device__ __forceinline__ int near_tap(float x, float& t) {
  constexpr float kLarge = 0x1.8p23f;
  float const sum = K == 1 ? snapped<float>(x) + kLarge : __fadd_rd(x, kLarge);
  t = K == 1 ? 0 : x - (sum - kLarge);
  return __float_as_int(sum) - (0x4b400000 + (K == 4));
}
template <int K>
__device__ __forceinline__ int near_tap(double x, double& t) {
  return first_tap<K, double>(x, t);
}

// Columns and rows, ends included.
struct TapBounds {
  int left, top, right, bottom;

  static __device__ __forceinline__ TapBounds empty() { return {INT_MAX, INT_MAX, -INT_MAX, -INT_MAX}; }
  static __device__ __forceinline__ TapBounds all() { return {-INT_MAX / 4, -INT_MAX / 4, INT_MAX / 4, INT_MAX / 4}; }
  // The bounds of the taps of coordinates within `margin`; everything, if these are NaN or farther away than `far`.
  template <int K, class F>
  __device__ __forceinline__ void add(F u, F v, F margin, F far) {
    TapBounds box = all();
    F t;
    if (u > -far && u < far && v > -far && v < far)
      box = {near_tap<K>(u - margin, t), near_tap<K>(v - margin, t), near_tap<K>(u + margin, t) + K - 1,
             near_tap<K>(v + margin, t) + K - 1};
    left = min(left, box.left);
    top = min(top, box.top);
    right = max(right, box.right);
    bottom = max(bottom, box.bottom);
  }
  __device__ __forceinline__ void move(int x, int y) {
    left += x;
    top += y;
    right += x;
    bottom += y;
  }
  // The bounding box of those of N adjacent threads.
  template <int N>
  __device__ __forceinline__ void merge_lanes() {
    left = warp_reduce<N>(left, Min{});
    top = warp_reduce<N>(top, Min{});
    right = warp_reduce<N>(right, Max{});
    bottom = warp_reduce<N>(bottom, Max{});
  }
};

// An upper bound of the rounding error of coordinates within the reach of a source tile.
constexpr float kCoordRounding = 1.f / 64;
// Coordinates farther from the image are processed one by one: sums over source tiles of the border would be rounding
// errors only.
constexpr int kFarCoord = 4096;

// A thread's sampling coordinates in a tile, relative to the tile's (u, v).
template <class F>
struct ThreadCoords {
  F u, v, weight, u_step, v_step, weight_step;  // of the first one, and steps between two
  F const* map_coords;                          // coordinates u and v from a map, or null
  bool affine;

  __device__ __forceinline__ ThreadCoords(Tile<F> const& tile, SampleCoords<F> const& coords, void const* kept,
                                          int column, int row)
      : map_coords(coords.has_map() ? static_cast<F const*>(kept) + threadIdx.x : nullptr), affine(tile.map.affine) {
    F const x = F(column), y = F(row);
    F const(&m)[9] = tile.map.m;
    u = x * m[0] + (y * m[1] + m[2]);
    v = x * m[3] + (y * m[4] + m[5]);
    weight = x * m[6] + (y * m[7] + m[8]);
    u_step = m[1] * kRowStep;
    v_step = m[4] * kRowStep;
    weight_step = m[7] * kRowStep;
  }
  __device__ __forceinline__ void at(int run, F& x, F& y) const {
    if (map_coords) {
      x = map_coords[2 * run * kThreads];
      y = map_coords[(2 * run + 1) * kThreads];
      return;
    }
    x = u_step * F(run) + u;
    y = v_step * F(run) + v;
    if (affine) return;
    F const scale = reciprocal(weight_step * F(run) + weight);
    x *= scale;
    y *= scale;
  }
};

// A block's tiles and the boxes of their taps, in shared memory.
template <class F>
struct BlockTiles {
  Tile<F> tiles[kMaxTilesPerBlock];
  TapBounds taps[kMaxTilesPerBlock];

  // By all threads of a block, of an output (samples, height, width). By a matrix, taps lie between those of a tile's
  // corners unless the horizon runs through it.
  template <int K, class T>
  __device__ __forceinline__ void prepare(TileGrid const& count, Sampling<T> const& p, int64_t samples, int width,
                                          int height) {
    auto const matrix_of = [&](int64_t b) { return p.coords.matrices + b * p.coords.matrix_stride; };
    prepare<K>(count, p, samples, width, height, matrix_of);
  }
  // By the matrices that `matrix(sample)` returns.
  template <int K, class T, class Matrix>
  __device__ __forceinline__ void prepare(TileGrid const& count, Sampling<T> const& p, int64_t samples, int width,
                                          int height, Matrix matrix) {
    if (threadIdx.x < 32) {
      int const number = threadIdx.x / 4 % kMaxTilesPerBlock;
      Tile<F> tile;
      tile.locate(count, number);
      tile.image = p.image_of(min(tile.b, samples - 1));
      TapBounds box = TapBounds::empty();
      if (!p.coords.has_map()) {
        tile.bind(homography(matrix(tile.b), p.coords.use), p.coords.use.source);
        F const x = F(threadIdx.x & 1 ? min(kTile, width - tile.x) - 1 : 0);
        F const y = F(threadIdx.x & 2 ? min(kTile, height - tile.y) - 1 : 0);
        F u, v;
        tile.map.apply(x, y, u, v);
        box.add<K>(u, v, F(kCoordRounding), F(kFarCoord));
        box.merge_lanes<4>();
        box.move(tile.u, tile.v);
        unsigned const before = __ballot_sync(0xffffffffu, tile.map.weight(x, y) > 0) >> 4 * number & 15;
        if (before != 0 && before != 15) box = TapBounds::all();
      }
      if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kMaxTilesPerBlock) {
        tiles[number] = tile;
        taps[number] = box;
      }
    }
    __syncthreads();
  }
  // Finds the bounding box of the taps of a tile, where `prepare` did not. The coordinates of maps are read one by one,
  // clamped to next to the image, and stored.
  template <int K, class T>
  __device__ __forceinline__ void find_taps(int number, Sampling<T> const& p, int width, int height, void* kept) {
    if (!p.coords.has_map()) return;
    Tile<F> const& tile = tiles[number];
    F* const map_coords = static_cast<F*>(kept) + threadIdx.x;
    int const x = tile.x + column_in_tile<T>(), first_y = tile.y + row_in_tile<T>();
    MapColumn<F> const map(p.coords, tile.b, first_y, x);
    F low_u = F(INFINITY), low_v = low_u, high_u = -low_u, high_v = high_u;  // of the coordinates
#pragma unroll
    for (int run = 0; run < kPixelsPerThread; ++run) {
      F u = 0, v = 0;
      if (x < width && first_y + run * kRowStep < height) {
        map.at(run * kRowStep, u, v);
        u = clamped(p.x_axis, u);
        v = clamped(p.y_axis, v);
        low_u = min(low_u, u), high_u = max(high_u, u);
        low_v = min(low_v, v), high_v = max(high_v, v);
      }
      map_coords[2 * run * kThreads] = u;
      map_coords[(2 * run + 1) * kThreads] = v;
    }
    TapBounds box = TapBounds::empty();
    if (low_u <= high_u) {
      box.add<K>(low_u, low_v, F(0), F(1 << 20));
      box.add<K>(high_u, high_v, F(0), F(1 << 20));
    }
    box.merge_lanes<32>();
    if (threadIdx.x % 32 == 0) {
      atomicMin(&taps[number].left, box.left);
      atomicMin(&taps[number].top, box.top);
      atomicMax(&taps[number].right, box.right);
      atomicMax(&taps[number].bottom, box.bottom);
    }
    __syncthreads();
  }
};

// The source tile of an image. Aligned: all rows of the image begin with whole vectors of 16 bytes.
//
// Else pixels keep their distance from whole vectors: rows and planes of the source tile are as far apart as those of
// the image, but for whole vectors, so that vectors of the image are vectors of the source tile, too.
template <class T, bool Aligned>
struct SourceTile {
  static constexpr int kVectorSize = 16 / int(sizeof(T));
  // The capacity suffices for a tile of kTile x kTile rotated by any angle. Double4 rows one below the other are in
  // different banks.
  static constexpr int kPitch = sizeof(T) == 1 ? 80 : sizeof(T) == 2 ? 72 : 56, kRows = 52;
  // Whole vectors of it, for rows that are as far apart as those of any image.
  static constexpr int kSize =
      Aligned ? kPitch * kRows : ((kPitch + kVectorSize - 1) * kRows + kVectorSize - 1) & -kVectorSize;
  static constexpr int kChannels = sizeof(T) == 8 ? 1 : 3;  // at a time
  static constexpr int kColumns = sizeof(T) == 8   ? 32
                                  : sizeof(T) == 4 ? 16
                                                   : 8;  // threads that take vectors of one row

  T* const memory;
  [[maybe_unused]] int own_pitch = kPitch, own_plane = kSize;
  int left, top, columns, rows;
  bool planar, fits;  // planar: one pixel of a row after the other
  int start = 0;      // of the pixel (left, top) of the first channel

  // Elements from a row to the next one, and from a channel: constants where aligned, for the offsets of taps.
  __device__ __forceinline__ int pitch() const { return Aligned ? kPitch : own_pitch; }
  __device__ __forceinline__ int plane() const { return Aligned ? kSize : own_plane; }

  // For a box that is not empty.
  __device__ __forceinline__ SourceTile(void* memory, TapBounds const& box, Images<T const> const& x)
      : memory(static_cast<T*>(memory)),
        left(Aligned ? box.left & -kVectorSize : box.left),
        top(box.top),
        columns(box.right - left + 1),
        rows(box.bottom - box.top + 1),
        planar(Aligned || x.step == 1) {
    if (!Aligned && planar) {
      own_pitch += int(x.row_stride) & (kVectorSize - 1);
      own_plane += int(x.channel_stride) & (kVectorSize - 1);
    }
    fits = columns <= min(pitch(), kColumns * kVectorSize) - (Aligned ? 0 : kVectorSize - 1) && rows <= kRows;
  }
  // Whether the taps in the box fit; where some are out of bounds, whether their padding can be stored.
  template <class S, class F>
  __device__ __forceinline__ SourceTile(void* memory, TapBounds const& box, Images<T const> const& x,
                                        Sampling<S> const& p, F)
      : SourceTile(memory, box, x) {
    bool const inside = box.left >= 0 && box.top >= 0 && box.right < p.x_axis.size && box.bottom < p.y_axis.size;
    // Reflected coordinates are not monotonic, and the fill may not be representable in the image's type.
    fits = fits && (inside || (p.x_axis.padding != Padding::reflection && (sizeof(T) == sizeof(F) || !p.fill)));
  }
  // Bytes of the source tile; the coordinates of maps are stored after it, at `end`.
  static KV_HD size_t bytes(int channels) {
    return size_t(min(channels, kChannels)) * (kSize + kVectorSize) * sizeof(T);
  }
  template <class F>
  static size_t bytes(int channels, SampleCoords<F> const& coords) {
    return bytes(channels) + (coords.has_map() ? 2 * kTile * kTile * sizeof(F) : 0);
  }

  // The first channel's pixel at the origin of coordinates relative to (u, v), of those that were loaded last.
  __device__ __forceinline__ T const* origin(int u, int v) const {
    return memory + ((v - top) * pitch() + (u - left) + start);
  }

  // Loads N channels from `first` on; fill(channel) is the value out of bounds.
  template <int N, class F, class Fill>
  __device__ __forceinline__ void load(Images<T const> const& x, int64_t b, int first, Axis<F> const& x_axis,
                                       Axis<F> const& y_axis, Fill fill) {
    __syncthreads();  // before the current contents are overwritten
    if constexpr (Aligned)
      load_aligned<N>(x, b, first, x_axis, y_axis, fill);
    else
      load_unaligned<N>(x, b, first, x_axis, y_axis, fill);
    __pipeline_commit();
    __pipeline_wait_prior(0);
    __syncthreads();
  }

  // Where all rows of the image begin with whole vectors.
  template <int N, class F, class Fill>
  __device__ __forceinline__ void load_aligned(Images<T const> const& x, int64_t b, int first, Axis<F> const& x_axis,
                                               Axis<F> const& y_axis, Fill fill) const {
    int const column = threadIdx.x % kColumns * kVectorSize, from = left + column;
    bool const within = from >= 0 && from + kVectorSize <= x_axis.size;
    bool const filled = y_axis.padding == Padding::fill, outside = from + kVectorSize <= 0 || from >= x_axis.size;
    int const row_stride = int(x.row_stride), step = int(x.step);  // a plane has less than 2^31 elements
    T const* planes[N];
#pragma unroll
    for (int k = 0; k < N; ++k) planes[k] = x.row(b, first + k, 0);
    T* to = memory + threadIdx.x / kColumns * kPitch + column;
    bool const inside = left >= 0 && top >= 0 && top + rows <= y_axis.size &&
                        left + (columns + kVectorSize - 1) / kVectorSize * kVectorSize <= x_axis.size;
    if (column >= columns) {
    } else if (inside) {
      int at = (top + int(threadIdx.x) / kColumns) * row_stride + from;
#pragma unroll 1
      for (int row = threadIdx.x / kColumns; row < rows; row += kThreads / kColumns) {
#pragma unroll
        for (int k = 0; k < N; ++k) __pipeline_memcpy_async(to + k * kSize, planes[k] + at, 16);
        at += kThreads / kColumns * row_stride;
        to += kThreads / kColumns * kPitch;
      }
    } else {
#pragma unroll 1
      for (int row = threadIdx.x / kColumns; row < rows;
           row += kThreads / kColumns, to += kThreads / kColumns * kPitch) {
        int const y = pixel_at(y_axis, top + row);
        bool const exists = unsigned(y) < unsigned(y_axis.size);
        if (within && exists) {
          int const at = y * row_stride + from;
#pragma unroll
          for (int k = 0; k < N; ++k) __pipeline_memcpy_async(to + k * kSize, planes[k] + at, 16);
        } else if (filled && (outside || !exists)) {
#pragma unroll
          for (int k = 0; k < N; ++k) {
            Vector<T, kVectorSize> vector;
            T const value = fill(first + k);
#pragma unroll
            for (int i = 0; i < kVectorSize; ++i) vector.v[i] = value;
            *reinterpret_cast<Vector<T, kVectorSize>*>(to + k * kSize) = vector;
          }
        } else {
#pragma unroll 1
          for (int i = 0; i < kVectorSize; ++i) {
            int const column = within ? from + i : pixel_at(x_axis, from + i);
            bool const is = exists && unsigned(column) < unsigned(x_axis.size);
            int const at = y * row_stride + column * step;
#pragma unroll
            for (int k = 0; k < N; ++k) to[k * kSize + i] = is ? planes[k][at] : fill(first + k);
          }
        }
      }
    }
  }

  // At any alignment: vectors of the image are vectors of the source tile.
  template <int N, class F, class Fill>
  __device__ __forceinline__ void load_unaligned(Images<T const> const& x, int64_t b, int first, Axis<F> const& x_axis,
                                                 Axis<F> const& y_axis, Fill fill) {
    int const pitch = own_pitch, plane = own_plane;
    constexpr int kRest = kVectorSize - 1, kRowsAtOnce = kThreads / kColumns;
    int const column = threadIdx.x % kColumns * kVectorSize, first_row = threadIdx.x / kColumns;
    int const row_stride = int(x.row_stride), step = int(x.step);  // a plane has less than 2^31 elements
    T const* planes[N];
#pragma unroll
    for (int k = 0; k < N; ++k) planes[k] = x.row(b, first + k, 0);
    int from = (top + first_row) * row_stride + left * step;
    start = planar ? int(reinterpret_cast<uintptr_t>(planes[0] + (top * row_stride + left)) / sizeof(T)) & kRest : 0;
    int to = start + first_row * pitch;
    if (planar && left >= kRest && top >= 0 && top + rows <= y_axis.size && left + columns + kRest <= x_axis.size) {
      // Vectors begin `past` elements before the tile's first column.
#pragma unroll 1
      for (int row = first_row; row < rows; row += kRowsAtOnce) {
#pragma unroll
        for (int k = 0; k < N; ++k) {
          int const past = (to + k * plane) & kRest, at = column - past;
          if (at < columns) __pipeline_memcpy_async(memory + (to + k * plane + at), planes[k] + (from + at), 16);
        }
        from += kRowsAtOnce * row_stride;
        to += kRowsAtOnce * pitch;
      }
    } else {
      bool const filled = y_axis.padding == Padding::fill;
#pragma unroll 1
      for (int row = first_row; row < rows; row += kRowsAtOnce, to += kRowsAtOnce * pitch) {
        int const y = pixel_at(y_axis, top + row);
        bool const exists = unsigned(y) < unsigned(y_axis.size);
        // Not of a row that stands for one out of bounds, which may be at another distance from whole vectors.
        bool const copies = planar && exists && ((y - top - row) * row_stride & kRest) == 0;
#pragma unroll 1
        for (int k = 0; k < N; ++k) {
          T const* const plane_k = x.row(b, first + k, 0);
          int const past = planar ? (to + k * plane) & kRest : 0, at = left - past + column;
          T* const cells = memory + (to + k * plane - past + column);
          if (column - past >= columns) continue;
          bool const within = at >= 0 && at + kVectorSize <= x_axis.size;
          if (copies && within) {
            __pipeline_memcpy_async(cells, plane_k + (y * row_stride + at), 16);
          } else if (filled && (!exists || at + kVectorSize <= 0 || at >= x_axis.size)) {
            T const value = fill(first + k);
#pragma unroll
            for (int i = 0; i < kVectorSize; ++i) cells[i] = value;
          } else {
            constexpr int kAtOnce = kVectorSize < 4 ? kVectorSize : 4;  // loads before the first of them is waited for
#pragma unroll 1
            for (int i = 0; i < kVectorSize; i += kAtOnce) {
              T values[kAtOnce];
#pragma unroll
              for (int j = 0; j < kAtOnce; ++j) {
                int const pixel = within ? at + i + j : pixel_at(x_axis, at + i + j);
                bool const is = exists && unsigned(pixel) < unsigned(x_axis.size);
                T const* const from = plane_k + (y * row_stride + pixel * step);
                if constexpr (sizeof(T) >= 4) {
                  if (is) __pipeline_memcpy_async(cells + i + j, from, sizeof(T));
                  if (!is) cells[i + j] = fill(first + k);
                } else {
                  values[j] = is ? *from : fill(first + k);
                }
              }
              if constexpr (sizeof(T) < 4)
#pragma unroll
                for (int j = 0; j < kAtOnce; ++j) cells[i + j] = values[j];
            }
          }
        }
      }
    }
  }
};

// Calls take(first, number) for all channels, some at a time, the number as a type.
template <int N, class Take>
__device__ __forceinline__ void for_each_channel_group(int channels, Take take) {
  int first = 0;
#pragma unroll 1
  for (; first + N <= channels; first += N) take(first, std::integral_constant<int, N>{});
  if constexpr (N > 1)
#pragma unroll 1
    for (; first < channels; ++first) take(first, std::integral_constant<int, 1>{});
}

// Whether rows begin at whole vectors, of images one pixel after the other.
template <class T>
KV_HD bool rows_are_aligned(Images<T> const& x) {
  int64_t const vector = 16 / int64_t(sizeof(T));
  return reinterpret_cast<uintptr_t>(x.data) % 16 == 0 && x.step == 1 && x.row_stride % vector == 0 &&
         x.channel_stride % vector == 0 && x.batch_stride % vector == 0;
}

// Calls run with whether they do, as a type. float64 has one form, which serves all images.
template <class T, class Run>
void with_alignment(bool aligned, Run run) {
  if (sizeof(T) < 8 && aligned)
    run(std::bool_constant<(sizeof(T) < 8)>{});
  else
    run(std::false_type{});
}
template <class T, class Run>
void with_alignment_of(Images<T> const& x, Run run) {
  with_alignment<T>(rows_are_aligned(x), run);
}

}  // namespace kv::geometry::cuda
