// The gradient of the image through a warp that maps rows to rows, on CUDA. The transpose of such a warp is separable:
// it is computed along y, then along x. A block computes some rows of the source:
//
//   down      A row of the source is the weighted sum of the rows of the gradient that have it as a tap. A thread
//             traverses four columns of the gradient downwards, and keeps the sums of the two source rows that the
//             current row reads. Complete sums go to shared memory.
//   across    A pixel is the weighted sum of the columns of these sums that have it as a tap.
//
// Coordinates are monotonic along an axis, so the rows (columns) that have a pixel as a tap are adjacent. Every pixel
// is written once, without atomics: results have the same bits every run.
#include "augmentation/warp_blocks/row_taps.cuh"
#include "augmentation/warp_rows_backward.h"

namespace kv::augmentation::cuda {
namespace {

constexpr int kMaxChannels = 3, kMaxRows = 16, kMaxThreads = 256;  // of a block at a time
constexpr int kRowsOfThread = 8;                                   // across, where a block has as many
constexpr int kRowsAhead = 4;                                      // of the gradient that are loaded together
constexpr int64_t kMaxSums = 48 << 10;                             // bytes

// A row or a column of the gradient adds to `pixel` with weight 1 - t, and to the next one with weight t.
struct TapPair {
  int pixel;
  float t;
};

// The tap pairs of an axis, sorted by pixel.
struct TapPairs {
  TapPair* pairs;
  int count;
  bool backwards;

  __device__ __forceinline__ int number(int i) const { return backwards ? count - 1 - i : i; }
  __device__ __forceinline__ void init(geometry::Axis<float> const& axis, RowMap const& map, int direction) {
    backwards = map.scale[direction] < 0;
    for (int i = int(threadIdx.x); i < count; i += int(blockDim.x)) {
      AxisTaps const taps(axis, map.at(direction, number(i)));
      pairs[i] = {taps.first, taps.second == taps.first ? 0.f : taps.t};
    }
  }
  // The index of the first pair with this pixel or a later one.
  __device__ __forceinline__ int first_at(int pixel) const {
    int low = 0, high = count;
    while (low < high) {
      int const middle = (low + high) / 2;
      if (pairs[middle].pixel < pixel)
        low = middle + 1;
      else
        high = middle;
    }
    return low;
  }
  // Sets first[x] to first_at(x - 1) for all pixels x - 1 from -1 to `size`.
  __device__ __forceinline__ void find_pixels(int size, int* first) const {
    int const lowest = pairs[0].pixel, highest = pairs[count - 1].pixel;
    for (int x = int(threadIdx.x); x < size + 2; x += int(blockDim.x))
      if (x - 1 <= lowest || x - 1 > highest) first[x] = x - 1 <= lowest ? 0 : count;
    for (int n = 1 + int(threadIdx.x); n < count; n += int(blockDim.x))
      for (int pixel = max(pairs[n - 1].pixel + 1, -1); pixel <= min(pairs[n].pixel, size); ++pixel)
        first[pixel + 1] = n;
  }
};

// A block has `rows` rows of an image, a multiple of R, and keeps their sums for a group of channels.
template <class T, int R, bool Vectors>
__global__ void __launch_bounds__(kMaxThreads)
    add_rows(__grid_constant__ geometry::SampleImageBackward<T> const p, int parts, int rows) {
  extern __shared__ __align__(16) float sums[];
  __shared__ RowMap map;
  __shared__ int read_down[2];
  int const width = int(p.grad.width), height = int(p.grad.height);
  int const to_width = int(p.grad_x.width), to_height = int(p.grad_x.height);
  int const vectors = (width + 3) / 4, pitch = 4 * vectors, most_channels = min(p.grad.channels, kMaxChannels);
  int64_t const b = blockIdx.x / unsigned(parts);
  int const top = int(blockIdx.x - b * parts) * rows, end = min(top + rows, to_height);
  TapPairs down{reinterpret_cast<TapPair*>(sums + most_channels * rows * pitch), height, false};
  TapPairs across{down.pairs + height, width, false};
  int* const first_across = reinterpret_cast<int*>(across.pairs + width);

  if (threadIdx.x == 0) map.init(p.coords.matrices + b * p.coords.matrix_stride, p.coords.use);
  __syncthreads();
  down.init(p.y_axis, map, 1);
  __syncthreads();
  if (threadIdx.x < 2) read_down[threadIdx.x] = down.first_at(threadIdx.x ? end : top - 1);
  __syncthreads();
  int const begin_down = read_down[0], end_down = read_down[1];
  bool const is_read = begin_down < end_down;
  if (is_read) {
    across.init(p.x_axis, map, 0);
    __syncthreads();
    across.find_pixels(to_width, first_across);
  }

#pragma unroll 1
  for (int first_channel = 0; first_channel < p.grad.channels; first_channel += kMaxChannels) {
    int const channels = min(p.grad.channels - first_channel, kMaxChannels);
    __syncthreads();  // before the sums of other channels are overwritten
#pragma unroll 1
    for (int task = int(threadIdx.x); is_read && task < channels * vectors; task += int(blockDim.x)) {
      int const k = task / vectors, x = 4 * (task - k * vectors);
      T const* row = p.grad.row(b, first_channel + k, down.number(begin_down)) + x * p.grad.step;
      int64_t const stride = down.backwards ? -p.grad.row_stride : p.grad.row_stride;
      float* to = sums + k * rows * pitch + x;
      float own[4]{}, next[4]{};  // the sums of row `y` and of the one below it
      int y = top - 1;
      auto const advance = [&] {
        if (y >= top) {
          *reinterpret_cast<Vector<float, 4>*>(to) = {own[0], own[1], own[2], own[3]};
          to += pitch;
        }
#pragma unroll
        for (int i = 0; i < 4; ++i) own[i] = next[i], next[i] = 0;
        ++y;
      };
#pragma unroll 1
      for (int n = begin_down; n < end_down; n += kRowsAhead) {
        float g[kRowsAhead][4];
#pragma unroll
        for (int r = 0; r < kRowsAhead; ++r, row += stride) {
          if constexpr (Vectors) {
            Vector<T, 4> vector{};
            if (n + r < end_down) vector = *reinterpret_cast<Vector<T, 4> const*>(row);
#pragma unroll
            for (int i = 0; i < 4; ++i) g[r][i] = read(vector.v[i]);
          } else {
#pragma unroll
            for (int i = 0; i < 4; ++i) g[r][i] = n + r < end_down && x + i < width ? read(row[i * p.grad.step]) : 0.f;
          }
        }
#pragma unroll
        for (int r = 0; r < kRowsAhead; ++r) {
          if (n + r >= end_down) continue;
          TapPair const pair = down.pairs[n + r];
          if (y < pair.pixel) {
            advance();
#pragma unroll 1
            while (y < pair.pixel) advance();  // where the source has more rows
          }
          // A tap of weight 0 contributes nothing, even if it is inf or NaN.
          if (pair.t != 1)
#pragma unroll
            for (int i = 0; i < 4; ++i) own[i] += (1 - pair.t) * g[r][i];
          if (pair.t != 0)
#pragma unroll
            for (int i = 0; i < 4; ++i) next[i] += pair.t * g[r][i];
        }
      }
#pragma unroll 1
      while (y < end) advance();
    }
    __syncthreads();

    // A thread has a column of R rows.
    int const groups = rows / R;  // of a channel
#pragma unroll 1
    for (int task = int(threadIdx.x); task < channels * groups * to_width; task += int(blockDim.x)) {
      int const group = task / to_width, x = task - group * to_width;
      int const k = group / groups, first = (group - k * groups) * R;
      float const* const from = sums + (k * rows + first) * pitch;
      float total[R]{};
      int const own_begin = is_read ? first_across[x + 1] : 0, own_end = is_read ? first_across[x + 2] : 0;
#pragma unroll 1
      for (int n = is_read ? first_across[x] : 0; n < own_end; ++n) {
        float const t = across.pairs[n].t, weight = n < own_begin ? t : 1 - t;
        if (weight == 0) continue;
        float const* const at = from + across.number(n);
#pragma unroll
        for (int r = 0; r < R; ++r) total[r] += weight * at[r * pitch];
      }
      T* to = p.grad_x.row(b, first_channel + k, top + first) + x;
#pragma unroll
      for (int r = 0; r < R; ++r, to += p.grad_x.row_stride)
        if (top + first + r < end) *to = round_to<T>(total[r]);
    }
  }
}

// The shared memory of a block: rows of sums, and the tap pairs of both axes.
struct BlockMemory {
  int64_t rows;
  size_t bytes;

  BlockMemory(int64_t channels, geometry::Size source, geometry::Size output) {
    int64_t const row = min(channels, int64_t(kMaxChannels)) * ceil_div(output.width, int64_t(4)) * 16;
    rows = clamp(kMaxSums / row, int64_t(1), int64_t(kMaxRows));
    if (rows > kRowsOfThread) rows = rows / kRowsOfThread * kRowsOfThread;
    bytes = size_t(rows * row + (output.height + output.width) * int64_t(sizeof(TapPair)) +
                   (source.width + 2) * int64_t(sizeof(int)));
  }
};
constexpr int64_t kMaxShared = 96 << 10, kStaticShared = 2 << 10;

}  // namespace

bool fits_block(geometry::Size source, geometry::Size output) {
  return int64_t(BlockMemory(kMaxChannels, source, output).bytes) + kStaticShared <= max_shared_bytes(kMaxShared);
}

template <class T>
int warp_rows_backward(WarpRowsBackward<T> const& params, CUstream_st* stream) {
  geometry::SampleImageBackward<T> const& p = params.warp;
  int64_t const width = p.grad.width, channels = min(p.grad.channels, kMaxChannels);
  BlockMemory const memory(channels, {p.grad_x.height, p.grad_x.width}, {p.grad.height, width});
  int64_t const parts = ceil_div(p.grad_x.height, memory.rows);
  int64_t const tasks = channels * ceil_div(width, int64_t(4));
  unsigned const threads = unsigned(clamp(ceil_div(tasks, int64_t(32)) * 32, int64_t(64), int64_t(kMaxThreads)));
  auto const is_aligned = [](int64_t elements) { return elements * int64_t(sizeof(T)) % int64_t(4 * sizeof(T)) == 0; };
  bool const vectors = p.grad.step == 1 && width % 4 == 0 && is_aligned(p.grad.row_stride) &&
                       is_aligned(p.grad.channel_stride) && is_aligned(p.grad.batch_stride) &&
                       reinterpret_cast<uintptr_t>(p.grad.data) % (4 * sizeof(T)) == 0;
  bool const whole = memory.rows % kRowsOfThread == 0;
  auto* const kernel = !whole    ? add_rows<T, 1, false>
                       : vectors ? add_rows<T, kRowsOfThread, true>
                                 : add_rows<T, kRowsOfThread, false>;
  if (cudaError_t const error =
          cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(memory.bytes)))
    return error;
  kernel<<<unsigned(p.grad.batch * parts), threads, memory.bytes, stream>>>(p, int(parts), int(memory.rows));
  return cudaGetLastError();
}

KV_INSTANTIATE_ONE(warp_rows_backward, WarpRowsBackward, float)
KV_INSTANTIATE_ONE(warp_rows_backward, WarpRowsBackward, ::kv::Half)
KV_INSTANTIATE_ONE(warp_rows_backward, WarpRowsBackward, ::kv::BFloat16)

}  // namespace kv::augmentation::cuda
