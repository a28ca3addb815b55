// The JPEG approximation on CUDA. A block of threads processes four squares of 16 x 16 pixels. Each of its six warps
// has 32 x 8 values of luma or of downsampled chroma, which are four 8 x 8 blocks. A thread transforms a row of eight
// in shared memory, then a column, where it quantizes the coefficients, then a row again. Before and after the blocks,
// a thread processes four pixels. A block of a list finds its image in the table.
#include <new>

#include "core/block_reduce.cuh"
#include "core/launch.cuh"
#include "jpeg.h"

namespace kv::enhance::cuda {
namespace {

constexpr int kWarps = 6, kThreads = 32 * kWarps;

// Values of a tile; chroma has a halo of one pixel. Rows are padded so that the rows of four blocks are in different
// banks.
template <class F>
struct Tile {
  F luma[kJpegSide][kJpegWidth + 1];
  F half[2][kJpegSide / 2][kJpegWidth / 2 + 1];
};
template <class F>
struct Chroma {
  F v[2][kJpegSide + 2][kJpegWidth + 3];
};

// The position of a block's tile.
struct TilePosition {
  int64_t image;
  int y, x, tile, tiles;
  template <class F>
  __device__ __forceinline__ explicit TilePosition(JpegLevels<F> const& levels, unsigned block = blockIdx.x) {
    int const across = (int(levels.width) + kJpegWidth - 1) / kJpegWidth;
    tiles = across * (int(levels.height) / kJpegSide);
    image = block / unsigned(tiles);
    tile = int(block - unsigned(image) * unsigned(tiles));
    y = tile / across * kJpegSide;
    x = tile % across * kJpegWidth;
  }
};

// Calls f(row, column) for the pixels of a tile and its halo, from -1 on.
template <class Call>
__device__ __forceinline__ void for_each_around(Call const& f) {
  for (int row = int(threadIdx.x) / 32 - 1; row <= kJpegSide; row += kWarps)
#pragma unroll
    for (int column = int(threadIdx.x) % 32 - 1; column <= kJpegWidth; column += 32) f(row, column);
}

__device__ __forceinline__ bool is_inner(int row, int column) {
  return row >= 0 && row < kJpegSide && column >= 0 && column < kJpegWidth;
}

template <class T>
__device__ __forceinline__ void load_levels(JpegBlocks<T> const& p, TilePosition const& at, Tile<Compute<T>>& planes,
                                            Chroma<Compute<T>>& chroma) {
  using F = Compute<T>;
  for_each_around([&](int row, int column) {
    int const y = min(border_index(Border::reflect, at.y + row, int(p.levels.height)), int(p.x.height) - 1);
    int const x = min(border_index(Border::reflect, at.x + column, int(p.levels.width)), int(p.x.width) - 1);
    T const* const from = p.x.row(at.image, 0, y) + x * p.x.step;
    auto const levels =
        jpeg_levels<F>(read(from[0]), read(from[p.x.channel_stride]), read(from[2 * p.x.channel_stride]));
    if (is_inner(row, column)) planes.luma[row][column] = levels.v[0];
#pragma unroll
    for (int c = 0; c < 2; ++c) chroma.v[c][row + 1][column + 1] = levels.v[1 + c];
  });
}

// Downsampling: reads four pixels along both axes for every second pixel.
template <class F, class Combine>
__device__ __forceinline__ void halve(Chroma<F> const& chroma, Tile<F>& planes, Combine const& combine) {
  for (int i = int(threadIdx.x); i < kJpegSide * kJpegWidth / 2; i += kThreads) {
    int const x = i % (kJpegWidth / 2), y = i / (kJpegWidth / 2) % (kJpegSide / 2),
              c = i / (kJpegWidth * kJpegSide / 4);
    auto const row = [&](int k) {
      F const* const from = &chroma.v[c][2 * y + k][2 * x];
      return combine(from[0], from[1], from[2], from[3]);
    };
    planes.half[c][y][x] = combine(row(0), row(1), row(2), row(3));
  }
}

// The four blocks of a warp.
template <class F>
struct Double4 {
  F* data;
  int pitch, plane, y, x;  // in the plane of the image
  int const lane = int(threadIdx.x) % 32;

  __device__ __forceinline__ Double4(Tile<F>& planes, TilePosition const& at) {
    int const warp = int(threadIdx.x) / 32;
    plane = warp < 4 ? 0 : warp - 3;
    if (plane == 0) {
      data = &planes.luma[warp / 2 * 8][warp % 2 * 32];
      pitch = kJpegWidth + 1;
      y = at.y + warp / 2 * 8, x = at.x + warp % 2 * 32;
    } else {
      data = planes.half[plane - 1][0];
      pitch = kJpegWidth / 2 + 1;
      y = at.y / 2, x = at.x / 2;
    }
  }
  __device__ __forceinline__ F* row() const { return data + lane % 8 * pitch + lane / 8 * 8; }
  __device__ __forceinline__ void load_row(F (&v)[8]) const {
#pragma unroll
    for (int i = 0; i < 8; ++i) v[i] = row()[i];
  }
  __device__ __forceinline__ void transform_rows() const {
    F v[8];
    load_row(v);
    jpeg_transform<F>(v);
#pragma unroll
    for (int i = 0; i < 8; ++i) row()[i] = v[i];
  }
  __device__ __forceinline__ void load_column(F (&v)[8]) const {
#pragma unroll
    for (int i = 0; i < 8; ++i) v[i] = data[i * pitch + lane];
    jpeg_transform<F>(v);
  }
  // Transforms a column of coefficients back to values, and stores the rows of blocks that are inside the image.
  __device__ __forceinline__ void finish(F (&v)[8], JpegLevels<F> const& levels, int64_t image) const {
    jpeg_inverse<F>(v);
#pragma unroll
    for (int i = 0; i < 8; ++i) data[i * pitch + lane] = v[i];
    __syncwarp();
    load_row(v);
    jpeg_inverse<F>(v);
    int const column = x + lane / 8 * 8;
    if (column >= levels.width_of(plane)) return;
    F* const to = levels.row(image, plane, y + lane % 8) + column;
#pragma unroll
    for (int i = 0; i < 8; i += 4) *reinterpret_cast<Vector<F, 4>*>(to + i) = {v[i], v[i + 1], v[i + 2], v[i + 3]};
  }
};

template <class F>
__device__ __forceinline__ void find_steps(JpegTables<F> const& tables, int64_t image, F (&steps)[128]) {
  if (threadIdx.x < 128)
    steps[threadIdx.x] =
        jpeg_step(jpeg_table(tables, image, int(threadIdx.x)), jpeg_percent(jpeg_quality(tables, image)).value).value;
}

template <class T>
__device__ __forceinline__ void transform_tile(JpegBlocks<T> const& p, TilePosition const& at) {
  using F = Compute<T>;
  __shared__ Tile<F> planes;
  __shared__ Chroma<F> chroma;
  __shared__ F steps[128];
  find_steps(p.tables, at.image, steps);
  load_levels(p, at, planes, chroma);
  __syncthreads();
  halve(chroma, planes, [](F a, F b, F c, F d) { return jpeg_halved<F>(a, b, c, d); });
  __syncthreads();
  Double4<F> const four(planes, at);
  four.transform_rows();
  __syncwarp();
  F v[8];
  four.load_column(v);
#pragma unroll
  for (int i = 0; i < 8; ++i) v[i] = jpeg_quantized<F>(v[i], steps[(four.plane > 0 ? 64 : 0) + 8 * i + four.lane % 8]);
  four.finish(v, p.levels, at.image);
}

template <class T>
__global__ void __launch_bounds__(kThreads) run_blocks(__grid_constant__ JpegBlocks<T> const p) {
  transform_tile(p, TilePosition(p.levels));
}

// What find() gives, in shared memory.
template <class Find>
__device__ __forceinline__ auto const& shared_sample(Find const& find) {
  using Sample = decltype(find());
  __shared__ __align__(16) unsigned char memory[sizeof(Sample)];
  if (threadIdx.x == 0) new (memory) Sample(find());
  __syncthreads();
  return *reinterpret_cast<Sample const*>(memory);
}

template <class List>
__global__ void __launch_bounds__(kThreads) run_blocks_of_list(__grid_constant__ List const p) {
  int const b = p.sample_of(int(blockIdx.x));
  if (p.copies(b)) return;
  auto const& one = shared_sample([&] { return p.blocks(b); });
  transform_tile(one, TilePosition(one.levels, blockIdx.x - unsigned(p.first_of(b))));
}

template <class T>
__device__ __forceinline__ void transform_gradients(JpegBlocksBackward<T> const& p, TilePosition const& at) {
  using F = Compute<T>;
  __shared__ Tile<F> planes, grads;
  __shared__ Chroma<F> chroma;
  __shared__ F steps[128], sums[kWarps][64];
  JpegLevels<F> const& levels = p.forward.levels;
  find_steps(p.forward.tables, at.image, steps);
  load_levels(p.forward, at, planes, chroma);
  __syncthreads();
  halve(chroma, planes, [](F a, F b, F c, F d) { return jpeg_halved<F>(a, b, c, d); });
  __syncthreads();
  for_each_around([&](int row, int column) {
    int const height = int(levels.height), width = int(levels.width);
    int const y = clamp(at.y + row, 0, height - 1), x = clamp(at.x + column, 0, width - 1);
    JpegColor<F> of{};
    if (y < p.grad.height && x < p.grad.width) {
      auto const down = jpeg_doubled<F>(y, height), across = jpeg_doubled<F>(x, width);
      F doubled[2];
#pragma unroll
      for (int c = 0; c < 2; ++c) {
        F const *const near = levels.row(at.image, 1 + c, down.near), *const far =
                                                                          levels.row(at.image, 1 + c, down.far);
        doubled[c] = (near[across.near] * down.near_weight + far[across.near] * down.far_weight) * across.near_weight +
                     (near[across.far] * down.near_weight + far[across.far] * down.far_weight) * across.far_weight;
      }
      T const* const g = p.grad.row(at.image, 0, y) + x * p.grad.step;
      of = jpeg_clipped_rgb_vjp<F>(
          levels.row(at.image, 0, y)[x], doubled[0], doubled[1],
          JpegColor<F>{{read(g[0]), read(g[p.grad.channel_stride]), read(g[2 * p.grad.channel_stride])}});
    }
    if (is_inner(row, column)) grads.luma[row][column] = of.v[0];
#pragma unroll
    for (int c = 0; c < 2; ++c) chroma.v[c][row + 1][column + 1] = of.v[1 + c];
  });
  __syncthreads();
  halve(chroma, grads, [](F a, F b, F c, F d) { return jpeg_doubled_vjp<F>(a, b, c, d); });
  __syncthreads();

  Double4<F> const four(planes, at), of_four(grads, at);
  four.transform_rows();
  of_four.transform_rows();
  __syncwarp();
  F v[8], g[8], gradients[8];
  four.load_column(v);
  of_four.load_column(g);
  bool const inside = four.x + four.lane / 8 * 8 < levels.width_of(four.plane);
#pragma unroll
  for (int i = 0; i < 8; ++i) {
    gradients[i] = 0;
    jpeg_quantized_vjp<F>(v[i], steps[(four.plane > 0 ? 64 : 0) + 8 * i + four.lane % 8], g[i], gradients[i]);
    if (!inside) gradients[i] = 0;
  }
  if (p.grad_levels.data) of_four.finish(g, p.grad_levels, at.image);
  if (!p.gradients) return;
#pragma unroll
  for (int i = 0; i < 8; ++i) {
    gradients[i] = warp_reduce<32, 8>(gradients[i], Sum());
    if (four.lane < 8) sums[threadIdx.x / 32][8 * i + four.lane] = gradients[i];
  }
  __syncthreads();
  int const i = int(threadIdx.x), k = i % 64;
  if (i < 128)
    p.gradients[(at.image * p.chunks + at.tile) * 128 + i] =
        i < 64 ? (sums[0][k] + sums[1][k]) + (sums[2][k] + sums[3][k]) : sums[4][k] + sums[5][k];
}

template <class T>
__global__ void __launch_bounds__(kThreads) run_blocks_backward(__grid_constant__ JpegBlocksBackward<T> const p) {
  transform_gradients(p, TilePosition(p.forward.levels));
}
template <class T>
__global__ void __launch_bounds__(kThreads) run_blocks_of_list_backward(__grid_constant__ JpegListBackward<T> const p) {
  int const b = p.sample_of(int(blockIdx.x));
  if (p.copies(b)) return;
  auto const& one = shared_sample([&] { return p.blocks_backward(b); });
  transform_gradients(one, TilePosition(one.forward.levels, blockIdx.x - unsigned(p.first_of(b))));
}

// --- pixels, four per thread -----------------------------------------------------------------------------------------

constexpr int kPixelsPerThread = 4, kRows = 8;

// Four upsampled pixels of a row of chroma, interpolated between a near and a far row and column of the downsampled
// plane. Out of bounds that plane replicates its border, or is zero.
template <class F>
__device__ __forceinline__ void spread(JpegLevels<F> const& levels, int64_t image, int plane, JpegPair<F> const& rows,
                                       int x, F near_weight, F far_weight, bool replicate, F (&v)[kPixelsPerThread]) {
  int const n = int(levels.width) / 2, first = x / 2;
  F const *const near = levels.row(image, plane, rows.near) + first, *const far =
                                                                         levels.row(image, plane, rows.far) + first;
  auto const interpolate = [&](F a, F b) { return a * rows.near_weight + b * rows.far_weight; };
  auto const a = *reinterpret_cast<Vector<F, 2> const*>(near), b = *reinterpret_cast<Vector<F, 2> const*>(far);
  F half[4] = {0, interpolate(a.v[0], b.v[0]), interpolate(a.v[1], b.v[1]), 0};
  if (first > 0)
    half[0] = interpolate(near[-1], far[-1]);
  else if (replicate)
    half[0] = half[1];
  if (first + 2 < n)
    half[3] = interpolate(near[2], far[2]);
  else if (replicate)
    half[3] = half[2];
#pragma unroll
  for (int i = 0; i < kPixelsPerThread; ++i)
    v[i] = half[1 + i / 2] * near_weight + half[i % 2 ? 2 + i / 2 : i / 2] * far_weight;
}

template <class T>
__device__ __forceinline__ void store_pixels(Images<T> const& to, int64_t image, int c, int y, int x, bool vectorized,
                                             Compute<T> const (&v)[kPixelsPerThread]) {
  T* const row = to.row(image, c, y);
  if (vectorized) {
    store_vector(row + x, v);
  } else {
#pragma unroll
    for (int i = 0; i < kPixelsPerThread; ++i)
      if (x + i < to.width) row[(x + i) * to.step] = round_to<T>(v[i]);
  }
}
template <class T>
KV_HD bool is_vectorizable(Images<T> const& x) {
  return x.step == 1 && (x.width | x.row_stride | x.channel_stride | x.batch_stride) % kPixelsPerThread == 0 &&
         reinterpret_cast<uintptr_t>(x.data) % (kPixelsPerThread * sizeof(T)) == 0;
}
template <class T>
dim3 blocks_of(Images<T> const& x) {
  return dim3(unsigned(ceil_div(x.width, 32 * kPixelsPerThread)), unsigned(ceil_div(x.height, kRows)),
              unsigned(min(x.batch, int64_t(65535))));
}

// Four pixels of an image from (y, x) on; `rows` are those of chroma.
template <class T>
__device__ __forceinline__ void write_pixels(JpegPixels<T> const& p, int64_t image, JpegPair<Compute<T>> const& rows,
                                             int y, int x, bool vectorized) {
  using F = Compute<T>;
  F chroma[2][kPixelsPerThread], rgb[3][kPixelsPerThread];
#pragma unroll
  for (int c = 0; c < 2; ++c)
    spread(p.levels, image, 1 + c, rows, x, rows.near_weight, rows.far_weight, true, chroma[c]);
  auto const luma = *reinterpret_cast<Vector<F, kPixelsPerThread> const*>(p.levels.row(image, 0, y) + x);
#pragma unroll
  for (int i = 0; i < kPixelsPerThread; ++i) {
    auto const result = jpeg_rgb<F>(luma.v[i], chroma[0][i], chroma[1][i]);
#pragma unroll
    for (int c = 0; c < 3; ++c) rgb[c][i] = jpeg_clip<F>(result.v[c]);
  }
#pragma unroll
  for (int c = 0; c < 3; ++c) store_pixels(p.y, image, c, y, x, vectorized, rgb[c]);
}

template <class T>
__global__ void __launch_bounds__(32 * kRows) run_pixels(__grid_constant__ JpegPixels<T> const p, bool vectorized) {
  int const x = int(blockIdx.x * 32 + threadIdx.x) * kPixelsPerThread, y = int(blockIdx.y * kRows + threadIdx.y);
  if (x >= p.y.width || y >= p.y.height) return;
  auto const rows = jpeg_doubled<Compute<T>>(y, int(p.levels.height));
  for (int64_t image = blockIdx.z; image < p.y.batch; image += gridDim.z)
    write_pixels(p, image, rows, y, x, vectorized);
}

// A block has a tile of an image.
constexpr int kTileThreads = kJpegSide * kJpegWidth / kPixelsPerThread;
// The first pixel of a thread.
struct TilePixel {
  int y, x;
  template <class F>
  __device__ __forceinline__ TilePixel(JpegLevels<F> const& levels, int first) {
    constexpr int kAcross = kJpegWidth / kPixelsPerThread;
    TilePosition const at(levels, blockIdx.x - unsigned(first));
    y = at.y + int(threadIdx.x) / kAcross, x = at.x + int(threadIdx.x) % kAcross * kPixelsPerThread;
  }
};
template <class T>
__device__ __forceinline__ void copy_pixels(Images<T const> const& from, Images<T> const& to, TilePixel const& at) {
  for (int c = 0; c < 3; ++c)
    for (int i = at.x; i < min(at.x + kPixelsPerThread, int(to.width)); ++i)
      to.row(0, c, at.y)[i * to.step] = from.row(0, c, at.y)[i * from.step];
}

template <class T>
__global__ void __launch_bounds__(kTileThreads) run_pixels_of_list(__grid_constant__ JpegList<T> const p) {
  int const b = p.sample_of(int(blockIdx.x));
  auto const& one = shared_sample([&] { return p.pixels(b); });
  TilePixel const at(one.levels, p.first_of(b));
  if (at.x >= one.y.width || at.y >= one.y.height) return;
  if (p.copies(b)) return copy_pixels(images_of<T>(p.list.images[b], p.channels), one.y, at);
  write_pixels(one, 0, jpeg_doubled<Compute<T>>(at.y, int(one.levels.height)), at.y, at.x, is_vectorizable(one.y));
}

// The gradients of four pixels of an image from (y, x) on.
template <class T>
__device__ __forceinline__ void write_gradients(JpegPixelsBackward<T> const& p, int64_t image, int y, int x,
                                                bool vectorized) {
  using F = Compute<T>;
  JpegLevels<F> const& levels = p.grad_levels;
  int const width = int(p.grad_x.width), height = int(p.grad_x.height);
  // The last row and column also serve the pixels out of bounds.
  int const after = y + 1 < height ? y + 1 : int(levels.height);
  int const across = x + kPixelsPerThread < width ? x + kPixelsPerThread : int(levels.width);
  F sums[3][kPixelsPerThread]{};
  for (int row = y; row < after; ++row) {
    auto const rows = jpeg_halved_vjp<F>(row, int(levels.height));
    for (int column = x; column < across; column += kPixelsPerThread) {
      F v[3][kPixelsPerThread];
      auto const luma = *reinterpret_cast<Vector<F, kPixelsPerThread> const*>(levels.row(image, 0, row) + column);
#pragma unroll
      for (int c = 0; c < 2; ++c) {
        spread(levels, image, 1 + c, rows, column, F(kJpegInner), F(kJpegOuter), false, v[1 + c]);
        F const *const near = levels.row(image, 1 + c, rows.near), *const far = levels.row(image, 1 + c, rows.far);
        auto const mirrored = [&](int i) {
          return (near[i] * rows.near_weight + far[i] * rows.far_weight) * F(kJpegOuter);
        };
        if (column == 0) v[1 + c][1] += mirrored(0);
        if (column + kPixelsPerThread == levels.width) v[1 + c][2] += mirrored(int(levels.width) / 2 - 1);
      }
#pragma unroll
      for (int i = 0; i < kPixelsPerThread; ++i) {
        v[0][i] = luma.v[i];
        int const to = min(column + i, width - 1) - x;
#pragma unroll
        for (int k = 0; k < kPixelsPerThread; ++k)
          if (k == to)
#pragma unroll
            for (int c = 0; c < 3; ++c) sums[c][k] += v[c][i];
      }
    }
  }
  F rgb[3][kPixelsPerThread];
#pragma unroll
  for (int i = 0; i < kPixelsPerThread; ++i) {
    auto const result = jpeg_levels_vjp<F>(sums[0][i], sums[1][i], sums[2][i]);
#pragma unroll
    for (int c = 0; c < 3; ++c) rgb[c][i] = result.v[c];
  }
#pragma unroll
  for (int c = 0; c < 3; ++c) store_pixels(p.grad_x, image, c, y, x, vectorized, rgb[c]);
}

template <class T>
__global__ void __launch_bounds__(32 * kRows)
    run_pixels_backward(__grid_constant__ JpegPixelsBackward<T> const p, bool vectorized) {
  int const x = int(blockIdx.x * 32 + threadIdx.x) * kPixelsPerThread, y = int(blockIdx.y * kRows + threadIdx.y);
  if (x >= p.grad_x.width || y >= p.grad_x.height) return;
  for (int64_t image = blockIdx.z; image < p.grad_x.batch; image += gridDim.z)
    write_gradients(p, image, y, x, vectorized);
}
template <class T>
__global__ void __launch_bounds__(kTileThreads)
    run_pixels_of_list_backward(__grid_constant__ JpegListBackward<T> const p) {
  int const b = p.sample_of(int(blockIdx.x));
  auto const& one = shared_sample([&] { return p.pixels_backward(b); });
  TilePixel const at(one.grad_levels, p.first_of(b));
  if (at.x >= one.grad_x.width || at.y >= one.grad_x.height) return;
  if (p.copies(b)) return copy_pixels(p.given(b), one.grad_x, at);
  write_gradients(one, 0, at.y, at.x, is_vectorizable(one.grad_x));
}

// One block of threads per image, one thread per quantization step.
template <class F>
__global__ void __launch_bounds__(128) run_steps_backward(__grid_constant__ JpegStepsBackward<F> const p) {
  int64_t const b = blockIdx.x;
  int const i = int(threadIdx.x);
  F const* const gradients = p.gradients + b * p.chunks * 128 + i;
  F parts[4]{};
  int64_t chunk = 0;
  for (; chunk + 4 <= p.chunks; chunk += 4)
#pragma unroll
    for (int k = 0; k < 4; ++k) parts[k] += gradients[(chunk + k) * 128];
  for (; chunk < p.chunks; ++chunk) parts[0] += gradients[chunk * 128];
  auto const percent = jpeg_percent(jpeg_quality(p.tables, b));
  F const table = jpeg_table(p.tables, b, i);
  F const of = ((parts[0] + parts[1]) + (parts[2] + parts[3])) * jpeg_step(table, percent.value).derivative;
  (i < 64 ? p.grad_luma : p.grad_chroma)[b * 64 + i % 64] = of * percent.value;
  F const sum = block_sum<128>(of * table);
  if (i == 0) p.grad_quality[b] = sum * percent.derivative;
}

template <class F>
unsigned tiles_of(JpegLevels<F> const& levels, int64_t images) {
  return unsigned(images * (levels.height / kJpegSide) * ceil_div(levels.width, kJpegWidth));
}

}  // namespace

template <class T>
int jpeg_blocks(JpegBlocks<T> const& p, CUstream_st* stream) {
  run_blocks<<<tiles_of(p.levels, p.x.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int jpeg_pixels(JpegPixels<T> const& p, CUstream_st* stream) {
  run_pixels<<<blocks_of(p.y), dim3(32, kRows), 0, stream>>>(p, is_vectorizable(p.y));
  return cudaGetLastError();
}
template <class T>
int jpeg_blocks_list(JpegList<T> const& p, CUstream_st* stream) {
  static_assert(sizeof(JpegList<T>) <= 32764, "more than a kernel's parameters");
  run_blocks_of_list<<<unsigned(p.list.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int jpeg_pixels_list(JpegList<T> const& p, CUstream_st* stream) {
  run_pixels_of_list<<<unsigned(p.list.items), kTileThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int jpeg_blocks_backward(JpegBlocksBackward<T> const& p, CUstream_st* stream) {
  run_blocks_backward<<<tiles_of(p.forward.levels, p.grad.batch), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int jpeg_pixels_backward(JpegPixelsBackward<T> const& p, CUstream_st* stream) {
  run_pixels_backward<<<blocks_of(p.grad_x), dim3(32, kRows), 0, stream>>>(p, is_vectorizable(p.grad_x));
  return cudaGetLastError();
}
template <class T>
int jpeg_blocks_again(JpegListBackward<T> const& p, CUstream_st* stream) {
  static_assert(sizeof(JpegListBackward<T>) <= 32764, "more than a kernel's parameters");
  run_blocks_of_list<<<unsigned(p.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int jpeg_blocks_list_backward(JpegListBackward<T> const& p, CUstream_st* stream) {
  run_blocks_of_list_backward<<<unsigned(p.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int jpeg_pixels_list_backward(JpegListBackward<T> const& p, CUstream_st* stream) {
  run_pixels_of_list_backward<<<unsigned(p.items), kTileThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class F>
int jpeg_steps_backward(JpegStepsBackward<F> const& p, CUstream_st* stream) {
  run_steps_backward<<<unsigned(p.batch), 128, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(jpeg_blocks, JpegBlocks)
KV_INSTANTIATE(jpeg_pixels, JpegPixels)
KV_INSTANTIATE(jpeg_blocks_list, JpegList)
KV_INSTANTIATE(jpeg_pixels_list, JpegList)
KV_INSTANTIATE(jpeg_blocks_backward, JpegBlocksBackward)
KV_INSTANTIATE(jpeg_pixels_backward, JpegPixelsBackward)
KV_INSTANTIATE(jpeg_blocks_again, JpegListBackward)
KV_INSTANTIATE(jpeg_blocks_list_backward, JpegListBackward)
KV_INSTANTIATE(jpeg_pixels_list_backward, JpegListBackward)
KV_INSTANTIATE_COMPUTED(jpeg_steps_backward, JpegStepsBackward)

}  // namespace kv::enhance::cuda
