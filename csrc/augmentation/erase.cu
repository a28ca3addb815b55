// Erased rectangles on CUDA: each thread has 16 bytes of a row.
#include "augmentation/erase.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kEraseThreads = 128;

// P elements of a row for each thread. A row of a channels-last image has all channels of its pixels.
template <class T, int P>
__global__ void __launch_bounds__(kEraseThreads)
    erase_rows(__grid_constant__ EraseRectangles<T> const p, unsigned vectors) {
  int64_t const i = blockIdx.x * int64_t(kEraseThreads) + threadIdx.x, r = i / vectors, first = (i - r * vectors) * P;
  if (r >= p.x.rows()) return;
  int64_t const plane = r / p.x.height, y = r - plane * p.x.height, b = p.sample(plane);
  Vector<T, P> v = *reinterpret_cast<Vector<T, P> const*>(p.x.row(plane, y) + first);
  float const* const box = p.boxes + b * p.box_stride;
  if (ErasedRange(box[1], box[3], p.x.height).contains(y)) {
    ErasedRange columns(box[0], box[2], p.x.width);
    columns.begin *= p.x.step, columns.end *= p.x.step;
    T const value = round_to<T>(p.values[b * p.value_stride]);
#pragma unroll
    for (int k = 0; k < P; ++k)
      if (columns.contains(first + k)) v.v[k] = value;
  }
  store_vector(p.y.row(plane, y) + first, v);
}

template <class T, int P>
int launch_erase(EraseRectangles<T> const& p, CUstream_st* stream) {
  unsigned const vectors = unsigned(p.x.row_size() / P);
  erase_rows<T, P><<<unsigned(ceil_div(p.x.rows() * vectors, kEraseThreads)), kEraseThreads, 0, stream>>>(p, vectors);
  return cudaGetLastError();
}

// Whether rows are whole vectors of P elements.
template <int P, class T>
bool has_whole_vectors(Planes<T> const& p) {
  constexpr int64_t bytes = P * sizeof(T), size = sizeof(T);
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.row_size() % P == 0 &&
         p.row_stride * size % bytes == 0 && p.outer_stride * size % bytes == 0 && p.inner_stride * size % bytes == 0;
}

}  // namespace

template <class T>
int erase_rectangles(EraseRectangles<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / sizeof(T);
  return has_whole_vectors<P>(p.x) && has_whole_vectors<P>(p.y) ? launch_erase<T, P>(p, stream)
                                                                : launch_erase<T, 1>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(erase_rectangles, EraseRectangles)

}  // namespace kv::augmentation::cuda
