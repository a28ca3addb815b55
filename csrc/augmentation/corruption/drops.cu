// Drops on CUDA: a block has a tile of a layer, of a list of the layer that the table says. For depths it marks
// outlines as bits of words, finds the nearest one of each row by them, and then the nearest row of each column.
#include "augmentation/corruption/drops.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kDropThreads = 256, kDropColumns = 64, kDropRows = 32;

// The tile of a block: of sample b, from (left, top) on.
struct DropTile {
  int64_t b;
  int left, top;

  __device__ __forceinline__ DropTile()
      : b(blockIdx.z), left(int(blockIdx.x) * kDropColumns), top(int(blockIdx.y) * kDropRows) {}
  // That of a number, of the only sample.
  __device__ __forceinline__ DropTile(int number, int width) : b(0) {
    int const across = (width + kDropColumns - 1) / kDropColumns;
    left = number % across * kDropColumns, top = number / across * kDropRows;
  }
};

template <class T>
__device__ __forceinline__ void compute_tile(DropDepths<T> const& p, DropTile const& tile) {
  constexpr int kFar = kFarFromOutline, kRows = kDropRows + 2 * kFar, kWords = 4;  // a word to the left of the tile
  constexpr int kWide = kDropColumns + 2, kTall = kDropRows + 2;                   // of what the mean reads
  __shared__ uint32_t inside[kRows + 2][kWords], outlines[kRows][kWords + 1];
  __shared__ uint16_t squares[kRows][kWide];
  __shared__ float distances[kTall][kWide];
  int const height = int(p.drops.height), width = int(p.drops.width), lane = threadIdx.x % 32;
  for (int i = threadIdx.x / 32; i < (kRows + 2) * kWords; i += kDropThreads / 32) {
    int const row = tile.top - kFar - 1 + i / kWords, column = tile.left - 32 + i % kWords * 32 + lane;
    bool const is_in_image = row >= 0 && row < height && column >= 0 && column < width;
    bool const is_inside = !is_in_image || p.drops.is_inside(tile.b, int64_t(row) * width + column);
    unsigned const bits = __ballot_sync(~0u, is_inside);
    if (lane == 0) inside[i / kWords][i % kWords] = bits;
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kRows * (kWords + 1); i += kDropThreads) {
    int const row = i / (kWords + 1), word = i % (kWords + 1), y = tile.top - kFar + row;
    uint32_t outline = 0;
    if (word < kWords && y >= 0 && y < height) {
      uint32_t const own = inside[row + 1][word], before = word > 0 ? inside[row + 1][word - 1] : ~0u,
                     after = word + 1 < kWords ? inside[row + 1][word + 1] : ~0u;
      uint32_t const left = __funnelshift_l(before, own, 1), right = __funnelshift_r(own, after, 1);
      outline = own & ~(left & right & inside[row][word] & inside[row + 2][word]);
      int const first = tile.left - 32 + 32 * word;  // column of bit 0
      if (first < 0) outline = 0;                    // whole words: tiles begin with one
      if (first + 32 > width) outline &= first >= width ? 0 : ~0u >> (first + 32 - width);
    }
    outlines[row][word] = outline;
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kRows * kWide; i += kDropThreads) {
    int const row = i / kWide, bit = 31 + i % kWide, word = bit / 32, shift = bit % 32;
    uint32_t const own = outlines[row][word];
    uint32_t const to_right = __funnelshift_r(own, outlines[row][word + 1], shift);
    uint32_t const to_left = __funnelshift_l(word > 0 ? outlines[row][word - 1] : 0, own, 31 - shift);
    int const steps = min(min(to_right ? __ffs(int(to_right)) - 1 : kFar, __clz(int(to_left))), kFar);
    squares[row][i % kWide] = uint16_t(steps * steps);
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kTall * kWide; i += kDropThreads) {
    int const row = i / kWide, column = i % kWide, own = row + kFar - 1;
    int square = squares[own][column];
    for (int step = 1; step < kFar && step * step < square; ++step)
      square =
          min(square, step * step + int(min(own >= step ? squares[own - step][column] : uint16_t(kFar * kFar),
                                            own + step < kRows ? squares[own + step][column] : uint16_t(kFar * kFar))));
    distances[row][column] = sqrtf(float(square));
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kDropRows * kDropColumns; i += kDropThreads) {
    int const row = tile.top + i / kDropColumns, column = tile.left + i % kDropColumns;
    if (row >= height || column >= width) continue;
    float const sum = sum_of_nine<float>([&](int down, int right) {
      return distances[reflected(row + down, height) - tile.top + 1][reflected(column + right, width) - tile.left + 1];
    });
    p.y[(tile.b * height + row) * width + column] = uint8_t(sum / 9);
  }
}

template <class T>
__device__ __forceinline__ void compute_tile(DropReliefs<T> const& p, DropTile const& tile) {
  constexpr int kWide = kDropColumns + 2, kTall = kDropRows + 2;
  __shared__ uint8_t lights[kTall][kWide];
  int const height = int(p.drops.height), width = int(p.drops.width);
  uint8_t const* const depths = p.depths + tile.b * height * width;
  for (int i = threadIdx.x; i < kTall * kWide; i += kDropThreads) {
    int const row = tile.top - 1 + i / kWide, column = tile.left - 1 + i % kWide;
    if (row < 0 || row >= height || column < 0 || column >= width) continue;
    lights[i / kWide][i % kWide] = uint8_t(lit([&](int down, int right) {
      return int(depths[int64_t(reflected(row + down, height)) * width + reflected(column + right, width)]);
    }));
  }
  __syncthreads();
  for (int i = threadIdx.x; i < kDropRows * kDropColumns; i += kDropThreads) {
    int const row = tile.top + i / kDropColumns, column = tile.left + i % kDropColumns;
    if (row >= height || column >= width) continue;
    int const sum = sum_of_nine<int>([&](int down, int right) {
      return int(
          lights[reflected(row + down, height) - tile.top + 1][reflected(column + right, width) - tile.left + 1]);
    });
    int64_t const at = int64_t(row) * width + column;
    p.y[tile.b * height * width + at] = T(rounded_ninth(sum)) * p.drops.level(tile.b, at);
  }
}

template <class T>
__device__ __forceinline__ void compute_tile(MarkStains<T> const& p, DropTile const& tile) {
  int const height = int(p.drops.height), width = int(p.drops.width);
  T const threshold = p.drops.threshold(tile.b);
  for (int i = threadIdx.x; i < kDropRows * kDropColumns; i += kDropThreads) {
    int const row = tile.top + i / kDropColumns, column = tile.left + i % kDropColumns;
    if (row >= height || column >= width) continue;
    int64_t const at = int64_t(row) * width + column;
    p.y[tile.b * height * width + at] = T(p.drops.value(tile.b, at) > threshold);
  }
}

template <class Kernel>
__global__ void __launch_bounds__(kDropThreads) compute_tiles(__grid_constant__ Kernel const p) {
  compute_tile(p, DropTile());
}
template <class List>
__global__ void __launch_bounds__(kDropThreads) compute_tiles_of_list(__grid_constant__ List const p) {
  int const b = p.sample_of(int(blockIdx.x));
  compute_tile(p.sample(b), DropTile(int(blockIdx.x) - p.listed[b].first, p.listed[b].width));
}

template <class Kernel>
int launch_tiles(Kernel const& p, CUstream_st* stream) {
  auto const& drops = p.drops;
  dim3 const tiles(unsigned(ceil_div(drops.width, kDropColumns)), unsigned(ceil_div(drops.height, kDropRows)),
                   unsigned(drops.batch));
  compute_tiles<<<tiles, kDropThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class List>
int launch_tiles_of_list(List p, CUstream_st* stream) {
  int64_t tiles = 0;
  for (int b = 0; b < p.count; ++b) {
    ListedDrops& own = p.listed[b];
    own.first = int(tiles);
    tiles += int64_t(ceil_div(own.width, kDropColumns)) * ceil_div(own.height, kDropRows);
    if (tiles > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  compute_tiles_of_list<<<unsigned(tiles), kDropThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int drop_depths(DropDepths<T> const& p, CUstream_st* stream) {
  return launch_tiles(p, stream);
}
template <class T>
int drop_reliefs(DropReliefs<T> const& p, CUstream_st* stream) {
  return launch_tiles(p, stream);
}
template <class T>
int mark_stains(MarkStains<T> const& p, CUstream_st* stream) {
  return launch_tiles(p, stream);
}
template <class T>
int drop_depths_list(DropDepthsList<T> const& p, CUstream_st* stream) {
  return launch_tiles_of_list(p, stream);
}
template <class T>
int drop_reliefs_list(DropReliefsList<T> const& p, CUstream_st* stream) {
  return launch_tiles_of_list(p, stream);
}
template <class T>
int mark_stains_list(MarkStainsList<T> const& p, CUstream_st* stream) {
  return launch_tiles_of_list(p, stream);
}

KV_INSTANTIATE_COMPUTED(drop_depths, DropDepths)
KV_INSTANTIATE_COMPUTED(drop_reliefs, DropReliefs)
KV_INSTANTIATE_COMPUTED(mark_stains, MarkStains)
KV_INSTANTIATE_COMPUTED(drop_depths_list, DropDepthsList)
KV_INSTANTIATE_COMPUTED(drop_reliefs_list, DropReliefsList)
KV_INSTANTIATE_COMPUTED(mark_stains_list, MarkStainsList)

}  // namespace kv::augmentation::cuda
