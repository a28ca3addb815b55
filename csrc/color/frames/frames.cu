// Frames of video on CUDA, in one launch: each code is read from device memory once, by the caches.
//
// whole     of codes that are integers a thread takes eight adjacent columns of a row of chroma, and its rows of luma,
//           of others four adjacent pixels of a row; where chroma is interpolated, the frame is a box.
// boxes     of codes that are integers are bands (frame_bands.cuh), columns (frame_columns.cuh), or halves
//           (frame_halves.cuh). Of others a block takes 32 columns of 32 rows. What these take of the planes, and with
//           which weights, is in shared memory. Windows that are larger than that are computed by each thread for
//           itself.
// matrices  a thread takes a pixel.
#include "frame_bands.cuh"
#include "frame_columns.cuh"
#include "frame_halves.cuh"

namespace kv::color::cuda {
namespace {

constexpr int kRowsEach = 4;  // rows of chroma of a thread
constexpr int kPixelsPerThread = 4, kThreads = kRowThreads, kTile = 32, kWarps = kRowWarps;
constexpr int kLargestWindow = 20, kLargestChromaWindow = kLargestWindow / 2 + 2;

// Blocks at once on a multiprocessor: bytes to bytes take fewer registers, with four 1.05x.
template <class S, class T>
constexpr int kRowBlocks = sizeof(S) == 1 && sizeof(T) == 1 ? 4 : 3;

template <class S, class T, bool Plain>
__global__ void __launch_bounds__(kRowThreads, kRowBlocks<S, T>)
    run_rows(__grid_constant__ PlanesToRgb<T> const p, __grid_constant__ CodeRowsPlan const plan, bool rgb_vectors) {
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32) * kOwn, width = p.x.size, height = p.y.size;
  int const rows = p.y.is_halved() ? 2 : 1, first = (int(blockIdx.y) * kRowWarps + threadIdx.x / 32) * kRowsEach;
  int const last = min(first + kRowsEach, p.y.chroma_size);
  if (int(blockIdx.x) * 32 * kOwn >= width || first >= last) return;
  bool const is_inside = x < width;
  int64_t const plane = p.rgb.plane(1) - p.rgb.plane(0);  // the result is dense
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    CodeRows<S, Plain> const codes(p, plan, frame, is_inside ? x : 0);
    // A row of chroma and its rows of luma, one ahead.
    OwnCodes<S> chroma, luma[2];
    auto const fetch = [&](int c) {
      chroma = codes.fetch_chroma(c);
#pragma unroll
      for (int r = 0; r < 2; ++r) luma[r] = codes.fetch_luma(min(c * rows + min(r, rows - 1), height - 1));
    };
    fetch(first);
    T* to = p.rgb.row(3 * frame, first * rows) + x;
    for (int c = first; c < last; ++c, to += rows * p.rgb.row_stride) {
      float numbers[2][kOwn], of_chroma[kOwn];
#pragma unroll
      for (int j = 0; j < kOwn; ++j) {
        of_chroma[j] = chroma.number(j, plan.exponent);
#pragma unroll
        for (int r = 0; r < 2; ++r) numbers[r][j] = luma[r].number(j, plan.exponent);
      }
      if (c + 1 < last) fetch(c + 1);
#pragma unroll
      for (int k = 0; k < 3; ++k) {
        float const *const m = p.colors.matrix + 3 * k, offset = p.colors.offset[k] + p.colors.bias[k];
        float added[kOwn / 2];
#pragma unroll
        for (int i = 0; i < kOwn / 2; ++i) added[i] = of_chroma[2 * i] * m[1] + (of_chroma[2 * i + 1] * m[2] + offset);
#pragma unroll
        for (int r = 0; r < 2; ++r) {
          if (r >= rows || c * rows + r >= height) break;
          float color[kOwn];
#pragma unroll
          for (int j = 0; j < kOwn; ++j) color[j] = numbers[r][j] * m[0] + added[j / 2];
          T* const to_row = to + k * plane + r * p.rgb.row_stride;
          Vector<T, kOwn> const stored = within<T>(color, p.colors.lowest[k], p.colors.highest[k]);
          if (rgb_vectors) {
            if (is_inside) store_vector(to_row, stored);
          } else {
            Compute<T> exact[kOwn];
#pragma unroll
            for (int j = 0; j < kOwn; ++j) exact[j] = read(stored.v[j]);
            store_words(to_row, exact, x, width);
          }
        }
      }
    }
  }
}

template <class S, class T>
__global__ void __launch_bounds__(kThreads) run_whole(__grid_constant__ PlanesToRgb<T> const p) {
  using F = Compute<T>;
  constexpr int N = kPixelsPerThread;
  int const x = int(blockIdx.x * 32 + threadIdx.x % 32) * N, width = p.x.size;
  int const y = int(blockIdx.y) * kWarps + threadIdx.x / 32;
  if (x >= width || y >= p.y.size) return;
  int const row = p.y.is_halved() ? y / 2 : y, halving = p.x.is_halved() ? 1 : 0;
  bool const is_vector = width % N == 0;  // the result is dense
  for (int64_t frame = blockIdx.z; frame < p.rgb.count() / 3; frame += gridDim.z) {
    Reader<S, T> const code{p, frame};
    F codes[3][N];
#pragma unroll
    for (int j = 0; j < N; ++j) {
      int const column = min(x + j, width - 1);
      codes[0][j] = code(0, y, column);
#pragma unroll
      for (int k = 1; k < 3; ++k) codes[k][j] = code(k, row, column >> halving);
    }
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      T* const to = p.rgb.row(3 * frame + k, y) + x;
      F color[N];
#pragma unroll
      for (int j = 0; j < N; ++j) color[j] = channel_of(p.colors, k, codes[0][j], codes[1][j], codes[2][j]);
      if (is_vector) {
        store_vector(to, color);
      } else {
#pragma unroll
        for (int j = 0; j < N; ++j)
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
      invert_up_to_factor(p.map + frame * p.map_stride, p.is_affine, p.from_result, exact);
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

template <class S, class T>
int run(PlanesToRgb<T> p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 1)  // as rounding to bytes does
    for (int k = 0; k < 3; ++k) {
      p.colors.lowest[k] = max(p.colors.lowest[k], 0.f);
      p.colors.highest[k] = min(p.colors.highest[k], 255.f);
    }
  unsigned const frames = unsigned(min(p.rgb.count() / 3, int64_t(65535)));
  auto const blocks = [&](int64_t width, int64_t height, int columns, int rows) {
    return dim3(unsigned(ceil_div(width, columns)), unsigned(ceil_div(height, rows)), frames);
  };
  bool const repeats = p.x.site == ChromaSite::nearest || !(p.x.is_halved() || p.y.is_halved());
  bool const is_whole = p.kind == FrameMap::whole && repeats;
  if constexpr (sizeof(Compute<T>) == 4 && (__is_same(S, uint8_t) || __is_same(S, uint16_t))) {
    CodeRowsPlan codes{};
    if (p.kind != FrameMap::matrices && plan_rows(p, codes)) {
      if (is_whole) {
        auto* const kernel = codes.is_plain ? run_rows<S, T, true> : run_rows<S, T, false>;
        kernel<<<blocks(p.x.size, p.y.chroma_size, 32 * kOwn, kRowWarps * kRowsEach), kRowThreads, 0, stream>>>(
            p, codes, p.x.size % kOwn == 0);
        return cudaGetLastError();
      }
      if constexpr (sizeof(S) == 1)
        if (are_halves(p, codes)) return launch_halves(p, stream);
      if constexpr (sizeof(S) == 1 && sizeof(T) <= 2) {
        ColumnPlan plan{};
        if (plan_columns(p, codes, plan)) return launch_columns(p, plan, stream);
      }
      BandPlan plan{};
      if (plan_bands(p, codes, plan)) return launch_bands<S>(p, plan, stream);
    }
  }
  if (is_whole)
    run_whole<S, T><<<blocks(p.x.size, p.y.size, 32 * kPixelsPerThread, kWarps), kThreads, 0, stream>>>(p);
  else if (p.kind != FrameMap::matrices)
    run_boxes<S, T><<<blocks(p.rgb.width, p.rgb.height, kTile, kTile), kThreads, 0, stream>>>(p);
  else
    run_matrices<S, T><<<blocks(p.rgb.width, p.rgb.height, 32, kWarps), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int planes_to_rgb(PlanesToRgb<T> const& p, CUstream_st* stream) {
  return with_codes<T>(p.code_bytes, [&](auto code) { return run<typename decltype(code)::type>(p, stream); });
}

KV_INSTANTIATE_WITH_BYTES(planes_to_rgb, PlanesToRgb)

}  // namespace kv::color::cuda
