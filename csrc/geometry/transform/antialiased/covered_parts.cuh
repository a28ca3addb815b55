// Antialiased samples by a matrix on CUDA: the values of a tile of the output, in parts whose source pixels fit in
// shared memory, padding included.
//
// A pixel has 1, 2, 4 or 8 adjacent threads, one for every such column of taps, so that a thread has up to four
// columns, and a warp has pixels along that axis of the output along which columns change most: rows of shared memory
// are a multiple of all banks, and what a warp reads together lies in few columns that are the same.
#pragma once

#include "geometry/transform/antialiased/antialiased.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kChannelsTogether = 3;

// The capacity of source tiles.
struct PartTiles {
  static constexpr int kPitch = 64, kRows = 52;
  static constexpr int bytes(int channels) {
    return (channels >= kChannelsTogether ? kChannelsTogether : 1) * kPitch * kRows * int(sizeof(float));
  }
};

// What all parts of a tile have in common, in shared memory.
template <class F>
struct PartPlan {
  Footprint<F> footprint;  // of an affine map
  bool fits, varies, along_x;
  bool separable;              // and of more than bilinear taps, for which large parts are faster
  int log_columns, log_rows;   // of pixels
  int taps_x, taps_y, across;  // across: the logarithm of the threads of a pixel; taps_x is a multiple of these
  F reach_x, reach_y;
  F low_u, low_v, high_u, high_v;  // from a part's first pixel, of the windows' first columns and rows; of affine maps
  F middle_u, middle_v;            // of the part
  F back[4], limit_x, limit_y;     // pixels of the source that are farther away than the limits are not read

  // By a warp, for a tile of an output of that size whose source tile has so many columns and rows. Parts have up to
  // 2^log_side pixels along each axis where weights are separable, else 32.
  __device__ __forceinline__ void init(Tile<F> const& tile, int width, int height, int columns, int rows,
                                       int log_side) {
    F const x = F(threadIdx.x & 1 ? min(kTile, width - tile.x) - 1 : 0);
    F const y = F(threadIdx.x & 2 ? min(kTile, height - tile.y) - 1 : 0);
    F u, v;
    tile.map.apply(x, y, u, v);
    Jacobian<F> const by = jacobian(tile.map, x, y, u, v);
    footprint = geometry::footprint(by);
    unsigned const before = __ballot_sync(kAllLanes, tile.map.weight(x, y) > 0) & 15;
    bool const near = vabs(u) < F(kFarCoord) && vabs(v) < F(kFarCoord);
    struct Most {
      F reach_x, reach_y, ux, uy, vx, vy;
    };
    auto const most =
        warp_reduce<4>(Most{footprint.reach_x, footprint.reach_y, vabs(by.ux), vabs(by.uy), vabs(by.vx), vabs(by.vy)},
                       [](Most const& a, Most const& b) -> Most {
                         return {max(a.reach_x, b.reach_x), max(a.reach_y, b.reach_y), max(a.ux, b.ux),
                                 max(a.uy, b.uy),           max(a.vx, b.vx),           max(a.vy, b.vy)};
                       });
    varies = !tile.map.affine;
    along_x = most.ux >= most.uy;
    reach_x = most.reach_x;
    reach_y = most.reach_y;
    // Taps of a weight of a millionth are left out.
    constexpr F kLess = F(1 - 2e-6);
    fits = __all_sync(kAllLanes, near) && (before == 0 || before == 15) && reach_x < F(kMaxReach) &&
           reach_y < F(kMaxReach);
    taps_x = taps_y = across = 0;
    if (fits) {
      taps_x = -floor_to_int<F>(-2 * reach_x * kLess);
      taps_y = -floor_to_int<F>(-2 * reach_y * kLess);
    }
    separable = !varies && footprint.is_separable() && max(taps_x, taps_y) > 2;
    across = taps_x <= 4 ? 0 : taps_x <= 8 ? 1 : taps_x <= 16 ? 2 : 3;
    fits = fits && taps_x <= 32;
    taps_x = (taps_x <= 2 ? 2 : taps_x <= 3 << across ? 3 : 4) << across;
    log_columns = log_rows = separable ? log_side : 5;
    // Sides of less than a tile are of parts that a block samples at once.
    int const log_pixels = separable && log_side < 5 ? 2 * log_side - across : 10;
    while (fits) {
      F const across_x = F((1 << log_columns) - 1), across_y = F((1 << log_rows) - 1);
      if (log_columns + log_rows <= log_pixels &&
          most.ux * across_x + most.uy * across_y + F(taps_x + 6) <= F(columns) &&
          most.vx * across_x + most.vy * across_y + F(taps_y + 3) <= F(rows))
        break;
      fits = log_columns + log_rows > 4;
      if (log_columns >= log_rows)
        --log_columns;
      else
        --log_rows;
    }
    F const last_x = F((1 << log_columns) - 1), last_y = F((1 << log_rows) - 1);
    low_u = min(by.ux * last_x, F(0)) + min(by.uy * last_y, F(0)) - reach_x;
    low_v = min(by.vx * last_x, F(0)) + min(by.vy * last_y, F(0)) - reach_y;
    high_u = max(by.ux * last_x, F(0)) + max(by.uy * last_y, F(0)) - reach_x;
    high_v = max(by.vx * last_x, F(0)) + max(by.vy * last_y, F(0)) - reach_y;
    middle_u = (by.ux * last_x + by.uy * last_y) / 2;
    middle_v = (by.vx * last_x + by.vy * last_y) / 2;
    F const det = by.ux * by.vy - by.uy * by.vx;
    if (varies || !(vabs(det) > F(1e-3))) {
      back[0] = back[1] = back[2] = back[3] = limit_x = limit_y = 0;
      return;
    }
    back[0] = by.vy / det;
    back[1] = -by.uy / det;
    back[2] = -by.vx / det;
    back[3] = by.ux / det;
    F const to_x = max(reach_x, F(taps_x) - reach_x) + 2, to_y = max(reach_y, F(taps_y) - reach_y) + F(0.5);
    limit_x = last_x / 2 + vabs(back[0]) * to_x + vabs(back[1]) * to_y;
    limit_y = last_y / 2 + vabs(back[2]) * to_x + vabs(back[3]) * to_y;
  }
  // More threads for a pixel of parts of few pixels, where the source tile has room for their taps.
  __device__ __forceinline__ void use_all_threads(int columns) {
    int const most = min(8 - log_columns - log_rows, 3);
    if (across >= most) return;
    int const threads = 1 << most, taps = max((taps_x + threads - 1) >> most, 2) << most;
    if (high_u - low_u + F(taps + 6) > F(columns)) return;
    F const more = F(max(taps - taps_x, 0));
    limit_x += vabs(back[0]) * more;
    limit_y += vabs(back[2]) * more;
    taps_x = taps;
    across = most;
  }
};

// Whether rows of images begin with vectors of four pixels.
template <class T>
KV_HD bool rows_are_fours(Images<T> const& x) {
  return reinterpret_cast<uintptr_t>(x.data) % (4 * sizeof(T)) == 0 && x.step == 1 &&
         (x.row_stride | x.channel_stride | x.batch_stride) % 4 == 0;
}

// Source pixels of a part: columns [left, left + columns) of rows [top, top + rows), counted from the tile's (u, v).
template <class F>
struct PartBounds {
  int left, top, columns, rows;
  F center_u, center_v;  // of the part, counted from (left, top)

  // Of the part at (x, y) of an output of that size; not more than fit.
  __device__ __forceinline__ PartBounds(Tile<F> const& tile, PartPlan<F> const& plan, int x, int y, int width,
                                        int height, int most_columns, int most_rows) {
    F const from_x = F(x - tile.x), from_y = F(y - tile.y);
    F low_u, low_v, high_u, high_v;
    tile.map.apply(from_x, from_y, low_u, low_v);
    high_u = low_u;
    high_v = low_v;
    if (!plan.varies) {
      low_u += plan.low_u;
      low_v += plan.low_v;
      high_u += plan.high_u;
      high_v += plan.high_v;
    } else {
      F const more_x = F(min(1 << plan.log_columns, width - x) - 1);
      F const more_y = F(min(1 << plan.log_rows, height - y) - 1);
#pragma unroll 1
      for (int i = 1; i < 4; ++i) {
        F u, v;
        tile.map.apply(from_x + (i & 1 ? more_x : 0), from_y + (i & 2 ? more_y : 0), u, v);
        low_u = min(low_u, u);
        low_v = min(low_v, v);
        high_u = max(high_u, u);
        high_v = max(high_v, v);
      }
      low_u -= plan.reach_x;
      low_v -= plan.reach_y;
      high_u -= plan.reach_x;
      high_v -= plan.reach_y;
    }
    left = ((floor_to_int<F>(low_u) + tile.u) & -4) - tile.u;
    top = floor_to_int<F>(low_v);
    columns = min(floor_to_int<F>(high_u) + plan.taps_x + 2 - left, most_columns);
    rows = min(floor_to_int<F>(high_v) + plan.taps_y + 2 - top, most_rows);
    center_u = (low_u + high_u) / 2 + plan.reach_x - F(left);
    center_v = (low_v + high_v) / 2 + plan.reach_y - F(top);
  }
  // Whether all taps, in vectors of V, are pixels of the image.
  template <int V, class Params>
  __device__ __forceinline__ bool is_inside(Tile<F> const& tile, Params const& p) const {
    int const x = left + tile.u, y = top + tile.v;
    return x >= 0 && x + (columns + V - 1) / V * V <= p.x_axis.size && y >= 0 && y + rows <= p.y_axis.size;
  }
  // Whether all taps are the fill.
  template <class T>
  __device__ __forceinline__ bool is_outside(Tile<F> const& tile, Sampling<T> const& p) const {
    int const x = left + tile.u, y = top + tile.v;
    return p.x_axis.padding == Padding::fill &&
           (x + columns <= 0 || x >= p.x_axis.size || y + rows <= 0 || y >= p.y_axis.size);
  }
};

// A channel of a pixel from memory, one tap after the other: those out of reach, and those of numbers that are not
// finite, where one of weight 0 contributes nothing.
template <class T, class F>
__device__ __noinline__ void sample_carefully(Sample<T> const& p, Tile<F> const& tile, int channel, int x, int y) {
  F u, v;
  F const column = F(x - tile.x), row = F(y - tile.y);
  tile.map.apply(column, row, u, v);
  Footprint<F> const f = footprint(jacobian(tile.map, column, row, u, v));
  CoveredTaps<F> const taps(p, u + F(tile.u), v + F(tile.v), f);
  F const fill = p.fill_value(tile.b, channel);
  F sum = fill, total = 1;
  if (!taps.is_outside(p)) {
    T const* const plane = p.x.row(tile.image, channel, 0);
    sum = total = 0;
#pragma unroll 1
    for (int j = taps.first_y; j <= taps.last_y; ++j) {
      int const from_row = padded_pixel(p.y_axis, j);
#pragma unroll 1
      for (int i = taps.first_x; i <= taps.last_x; ++i) {
        F const w = weight_of(f, F(i) - taps.u, F(j) - taps.v);
        if (!(w > 0)) continue;
        int const from = padded_pixel(p.x_axis, i);
        total += w;
        sum += w * ((from_row | from) < 0 ? fill : F(read(plane[from_row * p.x.row_stride + from * p.x.step])));
      }
    }
  }
  p.y.row(tile.b, channel, y)[x * p.y.step] = round_to<T>(sum / total);
}

// Loads N channels of a part, those of a row one after the other. Vectors of four pixels, if rows begin with such.
template <int N, bool Aligned, class Params, class F>
__device__ __forceinline__ void load_part(Params const& p, Tile<F> const& tile, PartPlan<F> const& plan,
                                          PartBounds<F> const& part, int first, F* memory) {
  using T = std::remove_const_t<std::remove_pointer_t<decltype(p.x.data)>>;
  constexpr int Pitch = PartTiles::kPitch, V = Aligned ? 4 : 1, kThreadsAcross = Pitch <= 64 ? 64 / V : 128 / V,
                kRowsAtOnce = kThreads / kThreadsAcross;
  int const column = threadIdx.x % kThreadsAcross * V, first_row = threadIdx.x / kThreadsAcross;
  if (column >= part.columns) return;
  int const from = part.left + tile.u + column, row_stride = int(p.x.row_stride), step = int(p.x.step);
  bool const within = from >= 0 && from + V <= p.x_axis.size, outside = from + V <= 0 || from >= p.x_axis.size;
  bool const filled = p.x_axis.padding == Padding::fill;
  T const* planes[N];
#pragma unroll
  for (int k = 0; k < N; ++k) planes[k] = p.x.row(tile.image, first + k, 0);
  F const du = F(column) + F(V - 1) / 2 - part.center_u, dv = F(first_row) - part.center_v;
  F x = plan.back[0] * du + plan.back[1] * dv, y = plan.back[2] * du + plan.back[3] * dv;
  F const step_x = plan.back[1] * F(kRowsAtOnce), step_y = plan.back[3] * F(kRowsAtOnce);
  F const limit_x = plan.limit_x, limit_y = plan.limit_y;
  int const rows = part.rows;
  F* to = memory + first_row * (N * Pitch) + column;
  constexpr bool kIsCopy = sizeof(T) == sizeof(F);
  constexpr int kTogether = kIsCopy ? 1 : 3;  // rows that are loaded before the first of them is converted
  auto const vector_at = [&](int k, int at) { return *reinterpret_cast<Vector<T, V> const*>(planes[k] + at); };
  auto const convert = [&](F* to, Vector<T, V> const& vector) {
    Vector<F, V> wide;
#pragma unroll
    for (int i = 0; i < V; ++i) wide.v[i] = read(vector.v[i]);
    *reinterpret_cast<Vector<F, V>*>(to) = wide;
  };
  auto const copy = [&](int at) {
#pragma unroll
    for (int k = 0; k < N; ++k) {
      if constexpr (kIsCopy)
        __pipeline_memcpy_async(to + k * Pitch, planes[k] + at, V * sizeof(T));
      else
        convert(to + k * Pitch, vector_at(k, at));
    }
  };
  int const top = part.top + tile.v;
  if (part.template is_inside<V>(tile, p)) {
    int at = (top + first_row) * row_stride + from * (Aligned ? 1 : step);
#pragma unroll 1
    for (int row = first_row; row < rows; row += kTogether * kRowsAtOnce) {
      bool needed[kTogether];
      [[maybe_unused]] Vector<T, V> vectors[kTogether][N];
#pragma unroll
      for (int r = 0; r < kTogether; ++r) {
        needed[r] = vabs(x) <= limit_x && vabs(y) <= limit_y && (r == 0 || row + r * kRowsAtOnce < rows);
        if constexpr (kIsCopy) {
          if (needed[r]) copy(at);
        } else if (needed[r]) {
#pragma unroll
          for (int k = 0; k < N; ++k) vectors[r][k] = vector_at(k, at);
        }
        x += step_x;
        y += step_y;
        at += kRowsAtOnce * row_stride;
      }
      if constexpr (!kIsCopy) {
#pragma unroll
        for (int r = 0; r < kTogether; ++r)
          if (needed[r])
#pragma unroll
            for (int k = 0; k < N; ++k) convert(to + (r * kRowsAtOnce * N + k) * Pitch, vectors[r][k]);
      }
      to += kTogether * kRowsAtOnce * N * Pitch;
    }
    return;
  }
#pragma unroll 1
  for (int row = first_row; row < rows; row += kRowsAtOnce, to += kRowsAtOnce * N * Pitch) {
    bool const needed = vabs(x) <= limit_x && vabs(y) <= limit_y;
    x += step_x;
    y += step_y;
    if (!needed) continue;
    int const from_row = padded_pixel(p.y_axis, top + row);
    if (within && from_row >= 0) {
      copy(from_row * row_stride + from * (Aligned ? 1 : step));
      continue;
    }
    bool const is_fill = filled && (outside || from_row < 0);
#pragma unroll 1
    for (int k = 0; k < N; ++k) {
      F const fill = p.fill_value(tile.b, first + k);
      T const* const plane = p.x.row(tile.image, first + k, 0) + from_row * row_stride;
#pragma unroll
      for (int i = 0; i < V; ++i) {
        int const pixel = is_fill ? -1 : padded_pixel(p.x_axis, from + i);
        to[k * Pitch + i] = (pixel | from_row) < 0 ? fill : F(read(plane[pixel * step]));
      }
    }
  }
}

// The same by all threads, which then see them. `aligned`: rows begin with vectors of four pixels.
template <int N, class Params, class F>
__device__ __forceinline__ void stage_part(Params const& p, Tile<F> const& tile, PartPlan<F> const& plan,
                                           PartBounds<F> const& part, bool aligned, int first, F* memory) {
  __syncthreads();  // before the current contents are overwritten
  if (aligned)
    load_part<N, true>(p, tile, plan, part, first, memory);
  else
    load_part<N, false>(p, tile, plan, part, first, memory);
  __pipeline_commit();
  __pipeline_wait_prior(0);
  __syncthreads();
}

// The integer not above x, which is below 2^21 in magnitude.
__device__ __forceinline__ int floor_near(float x, float& whole) {
  constexpr float kLarge = 0x1.8p23f;
  float const sum = __fadd_rd(x, kLarge);
  whole = sum - kLarge;
  return __float_as_int(sum) - 0x4b400000;
}

// Samples N channels of a part, with 2^A threads and Taps << A columns for each pixel; thread k mod 2^A stores channel
// k. Whether one of a thread's pixels is out of reach or not finite.
template <int A, int Taps, int N, class T, class F>
__device__ __forceinline__ bool sample_part(Sample<T> const& p, Tile<F> const& tile, PartPlan<F> const& plan,
                                            PartBounds<F> const& part, int first, int x0, int y0, F const* memory) {
  constexpr int Pitch = PartTiles::kPitch, kPixelsOfWarp = 32 >> A, kPixelsAtOnce = kThreads / 32 * kPixelsOfWarp;
  int const lane = threadIdx.x % 32, own = lane & ((1 << A) - 1), warp = threadIdx.x / 32;
  bool const along_x = plan.along_x;
  int const pixels = 1 << (plan.log_columns + plan.log_rows), log_line = along_x ? plan.log_columns : plan.log_rows;
  int const number = warp * kPixelsOfWarp + (lane >> A);
  int const along = number & ((1 << log_line) - 1), step = kPixelsAtOnce >> log_line;
  int cross = number >> log_line;
  int x = x0 + (along_x ? along : cross), y = y0 + (along_x ? cross : along);
  int const width = int(p.y.width), height = int(p.y.height);
  // Pixels of the line and lines that exist.
  int const lines = min(pixels >> log_line, along_x ? height - y0 : width - x0);
  bool const exists = along_x ? x < width : y < height;
  F const(&m)[9] = tile.map.m;
  F const step_u = F(step) * (along_x ? m[1] : m[0]), step_v = F(step) * (along_x ? m[4] : m[3]);
  F u, v;
  tile.map.apply(F(x - tile.x), F(y - tile.y), u, v);
  u -= F(part.left);
  v -= F(part.top);
  Footprint<F> f = plan.footprint;
  F const reach_x = plan.reach_x, reach_y = plan.reach_y;
  int const taps_y = plan.taps_y, last_left = part.columns - (Taps << A), last_top = part.rows - taps_y;
  int64_t const plane = p.y.channel_stride;
  T* to = p.y.row(tile.b, first + (N == 3 ? min(own, N - 1) : 0), y) + x * p.y.step;
  int const to_step = step * int(along_x ? p.y.row_stride : p.y.step);
  bool failed = false;
#pragma unroll 1
  for (int base = warp * kPixelsOfWarp; base < pixels; base += kPixelsAtOnce) {
    bool fits = true;
    if (plan.varies) {
      F const column = F(x - tile.x), row = F(y - tile.y);
      tile.map.apply(column, row, u, v);
      f = footprint(jacobian(tile.map, column, row, u, v));
      fits = f.reach_x <= reach_x && f.reach_y <= reach_y;
      u -= F(part.left);
      v -= F(part.top);
    }
    F left_of, top_of;
    int const left = floor_near(u - reach_x, left_of) + 1, top = floor_near(v - reach_y, top_of) + 1;
    fits = fits && unsigned(left) <= unsigned(last_left) && unsigned(top) <= unsigned(last_top);
    F const* at = memory + (fits ? top * (N * Pitch) + left : 0) + own;
    F const dx = left_of + F(own + 1) - u;
    F const dy = top_of + 1 - v;
    F total = 0, sums[N] = {}, row_x = f.xx * dx + f.xy * dy, row_y = f.xy * dx + f.yy * dy;
    F const step_x = f.xx * F(1 << A), step_y = f.xy * F(1 << A);
#pragma unroll 1
    for (int j = 0; j < taps_y; ++j) {
      F qx = row_x, qy = row_y;
#pragma unroll
      for (int i = 0; i < Taps; ++i) {
        F const weight = vsaturate(1 - vabs(qx)) * vsaturate(1 - vabs(qy));
        total += weight;
#pragma unroll
        for (int k = 0; k < N; ++k) sums[k] += weight * at[k * Pitch + (i << A)];
        qx += step_x;
        qy += step_y;
      }
      row_x += f.xy;
      row_y += f.yy;
      at += N * Pitch;
    }
    bool const is_pixel = exists && cross < lines;
    if constexpr (N == 3 && A >= 2) {
      // Thread k gets the sum of channel k, thread 3 that of the weights.
      bool const odd = lane & 1, second = lane & 2;
      F const even_0 = odd ? sums[1] : sums[0], even_1 = odd ? total : sums[2];
      F const other_0 = odd ? sums[0] : sums[1], other_1 = odd ? sums[2] : total;
      F const pair_0 = even_0 + __shfl_xor_sync(kAllLanes, other_0, 1);
      F const pair_1 = even_1 + __shfl_xor_sync(kAllLanes, other_1, 1);
      F sum = (second ? pair_1 : pair_0) + __shfl_xor_sync(kAllLanes, second ? pair_0 : pair_1, 2);
      if constexpr (A == 3) sum += __shfl_xor_sync(kAllLanes, sum, 4);
      F const mean = sum * reciprocal(__shfl_sync(kAllLanes, sum, (lane & -(1 << A)) | 3));
      failed = failed || !fits || mean - mean != 0;
      if (is_pixel && own < N) *to = round_to<T>(mean);
    } else {
#pragma unroll
      for (int step = 1; step < 1 << A; step *= 2) {
        total += __shfl_xor_sync(kAllLanes, total, step);
#pragma unroll
        for (int k = 0; k < N; ++k) sums[k] += __shfl_xor_sync(kAllLanes, sums[k], step);
      }
      F const scale = reciprocal(total);
      F all = 0;
#pragma unroll
      for (int k = 0; k < N; ++k) {
        sums[k] *= scale;
        all += sums[k];
      }
      failed = failed || !fits || all - all != 0;
      if (is_pixel) {
        if constexpr (A == 0) {
#pragma unroll
          for (int k = 0; k < N; ++k) to[k * plane] = round_to<T>(sums[k]);
        } else if constexpr (N == 3) {
          *to = round_to<T>(own ? sums[1] : sums[0]);
          if (own == 0) to[2 * plane] = round_to<T>(sums[2]);
        } else {
          if (own == 0) *to = round_to<T>(sums[0]);
        }
      }
    }
    cross += step;
    (along_x ? y : x) += step;
    to += to_step;
    u += step_u;
    v += step_v;
  }
  return failed;
}

// The pixels of a thread in a part, one by one.
template <int N, class T, class F>
__device__ __noinline__ void resample_part(Sample<T> const& p, Tile<F> const& tile, PartPlan<F> const& plan, int first,
                                           int x0, int y0) {
  int const lane = threadIdx.x % 32, threads = 1 << plan.across, pixels = 1 << (plan.log_columns + plan.log_rows);
  int const log_line = plan.along_x ? plan.log_columns : plan.log_rows;
#pragma unroll 1
  for (int base = int(threadIdx.x) / 32 * (32 >> plan.across); base < pixels; base += kThreads >> plan.across) {
    int const number = base + (lane >> plan.across), along = number & ((1 << log_line) - 1), cross = number >> log_line;
    int const x = x0 + (plan.along_x ? along : cross), y = y0 + (plan.along_x ? cross : along);
    if (number >= pixels || x >= p.y.width || y >= p.y.height) continue;
#pragma unroll 1
    for (int k = 0; k < N; ++k)
      if ((k & (threads - 1)) == (lane & (threads - 1))) sample_carefully(p, tile, first + k, x, y);
  }
}

// Calls take(across, taps) with a plan's numbers, as types: the logarithm of the threads of a pixel, the columns of
// each.
template <class F, class Take>
__device__ __forceinline__ void dispatch_shape(PartPlan<F> const& plan, Take take) {
  auto const with_across = [&](auto across) {
    constexpr int A = across.value;
    if (plan.taps_x == 2 << A)
      take(across, std::integral_constant<int, 2>{});
    else if (plan.taps_x == 3 << A)
      take(across, std::integral_constant<int, 3>{});
    else
      take(across, std::integral_constant<int, 4>{});
  };
  switch (plan.across) {
    case 0:
      return with_across(std::integral_constant<int, 0>{});
    case 1:
      return with_across(std::integral_constant<int, 1>{});
    case 2:
      return with_across(std::integral_constant<int, 2>{});
    default:
      return with_across(std::integral_constant<int, 3>{});
  }
}

// A block's tile and its plan, in shared memory.
template <class F>
struct TileInParts {
  Tile<F> tile;
  PartPlan<F> plan;

  // By all threads, of an output of that size.
  template <class Params>
  __device__ __forceinline__ void init(TileGrid const& tiles, Params const& p, int width, int height,
                                       int log_side = 5) {
    if (threadIdx.x < 32) {
      Tile<F> own;
      PartPlan<F> own_plan;
      own.init(tiles, p.coords);
      own.image = p.image_of(own.b);
      own_plan.init(own, width, height, PartTiles::kPitch, PartTiles::kRows, log_side);
      if (own_plan.separable && log_side < 5) own_plan.use_all_threads(PartTiles::kPitch);
      if (threadIdx.x == 0) {
        tile = own;
        plan = own_plan;
      }
    }
    __syncthreads();
  }
  __device__ __forceinline__ int count() const { return 1 << (10 - plan.log_columns - plan.log_rows); }
  // Where part `number` begins.
  __device__ __forceinline__ void locate(int number, int& x, int& y) const {
    int const log_across = 5 - plan.log_columns;
    x = tile.x + ((number & ((1 << log_across) - 1)) << plan.log_columns);
    y = tile.y + (number >> log_across << plan.log_rows);
  }
  __device__ __forceinline__ PartBounds<F> bounds(int x, int y, int width, int height) const {
    return {tile, plan, x, y, width, height, PartTiles::kPitch, PartTiles::kRows};
  }
  // Calls take(x, y) for the parts of the tile.
  template <class Take>
  __device__ __forceinline__ void for_each_part(int width, int height, Take take) const {
#pragma unroll 1
    for (int number = 0; number < count(); ++number) {
      int x, y;
      locate(number, x, y);
      if (x < width && y < height) take(x, y);
    }
  }
};

// Samples the part of a tile at (x0, y0).
template <class T, class F>
__device__ __forceinline__ void sample_whole_part(Sample<T> const& p, TileInParts<F> const& whole, int x0, int y0,
                                                  bool aligned, F* memory) {
  Tile<F> const& tile = whole.tile;
  PartPlan<F> const& plan = whole.plan;
  int const width = int(p.y.width), height = int(p.y.height);
  PartBounds<F> const part = whole.bounds(x0, y0, width, height);
  if (part.is_outside(tile, p)) {
    int const pixels = 1 << (plan.log_columns + plan.log_rows);
    for (int i = threadIdx.x; i < pixels; i += kThreads) {
      int const x = x0 + (i & ((1 << plan.log_columns) - 1)), y = y0 + (i >> plan.log_columns);
      if (x < width && y < height)
        for (int c = 0; c < p.x.channels; ++c)
          p.y.row(tile.b, c, y)[x * p.y.step] = round_to<T>(p.fill_value(tile.b, c));
    }
    return;
  }
  for_each_channel_group<kChannelsTogether>(p.x.channels, [&](int first, auto together) {
    constexpr int N = together.value;
    stage_part<N>(p, tile, plan, part, aligned, first, memory);
    bool failed = false;
    dispatch_shape(plan, [&](auto across, auto taps) {
      failed = sample_part<across.value, taps.value, N>(p, tile, plan, part, first, x0, y0, memory);
    });
    if (failed) resample_part<N>(p, tile, plan, first, x0, y0);
  });
}

}  // namespace
}  // namespace kv::geometry::cuda
