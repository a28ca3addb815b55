// Frames of video on CUDA, in one launch: each code is read from device memory once, by the caches.
//
// whole     a thread takes four adjacent pixels of a row; where chroma is interpolated, the frame is a box.
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

// N codes with a stride, of which the first `count` exist. `words`: they are one aligned word.
template <int N, class S, class F>
__device__ __forceinline__ void load_codes(S const* from, int stride, bool words, int count, F* to) {
  if constexpr (sizeof(S) == 1)
    if (words) {
      auto const codes = *reinterpret_cast<Vector<S, N> const*>(from);
#pragma unroll
      for (int j = 0; j < N; ++j) to[j] = F(number_of(codes.v[j]));
      return;
    }
#pragma unroll
  for (int j = 0; j < N; ++j) to[j] = j < count ? F(number_of(from[j * stride])) : F(0);
}

// Which accesses of run_whole are vectors.
struct WholeVectors {
  bool rgb, luma, pairs;
};

template <class S, class T>
__global__ void __launch_bounds__(kThreads)
    run_whole(__grid_constant__ PlanesToRgb<T> const p, WholeVectors const vectors) {
  using F = Compute<T>;
  constexpr int N = kPixelsPerThread;
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32) * N, width = p.x.size;
  int const y = int(blockIdx.y) * kWarps + threadIdx.x / 32;
  if (x >= width || y >= p.y.size) return;
  bool const is_halved = p.x.is_halved();
  int const row = p.y.is_halved() ? y / 2 : y, column = is_halved ? x / 2 : x, num_pixels = min(width - x, N);
  int const num_chroma = is_halved ? (num_pixels + 1) / 2 : num_pixels;
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    F luma[N], chroma[2][N];
    int const step = int(p.planes[0].column_stride);
    load_codes<N>(p.planes[0].template row<S>(frame, y) + x * step, step, vectors.luma, num_pixels, luma);
    if (vectors.pairs) {  // u v u v, or v u v u
      bool const swapped = p.planes[2].data < p.planes[1].data;
      F codes[N];
      load_codes<N>(p.planes[swapped ? 2 : 1].template row<S>(frame, row) + 2 * column, 1, true, N, codes);
#pragma unroll
      for (int j = 0; j < N; ++j) {
        chroma[0][j] = swapped ? codes[j / 2 * 2 + 1] : codes[j / 2 * 2];
        chroma[1][j] = swapped ? codes[j / 2 * 2] : codes[j / 2 * 2 + 1];
      }
    } else {
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        CodePlane const& plane = p.planes[1 + k];
        int const stride = int(plane.column_stride);
        S const* const from = plane.template row<S>(frame, row) + column * stride;
        if (is_halved) {
          F codes[N / 2];
          load_codes<N / 2>(from, stride, false, num_chroma, codes);
#pragma unroll
          for (int j = 0; j < N; ++j) chroma[k][j] = codes[j / 2];
        } else {
          load_codes<N>(from, stride, false, num_chroma, chroma[k]);
        }
      }
    }
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      T* const to = p.rgb.row(3 * frame + k, y) + x;
      F color[N];
#pragma unroll
      for (int j = 0; j < N; ++j) color[j] = p.colors.channel(k, luma[j], chroma[0][j], chroma[1][j], F(1));
      if (vectors.rgb) {
        store_vector(to, color);
      } else {
#pragma unroll
        for (int j = 0; j < N; ++j)
          if (j < num_pixels) to[j] = round_to<T>(color[j]);
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
// Small windows are read up to four entries.
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
    for (int j = 0; j < N && (j < 4 || j < end - begin); ++j)
      weights[j][i] = begin + j < end ? weight(begin + j) : F(0);
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

// A small window in registers: up to N entries. Those behind its end have no weight, and are its last entry again.
template <class F, int N>
struct Taps {
  F weights[N];
  int offsets[N];

  template <int M>
  __device__ __forceinline__ Taps(TileWeights<F, M> const& tile, int i, int stride) {
    int const first = tile.first[i], count = tile.count[i];
#pragma unroll
    for (int j = 0; j < N; ++j) {
      weights[j] = tile.weights[j][i];
      offsets[j] = (first + min(j, count - 1)) * stride;
    }
  }
};

// The sums of a plane over small windows. All codes are requested before the first one is used.
template <class S, class F, int N>
__device__ __forceinline__ F sum_small(S const* codes, int64_t row_stride, Taps<F, N> const& columns,
                                       Taps<F, N> const& rows) {
  S loaded[N][N];
#pragma unroll
  for (int r = 0; r < N; ++r) {
    S const* const from = codes + rows.offsets[r] * row_stride;
#pragma unroll
    for (int c = 0; c < N; ++c) loaded[r][c] = from[columns.offsets[c]];
  }
  F sum = 0;
#pragma unroll
  for (int r = 0; r < N; ++r) {
    F in_row = 0;
#pragma unroll
    for (int c = 0; c < N; ++c) in_row += columns.weights[c] * F(number_of(loaded[r][c]));
    sum += rows.weights[r] * in_row;
  }
  return sum;
}
// Of both planes of chroma, which are pairs of bytes.
template <class F, int N>
__device__ __forceinline__ void sum_small_pairs(uint8_t const* codes, int64_t row_stride, Taps<F, N> const& columns,
                                                Taps<F, N> const& rows, F& first, F& second) {
  uint32_t loaded[N][N];
#pragma unroll
  for (int r = 0; r < N; ++r) {
    uint8_t const* const from = codes + rows.offsets[r] * row_stride;
#pragma unroll
    for (int c = 0; c < N; ++c) loaded[r][c] = *reinterpret_cast<uint16_t const*>(from + columns.offsets[c]);
  }
  first = second = 0;
#pragma unroll
  for (int r = 0; r < N; ++r) {
    F a = 0, b = 0;
#pragma unroll
    for (int c = 0; c < N; ++c) {
      a += columns.weights[c] * F(number_of(uint8_t(loaded[r][c] & 255)));
      b += columns.weights[c] * F(number_of(uint8_t(loaded[r][c] >> 8)));
    }
    first += rows.weights[r] * a;
    second += rows.weights[r] * b;
  }
}

// The rows of a block's tile, whose windows have at most N x N pixels and M x M samples of chroma.
template <class S, class T, int N, int M>
__device__ __forceinline__ void run_tile(PlanesToRgb<T> const& p, TileAxis<Compute<T>> const& columns,
                                         TileAxis<Compute<T>> const& rows, int64_t frame, int x, int y0, bool pairs) {
  using F = Compute<T>;
  int const lane = threadIdx.x % 32, height = min(kTile, int(p.rgb.height) - y0);
  S const* codes[3];
#pragma unroll
  for (int k = 0; k < 3; ++k) codes[k] = p.planes[k].template row<S>(frame, 0);
  bool const swapped = codes[2] < codes[1];
  Taps<F, N> const luma(columns.luma, lane, int(p.planes[0].column_stride));
  Taps<F, M> const chroma(columns.chroma, lane, int(p.planes[1].column_stride));
  T* to = p.rgb.row(3 * frame, y0) + x;
  int64_t const plane_size = p.rgb.plane(1) - p.rgb.plane(0);  // the result is dense
  auto const row = [&](int i) {
    Taps<F, N> const luma_rows(rows.luma, i, 1);
    Taps<F, M> const chroma_rows(rows.chroma, i, 1);
    F u, v;
    F const y = sum_small(codes[0], p.planes[0].row_stride, luma, luma_rows);
    if constexpr (sizeof(S) == 1) {
      if (pairs) {
        sum_small_pairs(swapped ? codes[2] : codes[1], p.planes[1].row_stride, chroma, chroma_rows, u, v);
        if (swapped) {
          F const first = u;
          u = v;
          v = first;
        }
      }
    }
    if (sizeof(S) != 1 || !pairs) {
      u = sum_small(codes[1], p.planes[1].row_stride, chroma, chroma_rows);
      v = sum_small(codes[2], p.planes[2].row_stride, chroma, chroma_rows);
    }
    T* const at = to + i * p.rgb.row_stride;
#pragma unroll
    for (int k = 0; k < 3; ++k) at[k * plane_size] = round_to<T>(p.colors.channel(k, y, u, v, F(1)));
  };
  int const warp = threadIdx.x / 32;
  if (height == kTile) {
#pragma unroll
    for (int k = 0; k < kTile / kWarps; ++k) row(warp + k * kWarps);
  } else {
#pragma unroll 1
    for (int i = warp; i < height; i += kWarps) row(i);
  }
}

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

template <class S, class T>
__global__ void __launch_bounds__(kThreads, 3) run_boxes(__grid_constant__ PlanesToRgb<T> const p, bool pairs) {
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
      TileAxis<F> const& axis = warp < 2 ? columns : rows;
      int const num_luma = warp < 4 ? axis.luma.count[lane] : 0, num_chroma = warp < 4 ? axis.chroma.count[lane] : 0;
      bool const same_stride = p.planes[1].column_stride == p.planes[2].column_stride;
      if (fits && same_stride && __syncthreads_and(num_luma <= 4 && num_chroma <= 3)) {
        bool const is_small = __syncthreads_and(num_luma <= 2 && num_chroma <= 2);
        if (__syncthreads_and(num_luma <= 2 && num_chroma <= 1)) {
          if (x < width) run_tile<S, T, 2, 1>(p, columns, rows, frame, x, y0, pairs);
        } else if (is_small) {
          if (x < width) run_tile<S, T, 2, 2>(p, columns, rows, frame, x, y0, pairs);
        } else if (x < width) {
          run_tile<S, T, 4, 3>(p, columns, rows, frame, x, y0, pairs);
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
  bool const repeats = p.x.site == ChromaSite::nearest || !(p.x.is_halved() || p.y.is_halved());
  if (p.kind == FrameMap::whole && repeats) {
    constexpr int N = kPixelsPerThread;
    bool const whole = p.rgb.width % N == 0;  // the result is dense
    CodePlane const &y = p.planes[0], &u = p.planes[1], &v = p.planes[2];
    auto const first = min(reinterpret_cast<uintptr_t>(u.data), reinterpret_cast<uintptr_t>(v.data));
    auto const are_words = [](uintptr_t data, CodePlane const& x) {
      return (data | uintptr_t(x.row_stride) | uintptr_t(x.frame_stride)) % N == 0;
    };
    WholeVectors const vectors{
        whole, whole && p.code_bytes == 1 && y.column_stride == 1 && are_words(reinterpret_cast<uintptr_t>(y.data), y),
        whole && p.x.is_halved() && are_pairs(p) && are_words(first, u)};
    run_whole<S, T><<<blocks(32 * N, kWarps), kThreads, 0, stream>>>(p, vectors);
  } else if (p.kind != FrameMap::matrices) {
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
