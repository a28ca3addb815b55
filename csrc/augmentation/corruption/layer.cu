// Images behind a layer on CUDA: a thread has adjacent pixels of a row, in all channels. A block of a list finds its
// sample in the table.
#include "augmentation/corruption/layer.h"
#include "core/block_reduce.cuh"
#include "core/launch.cuh"
#include "core/stencils/filter_list.cuh"
#include "core/stencils/gradient_list.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kLayerThreads = 256;

// Of sample b the pixels of thread i, P of them; more than one where rows of images are whole vectors. WholeLayer:
// those of layers are, too.
template <int P, bool WholeLayer, class T>
__device__ __forceinline__ void put_behind(AddLayer<T> const& p, int64_t b, int i) {
  using F = Compute<T>;
  int const per_row = int(p.x.width) / P, row = i / per_row, column = (i - row * per_row) * P;
  if (row >= p.x.height) return;
  F const* const layer = p.layer_of(b) + row * p.layer_strides[2] + column * p.layer_strides[3];
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
    auto const v = *reinterpret_cast<Vector<T, P> const*>(p.row(p.x, b, c, row) + column * p.x.step);
    F result[P];
#pragma unroll
    for (int k = 0; k < P; ++k) result[k] = factors.behind(F(read(v.v[k])), m.v[k]);
    store_vector(p.row(p.y, b, c, row) + column * p.y.step, result);
  }
}

template <class T, int P, bool WholeLayer>
__global__ void __launch_bounds__(kLayerThreads) layer_of_batch(__grid_constant__ AddLayer<T> const p) {
  put_behind<P, WholeLayer>(p, blockIdx.y, int(blockIdx.x) * kLayerThreads + int(threadIdx.x));
}

// Whether rows of images are whole vectors of four elements.
template <class T>
KV_HD bool has_whole_rows_of_four(Planes<T> const& p) {
  return p.step == 1 && p.width % 4 == 0 && reinterpret_cast<uintptr_t>(p.data) % alignof(Vector<T, 4>) == 0 &&
         p.outer_stride % 4 == 0 && p.inner_stride % 4 == 0 && p.row_stride % 4 == 0;
}
template <class T>
KV_HD bool has_whole_rows_of_four(AddLayer<T> const& p) {
  return has_whole_rows_of_four(p.x) && has_whole_rows_of_four(p.y);
}
// Whether those of layers without windows are.
template <class T>
KV_HD bool has_whole_layers(AddLayer<T> const& p) {
  using F = Compute<T>;
  bool whole =
      !p.windows && p.layer_strides[3] == 1 && reinterpret_cast<uintptr_t>(p.layer) % alignof(Vector<F, 4>) == 0;
  for (int i = 0; i < 3; ++i) whole = whole && p.layer_strides[i] % 4 == 0;
  return whole;
}

// Four pixels a thread where all rows of the image are whole vectors; then every fourth thread would be enough.
template <class T>
__global__ void __launch_bounds__(kLayerThreads) layer_of_list(__grid_constant__ AddLayerList<T> const p) {
  unsigned block;
  AddLayer<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  int const first = int(block) * 4 * kLayerThreads, i = int(threadIdx.x);
  if constexpr (sizeof(T) <= 4)
    if (has_whole_rows_of_four(*one)) {
      has_whole_layers(*one) ? put_behind<4, true>(*one, 0, first / 4 + i)
                             : put_behind<4, false>(*one, 0, first / 4 + i);
      return;
    }
#pragma unroll
  for (int k = 0; k < 4; ++k) put_behind<1, false>(*one, 0, first + k * kLayerThreads + i);
}

// Calls use(x, m, gradient, where that of x is stored, the factors) for the values of a block of so many pixels of an
// image. Adjacent threads have adjacent pixels.
template <int Pixels, class T, class Use>
__device__ __forceinline__ void for_each_layered(AddLayerBackward<T> const& one, unsigned block, Use const& use) {
  using F = Compute<T>;
  int const width = int(one.x.width), first = int(block) * Pixels,
            last = min(first + Pixels, int(one.x.height) * width);
#pragma unroll Pixels == 4 * kLayerThreads ? 4 : 1
  for (int i = first + int(threadIdx.x); i < last; i += kLayerThreads) {
    int const row = i / width, column = i - row * width;
    F const* const layer = one.layer_of(0) + row * one.layer_strides[2] + column * one.layer_strides[3];
    for (int c = 0; c < int(one.channels); ++c)
      use(F(read(one.x.row(c, row)[column * one.x.step])), layer[c * one.layer_strides[1]],
          F(read(one.grad.row(c, row)[column * one.grad.step])), one.grad_x.row(c, row) + column * one.grad_x.step,
          LayerFactors<F>(one, 0, c));
  }
}

template <class T>
__global__ void __launch_bounds__(kLayerThreads) gradients_of_list(__grid_constant__ AddLayerBackwardList<T> const p) {
  using F = Compute<T>;
  unsigned block;
  AddLayerBackward<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  for_each_layered<4 * kLayerThreads>(*one, block, [&](F x, F m, F g, T* to, LayerFactors<F> const& factors) {
    *to = round_to<T>(factors.vjp(x, m, g));
  });
}

template <class T>
__global__ void __launch_bounds__(kLayerThreads) find_fog_factors(__grid_constant__ FogFactors<T> const p) {
  int const b = int(blockIdx.x * kLayerThreads + threadIdx.x);
  if (b < p.count) p.find(b);
}

template <class T>
__global__ void __launch_bounds__(kLayerThreads) sum_fog_of_list(__grid_constant__ FogBackwardList<T> const p) {
  using F = Compute<T>;
  unsigned block;
  FogBackward<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  F const most = *one->brightest;
  LayerFactors<F> const slopes(one->slopes, F(1));
  double sums[2] = {};
  for_each_layered<kFogPixels>(*one, block, [&](F x, F m, F g, T*, LayerFactors<F> const& factors) {
    sums[0] += factors.vjp_of_factors(slopes, x, m, g), sums[1] += x == most;
  });
  store_block_sums<kLayerThreads>(sums, p.sums + 2 * int64_t(blockIdx.x));
}
template <class T>
__global__ void __launch_bounds__(kLayerThreads) fog_gradients_of_list(__grid_constant__ FogBackwardList<T> const p) {
  using F = Compute<T>;
  unsigned block;
  FogBackward<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  int64_t const first = int64_t(blockIdx.x) - block;
  double const* const sums =
      sum_rows<kLayerThreads, 2>(p.sums + 2 * first, ceil_div(one->x.height * one->x.width, int64_t(kFogPixels)));
  F const most = *one->brightest, share = F(sums[0] / max(sums[1], 1.));
  for_each_layered<kFogPixels>(*one, block, [&](F x, F m, F g, T* to, LayerFactors<F> const& factors) {
    *to = round_to<T>(factors.vjp(x, m, g) + (x == most ? share : F(0)));
  });
}

template <int P, bool WholeLayer, class T>
int launch_layer(AddLayer<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.x.height * (p.x.width / P), kLayerThreads)),
                    unsigned(p.x.count() / p.planes_per_sample()));
  layer_of_batch<T, P, WholeLayer><<<blocks, kLayerThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int add_layer(AddLayer<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) <= 4)
    if (has_whole_rows_of_four(p))
      return has_whole_layers(p) ? launch_layer<4, true>(p, stream) : launch_layer<4, false>(p, stream);
  return launch_layer<1, false>(p, stream);
}

template <class T>
int add_layer_list(AddLayerList<T> const& p, CUstream_st* stream) {
  return launch_list(
      p, [](AddLayer<T> const& one) { return ceil_div(one.x.height * one.x.width, int64_t(4 * kLayerThreads)); },
      [&](AddLayerList<T> const& list, unsigned blocks) { layer_of_list<<<blocks, kLayerThreads, 0, stream>>>(list); });
}

template <class T>
int add_layer_list_backward(AddLayerBackwardList<T> const& p, CUstream_st* stream) {
  return launch_gradients(
      p,
      [](AddLayerBackward<T> const& one) { return ceil_div(one.x.height * one.x.width, int64_t(4 * kLayerThreads)); },
      [&](AddLayerBackwardList<T> const& list, unsigned blocks) {
        gradients_of_list<<<blocks, kLayerThreads, 0, stream>>>(list);
      });
}

template <class T>
int fog_factors(FogFactors<T> const& p, CUstream_st* stream) {
  find_fog_factors<<<unsigned(ceil_div(p.count, int64_t(kLayerThreads))), kLayerThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int fog_list_backward(FogBackwardList<T> const& p, CUstream_st* stream) {
  return launch_gradients(
      p, [](FogBackward<T> const& one) { return ceil_div(one.x.height * one.x.width, int64_t(kFogPixels)); },
      [&](FogBackwardList<T> const& list, unsigned blocks) {
        sum_fog_of_list<<<blocks, kLayerThreads, 0, stream>>>(list);
        fog_gradients_of_list<<<blocks, kLayerThreads, 0, stream>>>(list);
      });
}

KV_INSTANTIATE_WITH_BYTES(add_layer, AddLayer)
KV_INSTANTIATE_WITH_BYTES(add_layer_list, AddLayerList)
KV_INSTANTIATE(add_layer_list_backward, AddLayerBackwardList)
KV_INSTANTIATE_WITH_BYTES(fog_factors, FogFactors)
KV_INSTANTIATE(fog_list_backward, FogBackwardList)

}  // namespace kv::augmentation::cuda
