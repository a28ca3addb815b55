// CUDA kernel for add_weighted: each thread computes two vectors, or eight pixels where the alignments of rows differ.
#include "add_weighted.h"
#include "core/row_vectors.cuh"

namespace kv::enhance::cuda {
namespace {

constexpr int kThreads = 256;
template <int P>
constexpr int kAtOnce = P == 1 ? 8 : 2;  // vectors of P pixels

template <class T, int P>
__global__ void __launch_bounds__(kThreads) run(__grid_constant__ AddWeighted<T> const p) {
  using F = Compute<T>;
  int64_t const step = P > 1 ? 1 : p.x.step;
  for (int64_t plane = blockIdx.y; plane < p.x.count(); plane += gridDim.y) {
    F const a = p.weight_of(p.alpha, plane), b = p.weight_of(p.beta, plane), c = p.weight_of(p.gamma, plane);
    T const *const x = p.x.plane(plane), *const y = p.y.plane(plane);
    T* const result = p.result.plane(plane);
    auto const sum = [&](Vector<T, P> const& u, Vector<T, P> const& v, int64_t i) {
      F sums[P];
#pragma unroll
      for (int j = 0; j < P; ++j) sums[j] = read(u.v[j]) * a + read(v.v[j]) * b + c;
      store_vector(result + i * step, sums);
    };
    AlignedBody<P, int64_t> const body(result, 0, p.x.width);
    if (blockIdx.x == 0)
      body.for_each_peeled([&](int64_t i) { result[i] = round_to<T>(read(x[i]) * a + read(y[i]) * b + c); });
    int64_t const first = body.begin + (blockIdx.x * int64_t(kAtOnce<P> * kThreads) + threadIdx.x) * P;
    Vector<T, P> xs[kAtOnce<P>], ys[kAtOnce<P>];
#pragma unroll
    for (int k = 0; k < kAtOnce<P>; ++k) {
      int64_t const i = first + k * kThreads * P;
      if (i >= body.end) break;
      xs[k] = *reinterpret_cast<Vector<T, P> const*>(x + i * step);
      ys[k] = *reinterpret_cast<Vector<T, P> const*>(y + i * step);
    }
#pragma unroll
    for (int k = 0; k < kAtOnce<P>; ++k) {
      int64_t const i = first + k * kThreads * P;
      if (i < body.end) sum(xs[k], ys[k], i);
    }
  }
}

}  // namespace

template <class T>
int add_weighted(AddWeighted<T> const& p, CUstream_st* stream) {
  constexpr int P = sizeof(T) == 8 ? 1 : kPixels<T>;
  bool const equally_aligned = are_equally_aligned<P>(p.result, p.x) && are_equally_aligned<P>(p.result, p.y);
  with_row_vectors<P>(equally_aligned, [&](auto pixels) {
    constexpr int N = pixels.value;
    dim3 const blocks(unsigned(ceil_div(p.x.width, kAtOnce<N> * kThreads * N)),
                      unsigned(min(p.x.count(), int64_t(65535))));
    run<T, N><<<blocks, kThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE(add_weighted, AddWeighted)

}  // namespace kv::enhance::cuda
