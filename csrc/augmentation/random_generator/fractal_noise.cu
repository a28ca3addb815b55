// Fractal noise on CUDA: a launch for each level. A block draws the words of its tile and of the pixels around it,
// finds the centers of four pixels, and then the pixels. Samples of a list have as many levels as they need.
#include <new>

#include "augmentation/random_generator/fractal_noise.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kFractalThreads = 256, kFractalColumns = 64, kFractalRows = 32;  // of a tile, even

// A tile of channel c of sample b.
template <class T>
__device__ __forceinline__ void make_tile(FractalNoise<T> const& p, int64_t b, int64_t c) {
  constexpr int kTall = kFractalRows + 2, kWide = kFractalColumns + 2;
  constexpr int kBlocks = kWide / 4 + 2;  // that a row may touch
  __shared__ uint32_t words[kTall][kWide];
  __shared__ double centers[kFractalRows / 2 + 1][kFractalColumns / 2 + 1];
  int const h = int(p.h), w = int(p.w), height = 2 * h - 1, width = 2 * w - 1;
  int const left = int(blockIdx.x) * kFractalColumns, top = int(blockIdx.y) * kFractalRows;
  int64_t const plane = b * p.channels + c, numbers = int64_t(height) * width;
  DrawSource const source = p.noise.source(b);
  int const first = max(left - 1, 0), end = min(left + kFractalColumns + 1, width);
  if (p.level > 0)
    for (int i = threadIdx.x; i < kTall * kBlocks; i += kFractalThreads) {
      int const row = i / kBlocks, y = top - 1 + row;
      if (y < 0 || y >= height) continue;
      int const start = y * width;
      int const block = (start + first) / 4 + i % kBlocks, x = 4 * block - start;  // the column of its first number
      if (x >= end) continue;
      PhiloxWords const four = p.words(source, c, numbers, block);
#pragma unroll
      for (int k = 0; k < 4; ++k)
        if (x + k >= first && x + k < end) words[row][x + k - left + 1] = four.w[k];
    }
  __syncthreads();
  double const* const coarse = p.level > 0 ? p.coarse + plane * p.coarse_plane : nullptr;
  auto const level = contrib::fractal_plane(
      [=](int v, int u) { return coarse ? coarse[v * w + u] : p.corner(source, c, v, u); },
      [=](int y, int x) { return p.level > 0 ? p.number_of(words[y - top + 1][x - left + 1]) : 0.; }, p.weight(b), p.h,
      p.w);
  constexpr int kCenterRows = kFractalRows / 2 + 1, kCenterColumns = kFractalColumns / 2 + 1;
  for (int i = threadIdx.x; i < kCenterRows * kCenterColumns; i += kFractalThreads) {
    int const row = i / kCenterColumns, column = i % kCenterColumns, y = top - 1 + 2 * row, x = left - 1 + 2 * column;
    if (y > 0 && y < height && x > 0 && x < width) centers[row][column] = level.center(y, x);
  }
  __syncthreads();
  bool const is_last = p.is_last();
  int const rows = is_last ? int(p.tall) : height, columns = is_last ? int(p.wide) : width;
  for (int i = threadIdx.x; i < kFractalRows * kFractalColumns; i += kFractalThreads) {
    int const y = top + i / kFractalColumns, x = left + i % kFractalColumns;
    if (y >= rows || x >= columns) continue;
    double value = 0;
    if (!is_last || (y < p.height && x < p.width))
      value =
          level.at(y, x, [&](int row, int column) { return centers[(row - top + 1) >> 1][(column - left + 1) >> 1]; });
    if (is_last)
      p.y[(plane * rows + y) * columns + x] = T(value);
    else
      p.fine[plane * p.fine_plane + int64_t(y) * width + x] = value;
  }
}

template <class T>
__global__ void __launch_bounds__(kFractalThreads) make_level(__grid_constant__ FractalNoise<T> const p) {
  make_tile(p, blockIdx.z / p.channels, blockIdx.z % p.channels);
}

template <class T>
__global__ void __launch_bounds__(kFractalThreads) make_level_of_list(__grid_constant__ FractalNoiseList<T> const p) {
  __shared__ __align__(16) unsigned char memory[sizeof(FractalNoise<T>)];
  int const b = int(blockIdx.z / p.all.channels);
  if (threadIdx.x == 0) new (memory) FractalNoise<T>(p.sample(b));
  __syncthreads();
  auto const& one = *reinterpret_cast<FractalNoise<T> const*>(memory);
  if (one.level < one.levels) make_tile(one, 0, blockIdx.z - b * p.all.channels);
}

dim3 tiles_of(int64_t height, int64_t width, int64_t planes) {
  return {unsigned(ceil_div(width, int64_t(kFractalColumns))), unsigned(ceil_div(height, int64_t(kFractalRows))),
          unsigned(planes)};
}

}  // namespace

template <class T>
int fractal_noise(FractalNoise<T> const& p, CUstream_st* stream) {
  int64_t const height = p.is_last() ? p.tall : p.fine_height(), width = p.is_last() ? p.wide : p.fine_width();
  make_level<T><<<tiles_of(height, width, p.batch * p.channels), kFractalThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int fractal_noise_list(FractalNoiseList<T> const& p, CUstream_st* stream) {
  int64_t height = 1, width = 1;
  for (int b = 0; b < p.count; ++b) {
    FractalNoise<T> const one = p.sample(b);
    if (one.level >= one.levels) continue;
    height = max(height, one.is_last() ? one.tall : one.fine_height());
    width = max(width, one.is_last() ? one.wide : one.fine_width());
  }
  make_level_of_list<T><<<tiles_of(height, width, p.count * p.all.channels), kFractalThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(fractal_noise, FractalNoise)
KV_INSTANTIATE_COMPUTED(fractal_noise_list, FractalNoiseList)

}  // namespace kv::augmentation::cuda
