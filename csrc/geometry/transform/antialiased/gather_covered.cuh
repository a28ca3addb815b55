// The gradient of the image of antialiased warps on CUDA, by gathering: a pixel of the source reads the gradients of
// all output pixels that cover it. It serves affine maps with fill padding, one sample an image; for an affine map the
// output pixels around a source pixel are as many everywhere.
//
// A block takes a tile of the source, as a whole or in four parts. The gradients of the output pixels that may cover
// its pixels are stored in shared memory, divided by the sum of their weights. A thread has two source pixels, one
// below the other.
#pragma once

#include "geometry/transform/antialiased/antialiased.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kGatherRows = 2;  // of a thread at a time

// The output pixels around source pixels, of all tiles of a sample.
template <class F>
struct GatherShape {
  static constexpr int kColumns = 53, kRows = 53;  // of a tile's output pixels; banks of a column differ

  Footprint<F> footprint;
  F m[4], back[4];     // derivatives of source coordinates by those of the output, and back
  F reach_x, reach_y;  // from the middle of a thread's pixels
  int columns, rows;   // from there on
  // Of an output pixel, at most. Found once: ptxas 12.1 to 13.5 move bounds that loops of float64 compute in each turn
  // behind their comparison.
  int taps_x, taps_y;
  int size;      // of a part of a tile
  bool gathers;  // whether its output pixels fit

  __device__ __forceinline__ explicit GatherShape(Homography<double> const& map) {
    for (int i = 0; i < 4; ++i) m[i] = F(map.m[i + i / 2]);
    footprint = geometry::footprint(Jacobian<F>{m[0], m[1], m[2], m[3]});
    F const det = m[0] * m[3] - m[1] * m[2], scale = 1 / det;
    back[0] = m[3] * scale;
    back[1] = -m[1] * scale;
    back[2] = -m[2] * scale;
    back[3] = m[0] * scale;
    // Distances in the source of (x, y) cover q = S^-1 (x, y) in (-1, 1)^2, of all pixels of the thread.
    Footprint<F> const& f = footprint;
    F const to_x = 1 + vabs(f.xy) * F(kGatherRows - 1) / 2, to_y = 1 + f.yy * F(kGatherRows - 1) / 2;
    F const area = 1 / (f.xx * f.yy - f.xy * f.xy);  // S is [[yy, -xy], [-xy, xx]] times that
    F const per_qx[] = {(back[0] * f.yy - back[1] * f.xy) * area, (back[2] * f.yy - back[3] * f.xy) * area};
    F const per_qy[] = {(back[1] * f.xx - back[0] * f.xy) * area, (back[3] * f.xx - back[2] * f.xy) * area};
    reach_x = vabs(per_qx[0]) * to_x + vabs(per_qy[0]) * to_y;
    reach_y = vabs(per_qx[1]) * to_x + vabs(per_qy[1]) * to_y;
    constexpr F kLess = F(1 - 2e-6);
    gathers = map.affine && vabs(det) > F(1e-4) && max(reach_x, reach_y) < F(kColumns) &&
              f.reach_x < F(kMaxReach - 1) && f.reach_y < F(kMaxReach - 1);
    columns = rows = taps_x = taps_y = size = 0;
    if (!gathers) return;
    taps_x = -floor_to_int<F>(-2 * f.reach_x);
    taps_y = -floor_to_int<F>(-2 * f.reach_y);
    columns = -floor_to_int<F>(-2 * reach_x * kLess);
    rows = -floor_to_int<F>(-2 * reach_y * kLess);
    auto const fits = [&](int size) {
      F const span = F(size - 1);
      return (vabs(back[0]) + vabs(back[1])) * span + F(columns + 4) <= F(kColumns) &&
             (vabs(back[2]) + vabs(back[3])) * span + F(rows + 4) <= F(kRows);
    };
    size = fits(kGatherTile) ? kGatherTile : kGatherTile / 2;
    gathers = fits(size);
  }
};

// A part of a tile of the source, in shared memory.
template <class F>
struct CoveredGather {
  GatherShape<F> shape;
  Homography<double> map;
  int64_t b, image;
  int x, y;       // its first pixel
  int left, top;  // of its output pixels
  int columns, rows;
  F from_x, from_y;  // the source coordinates of output pixel (left, top), counted from (x, y)
  F to_x, to_y;      // the output coordinates of source pixel (x, y), counted from (left, top)

  __device__ __forceinline__ CoveredGather(Homography<double> const& map, int64_t b, int64_t image)
      : shape(map), map(map), b(b), image(image) {}
  // The part at (x, y).
  template <class T>
  __device__ __forceinline__ void locate(SampleImageBackward<T> const& p, int part_x, int part_y) {
    x = part_x;
    y = part_y;
    left = top = columns = rows = 0;
    double const(&m)[9] = map.m;
    double const scale = 1 / (m[0] * m[4] - m[1] * m[3]), du = double(x) - m[2], dv = double(y) - m[5];
    double const at_x = (m[4] * du - m[1] * dv) * scale, at_y = (m[0] * dv - m[3] * du) * scale;
    // Far from the output no pixel covers the tile.
    bool const near =
        at_x > -1e4 && at_x < double(p.grad.width) + 1e4 && at_y > -1e4 && at_y < double(p.grad.height) + 1e4;
    if (!near) return;
    F const(&by)[4] = shape.back;
    F const last = F(shape.size - 1), half = F(kGatherRows - 1) / 2;
    F const low_x = min(by[0] * last, F(0)) + min(by[1] * half, by[1] * (last - half));
    F const low_y = min(by[2] * last, F(0)) + min(by[3] * half, by[3] * (last - half));
    F const high_x = max(by[0] * last, F(0)) + max(by[1] * half, by[1] * (last - half));
    F const high_y = max(by[2] * last, F(0)) + max(by[3] * half, by[3] * (last - half));
    left = int(floor(at_x + double(low_x - shape.reach_x)));
    top = int(floor(at_y + double(low_y - shape.reach_y)));
    columns = min(int(floor(at_x + double(high_x - shape.reach_x))) + shape.columns + 2 - left, int(shape.kColumns));
    rows = min(int(floor(at_y + double(high_y - shape.reach_y))) + shape.rows + 2 - top, int(shape.kRows));
    to_x = F(at_x - left);
    to_y = F(at_y - top);
    from_x = F(m[0] * left + m[1] * top - du);
    from_y = F(m[3] * left + m[4] * top - dv);
  }
  // Whether an output pixel may cover a pixel of the tile.
  __device__ __forceinline__ bool is_covered(int width, int height) const {
    return columns > 0 && left < width && top < height && left + columns > 0 && top + rows > 0;
  }

  // The sum of weights of an output pixel whose source coordinates have these fractions.
  __device__ __forceinline__ F weight_of_all(F u, F v) const {
    Footprint<F> const& f = shape.footprint;
    F const first_x = F(floor_to_int<F>(u - f.reach_x) + 1) - u, first_y = F(floor_to_int<F>(v - f.reach_y) + 1) - v;
    int const taps_x = shape.taps_x, taps_y = shape.taps_y;
    if (f.is_separable()) {
      F across = 0, down = 0;
#pragma unroll 1
      for (int i = 0; i < taps_x; ++i) across += vsaturate(1 - vabs(f.xx * (first_x + F(i))));
#pragma unroll 1
      for (int i = 0; i < taps_y; ++i) down += vsaturate(1 - vabs(f.yy * (first_y + F(i))));
      return across * down;
    }
    F total = 0;
#pragma unroll 1
    for (int j = 0; j < taps_y; ++j) {
      F const dy = first_y + F(j);
      F qx = f.xx * first_x + f.xy * dy, qy = f.xy * first_x + f.yy * dy;
#pragma unroll 2
      for (int i = 0; i < taps_x; ++i) {
        total += vsaturate(1 - vabs(qx)) * vsaturate(1 - vabs(qy));
        qx += f.xx;
        qy += f.xy;
      }
    }
    return total;
  }
  // Stores the gradients of N channels over the sums of weights.
  template <int N, class T>
  __device__ __forceinline__ void load(SampleImageBackward<T> const& p, int first, F* memory) const {
    constexpr int kPitch = GatherShape<F>::kColumns, kPlane = kPitch * GatherShape<F>::kRows;
    constexpr int kTogether = 2;  // rows whose gradients are loaded before the first of them is waited for
    int const width = int(p.grad.width), height = int(p.grad.height), across = columns > 32 ? 64 : 32;
    int const column = int(threadIdx.x) & (across - 1), at_x = left + column, at_once = kThreads / across;
    if (column >= columns) return;
    bool const is_column = unsigned(at_x) < unsigned(width);
    T const* const grad = p.grad.row(b, first, 0) + at_x * p.grad.step;
#pragma unroll 1
    for (int row = int(threadIdx.x) / across; row < rows; row += kTogether * at_once) {
      F g[kTogether][N];
#pragma unroll
      for (int r = 0; r < kTogether; ++r) {
        int const at_y = top + row + r * at_once;
        bool const exists = is_column && unsigned(at_y) < unsigned(height);
        T const* const from = grad + at_y * p.grad.row_stride;
#pragma unroll
        for (int k = 0; k < N; ++k) g[r][k] = exists ? F(read(from[k * p.grad.channel_stride])) : F(0);
      }
#pragma unroll
      for (int r = 0; r < kTogether; ++r) {
        int const own = row + r * at_once;
        if (own >= rows) continue;
        F const u = from_x + (shape.m[0] * F(column) + shape.m[1] * F(own));
        F const v = from_y + (shape.m[2] * F(column) + shape.m[3] * F(own));
        F const scale = reciprocal(weight_of_all(u, v));
        F* const to = memory + own * kPitch + column;
#pragma unroll
        for (int k = 0; k < N; ++k) to[k * kPlane] = g[r][k] * scale;
      }
    }
  }
};

// The gradients of N channels of a thread's pixels, the first of them (x, y) in its tile. Columns: of the output
// pixels, or 0 for any number. Careful: an output pixel of weight 0 contributes nothing, even if its gradient is inf or
// NaN.
template <int Columns, int N, bool Careful, class F>
__device__ __forceinline__ void gather_pixels(CoveredGather<F> const& tile, int x, int y, F const* memory,
                                              F (&sums)[kGatherRows][N]) {
  constexpr int kPitch = GatherShape<F>::kColumns, kPlane = kPitch * GatherShape<F>::kRows;
  GatherShape<F> const& shape = tile.shape;
  Footprint<F> const& f = shape.footprint;
  F const(&m)[4] = shape.m;
  F const column = F(x), middle = F(y) + F(kGatherRows - 1) / 2;
  F const center_x = tile.to_x + (shape.back[0] * column + shape.back[1] * middle);
  F const center_y = tile.to_y + (shape.back[2] * column + shape.back[3] * middle);
  int const first_x = max(floor_to_int<F>(center_x - shape.reach_x) + 1, 0);
  int const first_y = max(floor_to_int<F>(center_y - shape.reach_y) + 1, 0);
  F const du = column - (tile.from_x + (m[0] * F(first_x) + m[1] * F(first_y)));
  F const dv = F(y) - (tile.from_y + (m[2] * F(first_x) + m[3] * F(first_y)));
  F row_x = f.xx * du + f.xy * dv, row_y = f.xy * du + f.yy * dv;
  F const step_xx = f.xx * m[0] + f.xy * m[2], step_xy = f.xy * m[0] + f.yy * m[2];  // of q by columns
  F const step_yx = f.xx * m[1] + f.xy * m[3], step_yy = f.xy * m[1] + f.yy * m[3];  // and by rows
  F const* row = memory + first_y * kPitch + first_x;
#pragma unroll
  for (int r = 0; r < kGatherRows; ++r)
#pragma unroll
    for (int k = 0; k < N; ++k) sums[r][k] = 0;
#pragma unroll 1
  for (int j = 0; j < shape.rows; ++j, row += kPitch) {
    F qx = row_x, qy = row_y;
    auto const add = [&](F const* from) {
      F g[N];
#pragma unroll
      for (int k = 0; k < N; ++k) g[k] = from[k * kPlane];
#pragma unroll
      for (int r = 0; r < kGatherRows; ++r) {
        F const weight = vsaturate(1 - vabs(qx + F(r) * f.xy)) * vsaturate(1 - vabs(qy + F(r) * f.yy));
        if (Careful && !(weight > 0)) continue;
#pragma unroll
        for (int k = 0; k < N; ++k) sums[r][k] += weight * g[k];
      }
      qx -= step_xx;
      qy -= step_xy;
    };
    if constexpr (Columns > 0) {
#pragma unroll
      for (int i = 0; i < Columns; ++i) add(row + i);
    } else {
#pragma unroll 1
      for (int i = 0; i < shape.columns; ++i) add(row + i);
    }
    row_x -= step_yx;
    row_y -= step_yy;
  }
}

// Writes the gradients of a tile, N channels from `first` on, to a plane and those behind it.
template <int Columns, int N, class F>
__device__ __forceinline__ void gather_covered_tile(CoveredGather<F> const& tile, int width, int height,
                                                    F const* memory, F* plane, int64_t plane_size) {
  int const size = tile.shape.size;
#pragma unroll 1
  for (int x = threadIdx.x % 32; x < min(size, width - tile.x); x += 32)
#pragma unroll 1
    for (int y = threadIdx.x / 32 * kGatherRows; y < min(size, height - tile.y); y += kThreads / 32 * kGatherRows) {
      F sums[kGatherRows][N];
      gather_pixels<Columns, N, false>(tile, x, y, memory, sums);
      F rest = 0;
#pragma unroll
      for (int r = 0; r < kGatherRows; ++r)
#pragma unroll
        for (int k = 0; k < N; ++k) rest += sums[r][k] - sums[r][k];
      if (rest != 0) gather_pixels<0, N, true>(tile, x, y, memory, sums);
      F* const to = plane + int64_t(tile.y + y) * width + (tile.x + x);
#pragma unroll
      for (int r = 0; r < kGatherRows; ++r)
        if (tile.y + y + r < height)
#pragma unroll
          for (int k = 0; k < N; ++k) to[k * plane_size + r * width] = sums[r][k];
    }
}

// How many blocks of threads a multiprocessor has at least.
template <class T>
constexpr int kGatherBlocks = sizeof(T) == 8 ? 2 : 4;

// Writes the gradients of a tile of the image of a sample, the one in that column and row of tiles.
template <class T>
__device__ __forceinline__ void gather_covered_block(SampleImageBackward<T> const& p, unsigned sample, unsigned column,
                                                     unsigned row) {
  using F = Compute<T>;
  constexpr int kTogether = sizeof(T) == 8 ? 1 : 3;
  __shared__ __align__(16) unsigned char shared_tile[sizeof(CoveredGather<F>)];
  extern __shared__ __align__(16) unsigned char shared_memory[];
  CoveredGather<F>& tile = *reinterpret_cast<CoveredGather<F>*>(shared_tile);
  F* const memory = reinterpret_cast<F*>(shared_memory);
  int const x0 = int(column) * kGatherTile, y0 = int(row) * kGatherTile;
  int const width = int(p.grad_x.width), height = int(p.grad_x.height);
  if (threadIdx.x < 32) {
    CoveredGather<F> own(homography(p.coords.matrices + sample * p.coords.matrix_stride, p.coords.use), sample,
                         p.image_of(sample));
    if (threadIdx.x == 0) tile = own;
  }
  __syncthreads();
  int64_t const plane = int64_t(height) * width;
  F* const planes = p.sums + tile.image * p.grad_x.channels * plane;
  int const size = tile.shape.gathers ? tile.shape.size : kGatherTile;
#pragma unroll 1
  for (int part = 0; part < (kGatherTile / size) * (kGatherTile / size); ++part) {
    int const x = x0 + (part & 1) * size, y = y0 + (part >> 1) * size;
    if (x >= width || y >= height) continue;
    __syncthreads();  // before the contents are overwritten
    if (threadIdx.x == 0 && tile.shape.gathers) tile.locate(p, x, y);
    __syncthreads();
    if (!tile.shape.gathers || !tile.is_covered(int(p.grad.width), int(p.grad.height))) {
#pragma unroll 1
      for (int i = threadIdx.x % 32; i < min(size, width - x); i += 32)
#pragma unroll 1
        for (int j = threadIdx.x / 32; j < min(size, height - y); j += kThreads / 32)
          for (int c = 0; c < p.grad_x.channels; ++c) planes[c * plane + int64_t(y + j) * width + (x + i)] = 0;
      continue;
    }
    for_each_channel_group<kTogether>(p.grad_x.channels, [&](int first, auto together) {
      constexpr int N = together.value;
      if (first > 0) __syncthreads();
      tile.template load<N>(p, first, memory);
      __syncthreads();
      auto const gather = [&](auto columns) {
        gather_covered_tile<columns.value, N>(tile, width, height, memory, planes + first * plane, plane);
      };
      switch (tile.shape.columns) {
        case 2:
          return gather(std::integral_constant<int, 2>{});
        case 3:
          return gather(std::integral_constant<int, 3>{});
        case 4:
          return gather(std::integral_constant<int, 4>{});
        default:
          return gather(std::integral_constant<int, 0>{});
      }
    });
  }
}

// The memory of a block.
template <class T>
int gather_bytes(int channels) {
  using F = Compute<T>;
  int const together = sizeof(T) == 8 || channels < 3 ? 1 : 3;
  return together * GatherShape<F>::kColumns * GatherShape<F>::kRows * int(sizeof(F));
}

}  // namespace
}  // namespace kv::geometry::cuda
