// Fractal noise on CUDA: a launch for each level. A block draws the words of its tile and of the pixels around it,
// finds the centers of four pixels, and then the pixels.
#include "augmentation/random_generator/fractal_noise.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kFractalThreads = 256, kFractalColumns = 64, kFractalRows = 32;  // of a tile, even

template <class T>
__global__ void __launch_bounds__(kFractalThreads) make_level(__grid_constant__ FractalNoise<T> const p) {
  constexpr int kTall = kFractalRows + 2, kWide = kFractalColumns + 2;
  constexpr int kBlocks = kWide / 4 + 2;  // that a row may touch
  __shared__ uint32_t words[kTall][kWide];
  __shared__ double centers[kFractalRows / 2 + 1][kFractalColumns / 2 + 1];
  int const h = int(p.h), w = int(p.w), height = 2 * h - 1, width = 2 * w - 1;
  int const left = int(blockIdx.x) * kFractalColumns, top = int(blockIdx.y) * kFractalRows;
  int64_t const plane = blockIdx.z, b = plane / p.channels, c = plane % p.channels, numbers = int64_t(height) * width;
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
  double const* const coarse = p.level > 0 ? p.coarse + plane * h * w : nullptr;
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
  int const rows = is_last ? int(p.height) : height, columns = is_last ? int(p.width) : width;
  for (int i = threadIdx.x; i < kFractalRows * kFractalColumns; i += kFractalThreads) {
    int const y = top + i / kFractalColumns, x = left + i % kFractalColumns;
    if (y >= rows || x >= columns) continue;
    double const value =
        level.at(y, x, [&](int row, int column) { return centers[(row - top + 1) >> 1][(column - left + 1) >> 1]; });
    if (is_last)
      p.y[(plane * rows + y) * columns + x] = T(value);
    else
      p.fine[plane * numbers + int64_t(y) * width + x] = value;
  }
}

}  // namespace

template <class T>
int fractal_noise(FractalNoise<T> const& p, CUstream_st* stream) {
  int64_t const height = p.is_last() ? p.height : p.fine_height(), width = p.is_last() ? p.width : p.fine_width();
  dim3 const blocks(unsigned(ceil_div(width, int64_t(kFractalColumns))),
                    unsigned(ceil_div(height, int64_t(kFractalRows))), unsigned(p.batch * p.channels));
  make_level<T><<<blocks, kFractalThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(fractal_noise, FractalNoise)

}  // namespace kv::augmentation::cuda
