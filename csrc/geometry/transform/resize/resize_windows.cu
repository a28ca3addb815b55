// Antialiased resizing of windows on CUDA, and its gradient. A block has a tile of the output of one sample. Backward,
// the output is the gradient of the image; it is 0 outside of the window.
//
//   weights   The block computes those of its columns and of its rows once.
//   down      Each row of the tile is the weighted sum of a few rows of the input: a line in shared memory.
//   across    Each pixel is the weighted sum of a few pixels of its line. A thread keeps the weights of a column in
//             registers, and goes through the lines.
//
// A mirrored window has the same weights in reverse order: positions in the tile are mirrored, nothing else is.
#include "core/launch.cuh"
#include "geometry/transform/resize/contributors.cuh"
#include "geometry/transform/resize/resize_windows.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;
constexpr int kMaxColumns = 256, kMinColumns = 64, kMaxPlanes = 4;  // of a tile; columns count elements
constexpr int kMaxLines = 16, kMaxRounds = 4;                       // rows at a time, and how many times
constexpr int kBlocks = 4;                                          // on a multiprocessor at once
constexpr int64_t kShared = 54 << 10;                               // of each

// How the output is divided among blocks, and the capacities of their shared memory in numbers.
struct WindowTiles {
  unsigned across, down, groups;  // tiles of columns and of rows, groups of planes
  int columns, rows, planes;      // of a tile; columns in pixels
  int lines;                      // rows at a time
  int span;                       // of a line
  int weights_x, weights_y;       // all of them
  int64_t bytes;
};

// One axis of a sample's window.
struct WindowAxis {
  ResizeAxis axis;
  Window window;

  // Where the axis begins in the input and in the output, and its length there.
  __device__ int in_first() const { return axis.backward ? 0 : window.first; }
  __device__ int out_first() const { return axis.backward ? window.first : 0; }
  __device__ int out_size() const { return axis.backward ? axis.source : axis.result; }
  // Positions of the output, and indices along the axis.
  __device__ int index_of(int position) const {
    int const i = position - out_first();
    return window.mirrored ? out_size() - 1 - i : i;
  }
  __device__ int in_size() const { return axis.backward ? axis.result : axis.source; }
  __device__ Contributors<float> contributors(int index) const {
    if (!axis.backward) {
      Band<float> const band = window_band<float>(axis, index);
      return {band.first, band.last - band.first + 1, 1};
    }
    if (axis.num == 0) return {0, axis.result, 1};  // all read the only pixel
    return window_holders<float>(axis, index);
  }
  // The first of as many pixels as any index reads, which are all within the input.
  __device__ int first_tap(Contributors<float> const& reads) const {
    return clamp(reads.first, 0, in_size() - axis.max_taps);
  }
};

// The weight of source pixel j in pixel i of the result, before it is divided by their sum.
__device__ __noinline__ float call_weight(ResizeAxis const& axis, int i, int j) {
  return window_at<float>(axis, j * axis.den - axis.center(i));
}
__device__ __forceinline__ float weight_of(ResizeAxis const& axis, int i, int j) {
  if (axis.filter != ResizeFilter::bilinear) return call_weight(axis, i, j);
  return __saturatef(1 - fabsf(float(double(j * axis.den - axis.center(i)) * axis.per_unit)));
}

// The part of an axis that a tile covers.
struct TileAxis {
  int begin, end;    // positions of the output within the window
  int low, count;    // indices of the axis
  int from, length;  // the pixels of the axis that they read
  int taps;

  __device__ __forceinline__ void init(WindowAxis const& a, int first, int last) {
    begin = max(first, a.out_first());
    end = min(last, a.out_first() + a.out_size());
    count = max(end - begin, 0);
    low = from = length = 0;
    taps = a.axis.max_taps;
    if (count == 0) return;
    low = min(a.index_of(begin), a.index_of(end - 1));
    from = a.first_tap(a.contributors(low));
    length = a.first_tap(a.contributors(low + count - 1)) + taps - from;
  }
  __device__ __forceinline__ bool covers(int position) const { return position >= begin && position < end; }
};

// The weights of a part of an axis, and where they begin in the input of the tile.
struct Weights {
  float* weights;  // weight k of index i at [k * stride + i * step]
  int stride, step;
  int* first;
  float* norms;  // backward: of the pixels that are read

  __device__ __forceinline__ void write_norms(WindowAxis const& a, TileAxis const& tile, int thread) const {
    for (int t = thread; t < tile.length; t += kThreads) {
      int const i = tile.from + t;
      Band<float> const band = window_band<float>(a.axis, i);
      float sum = 0;
#pragma unroll 1
      for (int j = band.first; j <= band.last; ++j) sum += weight_of(a.axis, i, j);
      norms[t] = 1 / sum;
    }
  }
  // `norms` are complete.
  __device__ __forceinline__ void write(WindowAxis const& a, TileAxis const& tile, int thread) const {
    int const threads = a.axis.backward && tile.taps > 8 ? 8 : 1;  // of an index
#pragma unroll 1
    for (int t = thread; t < tile.count * threads; t += kThreads) {
      int const local = t / threads, index = tile.low + local;
      Contributors<float> const reads = a.contributors(index);
      int const begin = a.first_tap(reads), end = reads.first + reads.count;
      float* const to = weights + local * step;
      float sum = 0;
#pragma unroll 1
      for (int k = t % threads; k < tile.taps; k += threads) {
        int const at = begin + k;
        float weight = 0;
        if (at >= reads.first && at < end)
          weight =
              a.axis.backward ? weight_of(a.axis, at, index) * norms[at - tile.from] : weight_of(a.axis, index, at);
        to[k * stride] = weight;
        sum += weight;
      }
      if (!a.axis.backward) {
        float const norm = 1 / sum;
#pragma unroll 1
        for (int k = 0; k < tile.taps; ++k) to[k * stride] *= norm;
      }
      first[local] = begin - tile.from;
    }
  }
};

// A sum that is not finite, of `taps` rows and columns: a tap of weight 0 contributes nothing, even if it is inf or
// NaN.
template <class T>
__device__ __noinline__ float sum_of_taps(T const* from, int row_stride, int step, float const* weights_y, int taps_y,
                                          float const* weights_x, int stride_x, int taps_x) {
  float sum = 0;
#pragma unroll 1
  for (int l = 0; l < taps_y; ++l)
#pragma unroll 1
    for (int k = 0; k < taps_x; ++k) {
      float const weight = weights_y[l] * weights_x[k * stride_x];
      if (weight != 0) sum += weight * float(read(from[int64_t(l) * row_stride + k * step]));
    }
  return sum;
}

// Four elements of a row: adjacent ones or, where rows are no whole vectors, every `apart`-th.
template <bool Vectors, class T>
__device__ __forceinline__ void load_four(T const* from, int apart, int existing, float (&v)[4]) {
  if constexpr (Vectors) {
    Vector<T, 4> const vector = *reinterpret_cast<Vector<T, 4> const*>(from);
#pragma unroll
    for (int i = 0; i < 4; ++i) v[i] = read(vector.v[i]);
  } else {
#pragma unroll
    for (int i = 0; i < 4; ++i) v[i] = i < existing ? read(from[i * apart]) : 0.f;
  }
}

template <class T, bool Vectors>
__global__ void __launch_bounds__(kThreads, kBlocks)
    resize_window_tiles(__grid_constant__ ResizeWindows<T> const p, WindowTiles const tiles) {
  __shared__ __align__(16) unsigned char axes_memory[2 * sizeof(WindowAxis)];
  __shared__ TileAxis tile_axes[2];
  extern __shared__ __align__(16) float memory[];
  WindowAxis* const axes = reinterpret_cast<WindowAxis*>(axes_memory);
  WindowAxis const &across = axes[0], &down = axes[1];

  unsigned rest = blockIdx.x;
  int const tile_x = int(rest % tiles.across) * tiles.columns;
  rest /= tiles.across;
  int const tile_y = int(rest % tiles.down) * tiles.rows;
  rest /= tiles.down;
  int const first_plane = int(rest % tiles.groups) * tiles.planes;
  int64_t const sample = rest / tiles.groups, plane0 = sample * p.planes + first_plane;
  int const planes = min(tiles.planes, int(p.planes) - first_plane);
  int const end_x = min(tile_x + tiles.columns, int(p.y.width)), end_y = min(tile_y + tiles.rows, int(p.y.height));
  int const elements = (end_x - tile_x) * int(p.y.step);  // of a row of the tile

  if (threadIdx.x % 32 == 0 && threadIdx.x < 64) {
    int const i = int(threadIdx.x / 32);
    Window const window = p.window(sample, i);
    axes[i] = {p.resize_axis(window, i), window};
    tile_axes[i].init(axes[i], i ? tile_y : tile_x, i ? end_y : end_x);
  }
  __syncthreads();
  TileAxis const columns = tile_axes[0], rows = tile_axes[1];

  bool const is_empty = columns.count == 0 || rows.count == 0;
  if (!is_empty) {
    float* const lines = memory;
    float* const weights_y = lines + tiles.planes * tiles.lines * tiles.span;
    float* const weights_x = weights_y + tiles.weights_y;
    int* const first_x = reinterpret_cast<int*>(weights_x + tiles.weights_x);
    int* const first_y = first_x + tiles.columns;
    float* const norms = reinterpret_cast<float*>(first_y + tiles.rows);
    Weights const of_columns{weights_x, columns.count, 1, first_x, norms};
    Weights const of_rows{weights_y, 1, rows.taps, first_y, norms + columns.length};
    int const from_last = kThreads - 1 - int(threadIdx.x);  // the last threads begin with the rows
    if (p.backward) {
      of_columns.write_norms(across, columns, int(threadIdx.x));
      of_rows.write_norms(down, rows, from_last);
      __syncthreads();
    }
    of_columns.write(across, columns, int(threadIdx.x));
    of_rows.write(down, rows, from_last);

    // Lines begin with the vector that holds the first element that is read.
    int const first_row = down.in_first() + rows.from, row_stride = int(p.x.row_stride);
    int const first_element = (across.in_first() + columns.from) * int(p.x.step);
    int const begin = Vectors ? first_element & -4 : first_element, offset = first_element - begin;
    int const length = offset + columns.length * int(p.x.step), fours = (length + 3) / 4;
    // Threads beside each other, and where a thread is among them; more such groups take other rows.
    int const width = min(fours, kThreads), groups = kThreads / width, group = int(threadIdx.x) / width;
    int const out_width = min(elements, kThreads), out_groups = kThreads / out_width,
              out_group = int(threadIdx.x) / out_width;

    // The lines of rows [top, top + count). Taps: how many there are, 0 for any number.
    auto const sum_rows = [&](int top, int count, auto most) {
      constexpr int K = decltype(most)::value;
      for (int four = int(threadIdx.x) - group * width; four < fours; four += width) {
        int const at = Vectors ? 4 * four : four, existing = Vectors ? 4 : (length - four + fours - 1) / fours;
        for (int k = 0; k < planes; ++k) {
          T const* const source = p.x.plane(plane0 + k) + int64_t(first_row) * row_stride + begin + at;
          float* line = lines + (k * tiles.lines + group) * tiles.span + at;
#pragma unroll 2
          for (int r = top + group; r < top + count; r += groups, line += groups * tiles.span) {
            float const* const weights = weights_y + r * rows.taps;
            T const* from = source + int64_t(first_y[r]) * row_stride;
            float sum[4]{};
            if constexpr (K > 0) {
              float v[K][4];
#pragma unroll
              for (int n = 0; n < K; ++n) load_four<Vectors>(from + int64_t(n) * row_stride, fours, existing, v[n]);
              Vector<float, K == 3 ? 4 : K> own;  // 3 are no vector
              if constexpr (K == 3)
                own = {weights[0], weights[1], weights[2]};
              else
                own = *reinterpret_cast<Vector<float, K> const*>(weights);
#pragma unroll
              for (int n = 0; n < K; ++n)
#pragma unroll
                for (int i = 0; i < 4; ++i) sum[i] += own.v[n] * v[n][i];
            } else {
#pragma unroll 4
              for (int n = 0; n < rows.taps; ++n, from += row_stride) {
                float const weight = weights[n];
                float v[4];
                load_four<Vectors>(from, fours, existing, v);
#pragma unroll
                for (int i = 0; i < 4; ++i) sum[i] += weight * v[i];
              }
            }
            if constexpr (Vectors) {
              *reinterpret_cast<Vector<float, 4>*>(line) = {sum[0], sum[1], sum[2], sum[3]};
            } else {
#pragma unroll
              for (int i = 0; i < 4; ++i)
                if (i < existing) line[i * fours] = sum[i];
            }
          }
        }
      }
    };

    // The pixels of these rows. A thread has a column.
    auto const sum_columns = [&](int top, int count, auto most, int step) {
      constexpr int K = decltype(most)::value;
      bool const backwards = down.window.mirrored;
      // The output from the line of row `top` on.
      int const y = backwards ? rows.end - 1 - top : rows.begin + top;
      int64_t const row_bytes = (backwards ? -p.y.row_stride : p.y.row_stride) * int64_t(sizeof(T));
      int64_t const to_stride = out_groups * row_bytes;
      int const line_stride = out_groups * tiles.span;
      for (int e = int(threadIdx.x) - out_group * out_width; e < elements; e += out_width) {
        int const pixel = step == 1 ? e : e / step, channel = e - pixel * step;
        if (!columns.covers(tile_x + pixel)) continue;
        int const local = across.index_of(tile_x + pixel) - columns.low;
        float const* const all_weights = weights_x + local;
        int const first = first_x[local] * step + channel;
        float weights[K > 0 ? K : 1];
#pragma unroll
        for (int n = 0; n < K; ++n) weights[n] = all_weights[n * columns.count];
#pragma unroll 1
        for (int k = 0; k < planes; ++k) {
          float const* line = lines + (k * tiles.lines + out_group) * tiles.span + offset + first;
          auto* to = reinterpret_cast<unsigned char*>(p.y.row(plane0 + k, y) + int64_t(tile_x) * step + e) +
                     out_group * row_bytes;
          int r = out_group;
          auto const write = [&](auto together) {
            constexpr int J = decltype(together)::value;
            float sums[J]{};
            float const* own = line;
#pragma unroll
            for (int j = 0; j < J; ++j, own += line_stride) {
              if constexpr (K > 0) {
#pragma unroll
                for (int n = 0; n < K; ++n) sums[j] += weights[n] * own[n * step];
              } else {
                for (int n = 0; n < columns.taps; ++n) sums[j] += all_weights[n * columns.count] * own[n * step];
              }
            }
            float poison = 0;
#pragma unroll
            for (int j = 0; j < J; ++j) poison += sums[j] * 0;
            if (poison != 0) {
              T const* const source = p.x.plane(plane0 + k) + int64_t(first_row) * row_stride + first_element + first;
#pragma unroll 1
              for (int j = 0; j < J; ++j) {
                int const row = top + r + j * out_groups;
                float const sum =
                    sum_of_taps(source + int64_t(first_y[row]) * row_stride, row_stride, step,
                                weights_y + row * rows.taps, rows.taps, all_weights, columns.count, columns.taps);
#pragma unroll
                for (int i = 0; i < J; ++i)
                  if (i == j) sums[i] = sum;
              }
            }
#pragma unroll
            for (int j = 0; j < J; ++j, to += to_stride) *reinterpret_cast<T*>(to) = round_to<T>(sums[j]);
            r += J * out_groups;
            line = own;
          };
          while (r + 3 * out_groups < count) write(std::integral_constant<int, 4>{});
          while (r < count) write(std::integral_constant<int, 1>{});
        }
      }
    };
    auto const with_taps = [&](int taps, auto run) {
      if (taps == 2)
        run(std::integral_constant<int, 2>{});
      else if (taps == 3)
        run(std::integral_constant<int, 3>{});
      else if (taps == 4)
        run(std::integral_constant<int, 4>{});
      else
        run(std::integral_constant<int, 0>{});
    };
    for (int top = 0; top < rows.count; top += tiles.lines) {
      int const count = min(tiles.lines, rows.count - top);
      __syncthreads();
      if (group < groups) with_taps(rows.taps, [&](auto taps) { sum_rows(top, count, taps); });
      __syncthreads();
      if (out_group < out_groups)
        with_taps(columns.taps, [&](auto taps) {
          p.x.step == 1 ? sum_columns(top, count, taps, 1) : sum_columns(top, count, taps, int(p.x.step));
        });
    }
  }
  if (!p.backward) return;

  // The pixels of the tile that are not in the window.
  if (!is_empty && columns.count == end_x - tile_x && rows.count == end_y - tile_y) return;
  for (int e = int(threadIdx.x); e < elements; e += kThreads) {
    bool const in_columns = !is_empty && columns.covers(tile_x + e / int(p.y.step));
    for (int k = 0; k < planes; ++k) {
      T* const out = p.y.plane(plane0 + k) + int64_t(tile_x) * p.y.step + e;
      for (int y = tile_y; y < end_y; ++y)
        if (!in_columns || !rows.covers(y)) out[y * p.y.row_stride] = T{};
    }
  }
}

// --- any types and sizes: one thread an element, the weights computed as they are needed -----------------------------

template <class T>
__global__ void resize_windows_any(__grid_constant__ ResizeWindows<T> const p) {
  using F = Compute<T>;
  int64_t const i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x, size = p.y.row_size(), step = p.x.step;
  if (i >= p.y.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.y.height, sample = plane / p.planes;
  int const position[] = {int(e / step), int(r - plane * p.y.height)};
  int index[2], from[2];
  Contributors<F> reads[2];
  bool inside = true;
  WindowAxis axes[] = {{p.resize_axis(p.window(sample, 0), 0), p.window(sample, 0)},
                       {p.resize_axis(p.window(sample, 1), 1), p.window(sample, 1)}};
#pragma unroll 1
  for (int a = 0; a < 2; ++a) {
    index[a] = axes[a].index_of(position[a]);
    inside = inside && index[a] >= 0 && index[a] < axes[a].out_size();
    if (!inside) break;
    reads[a] = find_contributors<F>(axes[a].axis, index[a]);
    from[a] = axes[a].in_first() + reads[a].first;
  }
  F sum = 0;
  if (inside) {
    T const* const source = p.x.row(plane, from[1]) + from[0] * step + e - position[0] * step;
    for (int l = 0; l < reads[0].count; ++l) {
      F const weight_x = find_weight(axes[0].axis, reads[0], index[0], l);
      F line = 0;
      for (int k = 0; k < reads[1].count && weight_x != 0; ++k) {
        F const weight = find_weight(axes[1].axis, reads[1], index[1], k);
        if (weight != 0) line += F(read(source[k * p.x.row_stride + l * step])) * weight;
      }
      if (weight_x != 0) sum += line * weight_x;
    }
  }
  p.y.row(plane, position[1])[e] = round_to<T>(sum);
}

// --- launches --------------------------------------------------------------------------------------------------------

// Tiles that serve windows of any size: the largest windows read most.
template <class T>
WindowTiles tiles_of(ResizeWindows<T> const& p, int64_t most) {
  int64_t const step = p.x.step, width = p.y.width, height = p.y.height, radius = filter_radius(p.filter);
  ResizeAxis const across(p.filter, p.source(0), p.result(0), p.align_corners, true, false);
  ResizeAxis const down(p.filter, p.source(1), p.result(1), p.align_corners, true, false);
  // The pixels that n adjacent ones of the output read, and their weights. Backward, s pixels of a window are read by
  // each of `result` ones, and by at most 2 radius result + s ones in all if s is larger than 2 radius.
  auto const pixels_read = [&](ResizeAxis const& a, int64_t n) {
    return p.backward ? int64_t(a.result) : min(ceil_div(n * a.num, a.den) + a.max_taps + 1, int64_t(a.source));
  };
  auto const weights = [&](ResizeAxis const& a, int64_t n) {
    return p.backward ? (2 * radius + 1) * max(int64_t(a.result), n) + n : n * a.max_taps;
  };
  auto const with = [&](int64_t columns, int64_t lines, int64_t rounds, int64_t planes) {
    int64_t const rows = lines * rounds;
    WindowTiles tiles{unsigned(ceil_div(width, columns)),
                      unsigned(ceil_div(height, rows)),
                      unsigned(ceil_div(p.planes, planes)),
                      int(columns),
                      int(rows),
                      int(planes),
                      int(lines),
                      int((pixels_read(across, columns) * step + 2 * 3) & -4),
                      int(weights(across, columns)),
                      int(weights(down, rows) + 3) & -4,
                      0};
    int64_t const norms = p.backward ? int64_t(across.result) + down.result : 0;
    tiles.bytes = 4 * (planes * lines * tiles.span + tiles.weights_x + tiles.weights_y + columns + rows + norms);
    return tiles;
  };
  auto const most_lines = [&](int64_t columns, int64_t planes) {
    int64_t lines = min(height, int64_t(kMaxLines));
    while (lines > 1 && with(columns, lines, kMaxRounds, planes).bytes > most) --lines;
    return lines;
  };
  int64_t columns = min(width, max(kMaxColumns / step, int64_t(1))), planes = min(p.planes, int64_t(kMaxPlanes));
  int64_t lines = most_lines(columns, planes);
  while (lines < min(height, int64_t(kMaxLines / 2)) && columns * step > kMinColumns) {
    columns = ceil_div(columns, 2);
    lines = most_lines(columns, planes);
  }
  while (planes > 1 && with(columns, lines, kMaxRounds, planes).bytes > most) --planes;
  // As equal as possible. More rounds share the weights, if there are enough blocks.
  columns = ceil_div(width, ceil_div(width, columns));
  lines = ceil_div(height, ceil_div(height, lines));
  WindowTiles const one = with(columns, lines, 1, planes);
  int64_t const blocks = p.x.count() / p.planes * one.groups * one.down * one.across;
  int64_t const rounds = clamp(blocks / (kBlocks * multiprocessors() * 3 / 2), int64_t(1), int64_t(kMaxRounds));
  return with(columns, lines, rounds, planes);
}

}  // namespace

template <class T>
int resize_windows(ResizeWindows<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    int64_t const most = max_shared_bytes(kShared);
    WindowTiles const tiles = tiles_of(p, most);
    if (tiles.bytes <= most && p.x.row_stride <= INT32_MAX) {
      bool const vectors = reinterpret_cast<uintptr_t>(p.x.data) % (4 * sizeof(T)) == 0 && p.x.row_stride % 4 == 0 &&
                           p.x.inner_stride % 4 == 0 && p.x.outer_stride % 4 == 0 && p.x.row_size() % 4 == 0;
      auto* const kernel = vectors ? resize_window_tiles<T, true> : resize_window_tiles<T, false>;
      if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(tiles.bytes)))
        return error;
      unsigned const blocks = unsigned(p.x.count() / p.planes) * tiles.groups * tiles.down * tiles.across;
      kernel<<<blocks, kThreads, unsigned(tiles.bytes), stream>>>(p, tiles);
      return cudaGetLastError();
    }
  }
  resize_windows_any<<<unsigned(ceil_div(p.y.rows() * p.y.row_size(), 256)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(resize_windows, ResizeWindows)

}  // namespace kv::geometry::cuda
