// Frames of video on CUDA, in one launch: each code is read from device memory once, by the caches.
//
// whole     a thread takes four adjacent pixels of a row; where chroma is interpolated, the frame is a box.
// boxes     of codes that are integers are bands (frame_bands.cuh). Of others a block takes 32 columns of 32 rows. What
//           these take of the planes, and with which weights, is in shared memory. Windows that are larger than that
//           are computed by each thread for itself.
// matrices  a thread takes a pixel.
#include "frame_bands.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kPixelsPerThread = 4, kThreads = 256, kTile = 32, kWarps = kThreads / 32;
constexpr int kLargestWindow = 20, kLargestChromaWindow = kLargestWindow / 2 + 2;

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
      for (int j = 0; j < N; ++j) color[j] = channel_of(p.colors, k, luma[j], chroma[0][j], chroma[1][j]);
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
      invert_up_to_factor(p.map + frame * p.map_stride, p.from_result, exact);
      for (int k = 0; k < 9; ++k) inverse[k] = F(exact[k]);
    }
    __syncthreads();
    if (is_pixel) {
      Preimage<F> const at(inverse, F(x), F(y));
      PixelWindow<F> const wx = p.window_at(at.x, p.x), wy = p.window_at(at.y, p.y);
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
    for (int j = 0; j < end - begin; ++j) weights[j][i] = weight(begin + j);
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
__global__ void __launch_bounds__(kThreads, 3) run_boxes(__grid_constant__ PlanesToRgb<T> const p) {
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
          p.rgb.row(3 * frame + k, y0 + i)[x] = round_to<T>(channel_of(p.colors, k, sums[0], sums[1], sums[2]));
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
    if constexpr (sizeof(Compute<T>) == 4 && (__is_same(S, uint8_t) || __is_same(S, uint16_t))) {
      BandPlan plan{};
      if (plan_bands(p, plan)) return launch_bands<S>(p, plan, stream);
    }
    run_boxes<S, T><<<blocks(kTile, kTile), kThreads, 0, stream>>>(p);
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
