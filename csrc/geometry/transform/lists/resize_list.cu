// Resizing of lists on CUDA, in one launch: one thread an element, the weights computed as they are needed.
#include "core/launch.cuh"
#include "geometry/transform/lists/resize_list.h"
#include "geometry/transform/resize/contributors.cuh"

namespace kv::geometry::cuda {
namespace {

template <class T>
__global__ void __launch_bounds__(kItemElements) resize_elements(__grid_constant__ ResizeList<T> const p) {
  using F = Compute<T>;
  __shared__ __align__(16) unsigned char memory[2 * sizeof(ResizeAxis)];
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
  int64_t const pixels = int64_t(to.height) * to.width;
  int64_t const i = int64_t(int(blockIdx.x) - p.list.first[b]) * kItemElements + threadIdx.x;
  if (i >= pixels * p.channels) return;
  int64_t const pixel = p.list.interleaved ? i / p.channels : i % pixels;
  int const c = int(p.list.interleaved ? i % p.channels : i / pixels);
  int const y = int(pixel / to.width), x = int(pixel - int64_t(y) * to.width);
  Contributors<F> const rows = find_contributors<F>(axes[0], y), columns = find_contributors<F>(axes[1], x);
  T const* const source = static_cast<T const*>(from.data) + c * from.channel_stride + rows.first * from.row_stride +
                          columns.first * from.step;
  F sum = 0;
  for (int k = 0; k < rows.count; ++k) {
    F const weight_y = find_weight(axes[0], rows, y, k);
    F line = 0;
    for (int l = 0; l < columns.count && weight_y != 0; ++l) {
      F const weight = find_weight(axes[1], columns, x, l);
      if (weight != 0) line += F(read(source[k * from.row_stride + l * from.step])) * weight;
    }
    sum += line * weight_y;
  }
  static_cast<T*>(to.data)[i] = round_to<T>(sum);
}

}  // namespace

template <class T>
int resize_list(ResizeList<T> const& p, CUstream_st* stream) {
  resize_elements<<<unsigned(p.list.items), kItemElements, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(resize_list, ResizeList)

}  // namespace kv::geometry::cuda
