// The backward pass of bilinear and nearest resizing of small images that do not grow, on CUDA: at most two pixels
// along each axis read a pixel of the source, which gathers from them. A block has some rows of 128 adjacent elements,
// and each thread one column of them.
#include "core/launch.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kWarps = 4;
constexpr int kGatherRows = 8;  // of a block

// Not inlined: the coordinates take most of the compile time.
__device__ __noinline__ LinearTaps<float> linear_taps_of(ResizeAxis const& axis, int i) {
  if (axis.filter == ResizeFilter::bilinear) return linear_taps<float>(axis, i);
  int const at = extent<float>(axis, i).first;
  return {at, at, 0};
}
__device__ __noinline__ Contributors<float> find_contributors(ResizeAxis const& axis, int index) {
  return contributors<float>(axis, index);
}

// The pixels of the result that read a pixel of the source along an axis, and their weights. Unused entries have weight
// 0 and an index in bounds.
struct Readers {
  int at[2];
  float weights[2];
};
__device__ __forceinline__ Readers find_readers(ResizeAxis const& axis, int index) {
  Contributors<float> const reads = find_contributors(axis, index);
  Readers readers;
#pragma unroll
  for (int k = 0; k < 2; ++k) {
    readers.at[k] = k < reads.count ? reads.first + k : reads.count > 0 ? reads.first : 0;
    readers.weights[k] = k < reads.count ? linear_taps_of(axis, readers.at[k]).weight(index) : 0;
  }
  return readers;
}

template <class T>
__global__ void __launch_bounds__(32 * kWarps)
    gather_readers(__grid_constant__ Resize<T> const p, unsigned across, unsigned down) {
  __shared__ Readers rows[kGatherRows];
  unsigned const q = blockIdx.x / across, plane = q / down;
  int const e = int(blockIdx.x - q * across) * 32 * kWarps + threadIdx.x, y0 = int(q - plane * down) * kGatherRows;
  int const size = int(p.y.row_size()), step = int(p.y.step), height = int(p.y.height);
  if (threadIdx.x < kGatherRows) rows[threadIdx.x] = find_readers(p.rows, min(y0 + int(threadIdx.x), height - 1));
  int const x = min(e, size - 1) / step;
  Readers const columns = find_readers(p.columns, x);
  __syncthreads();
  if (e >= size) return;
  T const* const in = p.x.plane(plane) + (e - x * step);
  T* const out = p.y.row(plane, y0) + e;
#pragma unroll
  for (int r = 0; r < kGatherRows; ++r) {
    float sum = 0;
#pragma unroll
    for (int i = 0; i < 2; ++i) {
      if (i > 0 && p.rows.max_taps < 2) break;
      T const* const row = in + rows[r].at[i] * p.x.row_stride;
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        if (k > 0 && p.columns.max_taps < 2) break;
        float const weight = rows[r].weights[i] * columns.weights[k];
        if (weight != 0) sum += weight * float(read(row[columns.at[k] * step]));
      }
    }
    if (y0 + r < height) out[r * p.y.row_stride] = round_to<T>(sum);
  }
}

}  // namespace

template <class T>
int resize_linear_backward(Resize<T> const& p, CUstream_st* stream) {
  auto const shrinks = [](ResizeAxis const& a) {
    return a.backward && a.num >= a.den && a.filter <= ResizeFilter::bilinear && a.filter != ResizeFilter::area &&
           !a.antialias && a.max_taps <= 2;
  };
  // Small images have too few strips to occupy the GPU. For large images strips are faster.
  // Special case, H200: 1.7 to 1.8 times as fast as strips (resize of 4x3x256x256 to 224x224).
  bool const is_small = p.y.rows() * p.y.row_size() <= 1 << 20;
  if (!is_small || !shrinks(p.rows) || !shrinks(p.columns) || p.minuend) return kUnsupported;
  unsigned const across = unsigned(ceil_div(p.y.row_size(), 32 * kWarps)),
                 down = unsigned(ceil_div(p.y.height, kGatherRows));
  gather_readers<<<unsigned(p.y.count() * across * down), 32 * kWarps, 0, stream>>>(p, across, down);
  return cudaGetLastError();
}

template int resize_linear_backward(Resize<float> const&, CUstream_st*);
template int resize_linear_backward(Resize<Half> const&, CUstream_st*);
template int resize_linear_backward(Resize<BFloat16> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
