// Flips and crops on CUDA. Each thread copies vectors of 16 bytes: of a few rows where those of image and result are
// aligned alike, else of one row.
#include <cmath>

#include "core/row_vectors.cuh"
#include "core/stencils/column_groups.cuh"
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

// Rows that begin anywhere: `threads` of them copy a row of the result, each one of its aligned vectors. It is read
// from the two aligned vectors of the image that contain it, or by element where part of it is out of bounds.
template <class T, int P>
__global__ void __launch_bounds__(kThreads)
    flip_unaligned_rows(__grid_constant__ Flip<T> const p, unsigned threads, T const* image_end) {
  unsigned const i = blockIdx.x * kThreads + threadIdx.x, row = i / threads, plane = row / unsigned(p.y.height);
  if (plane >= p.y.count()) return;
  int const t = int(i - row * threads), y = int(row - plane * unsigned(p.y.height));
  int const size = int(p.x.row_size()), left = int(p.left) * int(p.x.step), height = int(p.x.height);
  int const from_y = p.rows ? height - 1 - y : y + int(p.top);
  bool const in_bounds = unsigned(from_y) < unsigned(height);
  T const* const in = p.x.row(plane, in_bounds ? from_y : 0);
  T* const out = p.y.row(plane, y);
  auto const source = [&](int e) { return p.columns ? size - 1 - e : e + left; };
  auto const copy = [&](int e) {
    int const from = source(e);
    out[e] = in_bounds && unsigned(from) < unsigned(size) ? in[from] : T{};
  };
  AlignedBody<P, int> const body(out, 0, int(p.y.row_size()));
#pragma unroll 1
  for (int e = body.begin + t * P; e < body.end; e += int(threads) * P) {
    int const first = p.columns ? source(e + P - 1) : source(e);
    if (in_bounds && first >= 0 && first + P <= size && is_within<P>(in + first, image_end)) {
      Vector<T, P> vector;
      auto const words = load_shifted(in + first);
      __builtin_memcpy(&vector, words.v, sizeof(vector));
      store_reversed_if(out + e, vector, p.columns);
    } else {
#pragma unroll 1
      for (int l = 0; l < P; ++l) copy(e + l);
    }
  }
#pragma unroll 1
  for (int e = t; e < body.begin; e += int(threads)) copy(e);
#pragma unroll 1
  for (int e = body.end + t; e < body.last; e += int(threads)) copy(e);
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

// Crops between pixels: a thread goes down a group of columns (core/stencils/column_groups.cuh) with the means along x
// of the row above.
constexpr int kCropRows = 16, kAhead = 2;  // of a block; in flight

// As warps compute it, bit by bit.
template <class T>
__device__ __forceinline__ float midpoint(float a, float b) {
  float const between = fmaf(.5f, b - a, a);
  return sizeof(T) == 1 || between - between == 0 ? between : fmaf(.5f, a, .5f * b);
}

template <class T, int Bytes>
__global__ void __launch_bounds__(256)
    crop_between_groups(__grid_constant__ CropBetween<T> const p,
                        __grid_constant__ ColumnGroups<kGroupPixels<T>> const groups) {
  constexpr int P = kGroupPixels<T>;
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  int const y1 = min(y0 + groups.rows, int(p.y.height)), last = y1 - 1 + p.rows;
  using Rows = GroupRows<T, P + 1, 0>;
  Rows const reader(p.x, plane, p.left + x, Border::constant);
  GroupStore<T, P, Bytes, kFewestStores> out(p.y, plane, x, y0);
  auto const fetch = [&](int y) { return reader.fetch(p.top + min(y, last)); };
  auto const means_of = [&](typename Rows::Fetched const& row, float(&means)[P]) {
    float v[P + 1];
    reader.unpack(row, v);
#pragma unroll
    for (int j = 0; j < P; ++j) means[j] = p.columns ? midpoint<T>(v[j], v[j + 1]) : v[j];
  };
  float above[P];
  means_of(fetch(y0), above);
  typename Rows::Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y0 + p.rows + i);
#pragma unroll 1
  for (int first = y0; first < y1; first += kAhead)
#pragma unroll
    for (int i = 0; i < kAhead; ++i) {
      int const y = first + i;
      if (i > 0 && y >= y1) break;
      float below[P], means[P];
      means_of(ahead[i], below);
      ahead[i] = fetch(y + p.rows + kAhead);
#pragma unroll
      for (int j = 0; j < P; ++j) means[j] = p.rows ? midpoint<T>(above[j], below[j]) : below[j], above[j] = below[j];
      out.put(means);
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
    int64_t const threads = clamp(p.y.row_size() / P, int64_t(1), int64_t(UINT32_MAX) / p.y.rows());
    T const* const image_end = p.x.row(p.x.count() - 1, p.x.height - 1) + p.x.row_size();
    flip_unaligned_rows<T, P>
        <<<unsigned(ceil_div(p.y.rows() * threads, kThreads)), kThreads, 0, stream>>>(p, unsigned(threads), image_end);
  }
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

// Special case, H200: 1.9 (335x513) to 2.1 (375x500) times as fast as a warp by a translation, float16.
template <class T>
bool is_crop_between(Planes<T const> const& x, int64_t height, int64_t width, double top, double left) {
  auto const fits = [](double first, int64_t size, int64_t from) {
    return 2 * first == std::floor(2 * first) && first >= 0 && std::ceil(first) + double(size) <= double(from);
  };
  return supports_groups<kGroupPixels<T>, 0>(x) && width >= kGroupPixels<T> && x.height <= INT32_MAX / 2 &&
         fits(left, width, x.width) && fits(top, height, x.height);
}

template <class T>
int crop_between(CropBetween<T> const& p, CUstream_st* stream) {
  constexpr int P = kGroupPixels<T>;
  with_row_bytes<P>(
      [&](auto bytes) {
        static int const resident = resident_blocks(crop_between_groups<T, bytes.value>, 256);
        ColumnGroups<P> const groups(p.y.count(), p.y.height, p.y.width, kCropRows, 0, 1 + p.rows, resident);
        crop_between_groups<T, bytes.value><<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
      },
      p.y);
  return cudaGetLastError();
}

#define KV_CROP_BETWEEN(T)                                                                 \
  template bool is_crop_between(Planes<T const> const&, int64_t, int64_t, double, double); \
  template int crop_between(CropBetween<T> const&, CUstream_st*);
KV_CROP_BETWEEN(float)
KV_CROP_BETWEEN(Half)
KV_CROP_BETWEEN(BFloat16)
KV_CROP_BETWEEN(uint8_t)
#undef KV_CROP_BETWEEN

}  // namespace kv::geometry::cuda
