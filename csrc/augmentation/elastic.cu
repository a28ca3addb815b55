// Displacements of elastic transforms on CUDA, in one launch without intermediate images. A block traverses 128 columns
// of a plane downwards. It draws 32 rows of noise at a time into shared memory and filters them along x, and it filters
// 64 rows at a time along y. A window of 63 x 63 takes 126 products per pixel, so instructions limit the kernel.
#include "augmentation/elastic.h"
#include "core/row_prefetcher.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kThreads = 256, kTileWidth = 128, kTileHeight = 64;  // a thread filters 16 pixels along x, 4 x 8 along y
constexpr int kMaxBlocks = (3 + kTileWidth + kMaxElasticTaps + 3) / 4;  // of four pixels of noise in a row
constexpr int kNoisePitch = 4 * kMaxBlocks | 1;  // odd: the pixels of a column lie in different banks
constexpr int kPitch = kTileWidth + 4;           // of rows filtered along x: eight adjacent rows, too

struct ElasticMemory {
  alignas(16) float filtered[kTileHeight + kMaxElasticTaps - 1][kPitch];
  float noise[32][kNoisePitch];
  alignas(16) float kx[kMaxElasticTaps + 1], ky[kMaxElasticTaps + 1];
};

// N sums over windows that begin at 0 ... N - 1, for C adjacent columns. The last N values are kept in registers.
// Unlike that of filters/separable.cu it reads the weights by vectors.
template <int N, int C, class Load>
__device__ __forceinline__ void filter_windows(float const* weights, int taps, Load load, float (&sums)[N][C]) {
  float v[N][C];
#pragma unroll
  for (int i = 0; i < N - 1; ++i) load(i, v[i]);
  auto const add = [&](int tap, int i, float weight) {
    load(tap + N - 1, v[(i + N - 1) % N]);
#pragma unroll
    for (int n = 0; n < N; ++n)
#pragma unroll
      for (int c = 0; c < C; ++c) sums[n][c] = fmaf(weight, v[(i + n) % N][c], sums[n][c]);
  };
  int first = 0;
#pragma unroll 1
  for (; first + N <= taps; first += N)
#pragma unroll
    for (int i = 0; i < N; i += 4) {
      float4 const four = *reinterpret_cast<float4 const*>(weights + first + i);
      add(first + i, i, four.x);
      add(first + i + 1, i + 1, four.y);
      add(first + i + 2, i + 2, four.z);
      add(first + i + 3, i + 3, four.w);
    }
#pragma unroll
  for (int i = 0; i < N - 1; ++i) {
    if (first + i >= taps) break;
    add(first + i, i, weights[first + i]);
  }
}

// Drawn: the noise is drawn, not read.
template <bool Drawn>
__global__ void __launch_bounds__(kThreads, 2) blur_noise(__grid_constant__ ElasticDisplacements const p, int rows) {
  extern __shared__ __align__(16) unsigned char bytes[];
  ElasticMemory& memory = *reinterpret_cast<ElasticMemory*>(bytes);
  int const width = p.width, height = p.height, lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  unsigned const across = unsigned(width + kTileWidth - 1) / kTileWidth, down = unsigned(height + rows - 1) / rows;
  unsigned const tile_row = blockIdx.x / across, plane = tile_row / down;
  int const x0 = int(blockIdx.x - tile_row * across) * kTileWidth, y0 = int(tile_row - plane * down) * rows;
  int const y1 = min(y0 + rows, height), overlap = p.taps_y - 1, channel = int(plane & 1);
  int64_t const b = plane / 2, offset = int64_t(plane) * p.noise.pixels;
  float* const result = p.noise.y + offset;
  if (threadIdx.x <= kMaxElasticTaps) {
    memory.kx[threadIdx.x] = p.kx[threadIdx.x];
    memory.ky[threadIdx.x] = p.ky[threadIdx.x] * p.scale[channel];
  }
  [[maybe_unused]] DrawSource source{};
  if constexpr (Drawn) source = p.noise.source(b);
  // A draw makes four pixels, so rows are drawn in blocks of four from the first column that a window reads.
  int const left = x0 - p.taps_x / 2, begin = left & -4, before = left - begin;
  int const blocks = (before + min(kTileWidth, width - x0) + p.taps_x - 1 + 3) / 4;
  uint32_t const first_block = uint32_t(channel) * uint32_t(p.noise.blocks());

  for (int y = y0; y < y1; y += kTileHeight) {
    int const has = y == y0 ? 0 : overlap, needs = min(kTileHeight, y1 - y) + overlap;
    for (int row = has; row < needs; row += 32) {
      // Each thread has a row. Its warp draws every eighth block of four pixels, then filters 16 columns.
      int const at = y - p.taps_y / 2 + row + lane;
      bool const exists = row + lane < needs && at >= 0 && at < height;
#pragma unroll 2
      for (int block = warp; block < blocks; block += kThreads / 32) {
        int const column = begin + 4 * block;
        float v[4] = {};
        if (exists && column >= 0 && column < width) {
          if constexpr (Drawn) {
            PhiloxWords const words = source.words(p.noise.draw, first_block + uint32_t(at * width + column) / 4);
#pragma unroll
            for (int i = 0; i < 4; ++i) v[i] = symmetric_of<float>(words.w[i]);
          } else {
            float4 const four = *reinterpret_cast<float4 const*>(p.noise.x + offset + at * width + column);
            v[0] = four.x, v[1] = four.y, v[2] = four.z, v[3] = four.w;
          }
        }
#pragma unroll
        for (int i = 0; i < 4; ++i) memory.noise[lane][4 * block + i] = v[i];
      }
      __syncthreads();
      float sums[16][1] = {};
      float const* const window = memory.noise[lane] + before + 16 * warp;
      if (x0 + 16 * warp < width)
        filter_windows(memory.kx, p.taps_x, [&](int i, float(&v)[1]) { v[0] = window[i]; }, sums);
      if (row + lane < needs)
#pragma unroll
        for (int i = 0; i < 16; i += 4)
          *reinterpret_cast<float4*>(memory.filtered[row + lane] + 16 * warp + i) = {sums[i][0], sums[i + 1][0],
                                                                                     sums[i + 2][0], sums[i + 3][0]};
      __syncthreads();
    }

    float sums[8][4] = {};
    float const* const window = memory.filtered[8 * warp] + 4 * lane;
    if (y + 8 * warp < y1)
      filter_windows(
          memory.ky, p.taps_y,
          [&](int i, float(&v)[4]) {
            float4 const four = *reinterpret_cast<float4 const*>(window + i * kPitch);
            v[0] = four.x, v[1] = four.y, v[2] = four.z, v[3] = four.w;
          },
          sums);
    int const x = x0 + 4 * lane;
#pragma unroll
    for (int n = 0; n < 8; ++n) {
      int const to = y + 8 * warp + n;
      if (to < y1 && x < width)
        *reinterpret_cast<float4*>(result + to * width + x) = {sums[n][0], sums[n][1], sums[n][2], sums[n][3]};
    }
    // The last rows of this tile are the first ones of the next.
    if (y + kTileHeight < y1) {
      __syncthreads();
      for (int i = threadIdx.x; i < overlap * kPitch / 4; i += kThreads)
        reinterpret_cast<float4*>(memory.filtered[0])[i] =
            reinterpret_cast<float4 const*>(memory.filtered[kTileHeight])[i];
    }
    __syncthreads();
  }
}

}  // namespace

int elastic_displacements(ElasticDisplacements const& p, CUstream_st* stream) {
  int64_t const planes = 2 * p.noise.batch, columns = planes * ceil_div(p.width, kTileWidth);
  int64_t const resident = 2 * multiprocessors();
  int const rows = strip_height(columns, p.height, max(p.taps_y, 8), resident, resident);
  auto const kernel = p.noise.x ? blur_noise<false> : blur_noise<true>;
  if (int error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, sizeof(ElasticMemory)))
    return error;
  kernel<<<unsigned(columns * ceil_div(p.height, rows)), kThreads, sizeof(ElasticMemory), stream>>>(p, rows);
  return cudaGetLastError();
}

bool has_elastic_displacements() { return int64_t(sizeof(ElasticMemory)) <= max_shared_bytes(sizeof(ElasticMemory)); }

}  // namespace kv::augmentation::cuda
