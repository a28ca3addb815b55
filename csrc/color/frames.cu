// Frames of video on CUDA, in one launch: each code is read from device memory once, by the caches.
//
// whole     a thread takes four adjacent pixels of a row.
// boxes     a block takes 32 columns of 32 rows. What these take of the planes, and with which weights, is in shared
//           memory; of bytes each thread keeps the weights of a small window of its column. Windows that are larger
//           than the shared memory are computed by each thread for itself.
// matrices  a thread takes a pixel.
#include "core/launch.cuh"
#include "frames.h"

namespace kv::color::cuda {
namespace {

constexpr int kPixelsPerThread = 4, kThreads = 256, kTile = 32, kWarps = kThreads / 32;
constexpr int kLargestWindow = 20, kLargestChromaWindow = kLargestWindow / 2 + 2;

// By an or and a subtraction: the conversion instruction has a quarter of their rate.
template <class S>
__device__ __forceinline__ auto number_of(S code) {
  if constexpr (__is_same(S, uint8_t) || __is_same(S, uint16_t))
    return __uint_as_float(0x4b000000u | uint32_t(code)) - 8388608.f;
  else
    return read(code);
}

template <class S, class T>
struct Reader {
  PlanesToRgb<T> const& p;
  int64_t frame;
  __device__ __forceinline__ Compute<T> operator()(int plane, int row, int column) const {
    return Compute<T>(number_of(p.planes[plane].template row<S>(frame, row)[column * p.planes[plane].column_stride]));
  }
};

template <class S, class T>
__global__ void __launch_bounds__(kThreads) run_whole(__grid_constant__ PlanesToRgb<T> const p, bool vectorized) {
  using F = Compute<T>;
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32) * kPixelsPerThread, width = p.x.size;
  int const y = int(blockIdx.y) * kWarps + threadIdx.x / 32;
  if (x >= width || y >= p.y.size) return;
  bool const repeats = p.x.site == ChromaSite::nearest && p.x.is_halved();
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    Reader<S, T> const load{p, frame};
    F sums[3][kPixelsPerThread];
    if (repeats) {
      int const row = p.y.is_halved() ? y / 2 : y;
#pragma unroll
      for (int j = 0; j < kPixelsPerThread; ++j) sums[0][j] = x + j < width ? load(0, y, x + j) : F(0);
#pragma unroll
      for (int k = 1; k < 3; ++k)
#pragma unroll
        for (int j = 0; j < kPixelsPerThread; j += 2)
          sums[k][j] = sums[k][j + 1] = x + j < width ? load(k, row, (x + j) / 2) : F(0);
    } else {
      PixelWindow<F> const wy = window_at(F(y), p.y.size);
#pragma unroll 1
      for (int j = 0; j < kPixelsPerThread; ++j) {
        F sum[3] = {0, 0, 0};
        if (x + j < width) sum_windows(window_at(F(x + j), width), wy, p.x, p.y, load, sum);
#pragma unroll
        for (int i = 0; i < kPixelsPerThread; ++i)  // registers have no index
#pragma unroll
          for (int k = 0; k < 3; ++k)
            if (i == j) sums[k][i] = sum[k];
      }
    }
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      T* const to = p.rgb.row(3 * frame + k, y) + x;
      F color[kPixelsPerThread];
#pragma unroll
      for (int j = 0; j < kPixelsPerThread; ++j)
        color[j] = p.colors.channel(k, sums[0][j], sums[1][j], sums[2][j], F(1));
      if (vectorized) {
        store_vector(to, color);
      } else {
#pragma unroll
        for (int j = 0; j < kPixelsPerThread; ++j)
          if (x + j < width) to[j] = round_to<T>(color[j]);
      }
    }
  }
}

template <class S, class T>
__global__ void __launch_bounds__(kThreads) run_matrices(__grid_constant__ PlanesToRgb<T> const p) {
  using F = Compute<T>;
  __shared__ F inverse[9];
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32), y = int(blockIdx.y) * kWarps + threadIdx.x / 32;
  bool const is_pixel = x < p.rgb.width && y < p.rgb.height;
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    if (threadIdx.x == 0) {
      double exact[9];
      invert_up_to_factor(p.map + frame * p.map_stride, exact);
      for (int k = 0; k < 9; ++k) inverse[k] = F(exact[k]);
    }
    __syncthreads();
    if (is_pixel) {
      Preimage<F> const at(inverse, F(x), F(y));
      PixelWindow<F> const wx = window_at(at.x, p.x.size), wy = window_at(at.y, p.y.size);
      F sum[3];
      sum_windows(wx, wy, p.x, p.y, Reader<S, T>{p, frame}, sum);
      F const inside = wx.sum() * wy.sum();
#pragma unroll
      for (int k = 0; k < 3; ++k)
        p.rgb.row(3 * frame + k, y)[x] = round_to<T>(p.colors.channel(k, sum[0], sum[1], sum[2], inside));
    }
    __syncthreads();
  }
}

// What the windows of 32 columns or rows take of a plane: entries [first, first + count) with weights that add up to 1.
template <class F, int N>
struct TileWeights {
  int first[kTile], count[kTile];
  F weights[N][kTile];

  // False if a window is larger than N.
  template <class Weight>
  __device__ __forceinline__ bool set(int i, int begin, int end, Weight weight) {
    first[i] = begin;
    count[i] = end - begin;
    if (end - begin > N) return false;
    for (int j = begin; j < end; ++j) weights[j - begin][i] = weight(j);
    return true;
  }
};

template <class F>
struct TileAxis {
  TileWeights<F, kLargestWindow> luma;
  TileWeights<F, kLargestChromaWindow> chroma;

  __device__ __forceinline__ bool set(int i, PixelWindow<F> const& w, FrameAxis const& axis, bool of_chroma) {
    F const factor = F(1) / w.sum();
    if (of_chroma)
      return chroma.set(i, w.first_chroma(axis), w.last_chroma(axis),
                        [&](int c) { return w.chroma_weight(axis, c) * factor; });
    return luma.set(i, w.first, w.last, [&](int j) { return w.weight(j) * factor; });
  }
};

// The weights of a column's window, in registers. Entries behind its end have none, and are its last entry again.
template <class F, int N>
struct ColumnWeights {
  F weights[N];
  int offsets[N];  // in elements, from the row

  template <int M>
  __device__ __forceinline__ ColumnWeights(TileWeights<F, M> const& tile, int column, int64_t stride) {
    int const first = tile.first[column], count = tile.count[column];
#pragma unroll
    for (int c = 0; c < N; ++c) {
      weights[c] = c < count ? tile.weights[c][column] : F(0);
      offsets[c] = (first + min(c, count - 1)) * int(stride);
    }
  }
};

// Sums of a plane over the windows of a column and of rows.
template <class S, class T, int N>
struct Column {
  using F = Compute<T>;
  S const* codes;
  int64_t row_stride;
  ColumnWeights<F, N> taps;

  template <int M>
  __device__ __forceinline__ Column(CodePlane const& plane, int64_t frame, TileWeights<F, M> const& tile, int column)
      : codes(plane.row<S>(frame, 0)), row_stride(plane.row_stride), taps(tile, column, plane.column_stride) {}
  template <int M>
  __device__ __forceinline__ F sum(TileWeights<F, M> const& rows, int row) const {
    S const* from = codes + rows.first[row] * row_stride;
    F sum = 0;
    int const count = rows.count[row];
    for (int r = 0; r < count; ++r, from += row_stride) {
      F in_row = 0;
#pragma unroll
      for (int c = 0; c < N; ++c) in_row += taps.weights[c] * F(number_of(from[taps.offsets[c]]));
      sum += rows.weights[r][row] * in_row;
    }
    return sum;
  }
};

// The same of both planes of chroma, which are pairs of bytes in memory.
template <class T, int N>
struct PairColumn {
  using F = Compute<T>;
  uint8_t const* codes;  // the first bytes of pairs
  int64_t row_stride;
  bool swapped;
  ColumnWeights<F, N> taps;

  template <int M>
  __device__ __forceinline__ PairColumn(CodePlane const* planes, int64_t frame, TileWeights<F, M> const& tile,
                                        int column)
      : codes((planes[0].data < planes[1].data ? planes[0] : planes[1]).row<uint8_t>(frame, 0)),
        row_stride(planes[0].row_stride),
        swapped(planes[1].data < planes[0].data),
        taps(tile, column, 2) {}
  template <int M>
  __device__ __forceinline__ void sum(TileWeights<F, M> const& rows, int row, F* sums) const {
    uint8_t const* from = codes + rows.first[row] * row_stride;
    F first = 0, second = 0;
    int const count = rows.count[row];
    for (int r = 0; r < count; ++r, from += row_stride) {
      F a = 0, b = 0;
#pragma unroll
      for (int c = 0; c < N; ++c) {
        uint32_t const pair = *reinterpret_cast<uint16_t const*>(from + taps.offsets[c]);
        a += taps.weights[c] * F(number_of(uint8_t(pair & 255)));
        b += taps.weights[c] * F(number_of(uint8_t(pair >> 8)));
      }
      F const weight = rows.weights[r][row];
      first += weight * a;
      second += weight * b;
    }
    sums[0] = swapped ? second : first;
    sums[1] = swapped ? first : second;
  }
};

// The sums of one or two planes over the windows of a column and a row of the tile.
template <class S, int N, int Count, class F>
__device__ __forceinline__ void sum_planes(CodePlane const* planes, int64_t frame, TileWeights<F, N> const& columns,
                                           TileWeights<F, N> const& rows, int column, int row, F* sums) {
  int const width = columns.count[column], height = rows.count[row];
  int const first_row = rows.first[row], first_column = columns.first[column];
  S const* from[Count];
#pragma unroll
  for (int k = 0; k < Count; ++k) {
    from[k] = planes[k].row<S>(frame, first_row) + first_column * planes[k].column_stride;
    sums[k] = 0;
  }
  for (int r = 0; r < height; ++r) {
    F in_row[Count] = {};
#pragma unroll 4
    for (int c = 0; c < width; ++c) {
      F const weight = columns.weights[c][column];
#pragma unroll
      for (int k = 0; k < Count; ++k) in_row[k] += weight * F(number_of(from[k][c * int(planes[k].column_stride)]));
    }
    F const weight = rows.weights[r][row];
#pragma unroll
    for (int k = 0; k < Count; ++k) {
      sums[k] += weight * in_row[k];
      from[k] += planes[k].row_stride;
    }
  }
}

// The rows of a block's tile, whose windows have at most N columns of luma and M of chroma.
template <class S, class T, int N, int M>
__device__ __forceinline__ void run_tile(PlanesToRgb<T> const& p, TileAxis<Compute<T>> const& columns,
                                         TileAxis<Compute<T>> const& rows, int64_t frame, int x, int y0, bool paired) {
  using F = Compute<T>;
  int const lane = threadIdx.x % 32, height = min(kTile, int(p.rgb.height) - y0);
  Column<S, T, N> const luma(p.planes[0], frame, columns.luma, lane);
  auto const each_row = [&](auto chroma) {
    for (int i = threadIdx.x / 32; i < height; i += kWarps) {
      F sums[3] = {luma.sum(rows.luma, i)};
      chroma(i, sums + 1);
#pragma unroll
      for (int k = 0; k < 3; ++k)
        p.rgb.row(3 * frame + k, y0 + i)[x] = round_to<T>(p.colors.channel(k, sums[0], sums[1], sums[2], F(1)));
    }
  };
  if constexpr (sizeof(S) == 1)
    if (paired) {
      PairColumn<T, M> const chroma(p.planes + 1, frame, columns.chroma, lane);
      return each_row([&](int i, F* sums) { chroma.sum(rows.chroma, i, sums); });
    }
  Column<S, T, M> const u(p.planes[1], frame, columns.chroma, lane), v(p.planes[2], frame, columns.chroma, lane);
  each_row([&](int i, F* sums) {
    sums[0] = u.sum(rows.chroma, i);
    sums[1] = v.sum(rows.chroma, i);
  });
}

template <class S, class T>
__global__ void __launch_bounds__(kThreads, 3) run_boxes(__grid_constant__ PlanesToRgb<T> const p, bool paired) {
  using F = Compute<T>;
  __shared__ TileAxis<F> columns, rows;
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  int const x0 = int(blockIdx.x) * kTile, y0 = int(blockIdx.y) * kTile, x = x0 + lane;
  int const width = int(p.rgb.width), height = int(p.rgb.height);
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    BoxAxis<F> const box_x = p.box_axis(frame, false), box_y = p.box_axis(frame, true);
    bool fits = true;
    if (warp < 2)
      fits = columns.set(lane, box_x.window(min(x, width - 1)), p.x, warp == 1);
    else if (warp < 4)
      fits = rows.set(lane, box_y.window(min(y0 + lane, height - 1)), p.y, warp == 3);
    fits = __syncthreads_and(fits);
    if constexpr (__is_same(S, uint8_t) || __is_same(S, uint16_t)) {  // codes that are finite
      bool const is_small = warp == 0   ? columns.luma.count[lane] <= 2
                            : warp == 1 ? columns.chroma.count[lane] <= 2
                                        : true;
      bool const is_middle = warp == 0   ? columns.luma.count[lane] <= 4
                             : warp == 1 ? columns.chroma.count[lane] <= 3
                                         : true;
      if (fits && __syncthreads_and(is_middle)) {
        if (__syncthreads_and(is_small)) {
          if (x < width) run_tile<S, T, 2, 2>(p, columns, rows, frame, x, y0, paired);
        } else {
          if (x < width) run_tile<S, T, 4, 3>(p, columns, rows, frame, x, y0, paired);
        }
        __syncthreads();
        continue;
      }
    }
    if (x < width)
      for (int i = warp; i < kTile && y0 + i < height; i += kWarps) {
        F sums[3];
        if (fits) {
          sum_planes<S, kLargestWindow, 1>(p.planes, frame, columns.luma, rows.luma, lane, i, sums);
          sum_planes<S, kLargestChromaWindow, 2>(p.planes + 1, frame, columns.chroma, rows.chroma, lane, i, sums + 1);
        } else {
          PixelWindow<F> const wx = box_x.window(x), wy = box_y.window(y0 + i);
          sum_windows(wx, wy, p.x, p.y, Reader<S, T>{p, frame}, sums);
          F const factor = F(1) / (wx.sum() * wy.sum());
#pragma unroll
          for (int k = 0; k < 3; ++k) sums[k] *= factor;
        }
#pragma unroll
        for (int k = 0; k < 3; ++k)
          p.rgb.row(3 * frame + k, y0 + i)[x] = round_to<T>(p.colors.channel(k, sums[0], sums[1], sums[2], F(1)));
      }
    __syncthreads();
  }
}

// Whether chroma is pairs of adjacent bytes that are read at once.
template <class T>
bool are_pairs(PlanesToRgb<T> const& p) {
  CodePlane const &u = p.planes[1], &v = p.planes[2];
  auto const a = reinterpret_cast<uintptr_t>(u.data), b = reinterpret_cast<uintptr_t>(v.data);
  bool const is_even = (min(a, b) | uintptr_t(u.row_stride) | uintptr_t(u.frame_stride)) % 2 == 0;
  return p.code_bytes == 1 && max(a, b) - min(a, b) == 1 && u.column_stride == 2 && v.column_stride == 2 && is_even &&
         u.row_stride == v.row_stride && u.frame_stride == v.frame_stride;
}

template <class S, class T>
int run(PlanesToRgb<T> const& p, CUstream_st* stream) {
  unsigned const frames = unsigned(min(p.rgb.count() / 3, int64_t(65535)));
  auto const blocks = [&](int width, int height) {
    return dim3(unsigned(ceil_div(p.rgb.width, width)), unsigned(ceil_div(p.rgb.height, height)), frames);
  };
  if (p.kind == FrameMap::whole) {
    bool const vectorized = p.rgb.width % kPixelsPerThread == 0;  // the result is dense
    run_whole<S, T><<<blocks(32 * kPixelsPerThread, kWarps), kThreads, 0, stream>>>(p, vectorized);
  } else if (p.kind == FrameMap::boxes) {
    run_boxes<S, T><<<blocks(kTile, kTile), kThreads, 0, stream>>>(p, are_pairs(p));
  } else {
    run_matrices<S, T><<<blocks(32, kWarps), kThreads, 0, stream>>>(p);
  }
  return cudaGetLastError();
}

}  // namespace

template <class T>
int planes_to_rgb(PlanesToRgb<T> const& p, CUstream_st* stream) {
  if (p.code_bytes == 1) return run<uint8_t>(p, stream);
  if (p.code_bytes == 2) return run<uint16_t>(p, stream);
  if constexpr (!__is_same(T, uint8_t))
    return run<T>(p, stream);
  else
    return cudaErrorInvalidValue;  // which the entry has refused
}

KV_INSTANTIATE_WITH_BYTES(planes_to_rgb, PlanesToRgb)

}  // namespace kv::color::cuda
