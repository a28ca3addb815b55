// The gradient of the image on CUDA, by one of two methods. Gathering serves warps by a matrix with fill padding, and
// scattering the others. Where several samples read an image, a block gathers them to its tile one after the other.
#include "geometry/transform/sampling_blocks/gather.cuh"
#include "geometry/transform/sampling_blocks/scatter.cuh"

namespace kv::geometry::cuda {
namespace {

// One sample an image.
template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 5)
    gather_tiles(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, bool aligned_out) {
  gather_block<K, Aligned>(p, tiles, aligned_out);
}

// Whether a sample may read the tile of its image at (x, y): the box around the corners of the output overlaps it, or
// the horizon runs through the output.
template <int K, class T>
__device__ __noinline__ bool may_read_tile(SampleImageBackward<T> const& p, int64_t b, int x, int y) {
  auto const map = homography(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use);
  double left = INFINITY, top = INFINITY, right = -INFINITY, bottom = -INFINITY;
  int before = 0;
#pragma unroll 1
  for (int i = 0; i < 4; ++i) {
    double const column = i & 1 ? double(p.grad.width - 1) : 0, row = i & 2 ? double(p.grad.height - 1) : 0;
    double u, v;
    map.apply(column, row, u, v);
    before += map.weight(column, row) > 0;
    left = fmin(left, u);
    right = fmax(right, u);
    top = fmin(top, v);
    bottom = fmax(bottom, v);
  }
  constexpr double margin = K / 2. + 1;  // the taps, and more than the rounding of coordinates
  return before % 4 != 0 ||
         (left - margin < x + kTile && right + margin > x && top - margin < y + kTile && bottom + margin > y);
}

// Several samples an image. A block takes a tile of an image and some of its channels. It looks through the samples, as
// many at a time as it has threads, and adds those that read the tile in their order, so that all runs give the same
// bits. Each sum belongs to one thread.
template <class T, int K, bool Aligned>
__global__ void __launch_bounds__(kThreads, sizeof(T) == 8 ? 2 : 5)
    gather_samples(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles, int channels_per_block) {
  using F = Compute<T>;
  constexpr int kWarps = kThreads / 32;
  __shared__ GatherTile<F> shared_tiles[kMaxTilesPerBlock];
  __shared__ int counts[kWarps], readers[kThreads];
  extern __shared__ __align__(16) unsigned char shared_pixels[];
  Tile<F> located;
  located.locate(tiles, 0);
  int64_t const image = located.b;
  int const begin = int(blockIdx.y) * channels_per_block, channels = min(channels_per_block, p.grad.channels - begin);
  Images<F> const out{p.sums,           p.grad_x.batch_stride, p.grad_x.channel_stride, p.grad_x.row_stride,
                      p.grad_x.step,    p.grad_x.batch,        p.grad_x.height,         p.grad_x.width,
                      p.grad_x.channels};
#pragma unroll 1
  for (int64_t first = 0; first < p.grad.batch; first += kThreads) {
    int64_t const candidate = first + threadIdx.x;
    bool const reads = candidate < p.grad.batch && p.image_of(candidate) == image &&
                       may_read_tile<K>(p, candidate, located.x, located.y);
    unsigned const lanes = __ballot_sync(0xffffffffu, reads);
    if (threadIdx.x % 32 == 0) counts[threadIdx.x / 32] = __popc(lanes);
    __syncthreads();
    int position = __popc(lanes & ((1u << threadIdx.x % 32) - 1)), count = 0;
    for (int warp = 0; warp < kWarps; ++warp) {
      if (warp < int(threadIdx.x) / 32) position += counts[warp];
      count += counts[warp];
    }
    if (reads) readers[position] = threadIdx.x;
    __syncthreads();
#pragma unroll 1
    for (int next = 0; next < count; next += kMaxTilesPerBlock) {
      if (threadIdx.x < 32) {
        int const number = threadIdx.x / 4 % kMaxTilesPerBlock;
        Tile<F> of_sample = located;
        of_sample.b = first + readers[min(next + number, count - 1)];
        GatherTile<F> tile;
        tile.template init<K>(of_sample, p);
        if (threadIdx.x % 4 == 0 && threadIdx.x < 4 * kMaxTilesPerBlock) shared_tiles[number] = tile;
      }
      __syncthreads();
#pragma unroll 1
      for (int number = 0; number < min(kMaxTilesPerBlock, count - next); ++number) {
        GatherTile<F> const& tile = shared_tiles[number];
        if (!tile.is_unread(int(p.grad.width), int(p.grad.height)))
          gather_tile<K, true, Aligned>(p, tile, out, begin, channels, shared_pixels);
      }
      __syncthreads();  // before the tiles are overwritten
    }
  }
}

template <class T, int K>
__global__ void __launch_bounds__(32 * kScatterWarps, sizeof(T) == 8 ? 4 : 6)
    scatter_tiles(__grid_constant__ SampleImageBackward<T> const p, TileGrid tiles) {
  scatter_block<K>(p, tiles);
}

template <class T>
void gather(SampleImageBackward<T> const& p, CUstream_st* stream) {
  auto const& x = p.grad_x;
  TileGrid const tiles(x.batch, x.height, x.width, tiles_per_block(x.batch, x.height, x.width));
  with_alignment_of(p.grad, [&](auto aligned) {
    dispatch_taps(p.interpolation, [&](auto taps) {
      gather_tiles<T, taps.value, aligned.value>
          <<<tiles.blocks, kThreads, SourceTile<T, aligned.value>::bytes(p.grad.channels), stream>>>(
              p, tiles, rows_are_aligned(p.grad_x));
    });
  });
}

// Enough blocks to fill a large GPU: where the images have few tiles, each block takes some of the channels.
constexpr int64_t kGatherBlocks = 1024;

template <class T>
void add_gathered(SampleImageBackward<T> const& p, CUstream_st* stream) {
  auto const& x = p.grad_x;
  TileGrid const tiles(x.batch, x.height, x.width, 1);
  int64_t const groups = ceil_div(x.channels, SourceTile<T, true>::kChannels);
  int64_t const parts = min(groups, ceil_div(kGatherBlocks, int64_t(tiles.blocks)));
  int const channels_per_block = int(ceil_div(groups, parts)) * SourceTile<T, true>::kChannels;
  dim3 const blocks(tiles.blocks, unsigned(ceil_div(int64_t(x.channels), int64_t(channels_per_block))));
  with_alignment_of(p.grad, [&](auto aligned) {
    dispatch_taps(p.interpolation, [&](auto taps) {
      gather_samples<T, taps.value, aligned.value>
          <<<blocks, kThreads, SourceTile<T, aligned.value>::bytes(min(channels_per_block, x.channels)), stream>>>(
              p, tiles, channels_per_block);
    });
  });
}

template <class T>
void scatter(SampleImageBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  auto const& x = p.grad;
  TileGrid const tiles(x.batch, x.height, x.width, 1);
  dispatch_taps(p.interpolation, [&](auto taps) {
    scatter_tiles<T, taps.value><<<tiles.blocks, 32 * kScatterWarps, Sums<F>::bytes(x.channels), stream>>>(p, tiles);
  });
}

}  // namespace

template <class T>
int sample_image_backward(SampleImageBackward<T> const& p, CUstream_st* stream) {
  bool const gathers = !p.coords.has_map() && p.x_axis.padding == Padding::fill;
  if (gathers && p.is_one_sample_per_image()) {
    gather(p, stream);
    return cudaGetLastError();
  }
  int64_t const count = p.grad_x.batch * p.grad_x.channels * p.grad_x.height * p.grad_x.width;
  cudaError_t const error = cudaMemsetAsync(p.sums, 0, size_t(count) * sizeof(Compute<T>), stream);
  if (error != cudaSuccess) return error;
  if (p.grad.batch > 0) gathers ? add_gathered(p, stream) : scatter(p, stream);
  return cudaGetLastError();
}

KV_INSTANTIATE(sample_image_backward, SampleImageBackward)

}  // namespace kv::geometry::cuda
