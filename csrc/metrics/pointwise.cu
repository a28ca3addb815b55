// Losses element by element on CUDA: a block takes a piece of a row, each thread four elements of both tensors at a
// time.
#include "pointwise.h"
#include "sums.cuh"

namespace kv::cuda {
namespace {

template <class F>
struct Math {
  __device__ __forceinline__ static F exp(F x) {
    if constexpr (sizeof(F) == 4)
      return ::expf(x);
    else
      return ::exp(x);
  }
  __device__ __forceinline__ static F log(F x) {
    if constexpr (sizeof(F) == 4)
      return ::logf(x);
    else
      return ::log(x);
  }
  __device__ __forceinline__ static F sqrt(F x) { return fast_sqrt(x); }
  __device__ __forceinline__ static F divide(F x, F y) { return x * fast_reciprocal(y); }
};

constexpr int kThreads = kSumThreads, kPack = 4;

// Calls f(first element, x, y) for the elements of piece `piece` that the thread takes: with kPack of both where rows
// are `packed`, their starts and ends multiples of a pack, and with single ones elsewhere and of doubles. Not unrolled,
// as f is long and a multiprocessor has enough threads to keep its memory busy.
template <class T, class Call>
__device__ __forceinline__ void for_each_pack(Pair<T> const& pair, int64_t row, int64_t piece, bool packed, Call f) {
  using F = Compute<T>;
  T const *const x = pair.x + row * pair.x_stride, *const y = pair.y + row * pair.y_stride;
  int64_t const first = piece * kPointPiece, last = min(first + kPointPiece, pair.size);
  auto const take = [&](auto width) {
    constexpr int P = decltype(width)::value;
#pragma unroll 1
    for (int64_t e = first + P * threadIdx.x; e < last; e += P * kThreads) {
      Pack<T, P> const a = *reinterpret_cast<Pack<T, P> const*>(x + e);
      Pack<T, P> const b = *reinterpret_cast<Pack<T, P> const*>(y + e);
      F u[P], v[P];
#pragma unroll
      for (int i = 0; i < P; ++i) u[i] = read(a.v[i]), v[i] = read(b.v[i]);
      f(row * pair.size + e, u, v);
    }
  };
  if (sizeof(T) < 8 && packed)
    take(std::integral_constant<int, sizeof(T) < 8 ? kPack : 1>{});
  else
    take(std::integral_constant<int, 1>{});
}

template <class T>
__global__ void __launch_bounds__(kThreads) sum_points(__grid_constant__ PointwiseSum<T> const p, bool packed) {
  using F = Compute<T>;
  int64_t const row = blockIdx.x / p.pieces;
  F sum = 0;
  for_each_pack(p.pair, row, blockIdx.x - row * p.pieces, packed, [&](int64_t, auto const& x, auto const& y) {
#pragma unroll
    for (int i = 0; i < int(sizeof(x) / sizeof(F)); ++i) sum += point_loss<F, Math<F>>(p.pair.kind, x[i], y[i]);
  });
  sum = block_sum(sum);
  if (threadIdx.x == 0) p.partial[blockIdx.x] = sum;
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    map_points(__grid_constant__ PointwiseMap<T> const p, int64_t pieces, bool packed) {
  using F = Compute<T>;
  PointLoss const kind = p.pair.kind;
  int64_t const row = blockIdx.x / pieces;
  F const of_row = p.grad_of_sum ? p.gradient(row) : F(1);
  for_each_pack(p.pair, row, blockIdx.x - row * pieces, packed, [&](int64_t e, auto const& x, auto const& y) {
    constexpr int P = sizeof(x) / sizeof(F);
    F result[P];
#pragma unroll
    for (int i = 0; i < P; ++i) {
      if (p.grad || p.grad_of_sum)
        result[i] = point_slope<F, Math<F>>(kind, p.by_other, x[i], y[i]) * (p.grad ? read(p.grad[e + i]) : of_row);
      else
        result[i] = point_loss<F, Math<F>>(kind, x[i], y[i]);
    }
    store_pack(p.out + e, result);
  });
}

template <class T>
bool is_packed(Pair<T> const& pair, void const* other) {
  auto const aligned = [](void const* at) { return reinterpret_cast<uintptr_t>(at) % sizeof(Pack<T, kPack>) == 0; };
  return aligned(pair.x) && aligned(pair.y) && aligned(other) && pair.size % kPack == 0;
}

}  // namespace

template <class T>
int pointwise_sum(PointwiseSum<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.pair.rows;
  sum_points<<<unsigned(rows * p.pieces), kThreads, 0, stream>>>(p, is_packed(p.pair, nullptr));
  finish_sums<<<unsigned(rows), kThreads, 0, stream>>>(p.partial, p.pieces, p.finish, p.sums);
  return cudaGetLastError();
}

template <class T>
int pointwise_map(PointwiseMap<T> const& p, CUstream_st* stream) {
  int64_t const pieces = ceil_div(p.pair.size, kPointPiece);
  map_points<<<unsigned(p.pair.rows * pieces), kThreads, 0, stream>>>(p, pieces, is_packed(p.pair, p.out));
  return cudaGetLastError();
}

KV_INSTANTIATE(pointwise_sum, PointwiseSum)
KV_INSTANTIATE(pointwise_map, PointwiseMap)

}  // namespace kv::cuda
