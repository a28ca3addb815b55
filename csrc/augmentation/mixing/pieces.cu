// Images made of pieces on CUDA: a block has some rows of a plane of the result, a thread 16 bytes of a row at a time.
// The pieces of these rows are kept in shared memory, by 32-bit numbers.
#include "augmentation/mixing/pieces.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kPieceThreads = 128, kVectorsOfThread = 4, kMixThreads = 32;

// P elements of a row, `first` elements behind its begin, and 0 beyond its ends. All of them in one access where that
// is aligned.
template <class T, int P>
__device__ __forceinline__ void read_elements(T const* row, int first, int size, Compute<T> (&v)[P]) {
  if (row && first >= 0 && first + P <= size && reinterpret_cast<uintptr_t>(row + first) % alignof(Vector<T, P>) == 0) {
    auto const own = *reinterpret_cast<Vector<T, P> const*>(row + first);
#pragma unroll
    for (int i = 0; i < P; ++i) v[i] = read(own.v[i]);
    return;
  }
#pragma unroll
  for (int i = 0; i < P; ++i) v[i] = row && first + i >= 0 && first + i < size ? read(row[first + i]) : Compute<T>(0);
}

template <class T, int P>
__device__ __forceinline__ void store_elements(T* row, int first, int size, Compute<T> const (&v)[P]) {
  T* const to = row + first;
  if (first + P <= size && reinterpret_cast<uintptr_t>(to) % alignof(Vector<T, P>) == 0) return store_vector(to, v);
#pragma unroll
  for (int i = 0; i < P; ++i)
    if (first + i < size) to[i] = round_to<T>(v[i]);
}

// A piece whose columns are elements of rows. No image reaches the numbers to which it is clamped.
struct __align__(16) KeptPiece {
  int left, right, top, bottom, dx, dy, source;
  float weight;

  KeptPiece() = default;
  __device__ __forceinline__ KeptPiece(Piece const& p, int64_t step)
      : left(limited(p.left * step)),
        right(limited(p.right * step)),
        top(limited(p.top)),
        bottom(limited(p.bottom)),
        dx(limited(p.dx * step)),
        dy(limited(p.dy)),
        source(limited(p.source)),
        weight(p.weight) {}
  static __device__ __forceinline__ int limited(int64_t x) {
    return int(clamp(x, -int64_t(kMaxPieceRow), int64_t(kMaxPieceRow)));
  }
  __device__ __forceinline__ bool has_row(int y) const { return top <= y && y < bottom; }
  // Whether it has any of P elements of a row, and all of them.
  template <int P>
  __device__ __forceinline__ bool touches(int y, int first) const {
    return has_row(y) && left < first + P && first < right;
  }
  template <int P>
  __device__ __forceinline__ bool covers(int y, int first) const {
    return has_row(y) && left <= first && first + P <= right;
  }
  __device__ __forceinline__ bool has_element(int i) const { return left <= i && i < right; }
  __device__ __forceinline__ bool is_hidden_by(KeptPiece const& above) const {
    return left < above.right && above.left < right && top < above.bottom && above.top < bottom;
  }
};
// A piece of another sample that reads from the sample of a block.
struct __align__(16) Reader {
  KeptPiece piece;
  int number, user;
  bool is_hidden;  // in part, by pieces of later numbers
};

// The rows [top, bottom) of a plane that a block has.
struct BlockRows {
  int64_t plane;
  int top, bottom;
  template <class T>
  __device__ __forceinline__ BlockRows(Planes<T> const& y, int rows, unsigned parts) {
    plane = blockIdx.x / parts;
    top = int(blockIdx.x % parts) * rows;
    bottom = min(top + rows, int(y.height));
  }
  // Calls f(row, first element) for the vectors of a thread.
  template <int P, class F>
  __device__ __forceinline__ void for_each_vector(int vectors, F f) const {
    int row = int(threadIdx.x) / vectors, vector = int(threadIdx.x) % vectors;
    int const rows = kPieceThreads / vectors, rest = kPieceThreads % vectors;
    for (row += top; row < bottom; row += rows) {
      f(row, vector * P);
      vector += rest;
      if (vector >= vectors) vector -= vectors, ++row;
    }
  }
};

// Warp 0 calls keep(n, at) for the numbers below `count` for which is_kept(n), in order, and returns how many there
// are.
template <class IsKept, class Keep>
__device__ __forceinline__ int keep_in_order(int count, IsKept is_kept, Keep keep) {
  int kept = 0;
  for (int first = 0; first < count; first += 32) {
    int const n = first + int(threadIdx.x);
    bool const is_own = n < count && is_kept(n);
    unsigned const all = __ballot_sync(~0u, is_own);
    if (is_own) keep(n, kept + __popc(all & ((1u << threadIdx.x) - 1)));
    kept += __popc(all);
  }
  return kept;
}

template <class T, int P>
__global__ void __launch_bounds__(kPieceThreads)
    paste_rows(__grid_constant__ PastePieces<T> const p, int vectors, int rows, unsigned parts) {
  extern __shared__ __align__(16) char shared[];
  __shared__ int shared_count;
  auto* const kept = reinterpret_cast<KeptPiece*>(shared);
  BlockRows const block(p.y, rows, parts);
  int64_t const plane = block.plane, b = plane / p.planes_per_sample, step = p.y.step;
  int const size = int(p.x.row_size()), to_size = int(p.y.row_size());
  if (threadIdx.x < 32) {
    KeptPiece piece;
    int const all = keep_in_order(
        p.count,
        [&](int n) {
          piece = KeptPiece(p.piece(b, n), step);
          return piece.left < piece.right && piece.top < block.bottom && block.top < piece.bottom;
        },
        [&](int, int at) { kept[at] = piece; });
    if (threadIdx.x == 0) shared_count = all;
  }
  __syncthreads();
  int const count = shared_count;
  block.for_each_vector<P>(vectors, [&](int y, int first) {
    // What a copy hides is not read.
    int begin = count;
    while (begin > 0 && !(kept[begin - 1].weight == 1 && kept[begin - 1].covers<P>(y, first))) --begin;
    Compute<T> v[P];
    if (begin == 0) {
      read_elements<T, P>(p.row_of(plane, b, 0, y), first, size, v);
    } else {
      KeptPiece const piece = kept[begin - 1];
      read_elements<T, P>(p.row_of(plane, b, piece.source, y + piece.dy), first + piece.dx, size, v);
    }
    for (int n = begin; n < count; ++n) {
      KeptPiece const piece = kept[n];
      if (!piece.touches<P>(y, first)) continue;
      Compute<T> other[P];
      read_elements<T, P>(p.row_of(plane, b, piece.source, y + piece.dy), first + piece.dx, size, other);
      Compute<T> const weight = piece.weight, rest = 1 - weight;
#pragma unroll
      for (int i = 0; i < P; ++i)
        if (piece.has_element(first + i)) v[i] = weight == 1 ? other[i] : v[i] * rest + other[i] * weight;
    }
    store_elements<T, P>(p.y.row(plane, y), first, to_size, v);
  });
}

template <class T, int P>
__global__ void __launch_bounds__(kPieceThreads)
    paste_rows_backward(__grid_constant__ PastePieces<T> const p, int vectors, int rows, unsigned parts) {
  extern __shared__ __align__(16) char shared[];
  __shared__ int reader_count;
  auto* const own = reinterpret_cast<KeptPiece*>(shared);
  auto* const readers = reinterpret_cast<Reader*>(own + p.count);
  BlockRows const block(p.y, rows, parts);
  int64_t const plane = block.plane, b = plane / p.planes_per_sample, step = p.y.step;
  int const size = int(p.x.row_size()), to_size = int(p.y.row_size());
  for (int n = int(threadIdx.x); n < p.count; n += kPieceThreads) own[n] = KeptPiece(p.piece(b, n), step);
  if (threadIdx.x < 32) {
    Reader reader;
    int const all = keep_in_order(
        p.count,
        [&](int n) {
          int64_t const user = p.piece(b, n).user;
          if (b + user < 0 || b + user >= p.batch) return false;
          KeptPiece const piece(p.piece(b + user, n), step);
          reader = {piece, n, int(user), false};
          return piece.source == -user && piece.left < piece.right && piece.top + piece.dy < block.bottom &&
                 block.top < piece.bottom + piece.dy;
        },
        [&](int, int at) { readers[at] = reader; });
    if (threadIdx.x == 0) reader_count = all;
  }
  __syncthreads();
  int const count = reader_count;
  for (int i = int(threadIdx.x); i < count * p.count; i += kPieceThreads) {
    int const k = i / p.count, n = i % p.count;
    Reader& reader = readers[k];
    if (n <= reader.number) continue;
    KeptPiece const above = reader.user == 0 ? own[n] : KeptPiece(p.piece(b + reader.user, n), step);
    if (reader.piece.is_hidden_by(above)) reader.is_hidden = true;
  }
  __syncthreads();
  // v has the gradients to P elements from `first` on of row `y` of a result. What a piece above leaves of them:
  auto const cover = [](KeptPiece const& above, int y, int first, Compute<T>(&v)[P]) {
    if (!above.touches<P>(y, first)) return;
    Compute<T> const rest = 1 - Compute<T>(above.weight);
#pragma unroll
    for (int i = 0; i < P; ++i)
      if (above.has_element(first + i)) v[i] = rest == 0 ? Compute<T>(0) : v[i] * rest;
  };
  block.for_each_vector<P>(vectors, [&](int y, int first) {
    Compute<T> sum[P]{};
    bool is_hidden = false;
    for (int n = 0; n < p.count && !is_hidden; ++n) is_hidden = own[n].weight == 1 && own[n].covers<P>(y, first);
    if (!is_hidden) {
      read_elements<T, P>(p.row_of(plane, b, 0, y), first, size, sum);
      for (int n = 0; n < p.count; ++n) cover(own[n], y, first, sum);
    }
    for (int k = 0; k < count; ++k) {
      KeptPiece const piece = readers[k].piece;
      int const row = y - piece.dy, begin = first - piece.dx;
      if (!piece.touches<P>(row, begin)) continue;
      int const number = readers[k].number, user = readers[k].user;
      Compute<T> v[P];
      read_elements<T, P>(p.row_of(plane, b, user, row), begin, size, v);
      if (readers[k].is_hidden)
        for (int n = number + 1; n < p.count; ++n)
          cover(user == 0 ? own[n] : KeptPiece(p.piece(b + user, n), step), row, begin, v);
#pragma unroll
      for (int i = 0; i < P; ++i)
        if (piece.has_element(begin + i)) sum[i] += Compute<T>(piece.weight) * v[i];
    }
    store_elements<T, P>(p.y.row(plane, y), first, to_size, sum);
  });
}

// find_reader by all threads of a warp.
template <class T>
__device__ __forceinline__ int64_t find_reader_by_warp(MixPieces<T> const& p, int64_t b, int i) {
  T const own = p.drawn(b, i);
  if (!(own >= 0)) return b;
  int const lane = int(threadIdx.x) % 32;
  int rank = 0;
  for (int64_t k = lane; k < p.batch; k += 32) rank += precedes(p.drawn(k, i), k, own, b);
  rank = warp_reduce(rank, Sum());
  for (int64_t first = 0; first < p.batch; first += 32) {
    unsigned const chosen = __ballot_sync(~0u, first + lane < p.batch && p.drawn(first + lane, i) >= 0);
    if (rank < __popc(chosen)) return first + int(__fns(chosen, 0, rank + 1));
    rank -= __popc(chosen);
  }
  return b;
}

// A warp has a sample.
template <class T>
__global__ void __launch_bounds__(kMixThreads) mix_samples(__grid_constant__ MixPieces<T> const p) {
  mix_sample(p, blockIdx.x, [&](int64_t b, int i) { return find_reader_by_warp(p, b, i); });
}

template <class T, class Kernel>
int launch_rows(Kernel* kernel, PastePieces<T> const& p, size_t bytes, cudaStream_t stream) {
  int const vectors = int(ceil_div(p.y.row_size(), int64_t(16 / sizeof(T))));
  int const rows = max(kPieceThreads * kVectorsOfThread / vectors, 1);
  unsigned const parts = unsigned(ceil_div(p.y.height, int64_t(rows)));
  kernel<<<unsigned(p.y.count()) * parts, kPieceThreads, bytes, stream>>>(p, vectors, rows, parts);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int paste_pieces(PastePieces<T> const& p, CUstream_st* stream) {
  return launch_rows(paste_rows<T, 16 / sizeof(T)>, p, size_t(p.count) * sizeof(KeptPiece), stream);
}

template <class T>
int paste_pieces_backward(PastePieces<T> const& p, CUstream_st* stream) {
  size_t const bytes = size_t(p.count) * (sizeof(KeptPiece) + sizeof(Reader));
  return launch_rows(paste_rows_backward<T, 16 / sizeof(T)>, p, bytes, stream);
}

template <class T>
int mix_pieces(MixPieces<T> const& p, CUstream_st* stream) {
  mix_samples<<<unsigned(p.batch), kMixThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(paste_pieces, PastePieces)
KV_INSTANTIATE(paste_pieces_backward, PastePieces)
KV_INSTANTIATE_ONE(mix_pieces, MixPieces, float)

}  // namespace kv::augmentation::cuda
