// Sharpness on CUDA. Each warp traverses a strip of columns downwards and keeps its rows in registers, so a pixel is
// read from device memory once; of bytes each thread a group of columns. Channels-last images take simpler kernels: a
// block stages a tile of 64 x 16 pixels with its halo in shared memory.
#include "core/block_reduce.cuh"
#include "core/stencils/column_groups.cuh"
#include "core/stencils/filter_list.cuh"
#include "core/stencils/gradient_list.cuh"
#include "sharpness.h"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 256, kForwardRows = 8;

// --- strips ----------------------------------------------------------------------------------------------------------

template <class T, bool Aligned>
__device__ __forceinline__ void sharpen_strip(Sharpness<T> const& p, Strips<kPixels<T>> const& strips, unsigned block) {
  constexpr int P = kPixels<T>;
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(block, plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  Strip<1, Aligned, P> const strip(x, width, Border::replicate);
  RowCursor<T> rows(p.x, plane, y0 - 1);
  T* out = p.y.row(plane, y0);
  F const factor = p.factor.of(plane);

  F above[P], adjacent[P], own[P], next[P];  // horizontal sums of three, and the pixels of this row and the next one
  auto ahead = strip.fetch(rows.next());     // prefetches a row while another one is processed
  auto const down = [&](F(&sums)[P]) {
    auto const now = ahead;
    ahead = strip.fetch(rows.next());
    F v[P + 2];
    strip.spread(now, v);
#pragma unroll
    for (int i = 0; i < P; i += 2) {
      F const pair = v[i + 1] + v[i + 2];
      sums[i] = v[i] + pair, sums[i + 1] = pair + v[i + 3];
      own[i] = next[i], own[i + 1] = next[i + 1];
      next[i] = v[i + 1], next[i + 1] = v[i + 2];
    }
  };
  down(above);
  down(adjacent);
#pragma unroll 3
  for (int y = y0; y < y1; ++y) {
    F below[P], result[P];
    down(below);
    bool const inner = y > 0 && y + 1 < height;
#pragma unroll
    for (int i = 0; i < P; ++i) {
      bool const sharpens = inner && (i > 0 || x > 0) && ((Aligned && i + 1 < P) || x + i + 1 < width);
      F const smooth = smoothed(above[i] + adjacent[i] + below[i], own[i], F(0));
      result[i] = sharpens ? sharpened(own[i], smooth, factor) : clipped(own[i], F(0));
      above[i] = adjacent[i];
      adjacent[i] = below[i];
    }
    strip.store(out, result);
    out += p.y.row_stride;
  }
}

template <class T>
constexpr int kStripBlocks = sizeof(T) == 8   ? 1
                             : sizeof(T) == 4 ? 4
                                              : 3;  // on a multiprocessor at once

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads, kStripBlocks<T>)
    run_strip(__grid_constant__ Sharpness<T> const p, Strips<kPixels<T>> const strips) {
  sharpen_strip<T, Aligned>(p, strips, blockIdx.x);
}
template <class T>
__global__ void __launch_bounds__(kThreads, kStripBlocks<T>)
    run_strip_of_list(__grid_constant__ SharpnessList<T> const list) {
  unsigned block;
  Sharpness<T> const* const p = sample_of_block(list, block);
  if (!p) return;
  sharpen_strip<T, false>(*p, {p->x.count(), p->x.height, p->x.width, kForwardRows}, block);
}

// --- bytes: groups of columns ----------------------------------------------------------------------------------------
//
// Sums of bytes are exact, two at a time as numbers of 16 bits: those of pixels two columns apart.

// A row of a thread's group: for each of its words the pairs of even and of odd columns, and with their neighbors.
template <int N>
struct PairsOfRow {
  uint32_t own[2 * N], sums[2 * N];

  // `around` are the words from the pixel before the group on.
  __device__ __forceinline__ explicit PairsOfRow(uint32_t const (&around)[N + 1]) {
    uint32_t odd[N + 1], even[N + 1];  // columns 4 i - 1 and 4 i + 1; 4 i and 4 i + 2
#pragma unroll
    for (int i = 0; i <= N; ++i) odd[i] = around[i] & 0x00ff00ffu, even[i] = around[i] >> 8 & 0x00ff00ffu;
#pragma unroll
    for (int i = 0; i < N; ++i) {
      own[2 * i] = even[i], own[2 * i + 1] = __funnelshift_r(odd[i], odd[i + 1], 16);
      uint32_t const both = own[2 * i] + own[2 * i + 1];
      sums[2 * i] = odd[i] + both, sums[2 * i + 1] = both + __funnelshift_r(even[i], even[i + 1], 16);
    }
  }
};
// Number k of a pair.
__device__ __forceinline__ float number_of(uint32_t pair, int k) {  // 2^23 and the number, as bits
  return __uint_as_float(__byte_perm(pair, 0x4b000000u, k ? 0x7632 : 0x7610)) - float(1 << 23);
}

template <int Bytes>
__device__ __forceinline__ void sharpen_group(Sharpness<uint8_t> const& p,
                                              ColumnGroups<kGroupPixels<uint8_t>> const& groups, unsigned block) {
  constexpr int P = kGroupPixels<uint8_t>, N = P / 4, kAhead = 2;  // words of a group; rows in flight
  using Rows = GroupRows<uint8_t, P, 1, Bytes>;
  int64_t plane;
  int x, y0;
  groups.locate(block, plane, x, y0);
  Rows const rows(p.x, plane, x, Border::replicate);
  GroupStore<uint8_t, P, Bytes> out(p.y, plane, x, y0);
  int const height = int(p.x.height), y1 = min(y0 + groups.rows, height);
  float const factor = p.factor.of(plane), of_sum = (1 - factor) / 13;
  auto const fetch = [&](int y) { return rows.fetch(clamp(y, 0, height - 1)); };
  auto const pairs_of = [](typename Rows::Fetched const& fetched) {
    constexpr int kSkipped = 8 * Rows::kSkip;
    uint32_t packed[Rows::kPacked], around[N + 1];
    Rows::pack(fetched, packed);
#pragma unroll
    for (int i = 0; i <= N; ++i)
      around[i] =
          kSkipped == 0 ? packed[i] : __funnelshift_r(packed[i], packed[min(i + 1, Rows::kPacked - 1)], kSkipped);
    return PairsOfRow<N>(around);
  };
  PairsOfRow<N> above = pairs_of(fetch(y0 - 1)), at = pairs_of(fetch(y0));
  typename Rows::Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 + 1 + i);
#pragma unroll 1
  for (int first = y0; first < y1; first += kAhead)
#pragma unroll
    for (int k = 0; k < kAhead; ++k) {
      int const y = first + k;
      if (k > 0 && y >= y1) break;
      PairsOfRow<N> const below = pairs_of(ahead[k]);
      ahead[k] = fetch(y + 1 + kAhead);
      bool const sharpens = y > 0 && y + 1 < height;
      float const own_factor = sharpens ? factor : 1, sum_factor = sharpens ? of_sum : 0;
      float result[P];
#pragma unroll
      for (int i = 0; i < 2 * N; ++i) {
        uint32_t const sums = above.sums[i] + at.sums[i] + below.sums[i] + 4 * at.own[i];
#pragma unroll
        for (int half = 0; half < 2; ++half) {
          int const column = i / 2 * 4 + i % 2 + 2 * half;
          float const own = number_of(at.own[i], half);
          bool const is_border = (column == 0 && rows.left_end) || (column == P - 1 && rows.right_end);
          result[column] = is_border ? own : fmaf(own_factor, own, sum_factor * number_of(sums, half));
        }
      }
      out.put(result);
      above = at, at = below;
    }
}

template <int Bytes>
__global__ void __launch_bounds__(kThreads)
    run_groups(__grid_constant__ Sharpness<uint8_t> const p,
               __grid_constant__ ColumnGroups<kGroupPixels<uint8_t>> const groups) {
  sharpen_group<Bytes>(p, groups, blockIdx.x);
}
ColumnGroups<kGroupPixels<uint8_t>> __host__ __device__ groups_of(Sharpness<uint8_t> const& p) {
  constexpr int P = kGroupPixels<uint8_t>;
  return {p.x.count(), p.x.height, p.x.width, kStripRows, GroupRows<uint8_t, P, 1, 0>::kReach, kThreads};
}
__global__ void __launch_bounds__(kThreads) run_groups_of_list(__grid_constant__ SharpnessList<uint8_t> const list) {
  unsigned block;
  Sharpness<uint8_t> const* const p = sample_of_block(list, block);
  if (p) sharpen_group<0>(*p, groups_of(*p), block);
}

int launch_groups(Sharpness<uint8_t> const& p, CUstream_st* stream) {
  constexpr int P = kGroupPixels<uint8_t>;
  with_row_bytes<P>(
      [&](auto bytes) {
        static int const resident = resident_blocks(run_groups<bytes.value>, kThreads);
        ColumnGroups<P> const groups(p.x.count(), p.x.height, p.x.width, kStripRows,
                                     GroupRows<uint8_t, P, 1, bytes.value>::kReach, 3, resident);
        run_groups<bytes.value><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
      },
      p.x, p.y);
  return cudaGetLastError();
}

// The contributions of a row of gradients: to the pixels themselves, and to their neighbors, summed along the row.
template <class F>
struct ContributedRow {
  F own[4], sums[4];
};

// Each thread computes the gradients of four pixels and gets those of its neighbors by shuffle. Where a warp ends
// inside the image, its end thread computes one pixel more, for which it reads one more column of x.
template <class T, bool Aligned>
__device__ __forceinline__ void backward_strip(SharpnessBackward<T> const& p, Strips<> const& strips, unsigned block) {
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.locate(block, plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + int(strips.rows), height);
  Strip<1, Aligned> const strip(x, width, Border::replicate);
  Strip<0, Aligned> const strip_g(x, width, Border::replicate);
  bool const more_left = strip.left_end && x > 0, more_right = strip.right_end && x + 4 < width;
  int const more = more_left ? x - 1 : x + 4;
  int const farther = clamp(more_left ? more - 1 : more + 1, 0, width - 1);
  F const factor = p.factor.of(plane);

  int const first = max(y0 - 1, 0);
  RowCursor<T> rows_x(p.x, plane, first - 1), rows_g(p.grad, plane, first);
  // Horizontal sums of three in three rows of x, and the pixels of this row and the next one; element 4 is the
  // additional pixel.
  F above[5], adjacent[5], below[5]{}, own[5], next[5]{}, g[4], g_more{}, derivative = 0;
  auto const down_x = [&] {
#pragma unroll
    for (int i = 0; i < 5; ++i) above[i] = adjacent[i], adjacent[i] = below[i], own[i] = next[i];
    T const* const row = rows_x.next();
    F const far = more_left || more_right ? read(row[farther]) : F(0);
    F v[6];
    strip.load(v, row);
#pragma unroll
    for (int i = 0; i < 4; ++i) below[i] = v[i] + v[i + 1] + v[i + 2], next[i] = v[i + 1];
    below[4] = more_left ? far + v[0] + v[1] : v[4] + v[5] + far;
    next[4] = more_left ? v[0] : v[5];
  };
  auto const contribute = [&](int y, bool of_strip) {
    T const* const row_g = rows_g.next();
    strip_g.load(g, row_g);
    if (more_left || more_right) g_more = read(row_g[more]);
    down_x();
    bool const inner = y > 0 && y + 1 < height;
    auto const pixel_vjp = [&](int i, int at, F grad) {
      F const smooth = smoothed(above[i] + adjacent[i] + below[i], own[i], F(0));
      SharpenedVjp<F> of = sharpened_vjp(own[i], smooth, grad, factor);
      bool const never_last = Aligned && i < 3;
      if (!inner || (at <= 0 && (i == 0 || i == 4)) || (!never_last && at + 1 >= width))
        of = {clipped_vjp(own[i], grad, F(0)), 0, 0};
      return of;
    };
    ContributedRow<F> row;
    F around[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      auto const of = pixel_vjp(i, x + i, g[i]);
      row.own[i] = of.own + smoothed(F(0), of.around, F(0));
      around[i] = of.around;
      if (of_strip) derivative += of.factor;
    }
    F const end = more_left || more_right ? pixel_vjp(4, more, g_more).around : F(0);
    F left = __shfl_up_sync(0xffffffffu, around[3], 1), right = __shfl_down_sync(0xffffffffu, around[0], 1);
    if (strip.left_end) left = more_left ? end : F(0);
    if (strip.right_end) right = more_right ? end : F(0);
    row.sums[0] = left + around[0] + around[1];
    row.sums[1] = around[0] + around[1] + around[2];
    row.sums[2] = around[1] + around[2] + around[3];
    row.sums[3] = around[2] + around[3] + right;
    return row;
  };

  down_x();
  down_x();
  ContributedRow<F> before{}, here, after;
  if (y0 > 0) before = contribute(y0 - 1, false);
  here = contribute(y0, true);
  for (int y = y0; y < y1; ++y) {
    after = {};
    if (y + 1 < height) after = contribute(y + 1, y + 1 < y1);
    F result[4];
#pragma unroll
    for (int i = 0; i < 4; ++i)
      result[i] = here.own[i] + smoothed(before.sums[i] + here.sums[i] + after.sums[i], F(0), F(0));
    if (p.grad_x.data) strip.store(p.grad_x.row(plane, y), result);
    before = here;
    here = after;
  }
  if (!p.gradients) return;
  derivative = warp_reduce(derivative, Sum());
  unsigned const chunk = unsigned(y0) / strips.rows * strips.across + unsigned(x) / kStripWidth;
  if (threadIdx.x % 32 == 0) p.gradients[plane * p.chunks + chunk] = derivative;
}

template <class T>
constexpr int kBackwardBlocks = sizeof(Compute<T>) == 8 ? 1 : 3;

template <class T, bool Aligned>
__global__ void __launch_bounds__(kThreads, kBackwardBlocks<T>)
    run_backward_strip(__grid_constant__ SharpnessBackward<T> const p, Strips<> const strips) {
  backward_strip<T, Aligned>(p, strips, blockIdx.x);
}

template <class T>
__global__ void __launch_bounds__(kThreads, kBackwardBlocks<T>)
    run_backward_strip_of_list(__grid_constant__ SharpnessBackwardList<T> const list) {
  unsigned block;
  SharpnessBackward<T> const* const p = sample_of_block(list, block);
  if (p) backward_strip<T, false>(*p, {p->x.count(), p->x.height, p->x.width, kStripRows}, block);
}

// --- channels-last: tiles --------------------------------------------------------------------------------------------

// A tile with one value per pixel and a halo of R pixels.
template <class F, int R>
struct Tile {
  static constexpr int kWidth = kTileWidth + 2 * R, kHeight = kTileHeight + 2 * R;
  F v[kHeight][kWidth];

  // Sets all of its pixels, from -R on, to f(x, y).
  template <class Value>
  __device__ __forceinline__ void fill(Value f) {
    for (int i = int(threadIdx.x); i < kWidth * kHeight; i += kThreads)
      v[i / kWidth][i % kWidth] = f(i % kWidth - R, i / kWidth - R);
  }
  __device__ __forceinline__ F at(int x, int y) const { return v[y + R][x + R]; }
  __device__ __forceinline__ F sum_of_nine(int x, int y) const {
    F sum = 0;
#pragma unroll
    for (int j = -1; j <= 1; ++j) sum += at(x - 1, y + j) + at(x, y + j) + at(x + 1, y + j);
    return sum;
  }
};

// The position of a block's tile in its planes.
template <class T>
struct Corner {
  int x, y, width, height;
  __device__ __forceinline__ Corner(Planes<T> const& p, unsigned block) : width(int(p.width)), height(int(p.height)) {
    int const across = (width + kTileWidth - 1) / kTileWidth;
    x = int(block) % across * kTileWidth;
    y = int(block) / across * kTileHeight;
  }
  __device__ __forceinline__ bool has(int dx, int dy) const {
    return x + dx >= 0 && x + dx < width && y + dy >= 0 && y + dy < height;
  }
  __device__ __forceinline__ bool is_inner(int dx, int dy) const {
    return x + dx > 0 && x + dx < width - 1 && y + dy > 0 && y + dy < height - 1;
  }
  __device__ __forceinline__ T& of(Planes<T> const& p, int64_t plane, int dx, int dy) const {
    return p.row(plane, y + dy)[(x + dx) * p.step];
  }
};

// A tile of every `step`-th plane.
template <class T>
__device__ __forceinline__ void sharpen_tile(Sharpness<T> const& p, unsigned block, int64_t first, int64_t step) {
  using F = Compute<T>;
  constexpr F white = sizeof(T) == 1 ? 255 : 1;  // bytes are 255ths
  __shared__ Tile<F, 1> tile;
  Corner<T const> const at(p.x, block);
  Corner<T> const to(p.y, block);
  for (int64_t plane = first; plane < p.x.count(); plane += step) {
    F const factor = p.factor.of(plane);
    __syncthreads();  // the previous plane may still be in use
    tile.fill([&](int x, int y) { return at.has(x, y) ? read(at.of(p.x, plane, x, y)) * (1 / white) : F(0); });
    __syncthreads();
#pragma unroll
    for (int i = int(threadIdx.x); i < kTileWidth * kTileHeight; i += kThreads) {
      int const x = i % kTileWidth, y = i / kTileWidth;
      if (!at.has(x, y)) continue;
      F const v = tile.at(x, y);
      F const result =
          at.is_inner(x, y) ? sharpened(v, smoothed(tile.sum_of_nine(x, y), v, F(0)), factor) : clipped(v, F(0));
      to.of(p.y, plane, x, y) = round_to<T>(result * white);
    }
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Sharpness<T> const p) {
  sharpen_tile(p, blockIdx.x, blockIdx.y, gridDim.y);
}
template <class T>
__global__ void __launch_bounds__(kThreads) run_of_list(__grid_constant__ SharpnessList<T> const list) {
  unsigned block;
  Sharpness<T> const* const p = sample_of_block(list, block);
  if (p) sharpen_tile(by_channels(*p), block, 0, 1);
}

template <class T>
__device__ __forceinline__ void backward_tile(SharpnessBackward<T> const& p, unsigned block, int64_t first,
                                              int64_t step) {
  using F = Compute<T>;
  __shared__ Tile<F, 2> image;
  __shared__ Tile<F, 1> around;
  __shared__ Tile<F, 0> own;
  Corner<T const> const at(p.x, block);
  for (int64_t plane = first; plane < p.x.count(); plane += step) {
    F const factor = p.factor.of(plane);
    F derivative = 0;
    __syncthreads();  // the previous plane may still be in use
    image.fill([&](int x, int y) { return at.has(x, y) ? read(at.of(p.x, plane, x, y)) : F(0); });
    __syncthreads();
    around.fill([&](int x, int y) {
      if (!at.has(x, y)) return F(0);
      bool const is_own = x >= 0 && x < kTileWidth && y >= 0 && y < kTileHeight;
      F const v = image.at(x, y), g = read(at.of(p.grad, plane, x, y));
      if (!at.is_inner(x, y)) {
        if (is_own) own.v[y][x] = clipped_vjp(v, g, F(0));
        return F(0);
      }
      auto const of = sharpened_vjp(v, smoothed(image.sum_of_nine(x, y), v, F(0)), g, factor);
      if (is_own) {
        own.v[y][x] = of.own;
        derivative += of.factor;
      }
      return of.around;
    });
    __syncthreads();
    Corner<T> const to(p.grad_x, block);
    for (int i = int(threadIdx.x); p.grad_x.data && i < kTileWidth * kTileHeight; i += kThreads) {
      int const x = i % kTileWidth, y = i / kTileWidth;
      if (at.has(x, y))
        to.of(p.grad_x, plane, x, y) =
            round_to<T>(own.at(x, y) + smoothed(around.sum_of_nine(x, y), around.at(x, y), F(0)));
    }
    if (!p.gradients) continue;
    derivative = block_sum<kThreads>(derivative);
    if (threadIdx.x == 0) p.gradients[plane * p.chunks + block] = derivative;
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) run_backward(__grid_constant__ SharpnessBackward<T> const p) {
  backward_tile(p, blockIdx.x, blockIdx.y, gridDim.y);
}
template <class T>
__global__ void __launch_bounds__(kThreads)
    run_backward_of_list(__grid_constant__ SharpnessBackwardList<T> const list) {
  unsigned block;
  SharpnessBackward<T> const* const p = sample_of_block(list, block);
  if (p) backward_tile(*p, block, 0, 1);
}

template <class T>
dim3 tiles_of(Planes<T> const& x) {
  return dim3(unsigned(ceil_div(x.width, kTileWidth) * ceil_div(x.height, kTileHeight)),
              unsigned(min(x.count(), int64_t(65535))));
}

}  // namespace

template <class T>
int sharpness(Sharpness<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 1) {
    // Special case, H200: 2.2 (336x512) to 2.3 (335x513) times as fast as strips.
    if (supports_groups<kGroupPixels<T>, 1>(p.x)) return launch_groups(p, stream);
  } else if (p.x.step == 1) {
    // Special case, H200: 3.4 to 5.6 times as fast as tiles.
    constexpr int P = kPixels<T>;
    Strips<P> const strips(p.x.count(), p.x.height, p.x.width, kForwardRows);
    with_alignment<T>(is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y), [&](auto aligned) {
      run_strip<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
    });
    return cudaGetLastError();
  }
  run<<<tiles_of(p.x), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

// Each image by the kernel that a batch of it takes.
template <class T>
int sharpness_list(SharpnessList<T> const& p, CUstream_st* stream) {
  auto const launch = [&](auto kernel, auto blocks_of) {
    return launch_list(p, blocks_of, [&](SharpnessList<T> const& list, unsigned blocks) {
      if (blocks > 0) kernel<<<blocks, kThreads, 0, stream>>>(list);
    });
  };
  auto const is_grouped = [](Sharpness<T> const& one) {
    if constexpr (sizeof(T) == 1) return supports_groups<kGroupPixels<T>, 1>(one.x);
    return false;
  };
  if constexpr (sizeof(T) == 1) {
    int const error = launch(run_groups_of_list, [&](Sharpness<T> const& one) -> int64_t {
      return is_grouped(one) ? groups_of(one).blocks() : 0;
    });
    if (error) return error;
  } else if (!p.list.interleaved) {
    return launch(run_strip_of_list<T>, [](Sharpness<T> const& one) -> int64_t {
      return Strips<kPixels<T>>(one.x.count(), one.x.height, one.x.width, kForwardRows).blocks();
    });
  }
  return launch(run_of_list<T>, [&](Sharpness<T> const& one) -> int64_t {
    return is_grouped(one) ? 0 : ceil_div(one.x.width, kTileWidth) * ceil_div(one.x.height, kTileHeight);
  });
}
template <class T>
int sharpness_backward(SharpnessBackward<T> const& p, CUstream_st* stream) {
  Strips<> const strips(p.x.count(), p.x.height, p.x.width, kStripRows);
  bool const vectors =
      is_vectorizable<4>(p.x) && is_vectorizable<4>(p.grad) && (!p.grad_x.data || is_vectorizable<4>(p.grad_x));
  // Special case, H200: 2.6 to 3.4 times as fast as tiles.
  if (p.x.step == 1)
    with_alignment<T>(vectors, [&](auto aligned) {
      run_backward_strip<T, aligned.value><<<strips.blocks(), kThreads, 0, stream>>>(p, strips);
    });
  else
    run_backward<<<tiles_of(p.x), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int sharpness_list_backward(SharpnessBackwardList<T> const& p, CUstream_st* stream) {
  bool const in_strips = !p.interleaved;
  auto const blocks_of = [&](SharpnessBackward<T> const& one) -> int64_t {
    Planes<T const> const& x = one.x;
    if (in_strips) return Strips<>(x.count(), x.height, x.width, kStripRows).blocks();
    return ceil_div(x.width, kTileWidth) * ceil_div(x.height, kTileHeight);
  };
  return launch_gradients(p, blocks_of, [&](SharpnessBackwardList<T> const& list, unsigned blocks) {
    in_strips ? run_backward_strip_of_list<T><<<blocks, kThreads, 0, stream>>>(list)
              : run_backward_of_list<T><<<blocks, kThreads, 0, stream>>>(list);
  });
}

KV_INSTANTIATE_WITH_BYTES(sharpness, Sharpness)
KV_INSTANTIATE_WITH_BYTES(sharpness_list, SharpnessList)
KV_INSTANTIATE(sharpness_backward, SharpnessBackward)
KV_INSTANTIATE(sharpness_list_backward, SharpnessBackwardList)

}  // namespace kv::enhance::cuda
