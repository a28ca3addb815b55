// Warps of images that are made of pieces, with programs of color steps, on CUDA. A block collects the pixels that a
// tile of the result reads in shared memory, each from the image of its piece. A thread samples a column of four pixels
// and applies the program to them.
#include "augmentation/mixing/warp_pieces.h"
#include "color/program.cuh"
#include "geometry/transform/sample_unstaged.cuh"
#include "geometry/transform/source_tile.cuh"

namespace kv::augmentation::cuda {
namespace {

using color::cuda::kThreads;
using geometry::cuda::BlockTiles;
using geometry::cuda::kRowStep;
using geometry::cuda::TapBounds;
using geometry::cuda::Tile;
using geometry::cuda::TileGrid;
static_assert(kThreads == geometry::cuda::kThreads);
constexpr int kChannels = 3, kOwnPixels = geometry::cuda::kPixelsPerThread;
// Of the pixels that a tile reads. Rows one below the other are in different banks.
constexpr int kPitch = 72, kSourceRows = 60, kPlane = kPitch * kSourceRows, kVector = 4;

// A piece of which pixels are read.
template <class T>
struct __align__(16) ReadPiece {
  int left, top, right, bottom, dx, dy;
  T const* image;  // null where there is none

  static __device__ __forceinline__ int limited(int64_t x) {
    return int(clamp(x, -int64_t(kMaxPieceRow), int64_t(kMaxPieceRow)));
  }
  // Number n of sample b; 0 is the image itself.
  __device__ __forceinline__ void init(WarpPieces<T> const& p, int64_t b, int n) {
    Images<T const> const& x = p.warp.x;
    left = top = dx = dy = 0;
    right = int(x.width), bottom = int(x.height);
    image = x.row(b, 0, 0);
    if (n == 0) return;
    Piece const piece = p.piece(b, n - 1);
    left = limited(piece.left), top = limited(piece.top), right = limited(piece.right), bottom = limited(piece.bottom);
    dx = limited(piece.dx), dy = limited(piece.dy);
    int64_t const source = b + limited(piece.source);
    image = source >= 0 && source < x.batch ? x.row(source, 0, 0) : nullptr;
  }
  __device__ __forceinline__ bool has(int x, int y) const { return left <= x && x < right && top <= y && y < bottom; }
  __device__ __forceinline__ bool touches(TapBounds const& box) const {
    return left <= box.right && box.left < right && top <= box.bottom && box.top < bottom;
  }
  __device__ __forceinline__ bool covers(TapBounds const& box) const {
    return left <= box.left && box.right < right && top <= box.top && box.bottom < bottom;
  }
  // Whether all pixels of a box that it covers are in its image.
  __device__ __forceinline__ bool has_image_of(TapBounds const& box, Images<T const> const& x) const {
    return image && box.left + dx >= 0 && box.top + dy >= 0 && box.right + dx < int(x.width) &&
           box.bottom + dy < int(x.height);
  }
  // The first channel of what it shows at (x, y): null for 0, where there is no pixel.
  __device__ __forceinline__ T const* pixel(Images<T const> const& images, int x, int y) const {
    int const u = x + dx, v = y + dy;
    bool const exists = image && unsigned(u) < unsigned(images.width) && unsigned(v) < unsigned(images.height);
    return exists ? image + (v * int(images.row_stride) + u * int(images.step)) : nullptr;
  }
};

// The last one of a set of pieces, as bits by number, that has a pixel. The first one of the set has all.
template <class T>
__device__ __forceinline__ ReadPiece<T> const& piece_at(ReadPiece<T> const* pieces, unsigned set, int x, int y) {
  int n = 31 - __clz(int(set));
  while ((set & (set - 1)) && !pieces[n].has(x, y)) {
    set ^= 1u << n;
    n = 31 - __clz(int(set));
  }
  return pieces[n];
}

// The numbers of the pieces that pixels of a box within the images are read from, as bits. By all threads of a warp.
template <class T>
__device__ __forceinline__ unsigned pieces_of(ReadPiece<T> const* pieces, int count, TapBounds const& box) {
  int const lane = int(threadIdx.x) % 32;
  bool const exists = lane <= count;
  unsigned const touching = __ballot_sync(~0u, exists && pieces[lane].touches(box));
  unsigned const covering = __ballot_sync(~0u, exists && pieces[lane].covers(box));
  return touching & (~0u << (31 - __clz(int(covering))));  // what a copy hides is not read
}

// A sample tap by tap: where the taps do not fit shared memory, or where a tap of weight 0, which contributes nothing,
// may not be finite.
template <class T>
__device__ __noinline__ void sample_by_taps(WarpPieces<T> const& p, ReadPiece<T> const* pieces, Tile<float> const& tile,
                                            int x, int y, float (&result)[kChannels]) {
  geometry::Sample<T> const& warp = p.warp;
  float u, v, wx[2], wy[2];
  geometry::cuda::TileCoords<float>(warp.coords, tile).at(y, x, u, v);
  geometry::cuda::TapWindow<2, float> const window(warp, u, v);
  geometry::tap_weights(window.tx, wx);
  geometry::tap_weights(window.ty, wy);
  float sum[kChannels]{};
#pragma unroll 1
  for (int i = 0; i < 4; ++i) {
    int const column = window.x + (i & 1), row = window.y + (i >> 1);
    float const weight = wx[i & 1] * wy[i >> 1];
    if (weight == 0) continue;
    bool const inside = unsigned(column) < unsigned(warp.x.width) && unsigned(row) < unsigned(warp.x.height);
    T const* const from =
        inside ? piece_at(pieces, ~0u >> (31 - p.count), column, row).pixel(warp.x, column, row) : nullptr;
#pragma unroll
    for (int k = 0; k < kChannels; ++k)
      sum[k] += weight * (!inside ? warp.fill_value(tile.b, k) : from ? read(from[k * warp.x.channel_stride]) : 0);
  }
#pragma unroll
  for (int k = 0; k < kChannels; ++k) result[k] = sum[k];
}

template <class T>
__device__ __forceinline__ void copy_pixel(float* to, T const* from, int channel_stride) {
#pragma unroll
  for (int k = 0; k < kChannels; ++k)
    if constexpr (sizeof(T) == 4)
      __pipeline_memcpy_async(to + k * kPlane, from + k * channel_stride, 4);
    else
      to[k * kPlane] = read(from[k * channel_stride]);
}
// Four adjacent pixels, which are a vector.
template <class T>
__device__ __forceinline__ void copy_vector(float* to, T const* from, int channel_stride) {
  if constexpr (sizeof(T) == 4) {
#pragma unroll
    for (int k = 0; k < kChannels; ++k) __pipeline_memcpy_async(to + k * kPlane, from + k * channel_stride, 16);
  } else {
    Vector<T, 4> all[kChannels];
#pragma unroll
    for (int k = 0; k < kChannels; ++k) all[k] = *reinterpret_cast<Vector<T, 4> const*>(from + k * channel_stride);
#pragma unroll
    for (int k = 0; k < kChannels; ++k) {
      auto const& [x, y, z, w] = all[k].v;
      *reinterpret_cast<Vector<float, 4>*>(to + k * kPlane) = {read(x), read(y), read(z), read(w)};
    }
  }
}

__device__ __forceinline__ bool fits(TapBounds const& box) {
  return box.right - box.left + kVector <= kPitch && box.bottom - box.top < kSourceRows;
}

// Collects the pixels of a box; returns the column of its first one, so that vectors of images are vectors here.
template <class T>
__device__ __forceinline__ int load_box(WarpPieces<T> const& p, ReadPiece<T> const* pieces, int64_t b,
                                        TapBounds const& box, float* pixels) {
  Images<T const> const& x = p.warp.x;
  int const width = int(x.width), height = int(x.height);
  int const channel_stride = int(x.channel_stride), row_stride = int(x.row_stride), step = int(x.step);
  TapBounds const inner{max(box.left, 0), max(box.top, 0), min(box.right, width - 1), min(box.bottom, height - 1)};
  unsigned const set = pieces_of(pieces, p.count, inner);
  ReadPiece<T> const& last = pieces[31 - __clz(int(set))];
  bool const is_one = !(set & (set - 1)) && inner.left == box.left && inner.top == box.top &&
                      inner.right == box.right && inner.bottom == box.bottom && last.has_image_of(box, x);
  bool const has_vectors =
      step == 1 && ((reinterpret_cast<uintptr_t>(last.image) / sizeof(T) | width | row_stride | channel_stride) &
                    (kVector - 1)) == 0;
  if (is_one && has_vectors) {
    constexpr int kAcross = 16, kRowsAtOnce = kThreads / kAcross;
    int const skew = (box.left + last.dx) & (kVector - 1), columns = box.right - box.left + 1 + skew;
    int const first_row = int(threadIdx.x) / kAcross;
    for (int column = int(threadIdx.x) % kAcross * kVector; column < columns; column += kAcross * kVector) {
      int row = box.top + first_row;
      T const* from = last.image + ((row + last.dy) * row_stride + (box.left + last.dx - skew + column));
      float* to = pixels + (first_row * kPitch + column);
#pragma unroll 2
      for (; row <= box.bottom; row += kRowsAtOnce, to += kRowsAtOnce * kPitch, from += kRowsAtOnce * row_stride)
        copy_vector(to, from, channel_stride);
    }
    return skew;
  }
  constexpr int kRowsAtOnce = kThreads / 32;
  int const lane = int(threadIdx.x) % 32, warp = int(threadIdx.x) / 32;
  for (int column = box.left + lane; column <= box.right; column += 32) {
    float* to = pixels + (warp * kPitch + (column - box.left));
#pragma unroll 1
    for (int row = box.top + warp; row <= box.bottom; row += kRowsAtOnce, to += kRowsAtOnce * kPitch) {
      bool const inside = unsigned(column) < unsigned(width) && unsigned(row) < unsigned(height);
      T const* const from = inside ? piece_at(pieces, set, column, row).pixel(x, column, row) : nullptr;
      if (from) {
        copy_pixel(to, from, channel_stride);
      } else {
#pragma unroll
        for (int k = 0; k < kChannels; ++k) to[k * kPlane] = inside ? 0 : p.warp.fill_value(b, k);
      }
    }
  }
  return 0;
}

// The bounds of the taps of rows of a tile, where no horizon runs through them.
__device__ __forceinline__ TapBounds box_of_rows(Tile<float> const& tile, int first, int last, int right) {
  TapBounds box = TapBounds::empty();
#pragma unroll
  for (int i = 0; i < 4; ++i) {
    float u, v;
    tile.map.apply(float(i & 1 ? right : 0), float(i & 2 ? last : first), u, v);
    box.add<2>(u, v, geometry::cuda::kCoordRounding, float(geometry::cuda::kFarCoord));
  }
  box.move(tile.u, tile.v);
  return box;
}

template <class T, bool FrequentOnly>
__global__ void __launch_bounds__(kThreads, 4)
    warp_tiles_of_pieces(__grid_constant__ WarpPieces<T> const p, TileGrid const tiles) {
  __shared__ BlockTiles<float> block;
  __shared__ color::cuda::Sample<float> sample;
  __shared__ ReadPiece<T> pieces[kMaxReadPieces + 1];
  extern __shared__ __align__(16) float pixels[];
  constexpr float kScale = 1.f / color::cuda::kScale<T>;
  geometry::Sample<T> const& warp = p.warp;
  int const width = int(warp.y.width), height = int(warp.y.height);
  block.template prepare<2>(tiles, warp, warp.y.batch, width, height);
  int64_t const b = block.tiles[0].b;
  if (int(threadIdx.x) <= p.count) pieces[threadIdx.x].init(p, b, int(threadIdx.x));
  sample.prepare(p.program, b, false);

#pragma unroll 1
  for (int number = 0; number < int(tiles.per_block); ++number) {
    Tile<float> const& tile = block.tiles[number];
    if (tile.x >= width) break;
    TapBounds const whole = block.taps[number];
    int const column = geometry::cuda::column_in_tile(geometry::cuda::kAcross<float>),
              row = geometry::cuda::row_in_tile(geometry::cuda::kAcross<float>);
    int const x = tile.x + column, y = tile.y + row;
    bool const exists = x < width && y < height;
    // Where perspective brings far pixels together, half a tile at a time.
    int const parts = fits(whole) || whole.right - whole.left + kVector > kPitch ? 1 : 2;
    float c[kChannels][kOwnPixels]{};
#pragma unroll 1
    for (int part = 0; part < parts; ++part) {
      auto const is_own = [&](int j) { return parts == 1 || j / (kOwnPixels / 2) == part; };
      int const first_row = part * (geometry::kTile / 2);
      if (tile.y + first_row >= height) break;
      TapBounds const box =
          parts == 1 ? whole
                     : box_of_rows(tile, first_row, min(first_row + geometry::kTile / 2, height - tile.y) - 1,
                                   min(geometry::kTile, width - tile.x) - 1);
      bool const outside =
          box.right < 0 || box.bottom < 0 || box.left >= int(warp.x.width) || box.top >= int(warp.x.height);
      float poison = 0;  // NaN where a tap is no finite number
      if (outside) {
#pragma unroll
        for (int k = 0; k < kChannels; ++k)
#pragma unroll
          for (int j = 0; j < kOwnPixels; ++j)
            if (is_own(j)) c[k][j] = read(round_to<T>(warp.fill_value(b, k))) * kScale;
      } else if (fits(box)) {
        __syncthreads();  // before the current pixels are overwritten
        int const skew = load_box(p, pieces, b, box, pixels);
        __pipeline_commit();
        __pipeline_wait_prior(0);
        __syncthreads();
        geometry::cuda::ThreadCoords<float> const coords(tile, warp.coords, nullptr, column, row);
        float const* const origin = pixels + ((tile.v - box.top) * kPitch + (tile.u - box.left + skew));
#pragma unroll
        for (int j = 0; j < kOwnPixels; ++j) {
          if (!exists || !is_own(j) || y + j * kRowStep >= height) continue;
          float u, v, tx, ty, wx[2], wy[2];
          coords.at(j, u, v);
          int const at = geometry::cuda::near_tap<2>(u, tx), below = geometry::cuda::near_tap<2>(v, ty);
          float const* const taps = origin + (below * kPitch + at);
#pragma unroll
          for (int k = 0; k < kChannels; ++k) {
            float const sum = geometry::cuda::mean<2>(taps + k * kPlane, kPitch, 1, tx, ty, wx, wy);
            if (sizeof(T) > 1) poison += sum * 0;
            c[k][j] = read(round_to<T>(sum)) * kScale;
          }
        }
      }
      if (exists && !outside && (!fits(box) || poison != 0))
#pragma unroll
        for (int j = 0; j < kOwnPixels; ++j) {
          if (!is_own(j) || y + j * kRowStep >= height) continue;
          float sums[kChannels];
          sample_by_taps(p, pieces, tile, x, y + j * kRowStep, sums);
#pragma unroll
          for (int k = 0; k < kChannels; ++k) c[k][j] = read(round_to<T>(sums[k])) * kScale;
        }
    }
    if (!exists) continue;
#pragma unroll 1
    for (int s = 0; s < sample.length; ++s) {
      auto const entry = sample.order[s];
      color::cuda::EvaluateStep<float, kChannels, kOwnPixels, FrequentOnly> values{c, sample.p + entry.first};
      color::cuda::run_entry(entry, values);
    }
    color::Pixels const& to = p.program.y;
    dispatch_dtype(to.type, [&](auto stored) {
      using R = decltype(stored);
      if constexpr (sizeof(R) <= 4) {
        R* const first = static_cast<R*>(to.data) + to.offset(b) + (y * width + x) * int(to.step);
#pragma unroll
        for (int j = 0; j < kOwnPixels; ++j)
          if (y + j * kRowStep < height)
#pragma unroll
            for (int k = 0; k < kChannels; ++k)
              if (k < to.channels)
                first[k * int(to.channel_stride) + j * kRowStep * width * int(to.step)] =
                    round_to<R>(Compute<R>(c[k][j] * float(color::cuda::kScale<R>)));
      }
    });
  }
}

}  // namespace

template <class T>
int warp_pieces(WarpPieces<T> const& params, CUstream_st* stream) {
  WarpPieces<T> p = params;
  TileGrid const tiles(p.warp.y.batch, p.warp.y.height, p.warp.y.width,
                       geometry::tiles_per_block(p.warp.y.batch, p.warp.y.height, p.warp.y.width));
  bool const frequent = color::cuda::has_frequent_steps_only(p.program);
  if (frequent) color::cuda::invert_deviations(p.program);
  auto* const kernel = frequent ? warp_tiles_of_pieces<T, true> : warp_tiles_of_pieces<T, false>;
  constexpr int bytes = kChannels * kPlane * int(sizeof(float));
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  kernel<<<tiles.blocks, kThreads, bytes, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(warp_pieces, WarpPieces, float)
KV_INSTANTIATE_ONE(warp_pieces, WarpPieces, uint8_t)
KV_INSTANTIATE_ONE(warp_pieces, WarpPieces, ::kv::Half)
KV_INSTANTIATE_ONE(warp_pieces, WarpPieces, ::kv::BFloat16)

}  // namespace kv::augmentation::cuda
