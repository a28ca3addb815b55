// Sharpness on CUDA: a block takes tiles of 64 x 16 pixels, which it shares with a rim around.
#include "core/launch.cuh"
#include "sharpness.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

// A tile of one value a pixel, with a rim of R pixels, place by place.
template <class F, int R>
struct Tile {
  static constexpr int kWidth = kTileWidth + 2 * R, kHeight = kTileHeight + 2 * R;
  F v[kHeight][kWidth];

  // Calls f(x, y) -> value for all of its pixels, from -R on.
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

// Where a block's tile is in its planes.
template <class T>
struct Corner {
  int x, y, width, height;
  __device__ __forceinline__ explicit Corner(Planes<T> const& p) : width(int(p.width)), height(int(p.height)) {
    int const across = (width + kTileWidth - 1) / kTileWidth;
    x = int(blockIdx.x) % across * kTileWidth;
    y = int(blockIdx.x) / across * kTileHeight;
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

template <class T>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ Sharpness<T> const p) {
  using F = Compute<T>;
  __shared__ Tile<F, 1> tile;
  Corner<T const> const at(p.x);
  Corner<T> const to(p.y);
  for (int64_t plane = blockIdx.y; plane < p.x.count(); plane += gridDim.y) {
    F const factor = p.factor.of(plane);
    __syncthreads();  // the plane before may be in use
    tile.fill([&](int x, int y) { return at.has(x, y) ? read(at.of(p.x, plane, x, y)) : F(0); });
    __syncthreads();
#pragma unroll
    for (int i = int(threadIdx.x); i < kTileWidth * kTileHeight; i += kThreads) {
      int const x = i % kTileWidth, y = i / kTileWidth;
      if (!at.has(x, y)) continue;
      F const v = tile.at(x, y);
      F const result =
          at.is_inner(x, y) ? sharpened(v, smoothed(tile.sum_of_nine(x, y), v, F(0)), factor) : clipped(v, F(0));
      to.of(p.y, plane, x, y) = round_to<T>(result);
    }
  }
}

template <class T>
__global__ void __launch_bounds__(kThreads) run_backward(__grid_constant__ SharpnessBackward<T> const p) {
  using F = Compute<T>;
  __shared__ Tile<F, 2> image;
  __shared__ Tile<F, 1> around;
  __shared__ Tile<F, 0> own;
  __shared__ F sums[kThreads / 32];
  Corner<T const> const at(p.x);
  for (int64_t plane = blockIdx.y; plane < p.x.count(); plane += gridDim.y) {
    F const factor = p.factor.of(plane);
    F slope = 0;
    __syncthreads();  // the plane before may be in use
    image.fill([&](int x, int y) { return at.has(x, y) ? read(at.of(p.x, plane, x, y)) : F(0); });
    __syncthreads();
    around.fill([&](int x, int y) {
      if (!at.has(x, y)) return F(0);
      bool const is_own = x >= 0 && x < kTileWidth && y >= 0 && y < kTileHeight;
      F const v = image.at(x, y), g = read(at.of(p.grad, plane, x, y));
      if (!at.is_inner(x, y)) {
        if (is_own) own.v[y][x] = pull_clipped(v, g, F(0));
        return F(0);
      }
      auto const of = pull_sharpened(v, smoothed(image.sum_of_nine(x, y), v, F(0)), g, factor);
      if (is_own) {
        own.v[y][x] = of.own;
        slope += of.factor;
      }
      return of.around;
    });
    __syncthreads();
    Corner<T> const to(p.grad_x);
    for (int i = int(threadIdx.x); p.grad_x.data && i < kTileWidth * kTileHeight; i += kThreads) {
      int const x = i % kTileWidth, y = i / kTileWidth;
      if (at.has(x, y))
        to.of(p.grad_x, plane, x, y) =
            round_to<T>(own.at(x, y) + smoothed(around.sum_of_nine(x, y), around.at(x, y), F(0)));
    }
    if (!p.slopes) continue;
    slope = warp_sum(slope);
    if (threadIdx.x % 32 == 0) sums[threadIdx.x / 32] = slope;
    __syncthreads();
    if (threadIdx.x == 0) {
      F sum = 0;
      for (F const& of_warp : sums) sum += of_warp;
      p.slopes[plane * p.pieces + blockIdx.x] = sum;
    }
  }
}

template <class T>
dim3 tiles_of(Planes<T> const& x) {
  return dim3(unsigned(ceil_div(x.width, kTileWidth) * ceil_div(x.height, kTileHeight)),
              unsigned(min(x.count(), int64_t(65535))));
}

}  // namespace

template <class T>
int sharpness(Sharpness<T> const& p, CUstream_st* stream) {
  run<<<tiles_of(p.x), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int sharpness_backward(SharpnessBackward<T> const& p, CUstream_st* stream) {
  run_backward<<<tiles_of(p.x), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sharpness, Sharpness)
KV_INSTANTIATE(sharpness_backward, SharpnessBackward)

}  // namespace kv::cuda
