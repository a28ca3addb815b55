// Contrast of channels on CUDA, in two launches. In the first one each block sums a chunk of a plane. In the second one
// each block adds up the chunks of its plane, then maps its chunk, the last ones first: what the first launch read last
// is still in the L2 cache. Between them the gradient has a launch that sums the gradients of the mean.
#include "channel_contrast.h"
#include "core/block_reduce.cuh"
#include "core/row_vectors.cuh"
#include "core/stencils/filter_list.cuh"
#include "core/stencils/gradient_list.cuh"

namespace kv::enhance::cuda {
namespace {

constexpr int kContrastThreads = 256;
// Pixels of 16 bytes, which a thread adds up wherever they begin, so that sums do not depend on alignment.
template <class T>
constexpr int kSummed = 16 / int(sizeof(T));
// Those of a thread's vectors where all planes are aligned alike.
template <class T>
constexpr int kMapped = sizeof(T) == 8 ? 1 : kSummed<T>;

// A part of a flat plane.
template <class T>
struct ContrastChunk {
  int64_t plane;
  int begin, end;
  __device__ __forceinline__ ContrastChunk(unsigned block, int64_t pixels) {
    int64_t const chunks = contrast_chunks<T>(pixels);
    plane = block / chunks;
    begin = int(block - plane * chunks) * kContrastChunk<T>;
    end = int(min(int64_t(begin) + kContrastChunk<T>, pixels));
  }
};

template <class T>
__device__ __forceinline__ Vector<T, kSummed<T>> pixels_of(T const* x, int64_t step, int i, int end) {
  constexpr int N = kSummed<T>;
  if (step == 1) {
    bool const is_vector = reinterpret_cast<uintptr_t>(x + i) % 16 == 0 && i + N <= end;
    return is_vector ? *reinterpret_cast<Vector<T, N> const*>(x + i) : load_unaligned<N>(x + i, x + end);
  }
  Vector<T, N> v;
#pragma unroll
  for (int k = 0; k < N; ++k) v.v[k] = i + k < end ? x[(i + k) * step] : T{};
  return v;
}

// The sum of value(pixel of each of the planes...) over a chunk. It is 0 for pixels behind the last one, which are 0.
template <class T, class Value, class... Read>
__device__ __forceinline__ void sum_chunk(ContrastChunk<T> const& at, Compute<T>* to, Value value,
                                          Read const&... planes) {
  using F = Compute<T>;
  constexpr int N = kSummed<T>;
  __shared__ F memory[kContrastThreads / 32];
  F sum = 0;
#pragma unroll 2
  for (int i = at.begin + int(threadIdx.x) * N; i < at.end; i += kContrastThreads * N) {
    auto const add = [&](auto const&... vectors) {
#pragma unroll
      for (int k = 0; k < N; ++k) sum += value(F(read(vectors.v[k]))...);
    };
    add(pixels_of(planes.plane(at.plane), planes.step, i, at.end)...);
  }
  sum = block_sum_to_all(sum, memory);
  if (threadIdx.x == 0) *to = sum;
}

// The sum of the chunks of a plane, to all threads.
template <class F>
__device__ __forceinline__ F sum_of_chunks(F const* partial, int64_t chunks) {
  __shared__ F memory[kContrastThreads / 32];
  F sum = 0;
  for (int64_t i = threadIdx.x; i < chunks; i += kContrastThreads) sum += partial[i];
  return block_sum_to_all(sum, memory);
}

// The mean of a plane, by the sums of all chunks.
template <class T, class F>
__device__ __forceinline__ F mean_of_plane(Planes<T const> const& x, F const* partial, int64_t plane) {
  int64_t const chunks = contrast_chunks<T>(x.width);
  return sum_of_chunks(partial + plane * chunks, chunks) / F(x.width);
}

template <class T>
__device__ __forceinline__ void sum_pixels(Planes<T const> const& x, Compute<T>* partial, unsigned block) {
  using F = Compute<T>;
  ContrastChunk<T> const at(block, x.width);
  if constexpr (sizeof(T) == 1) {  // exact, by integers
    __shared__ int memory[kContrastThreads / 32];
    constexpr int N = kSummed<T>;
    T const* const plane = x.plane(at.plane);
    unsigned sum = 0;
#pragma unroll 4
    for (int i = at.begin + int(threadIdx.x) * N; i < at.end; i += kContrastThreads * N) {
      auto const pixels = pixels_of(plane, x.step, i, at.end);
      uint32_t words[N / 4];
      __builtin_memcpy(words, &pixels, N);
#pragma unroll
      for (uint32_t const word : words) sum = __dp4a(word, 0x01010101u, sum);
    }
    int const total = block_sum_to_all(int(sum), memory);
    if (threadIdx.x == 0) partial[block] = F(total);
  } else {
    sum_chunk<T>(at, partial + block, [](F x) { return x; }, x);
  }
}

// P: pixels of a thread's vectors.
template <int P, class T>
__device__ __forceinline__ void map_contrast(ChannelContrast<T> const& p, unsigned block) {
  using F = Compute<T>;
  int64_t const step = p.x.step;
  ContrastChunk<T> const at(block, p.x.width);
  F const mean = mean_of_plane(p.x, p.partial, at.plane);
  T const* const x = p.x.plane(at.plane);
  T* const y = p.y.plane(at.plane);
  AlignedBody<P, int> const body(x, at.begin, at.end);
  body.for_each_peeled([&](int i) { y[i * step] = round_to<T>(p.mapped(F(read(x[i * step])), mean)); });
#pragma unroll 4
  for (int i = body.begin + int(threadIdx.x) * P; i < body.end; i += kContrastThreads * P) {
    auto const own = *reinterpret_cast<Vector<T, P> const*>(x + i * step);
    F v[P];
#pragma unroll
    for (int k = 0; k < P; ++k) v[k] = p.mapped(F(read(own.v[k])), mean);
    store_vector(y + i * step, v);
  }
}

template <class T>
__global__ void __launch_bounds__(kContrastThreads) sum_planes(Planes<T const> x, Compute<T>* partial) {
  sum_pixels(x, partial, blockIdx.x);
}
template <class T, int P>
__global__ void __launch_bounds__(kContrastThreads) map_planes(__grid_constant__ ChannelContrast<T> const p) {
  map_contrast<P>(p, gridDim.x - 1 - blockIdx.x);
}

// The first (P = 0) or the second launch of a list.
template <class T, int P>
__global__ void __launch_bounds__(kContrastThreads) contrast_of_list(__grid_constant__ ChannelContrastList<T> const p) {
  unsigned block;
  ChannelContrast<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  ChannelContrast<T> flat = flat_sample(*one);
  flat.partial += int64_t(blockIdx.x - block);
  if constexpr (P == 0)
    sum_pixels(flat.x, flat.partial, block);
  else
    map_contrast<P>(flat, block);
}

template <class T>
__device__ __forceinline__ void sum_of_gradients(ChannelContrastBackward<T> const& p, unsigned block) {
  using F = Compute<T>;
  ContrastChunk<T> const at(block, p.x.width);
  F const mean = mean_of_plane(p.x, p.partial, at.plane);
  sum_chunk<T>(at, p.partial_grads + block, [&](F grad, F x) { return p.before_clamp(grad, x, mean); }, p.grad, p.x);
}
template <int P, class T>
__device__ __forceinline__ void map_gradient(ChannelContrastBackward<T> const& p, unsigned block) {
  using F = Compute<T>;
  int64_t const chunks = contrast_chunks<T>(p.x.width);
  ContrastChunk<T> const at(block, p.x.width);
  F const mean = mean_of_plane(p.x, p.partial, at.plane),
          of_mean = sum_of_chunks(p.partial_grads + at.plane * chunks, chunks) * (1 - p.factor) / F(p.x.width);
  T const *const x = p.x.plane(at.plane), *const grad = p.grad.plane(at.plane);
  T* const grad_x = p.grad_x.plane(at.plane);
  auto const gradient = [&](T const& g, T const& x) {
    return p.before_clamp(F(read(g)), F(read(x)), mean) * p.factor + of_mean;
  };
  AlignedBody<P, int> const body(x, at.begin, at.end);
  body.for_each_peeled(
      [&](int i) { grad_x[i * p.grad_x.step] = round_to<T>(gradient(grad[i * p.grad.step], x[i * p.x.step])); });
#pragma unroll 2
  for (int i = body.begin + int(threadIdx.x) * P; i < body.end; i += kContrastThreads * P) {
    auto const own = *reinterpret_cast<Vector<T, P> const*>(x + i * p.x.step);
    auto const grads = *reinterpret_cast<Vector<T, P> const*>(grad + i * p.grad.step);
    F v[P];
#pragma unroll
    for (int k = 0; k < P; ++k) v[k] = gradient(grads.v[k], own.v[k]);
    store_vector(grad_x + i * p.grad_x.step, v);
  }
}

template <class T>
__global__ void __launch_bounds__(kContrastThreads)
    sum_gradients(__grid_constant__ ChannelContrastBackward<T> const p) {
  sum_of_gradients(p, blockIdx.x);
}
template <class T, int P>
__global__ void __launch_bounds__(kContrastThreads)
    map_gradients(__grid_constant__ ChannelContrastBackward<T> const p) {
  map_gradient<P>(p, gridDim.x - 1 - blockIdx.x);
}

// The three launches of a list. P: as above, of the last one.
enum class ContrastLaunch { sum, sum_gradients, map };
template <ContrastLaunch Launch, class T, int P = 1>
__global__ void __launch_bounds__(kContrastThreads)
    contrast_gradients_of_list(__grid_constant__ ChannelContrastBackwardList<T> const p) {
  unsigned block;
  ChannelContrastBackward<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  ChannelContrastBackward<T> flat = flat_gradients(*one);
  flat.partial += int64_t(blockIdx.x - block), flat.partial_grads += int64_t(blockIdx.x - block);
  if constexpr (Launch == ContrastLaunch::sum)
    sum_pixels(flat.x, flat.partial, block);
  else if constexpr (Launch == ContrastLaunch::sum_gradients)
    sum_of_gradients(flat, block);
  else
    map_gradient<P>(flat, block);
}

}  // namespace

template <class T>
int channel_contrast(ChannelContrast<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.x.count() * contrast_chunks<T>(p.x.width));
  sum_planes<T><<<blocks, kContrastThreads, 0, stream>>>(p.x, p.partial);
  with_row_vectors<kMapped<T>>(are_equally_aligned<kMapped<T>>(p.x, p.y), [&](auto pixels) {
    map_planes<T, pixels.value><<<blocks, kContrastThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

template <class T>
int channel_contrast_list(ChannelContrastList<T> const& p, CUstream_st* stream) {
  bool const aligned = all_samples(p, [](ChannelContrast<T> const& one) {
    ChannelContrast<T> const flat = flat_sample(one);
    return are_equally_aligned<kMapped<T>>(flat.x, flat.y);
  });
  return launch_list(
      p, [&](ChannelContrast<T> const& one) { return p.channels * contrast_chunks<T>(one.x.height * one.x.width); },
      [&](ChannelContrastList<T> const& list, unsigned blocks) {
        contrast_of_list<T, 0><<<blocks, kContrastThreads, 0, stream>>>(list);
        with_row_vectors<kMapped<T>>(aligned, [&](auto pixels) {
          contrast_of_list<T, pixels.value><<<blocks, kContrastThreads, 0, stream>>>(list);
        });
      });
}

template <class T>
int channel_contrast_backward(ChannelContrastBackward<T> const& p, CUstream_st* stream) {
  constexpr int P = kMapped<T>;
  unsigned const blocks = unsigned(p.x.count() * contrast_chunks<T>(p.x.width));
  sum_planes<T><<<blocks, kContrastThreads, 0, stream>>>(p.x, p.partial);
  sum_gradients<T><<<blocks, kContrastThreads, 0, stream>>>(p);
  with_row_vectors<P>(are_equally_aligned<P>(p.x, p.grad) && are_equally_aligned<P>(p.x, p.grad_x),
                      [&](auto pixels) { map_gradients<T, pixels.value><<<blocks, kContrastThreads, 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int channel_contrast_list_backward(ChannelContrastBackwardList<T> const& p, CUstream_st* stream) {
  constexpr int P = kMapped<T>;
  bool const aligned = all_gradients(p, [](ChannelContrastBackward<T> const& sample) {
    ChannelContrastBackward<T> const one = flat_gradients(sample);
    return are_equally_aligned<P>(one.x, one.grad) && are_equally_aligned<P>(one.x, one.grad_x);
  });
  using List = ChannelContrastBackwardList<T>;
  return launch_gradients(
      p,
      [&](ChannelContrastBackward<T> const& one) {
        return p.channels * contrast_chunks<T>(one.x.height * one.x.width);
      },
      [&](List const& list, unsigned blocks) {
        contrast_gradients_of_list<ContrastLaunch::sum><<<blocks, kContrastThreads, 0, stream>>>(list);
        contrast_gradients_of_list<ContrastLaunch::sum_gradients><<<blocks, kContrastThreads, 0, stream>>>(list);
        with_row_vectors<P>(aligned, [&](auto pixels) {
          contrast_gradients_of_list<ContrastLaunch::map, T, pixels.value>
              <<<blocks, kContrastThreads, 0, stream>>>(list);
        });
      });
}

KV_INSTANTIATE_WITH_BYTES(channel_contrast, ChannelContrast)
KV_INSTANTIATE_WITH_BYTES(channel_contrast_list, ChannelContrastList)
KV_INSTANTIATE(channel_contrast_backward, ChannelContrastBackward)
KV_INSTANTIATE(channel_contrast_list_backward, ChannelContrastBackwardList)

}  // namespace kv::enhance::cuda
