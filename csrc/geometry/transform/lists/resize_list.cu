// Resizing of lists on CUDA, in one launch. A thread has some rows of a column: where pixels have two taps along both
// axes at most, as those of bilinear results and of the gradients of smaller ones, their weights are computed once.
#include "core/launch.cuh"
#include "geometry/transform/lists/resize_list.h"
#include "geometry/transform/resize/contributors.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = kItemColumns, kRows = kItemRows;
constexpr int kAtOnce = 4;  // rows whose pixels a thread reads before it needs them

// The pixels that an index reads, if these are two at most. Unused entries have weight 0 and an index in bounds.
template <class F>
struct Pair {
  int at[2];
  F weights[2];

  __device__ __forceinline__ void find(ResizeAxis const& axis, int index) {
    Contributors<F> const reads = find_contributors<F>(axis, index);
#pragma unroll
    for (int k = 0; k < 2; ++k) {
      at[k] = k < reads.count ? reads.first + k : reads.count > 0 ? reads.first : 0;
      weights[k] = k < reads.count ? find_weight(axis, reads, index, k) : F(0);
    }
  }
};

// A block has adjacent elements of some rows, in all planes.
template <class T>
__global__ void __launch_bounds__(kThreads) resize_list_tiles(__grid_constant__ ResizeList<T> const p) {
  using F = Compute<T>;
  __shared__ __align__(16) unsigned char memory[2 * sizeof(ResizeAxis)];
  __shared__ Pair<F> rows[kRows];
  int const b = p.list.sample_of(int(blockIdx.x));
  ListedImage const& from = p.list.images[b];
  ListedResult const& to = p.list.results[b];
  if (threadIdx.x < 2) {
    bool const down = threadIdx.x == 0;
    new (memory + threadIdx.x * sizeof(ResizeAxis))
        ResizeAxis(resize_axis_at(p, down ? from.height : from.width, down ? to.height : to.width));
  }
  __syncthreads();
  auto const& axes = *reinterpret_cast<ResizeAxis const(*)[2]>(memory);
  bool const interleaved = p.list.interleaved;
  int const step = interleaved ? p.channels : 1, planes = interleaved ? 1 : p.channels, size = to.width * step;
  int const across = (size + kThreads - 1) / kThreads, block = int(blockIdx.x) - p.list.first[b];
  int const e = block % across * kThreads + int(threadIdx.x), y0 = block / across * kRows;
  int const x = min(e, size - 1) / step, height = to.height;
  bool const in_pairs = axes[0].max_taps <= 2 && axes[1].max_taps <= 2;
  Pair<F> columns;
  if (in_pairs) {
    if (threadIdx.x < kRows) rows[threadIdx.x].find(axes[0], min(y0 + int(threadIdx.x), height - 1));
    columns.find(axes[1], x);
  }
  __syncthreads();
  if (e >= size) return;
  int64_t const plane_size = int64_t(height) * size;
  T const* source = static_cast<T const*>(from.data) + (e - x * step) * (interleaved ? from.channel_stride : 0);
  T* out = static_cast<T*>(to.data) + int64_t(y0) * size + e;
  int const count = min(kRows, height - y0);
  if (in_pairs) {
    int64_t const left = columns.at[0] * from.step, right = columns.at[1] * from.step;
    for (int c = 0; c < planes; ++c, source += from.channel_stride, out += plane_size) {
#pragma unroll 1
      for (int r = 0; r < count; r += kAtOnce) {
        // All taps are read before any is weighted, those of weight 0 as well, so that nothing waits for another read.
        F taps[kAtOnce][2][2];
#pragma unroll
        for (int j = 0; j < kAtOnce; ++j)
#pragma unroll
          for (int k = 0; k < 2; ++k) {
            T const* const row = source + rows[r + j].at[k] * from.row_stride;
            taps[j][k][0] = F(read(row[left]));
            taps[j][k][1] = F(read(row[right]));
          }
#pragma unroll
        for (int j = 0; j < kAtOnce; ++j) {
          F sum = 0;
#pragma unroll
          for (int k = 0; k < 2; ++k) {
            F line = 0;
#pragma unroll
            for (int l = 0; l < 2; ++l)
              line = columns.weights[l] != 0 ? line + columns.weights[l] * taps[j][k][l] : line;
            sum = rows[r + j].weights[k] != 0 ? sum + rows[r + j].weights[k] * line : sum;
          }
          if (r + j < count) out[int64_t(r + j) * size] = round_to<T>(sum);
        }
      }
    }
    return;
  }
  // More pixels: the weights are computed as they are needed.
  Contributors<F> const taps_x = find_contributors<F>(axes[1], x);
  for (int r = 0; r < count; ++r) {
    Contributors<F> const taps_y = find_contributors<F>(axes[0], y0 + r);
    T const* const first = source + taps_y.first * from.row_stride + taps_x.first * from.step;
    for (int c = 0; c < planes; ++c) {
      T const* const at = first + c * from.channel_stride;
      F sum = 0;
      for (int k = 0; k < taps_y.count; ++k) {
        F const weight_y = find_weight(axes[0], taps_y, y0 + r, k);
        F line = 0;
        for (int l = 0; l < taps_x.count && weight_y != 0; ++l) {
          F const weight = find_weight(axes[1], taps_x, x, l);
          if (weight != 0) line += F(read(at[k * from.row_stride + l * from.step])) * weight;
        }
        sum += line * weight_y;
      }
      out[c * plane_size + int64_t(r) * size] = round_to<T>(sum);
    }
  }
}

}  // namespace

template <class T>
int resize_list(ResizeList<T> const& p, CUstream_st* stream) {
  resize_list_tiles<<<unsigned(p.list.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(resize_list, ResizeList)

}  // namespace kv::geometry::cuda
