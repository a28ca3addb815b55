// Images behind a layer on CUDA: a thread has adjacent pixels of a row, in all channels.
#include "augmentation/corruption/layer.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kLayerThreads = 256;

// P pixels a thread; more than one where rows of images are whole vectors. WholeLayer: those of layers are, too.
template <class T, int P, bool WholeLayer>
__global__ void __launch_bounds__(kLayerThreads) put_behind(__grid_constant__ AddLayer<T> const p) {
  using F = Compute<T>;
  int const i = blockIdx.x * kLayerThreads + threadIdx.x, per_row = int(p.width) / P, row = i / per_row,
            column = (i - row * per_row) * P;
  if (row >= p.height) return;
  int64_t const b = blockIdx.y;
  F const* const layer = p.layer_of(b) + row * p.layer_strides[2] + column * p.layer_strides[3];
  T const* const x = p.x + b * p.x_strides[0] + row * p.x_strides[2] + column * p.x_strides[3];
  T* const y = p.y + b * p.y_strides[0] + row * p.y_strides[2] + column * p.y_strides[3];
  Vector<F, P> m;
  auto const read_layer = [&](F const* from) {
    if constexpr (WholeLayer) {
      m = *reinterpret_cast<Vector<F, P> const*>(from);
    } else {
#pragma unroll
      for (int k = 0; k < P; ++k) m.v[k] = from[k * p.layer_strides[3]];
    }
  };
  read_layer(layer);
#pragma unroll 3
  for (int c = 0; c < int(p.channels); ++c) {
    if (c > 0 && p.layer_strides[1] != 0) read_layer(layer + c * p.layer_strides[1]);
    LayerFactors<F> const factors(p, b, c);
    auto const v = *reinterpret_cast<Vector<T, P> const*>(x + c * p.x_strides[1]);
    F result[P];
#pragma unroll
    for (int k = 0; k < P; ++k) result[k] = factors.behind(F(read(v.v[k])), m.v[k]);
    store_vector(y + c * p.y_strides[1], result);
  }
}

// Whether rows are whole vectors of four elements.
template <class T>
bool has_whole_rows_of_four(T const* data, int64_t width, int64_t const (&strides)[4]) {
  bool whole = strides[3] == 1 && width % 4 == 0 && reinterpret_cast<uintptr_t>(data) % alignof(Vector<T, 4>) == 0;
  for (int i = 0; i < 3; ++i) whole = whole && strides[i] % 4 == 0;
  return whole;
}

template <int P, bool WholeLayer, class T>
int launch_layer(AddLayer<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.height * (p.width / P), kLayerThreads)), unsigned(p.batch));
  put_behind<T, P, WholeLayer><<<blocks, kLayerThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int add_layer(AddLayer<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) <= 4)
    if (has_whole_rows_of_four(p.x, p.width, p.x_strides) && has_whole_rows_of_four(p.y, p.width, p.y_strides))
      return !p.windows && has_whole_rows_of_four(p.layer, p.width, p.layer_strides)
                 ? launch_layer<4, true>(p, stream)
                 : launch_layer<4, false>(p, stream);
  return launch_layer<1, false>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(add_layer, AddLayer)

}  // namespace kv::augmentation::cuda
