// Flips and crops on CUDA. Each thread copies vectors of 16 bytes: of a few rows where those of image and result are
// aligned alike, else of one row.
#include "core/row_vectors.cuh"
#include "geometry/transform/flip.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256, kRows = 4;  // rows in flight per thread

// Stores a vector, or its elements in reverse order.
template <class T, int P>
__device__ __forceinline__ void store_reversed_if(T* to, Vector<T, P> const& from, bool reversed) {
  Vector<T, P> vector = from;
  if (reversed)
#pragma unroll
    for (int l = 0; l < P; ++l) vector.v[l] = from.v[P - 1 - l];
  store_vector(to, vector);
}

// Blocks of rows of a plane are `across` vectors wide; there are `down` in a plane.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    flip_rows(__grid_constant__ Flip<T> const p, unsigned across, unsigned down) {
  unsigned const i = blockIdx.x * kThreads + threadIdx.x, block = i / across, plane = block / down;
  if (plane >= p.y.count()) return;
  int const e = int(i - block * across) * P, y = int(block - plane * down) * kRows;
  int const size = int(p.x.row_size()), height = int(p.x.height);
  int const from = p.columns ? size - P - e : e + int(p.left);
  int const first = p.rows ? height - 1 - y : y + int(p.top), down_one = p.rows ? -1 : 1;
  int const rows = unsigned(from) < unsigned(size) ? min(kRows, int(p.y.height) - y) : 0;
  T const* const in = p.x.row(plane, first) + from;
  int64_t const stride = p.x.row_stride * down_one;
  Vector<T, P> vectors[kRows] = {};
#pragma unroll
  for (int k = 0; k < kRows; ++k)
    if (k < rows && unsigned(first + k * down_one) < unsigned(height))
      vectors[k] = *reinterpret_cast<Vector<T, P> const*>(in + k * stride);
  T* const out = p.y.row(plane, y) + e;
#pragma unroll
  for (int k = 0; k < kRows; ++k) {
    if (y + k >= p.y.height) break;
    store_reversed_if(out + k * p.y.row_stride, vectors[k], p.columns);
  }
}

// Rows that begin anywhere: 2^shift threads copy a row of the result, by its aligned vectors. Each is read from the two
// aligned vectors of the image that contain it, or by element where part of it is out of bounds.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    flip_unaligned_rows(__grid_constant__ Flip<T> const p, int shift, T const* image_end) {
  unsigned const i = blockIdx.x * kThreads + threadIdx.x, row = i >> shift, plane = row / unsigned(p.y.height);
  if (plane >= p.y.count()) return;
  int const threads = 1 << shift, t = int(i) & (threads - 1), y = int(row - plane * unsigned(p.y.height));
  int const size = int(p.x.row_size()), left = int(p.left) * int(p.x.step), height = int(p.x.height);
  int const from_y = p.rows ? height - 1 - y : y + int(p.top);
  bool const in_bounds = unsigned(from_y) < unsigned(height);
  T const* const in = p.x.row(plane, in_bounds ? from_y : 0);
  T* const out = p.y.row(plane, y);
  auto const source = [&](int e) { return p.columns ? size - 1 - e : e + left; };
  auto const element = [&](int from) { return in_bounds && unsigned(from) < unsigned(size) ? in[from] : T{}; };
  AlignedBody<P, int> const body(out, 0, int(p.y.row_size()));
#pragma unroll 1
  for (int e = body.begin + t * P; e < body.end; e += threads * P) {
    int const first = p.columns ? source(e + P - 1) : source(e);
    Vector<T, P> vector;
    if (in_bounds && first >= 0 && first + P <= size) {
      vector = load_unaligned<P>(in + first, image_end);
    } else {
#pragma unroll
      for (int l = 0; l < P; ++l) vector.v[l] = element(first + l);
    }
    store_reversed_if(out + e, vector, p.columns);
  }
#pragma unroll 1
  for (int e = t; e < body.begin; e += threads) out[e] = element(source(e));
#pragma unroll 1
  for (int e = body.end + t; e < body.last; e += threads) out[e] = element(source(e));
}

// Rows of several channels whose pixels are adjacent, reversed pixel by pixel: a warp copies 32 x kColumns elements of
// some rows, each thread every 32nd one.
constexpr int kWarps = kThreads / 32, kColumns = 8;

template <class T>
__global__ void __launch_bounds__(kThreads) reverse_pixels(__grid_constant__ Flip<T> const p) {
  int const e = int(blockIdx.x) * 32 * kColumns + int(threadIdx.x % 32);
  int const first_y = int(blockIdx.y * kWarps + threadIdx.x / 32) * kRows;
  int const size = int(p.x.row_size()), step = int(p.x.step), height = int(p.x.height);
  auto const source = [&](int k) { return size - step - (e + 32 * k) + 2 * ((e + 32 * k) % step); };
  for (int64_t plane = blockIdx.z; plane < p.y.count(); plane += gridDim.z) {
    T const* const in = p.x.plane(plane);
    T* const out = p.y.plane(plane) + e;
    for (int y = first_y; y < height; y += int(gridDim.y) * kWarps * kRows) {
      T elements[kRows][kColumns] = {};
#pragma unroll
      for (int r = 0; r < kRows; ++r) {
        if (y + r >= height) continue;
        T const* const in_row = in + (p.rows ? height - 1 - y - r : y + r) * p.x.row_stride;
#pragma unroll
        for (int k = 0; k < kColumns; ++k)
          if (e + 32 * k < size) elements[r][k] = in_row[source(k)];
      }
      T* const out_row = out + y * p.y.row_stride;
#pragma unroll
      for (int r = 0; r < kRows; ++r)
#pragma unroll
        for (int k = 0; k < kColumns; ++k)
          if (y + r < height && e + 32 * k < size) out_row[r * p.y.row_stride + 32 * k] = elements[r][k];
    }
  }
}

}  // namespace

template <class T>
int flip(Flip<T> const& p, CUstream_st* stream) {
  constexpr int P = 16 / int(sizeof(T));
  int64_t const vectors = ceil_div(p.y.row_size(), P);
  // Special case, H200: 1.01 (hflip) to 1.18 (rotate180 backward) times as fast as shifted vectors.
  if (is_vectorizable<P>(p.x) && is_vectorizable<P>(p.y) && p.left % P == 0) {
    int64_t const down = ceil_div(p.y.height, kRows);
    flip_rows<T, P><<<unsigned(ceil_div(vectors * down * p.y.count(), kThreads)), kThreads, 0, stream>>>(
        p, unsigned(vectors), unsigned(down));
  } else if (p.columns && p.x.step > 1) {
    dim3 const blocks(unsigned(ceil_div(p.y.row_size(), 32 * kColumns)),
                      unsigned(min(ceil_div(p.y.height, kWarps * kRows), int64_t(65535))),
                      unsigned(min(p.y.count(), int64_t(65535))));
    reverse_pixels<<<blocks, kThreads, 0, stream>>>(p);
  } else {
    int shift = 2;
    while (shift < 5 && (1 << shift) < vectors) ++shift;
    while (shift > 0 && p.y.rows() > UINT32_MAX >> (shift + 1)) --shift;
    T const* const image_end = p.x.row(p.x.count() - 1, p.x.height - 1) + p.x.row_size();
    flip_unaligned_rows<T, P>
        <<<unsigned(ceil_div(p.y.rows() << shift, kThreads)), kThreads, 0, stream>>>(p, shift, image_end);
  }
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

}  // namespace kv::geometry::cuda
