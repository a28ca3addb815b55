// The range of planes on CUDA, in two launches. In the first one each block reduces its chunk of a plane. In the second
// one each block combines the results of all chunks of the plane, then maps its chunk. The second launch traverses the
// chunks backwards: it starts with what the first one read last, which is still in the L2 cache.
#include "byte_histogram.cuh"
#include "core/product.h"
#include "core/stencils/filter_list.cuh"
#include "core/stencils/gradient_list.cuh"
#include "min_max.h"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 256, kWarps = kThreads / 32;

// The smaller one of both, or NaN.
template <class F>
__device__ __forceinline__ F smaller(F a, F b) {
  return a < b || a != a ? a : b;
}
template <class F>
__device__ __forceinline__ F larger(F a, F b) {
  return a > b || a != a ? a : b;
}

template <class F>
struct Range {
  F smallest, largest;
  __device__ __forceinline__ static Range none() {
    return {F(__int_as_float(0x7f800000)), -F(__int_as_float(0x7f800000))};
  }
  __device__ __forceinline__ void add(Range const& other) {
    smallest = smaller(smallest, other.smallest), largest = larger(largest, other.largest);
  }
};

template <class F>
struct Sums : RangeSums<F> {
  __device__ __forceinline__ static Sums none() { return {}; }
  __device__ __forceinline__ void add(Sums const& other) {
    this->grad += other.grad, this->product += other.product;
    this->smallest += other.smallest, this->largest += other.largest;
  }
};

// Combines the results of all threads of a block in a fixed order.
template <class S>
__device__ __forceinline__ S of_block(S value) {
  __shared__ S warps[kWarps];
  value = warp_reduce(value, [](S a, S const& b) {
    a.add(b);
    return a;
  });
  if (threadIdx.x % 32 == 0) warps[threadIdx.x / 32] = value;
  __syncthreads();
  S all = warps[0];
#pragma unroll
  for (int i = 1; i < kWarps; ++i) all.add(warps[i]);
  return all;
}

// Combines the results of a plane's chunks in a fixed order.
template <class S, class F>
__device__ __forceinline__ S of_plane(F const* partial, int64_t chunks) {
  S value = S::none();
  for (int64_t i = threadIdx.x; i < chunks; i += kThreads) value.add(reinterpret_cast<S const*>(partial)[i]);
  return of_block(value);
}

struct ChunkPosition {
  int64_t plane, chunk;
  int begin, end;
  __device__ __forceinline__ ChunkPosition(unsigned block, int64_t size, int64_t chunks, int64_t pixels)
      : plane(block / chunks),
        chunk(block - plane * chunks),
        begin(int(chunk * size)),
        end(int(min(chunk * size + size, pixels))) {}
};

// The range of a chunk, to place `to` of the partial ones.
template <int P, class T>
__device__ __forceinline__ void reduce_chunk(MinMax<T> const& p, ChunkPosition const& at, unsigned to) {
  using F = Compute<T>;
  Range<F> range = Range<F>::none();
  for_each_vector<kThreads, P>(p.x.plane(at.plane), p.x.step, at.begin, at.end, [&](auto const& vector, int) {
#pragma unroll
    for (T const x : vector.v) range.add({read(x), read(x)});
  });
  range = of_block(range);
  if (threadIdx.x == 0) reinterpret_cast<Range<F>*>(p.partial)[to] = range;
}

template <int P, class T>
__device__ __forceinline__ void map_chunk(MinMax<T> const& p, ChunkPosition const& at) {
  using F = Compute<T>;
  auto const range = of_plane<Range<F>>(p.partial + 2 * at.plane * p.chunks, p.chunks);
  F const smallest = range.smallest, factor = p.scale / (range.largest - smallest + p.eps);
  bool const stays = p.keeps_flat && smallest == range.largest;
  if (at.chunk == 0 && threadIdx.x == 0) {
    p.range[2 * at.plane] = round_to<T>(smallest);
    p.range[2 * at.plane + 1] = round_to<T>(range.largest);
  }
  T* const y = p.y.plane(at.plane);
  for_each_vector<kThreads, P>(p.x.plane(at.plane), p.x.step, at.begin, at.end, [&](auto const& vector, int i) {
    constexpr int N = sizeof(vector) / sizeof(T);
    F v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F const x = read(vector.v[k]);
      v[k] = stays ? x : p.mapped(x, smallest, factor);
    }
    store_vector(y + i * p.y.step, v);
  });
}

// The sums of a chunk, to place `to` of the partial ones.
template <int P, class T>
__device__ __forceinline__ void reduce_chunk(MinMaxBackward<T> const& p, ChunkPosition const& at, unsigned to) {
  using F = Compute<T>;
  F const smallest = read(p.range[2 * at.plane]), largest = read(p.range[2 * at.plane + 1]);
  T const* const grad = p.grad.plane(at.plane);
  Sums<F> sums{};
  for_each_vector<kThreads, P>(p.x.plane(at.plane), p.x.step, at.begin, at.end, [&](auto const& vector, int i) {
    constexpr int N = sizeof(vector) / sizeof(T);
    auto const grads = *reinterpret_cast<Vector<T, N> const*>(grad + i * p.grad.step);
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F const g = read(grads.v[k]), x = read(vector.v[k]);
      sums.add({{g, g * (x - smallest), F(x == smallest), F(x == largest)}});
    }
  });
  sums = of_block(sums);
  if (threadIdx.x == 0) reinterpret_cast<Sums<F>*>(p.partial)[to] = sums;
}

template <int P, class T>
__device__ __forceinline__ void map_chunk(MinMaxBackward<T> const& p, ChunkPosition const& at) {
  using F = Compute<T>;
  F const smallest = read(p.range[2 * at.plane]), largest = read(p.range[2 * at.plane + 1]);
  bool const stays = p.keeps_flat && smallest == largest;
  RangeGradient<F> const to(of_plane<Sums<F>>(p.partial + 4 * at.plane * p.chunks, p.chunks), smallest, largest,
                            p.scale, p.eps);
  T const* const grad = p.grad.plane(at.plane);
  T* const grad_x = p.grad_x.plane(at.plane);
  for_each_vector<kThreads, P>(p.x.plane(at.plane), p.x.step, at.begin, at.end, [&](auto const& vector, int i) {
    constexpr int N = sizeof(vector) / sizeof(T);
    auto const grads = *reinterpret_cast<Vector<T, N> const*>(grad + i * p.grad.step);
    F v[N];
#pragma unroll
    for (int k = 0; k < N; ++k) {
      F const x = read(vector.v[k]);
      F const own = product(read(grads.v[k]), to.factor) + (x == smallest ? to.grad_smallest : F(0)) +
                    (x == largest ? to.grad_largest : F(0));
      v[k] = stays ? F(read(grads.v[k])) : own;
    }
    store_vector(grad_x + i * p.grad_x.step, v);
  });
}

// Samples of lists with each channel as a row, whose partial results begin at those of block `first`.
template <class T>
__device__ __forceinline__ MinMax<T> flat_from(MinMax<T> const& one, int64_t first) {
  MinMax<T> flat = flat_sample(one);
  flat.partial += 2 * first;
  return flat;
}
template <class T>
__device__ __forceinline__ MinMaxBackward<T> flat_from(MinMaxBackward<T> const& one, int64_t first) {
  MinMaxBackward<T> flat = flat_gradients(one);
  flat.partial += 4 * first;
  return flat;
}

// The first launch, and the one that maps, of a batch and of a list.
template <int P, bool Maps, class Batch>
__global__ void __launch_bounds__(kThreads) run_batch(__grid_constant__ Batch const p) {
  unsigned const block = Maps ? gridDim.x - 1 - blockIdx.x : blockIdx.x;
  ChunkPosition const at(block, p.chunk, p.chunks, p.x.width);
  if constexpr (Maps)
    map_chunk<P>(p, at);
  else
    reduce_chunk<P>(p, at, block);
}
template <int P, bool Maps, class List>
__global__ void __launch_bounds__(kThreads) run_list(__grid_constant__ List const p) {
  unsigned block;
  auto const* const one = sample_of_block(p, block);
  if (!one) return;
  auto flat = flat_from(*one, int64_t(blockIdx.x - block));
  flat.chunks = ceil_div(flat.x.width, flat.chunk);
  ChunkPosition const at(block, flat.chunk, flat.chunks, flat.x.width);
  if constexpr (Maps)
    map_chunk<P>(flat, at);
  else
    reduce_chunk<P>(flat, at, block);
}

// Whether vectors of x are vectors of what is read and written with it.
template <class T>
bool are_aligned(MinMax<T> const& p) {
  return are_equally_aligned<kPixels<T>>(p.x, p.y);
}
template <class T>
bool are_aligned(MinMaxBackward<T> const& p) {
  return are_equally_aligned<kPixels<T>>(p.x, p.grad) && are_equally_aligned<kPixels<T>>(p.x, p.grad_x);
}

template <template <class> class Batch, class T>
int launch_batch(Batch<T> const& p, CUstream_st* stream) {
  unsigned const blocks = unsigned(p.x.count() * p.chunks);
  with_row_vectors<kRowVector<T>>(are_aligned(p), [&](auto pixels) {
    run_batch<pixels.value, false><<<blocks, kThreads, 0, stream>>>(p);
    run_batch<pixels.value, true><<<blocks, kThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}
// By launch(how many blocks a sample has, run), which calls run(table, blocks).
template <class T, class List, class Launch>
int launch_tables(List const& p, bool aligned, CUstream_st* stream, Launch launch) {
  int error = 0;
  auto const blocks_of = [&](auto const& one) {
    return p.channels * ceil_div(one.x.height * one.x.width, p.all.chunk);
  };
  with_row_vectors<kRowVector<T>>(aligned, [&](auto pixels) {
    error = launch(blocks_of, [&](List const& list, unsigned blocks) {
      run_list<pixels.value, false><<<blocks, kThreads, 0, stream>>>(list);
      run_list<pixels.value, true><<<blocks, kThreads, 0, stream>>>(list);
    });
  });
  return error;
}

}  // namespace

template <class T>
int min_max(MinMax<T> const& p, CUstream_st* stream) {
  return launch_batch(p, stream);
}

template <class T>
int min_max_backward(MinMaxBackward<T> const& p, CUstream_st* stream) {
  return launch_batch(p, stream);
}

template <class T>
int min_max_list(MinMaxList<T> const& p, CUstream_st* stream) {
  bool const aligned = all_samples(p, [](MinMax<T> const& one) { return are_aligned(flat_sample(one)); });
  return launch_tables<T>(p, aligned, stream, [&](auto blocks_of, auto run) { return launch_list(p, blocks_of, run); });
}

template <class T>
int min_max_list_backward(MinMaxBackwardList<T> const& p, CUstream_st* stream) {
  bool const aligned = all_gradients(p, [](MinMaxBackward<T> const& one) { return are_aligned(flat_gradients(one)); });
  return launch_tables<T>(p, aligned, stream,
                          [&](auto blocks_of, auto run) { return launch_gradients(p, blocks_of, run); });
}

KV_INSTANTIATE(min_max, MinMax)
KV_INSTANTIATE(min_max_list, MinMaxList)
KV_INSTANTIATE(min_max_backward, MinMaxBackward)
KV_INSTANTIATE(min_max_list_backward, MinMaxBackwardList)

}  // namespace kv::enhance::cuda
