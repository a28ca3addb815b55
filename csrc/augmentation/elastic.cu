// Displacements of elastic transforms on CUDA, in one launch without intermediate images. A block traverses 128 columns
// of a plane downwards. It draws 32 rows of noise at a time into shared memory and filters them along x, and it filters
// 64 rows at a time along y. A window of 63 x 63 takes 126 products per pixel, so instructions limit the kernel.
#include <new>

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
  alignas(16) float noise[32][kNoisePitch];
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

// The weights of both axes, in shared memory; those of y are scaled.
__device__ __forceinline__ void set_weights(ElasticDisplacements const& p, int channel, ElasticMemory& memory) {
  int const t = int(threadIdx.x);
  float const scale = p.noise.parameters ? p.noise.parameters[1] : p.scale[channel];
  if (p.sigma[0] == 0) {
    if (t <= kMaxElasticTaps) memory.kx[t] = p.kx[t], memory.ky[t] = p.ky[t] * scale;
    return;
  }
  // In double, as the host computes those of one size. The first warps have the weights of x, the next ones those of y.
  constexpr int kWeights = kMaxElasticTaps + 1;
  double* const weights = reinterpret_cast<double*>(memory.noise);
  int const axis = t / kWeights, tap = t % kWeights;
  double weight = 0;
  if (axis < 2) {
    int const taps = axis ? p.taps_y : p.taps_x;
    if (tap < taps)
      weight =
          filters::tap_weight(filters::Taps<double>{nullptr, 0, p.sigma[axis], taps, taps / 2, true, false}, 0, tap);
    weights[t] = weight;
  }
  __syncthreads();
  if (axis < 2) {
    double sum = 0;
    for (int i = 0; i < kWeights; ++i) sum += weights[axis * kWeights + i];
    float const normalized = float(weight / sum);
    axis ? memory.ky[tap] = normalized * scale : memory.kx[tap] = normalized;
  }
  __syncthreads();
}

// A strip of a plane. Drawn: the noise is drawn, not read. Aligned: rows are multiples of four pixels.
template <bool Drawn, bool Aligned>
__device__ __forceinline__ void blur_strip(ElasticDisplacements const& p, unsigned block_index, int rows) {
  extern __shared__ __align__(16) unsigned char bytes[];
  ElasticMemory& memory = *reinterpret_cast<ElasticMemory*>(bytes);
  int const width = p.width, height = p.height, lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  unsigned const across = unsigned(width + kTileWidth - 1) / kTileWidth, down = unsigned(height + rows - 1) / rows;
  unsigned const tile_row = block_index / across, plane = tile_row / down;
  int const x0 = int(block_index - tile_row * across) * kTileWidth, y0 = int(tile_row - plane * down) * rows;
  int const y1 = min(y0 + rows, height), overlap = p.taps_y - 1, channel = int(plane & 1);
  int64_t const b = plane / 2, offset = int64_t(plane) * p.noise.pixels;
  float* const result = p.noise.y + offset;
  bool const is_chosen = p.noise.is_chosen(b);
  set_weights(p, channel, memory);
  [[maybe_unused]] DrawSource source{};
  if constexpr (Drawn) source = p.noise.source(b);
  // A draw makes four pixels, which are counted row by row. So rows are drawn in blocks of four from the first column
  // that a window reads, or up to three before it.
  int const left = x0 - p.taps_x / 2;
  int const blocks = ((Aligned ? left & 3 : 3) + min(kTileWidth, width - x0) + p.taps_x - 1 + 3) / 4;
  uint32_t const first_block = uint32_t(channel) * uint32_t(p.noise.blocks());

  for (int y = y0; y < y1; y += kTileHeight) {
    int const has = y == y0 ? 0 : overlap, needs = min(kTileHeight, y1 - y) + overlap;
    for (int row = has; row < needs; row += 32) {
      // Each thread has a row. Its warp draws every eighth block of four pixels, then filters 16 columns.
      int at = y - p.taps_y / 2 + row + lane;
      if (p.is_mirrored) at = border_index(Border::reflect, at, height);
      bool const exists = is_chosen && row + lane < needs && at >= 0 && at < height;
      int const before = (Aligned ? left : at * width + left) & 3, begin = left - before;
#pragma unroll 2
      for (int block = warp; block < blocks; block += kThreads / 32) {
        int const column = begin + 4 * block;
        float v[4] = {};
        if (exists && column + (Aligned ? 0 : 3) >= 0 && column < width) {
          if constexpr (Drawn) {
            PhiloxWords const words = source.words(p.noise.draw, first_block + uint32_t(at * width + column) / 4);
#pragma unroll
            for (int i = 0; i < 4; ++i) v[i] = symmetric_of<float>(words.w[i]);
          } else if constexpr (Aligned) {
            float4 const four = *reinterpret_cast<float4 const*>(p.noise.x + offset + at * width + column);
            v[0] = four.x, v[1] = four.y, v[2] = four.z, v[3] = four.w;
          } else {
#pragma unroll
            for (int i = 0; i < 4; ++i)
              if (unsigned(column + i) < unsigned(width)) v[i] = p.noise.x[offset + at * width + column + i];
          }
          if constexpr (!Aligned)
#pragma unroll
            for (int i = 0; i < 4; ++i)
              if (unsigned(column + i) >= unsigned(width)) v[i] = 0;
        }
#pragma unroll
        for (int i = 0; i < 4; ++i) memory.noise[lane][4 * block + i] = v[i];
      }
      __syncthreads();
      int const radius = p.taps_x / 2,
                beyond = radius + min(x0 + kTileWidth - width, 0);  // columns behind the last one
      if (p.is_mirrored && (x0 == 0 || beyond > 0)) {
        float* const columns = memory.noise[lane] - begin;
        for (int i = 1 + warp; i <= radius - x0; i += kThreads / 32) columns[-i] = columns[i];
        for (int i = 1 + warp; i <= beyond; i += kThreads / 32) columns[width - 1 + i] = columns[width - 1 - i];
        __syncthreads();
      }
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
      if (to >= y1 || x >= width) continue;
      if constexpr (Aligned) {
        *reinterpret_cast<float4*>(result + to * width + x) = {sums[n][0], sums[n][1], sums[n][2], sums[n][3]};
      } else {
#pragma unroll
        for (int i = 0; i < 4; ++i)
          if (x + i < width) result[to * width + x + i] = sums[n][i];
      }
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

template <bool Drawn, bool Aligned>
__global__ void __launch_bounds__(kThreads, 2) blur_noise(__grid_constant__ ElasticDisplacements const p, int rows) {
  blur_strip<Drawn, Aligned>(p, blockIdx.x, rows);
}

template <bool Drawn>
__global__ void __launch_bounds__(kThreads, 2)
    blur_noise_of_list(__grid_constant__ ElasticDisplacementsList const p, int rows) {
  __shared__ __align__(16) unsigned char memory[sizeof(ElasticDisplacements)];
  int const b = p.list.sample_of(int(blockIdx.x));
  auto& one = *reinterpret_cast<ElasticDisplacements*>(memory);
  if (threadIdx.x == 0) one = p.sample(b);
  __syncthreads();
  unsigned const block = blockIdx.x - unsigned(p.list.first[b]);
  one.width % 4 == 0 ? blur_strip<Drawn, true>(one, block, rows) : blur_strip<Drawn, false>(one, block, rows);
}

// Of planes with so many columns of tiles and rows.
int strip_rows(int64_t columns, int height, int taps_y) {
  int64_t const resident = 2 * multiprocessors();
  return strip_height(columns, height, max(taps_y, 8), resident, resident);
}

template <class Kernel, class Params>
int launch_strips(Kernel kernel, Params const& p, int64_t blocks, int rows, CUstream_st* stream) {
  if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  if (int error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, sizeof(ElasticMemory)))
    return error;
  kernel<<<unsigned(blocks), kThreads, sizeof(ElasticMemory), stream>>>(p, rows);
  return cudaGetLastError();
}

}  // namespace

int elastic_displacements(ElasticDisplacements const& p, CUstream_st* stream) {
  int64_t const columns = 2 * p.noise.batch * ceil_div(p.width, kTileWidth);
  int const rows = strip_rows(columns, p.height, p.taps_y);
  bool const aligned = p.width % 4 == 0;
  auto const kernel = p.noise.x ? (aligned ? blur_noise<false, true> : blur_noise<false, false>)
                                : (aligned ? blur_noise<true, true> : blur_noise<true, false>);
  return launch_strips(kernel, p, columns * ceil_div(p.height, rows), rows, stream);
}

int elastic_displacements_list(ElasticDisplacementsList const& given, CUstream_st* stream) {
  ElasticDisplacementsList p = given;
  int64_t columns = 0, blocks = 0;
  int highest = 1;
  for (int b = 0; b < p.list.count; ++b) {
    columns += 2 * ceil_div(p.list.width[b], kTileWidth);
    highest = max(highest, p.list.height[b]);
  }
  int const rows = strip_rows(columns, highest, p.all.taps_y);
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += 2 * ceil_div(p.list.width[b], kTileWidth) * ceil_div(p.list.height[b], rows);
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  return launch_strips(p.all.noise.x ? blur_noise_of_list<false> : blur_noise_of_list<true>, p, blocks, rows, stream);
}

bool has_elastic_displacements() { return int64_t(sizeof(ElasticMemory)) <= max_shared_bytes(sizeof(ElasticMemory)); }

}  // namespace kv::augmentation::cuda
