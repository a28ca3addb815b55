// Images made of pieces on CUDA: each thread has 16 bytes of a row of the result.
#include "augmentation/mixing/pieces.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kPieceThreads = 128, kMixThreads = 32;

// P elements of a row, `first` elements behind its begin, and 0 beyond its ends. All of them in one access where that
// is aligned.
template <class T, int P>
__device__ __forceinline__ void read_elements(T const* row, int64_t first, int64_t size, Compute<T> (&v)[P]) {
  if (row && first >= 0 && first + P <= size && reinterpret_cast<uintptr_t>(row + first) % alignof(Vector<T, P>) == 0) {
    auto const own = *reinterpret_cast<Vector<T, P> const*>(row + first);
#pragma unroll
    for (int i = 0; i < P; ++i) v[i] = read(own.v[i]);
    return;
  }
#pragma unroll
  for (int i = 0; i < P; ++i) v[i] = row && first + i >= 0 && first + i < size ? read(row[first + i]) : Compute<T>(0);
}

// The plane, the row and the first element of a thread. False after the last one.
template <class T, int P>
__device__ __forceinline__ bool locate(Planes<T> const& y, unsigned vectors, int64_t& plane, int64_t& row,
                                       int64_t& first) {
  int64_t const i = blockIdx.x * int64_t(kPieceThreads) + threadIdx.x, r = i / vectors;
  first = (i - r * vectors) * P;
  plane = r / y.height;
  row = r - plane * y.height;
  return r < y.rows();
}

template <class T, int P>
__device__ __forceinline__ void store_elements(Planes<T> const& y, int64_t plane, int64_t row, int64_t first,
                                               Compute<T> const (&v)[P]) {
  T* const to = y.row(plane, row) + first;
  if (first + P <= y.row_size() && reinterpret_cast<uintptr_t>(to) % alignof(Vector<T, P>) == 0)
    return store_vector(to, v);
#pragma unroll
  for (int i = 0; i < P; ++i)
    if (first + i < y.row_size()) to[i] = round_to<T>(v[i]);
}

template <class T, int P>
__global__ void __launch_bounds__(kPieceThreads)
    paste_rows(__grid_constant__ PastePieces<T> const p, unsigned vectors) {
  int64_t plane, y, first;
  if (!locate<T, P>(p.y, vectors, plane, y, first)) return;
  int64_t const b = plane / p.planes_per_sample, step = p.y.step, size = p.x.row_size();
  // What a copy hides is not read.
  int begin = p.count;
  for (bool is_hidden = false; begin > 0 && !is_hidden; --begin) {
    Piece const piece = p.piece(b, begin - 1);
    is_hidden = piece.weight == 1 && piece.has_row(y) && piece.left * step <= first && first + P <= piece.right * step;
    if (is_hidden) break;
  }
  Compute<T> v[P];
  if (begin == 0) {
    read_elements<T, P>(p.row_of(plane, b, 0, y), first, size, v);
  } else {
    Piece const piece = p.piece(b, begin - 1);
    read_elements<T, P>(p.row_of(plane, b, piece.source, y + piece.dy), first + piece.dx * step, size, v);
  }
  for (int n = begin; n < p.count; ++n) {
    Piece const piece = p.piece(b, n);
    int64_t const left = piece.left * step, right = piece.right * step;
    if (!piece.has_row(y) || right <= first || left >= first + P) continue;
    Compute<T> other[P];
    read_elements<T, P>(p.row_of(plane, b, piece.source, y + piece.dy), first + piece.dx * step, size, other);
    Compute<T> const weight = piece.weight, rest = 1 - weight;
#pragma unroll
    for (int i = 0; i < P; ++i)
      if (left <= first + i && first + i < right) v[i] = weight == 1 ? other[i] : v[i] * rest + other[i] * weight;
  }
  store_elements<T, P>(p.y, plane, y, first, v);
}

template <class T, int P>
__global__ void __launch_bounds__(kPieceThreads)
    paste_rows_backward(__grid_constant__ PastePieces<T> const p, unsigned vectors) {
  int64_t plane, y, first;
  if (!locate<T, P>(p.y, vectors, plane, y, first)) return;
  int64_t const b = plane / p.planes_per_sample, step = p.y.step, size = p.x.row_size();
  // v has the gradients to P elements from `first` on of row `row` of the result of a sample, which the pieces from n
  // on cover.
  auto const cover = [&](int64_t sample, int n, int64_t row, int64_t first, Compute<T>(&v)[P]) {
    for (; n < p.count; ++n) {
      Piece const above = p.piece(sample, n);
      int64_t const left = above.left * step, right = above.right * step;
      if (!above.has_row(row) || right <= first || left >= first + P) continue;
      Compute<T> const rest = 1 - Compute<T>(above.weight);
#pragma unroll
      for (int i = 0; i < P; ++i)
        if (left <= first + i && first + i < right) v[i] = rest == 0 ? Compute<T>(0) : v[i] * rest;
    }
  };
  Compute<T> sum[P];
  read_elements<T, P>(p.row_of(plane, b, 0, y), first, size, sum);
  cover(b, 0, y, first, sum);
  for (int n = 0; n < p.count; ++n) {
    int64_t const user = p.piece(b, n).user;
    if (b + user < 0 || b + user >= p.batch) continue;
    Piece const piece = p.piece(b + user, n);
    int64_t const row = y - piece.dy, begin = first - piece.dx * step, left = piece.left * step,
                  right = piece.right * step;
    if (piece.source != -user || !piece.has_row(row) || right <= begin || left >= begin + P) continue;
    Compute<T> v[P];
    read_elements<T, P>(p.row_of(plane, b, user, row), begin, size, v);
    cover(b + user, n + 1, row, begin, v);
#pragma unroll
    for (int i = 0; i < P; ++i)
      if (left <= begin + i && begin + i < right) sum[i] += Compute<T>(piece.weight) * v[i];
  }
  store_elements<T, P>(p.y, plane, y, first, sum);
}

template <class T>
__global__ void __launch_bounds__(kMixThreads) mix_samples(__grid_constant__ MixPieces<T> const p) {
  int64_t const b = blockIdx.x * int64_t(kMixThreads) + threadIdx.x;
  if (b < p.batch) mix_sample(p, b);
}

template <int P, class T>
unsigned pieces_vectors(PastePieces<T> const& p) {
  return unsigned(ceil_div(p.y.row_size(), P));
}

}  // namespace

template <class T>
int paste_pieces(PastePieces<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / sizeof(T);
  unsigned const vectors = pieces_vectors<P>(p);
  paste_rows<T, P><<<unsigned(ceil_div(p.y.rows() * vectors, kPieceThreads)), kPieceThreads, 0, stream>>>(p, vectors);
  return cudaGetLastError();
}

template <class T>
int paste_pieces_backward(PastePieces<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / sizeof(T);
  unsigned const vectors = pieces_vectors<P>(p);
  paste_rows_backward<T, P>
      <<<unsigned(ceil_div(p.y.rows() * vectors, kPieceThreads)), kPieceThreads, 0, stream>>>(p, vectors);
  return cudaGetLastError();
}

template <class T>
int mix_pieces(MixPieces<T> const& p, CUstream_st* stream) {
  mix_samples<<<unsigned(ceil_div(p.batch, kMixThreads)), kMixThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(paste_pieces, PastePieces)
KV_INSTANTIATE(paste_pieces_backward, PastePieces)
KV_INSTANTIATE_ONE(mix_pieces, MixPieces, float)

}  // namespace kv::augmentation::cuda
