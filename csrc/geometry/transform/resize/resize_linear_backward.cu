// The backward pass of bilinear and nearest resizing on CUDA. A pixel of the source gathers from the pixels of the
// result that read it.
//
// Downsampling of small images: at most two pixels along each axis read a pixel. A block has some rows of 128 adjacent
// elements, and each thread one column of them.
//
// Upsampling: a warp traverses the gradient downwards; each thread has four columns. Along y it keeps only two sums: a
// row of the gradient adds to those of the source rows above and below its coordinate. A complete sum is written to a
// line in shared memory, from which the pixels of its row gather along x.
#include "core/row_prefetcher.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kWarps = 4, kOwn = 4, kSpan = 32 * kOwn, kRing = 4;
constexpr int kTaps = 8;     // of a pixel along x, at most
constexpr int kColumns = 4;  // that a thread writes, 32 apart, at most

// Not inlined: the coordinates take most of the compile time.
__device__ __noinline__ LinearTaps<float> linear_taps_of(ResizeAxis const& axis, int i) {
  if (axis.filter == ResizeFilter::bilinear) return linear_taps<float>(axis, i);
  int const at = extent<float>(axis, i).first;
  return {at, at, 0};
}
__device__ __noinline__ Contributors<float> find_contributors(ResizeAxis const& axis, int index) {
  return contributors<float>(axis, index);
}

// --- downsampling ----------------------------------------------------------------------------------------------------

constexpr int kGatherRows = 8;  // of a block

// The pixels of the result that read a pixel of the source along an axis, and their weights. Unused entries have weight
// 0 and an index in bounds.
struct Readers {
  int at[2];
  float weights[2];
};
__device__ __forceinline__ Readers find_readers(ResizeAxis const& axis, int index) {
  Contributors<float> const reads = find_contributors(axis, index);
  Readers readers;
#pragma unroll
  for (int k = 0; k < 2; ++k) {
    readers.at[k] = k < reads.count ? reads.first + k : reads.count > 0 ? reads.first : 0;
    readers.weights[k] = k < reads.count ? linear_taps_of(axis, readers.at[k]).weight(index) : 0;
  }
  return readers;
}

template <class T>
__global__ void __launch_bounds__(32 * kWarps)
    gather_readers(__grid_constant__ Resize<T> const p, unsigned across, unsigned down) {
  __shared__ Readers rows[kGatherRows];
  unsigned const q = blockIdx.x / across, plane = q / down;
  int const e = int(blockIdx.x - q * across) * 32 * kWarps + threadIdx.x, y0 = int(q - plane * down) * kGatherRows;
  int const size = int(p.y.row_size()), step = int(p.y.step), height = int(p.y.height);
  if (threadIdx.x < kGatherRows) rows[threadIdx.x] = find_readers(p.rows, min(y0 + int(threadIdx.x), height - 1));
  int const x = min(e, size - 1) / step;
  Readers const columns = find_readers(p.columns, x);
  __syncthreads();
  if (e >= size) return;
  T const* const in = p.x.plane(plane) + (e - x * step);
  T* const out = p.y.row(plane, y0) + e;
#pragma unroll
  for (int r = 0; r < kGatherRows; ++r) {
    float sum = 0;
#pragma unroll
    for (int i = 0; i < 2; ++i) {
      if (i > 0 && p.rows.max_taps < 2) break;
      T const* const row = in + rows[r].at[i] * p.x.row_stride;
#pragma unroll
      for (int k = 0; k < 2; ++k) {
        if (k > 0 && p.columns.max_taps < 2) break;
        float const weight = rows[r].weights[i] * columns.weights[k];
        if (weight != 0) sum += weight * float(read(row[columns.at[k] * step]));
      }
    }
    if (y0 + r < height) out[r * p.y.row_stride] = round_to<T>(sum);
  }
}

// --- upsampling ------------------------------------------------------------------------------------------------------

// The strips: `width` columns of some rows of a plane, a warp each.
struct SourceStrips {
  int width, rows;
  unsigned across, down, count;
};

struct WarpMemory {
  LinearTaps<float> pairs[kSpan];  // of the columns of the gradient
  float line[kSpan + kTaps];       // of sums
};

template <class T>
__global__ void __launch_bounds__(32 * kWarps)
    transpose_pairs(__grid_constant__ Resize<T> const p, SourceStrips strips) {
  __shared__ Vector<T, kOwn> rings[kWarps][kRing][32];
  __shared__ WarpMemory memory[kWarps];
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  unsigned const number = blockIdx.x * kWarps + warp, q = number / strips.across, plane = q / strips.down;
  if (number >= strips.count) return;
  int const x0 = int(number - q * strips.across) * strips.width, x1 = min(x0 + strips.width, int(p.y.width));
  int const y0 = int(q - plane * strips.down) * strips.rows, y1 = min(y0 + strips.rows, int(p.y.height));
  auto& ring = rings[warp];
  auto& [pairs, line] = memory[warp];

  // The columns of the gradient that the strip reads, from a whole vector on.
  int const begin = find_contributors(p.columns, x0).first & -kOwn, own = begin + kOwn * lane, width = int(p.x.width);
#pragma unroll
  for (int i = 0; i < kOwn; ++i) {
    pairs[32 * i + lane] = linear_taps_of(p.columns, min(begin + 32 * i + lane, width - 1));
    ring[i][lane] = {};
  }
  if (lane < kTaps) line[kSpan + lane] = 0;
  __syncwarp();
  int first[kColumns];
  float weights[kColumns][kTaps];
#pragma unroll
  for (int i = 0; i < kColumns; ++i) {
    int const x = min(x0 + 32 * i + lane, x1 - 1);
    Contributors<float> const reads = find_contributors(p.columns, x);
    first[i] = reads.first - begin;
#pragma unroll
    for (int k = 0; k < kTaps; ++k) weights[i][k] = k < reads.count ? pairs[first[i] + k].weight(x) : 0;
  }

  Contributors<float> const of_top = find_contributors(p.rows, y0), of_bottom = find_contributors(p.rows, y1 - 1);
  int const rows = of_bottom.first + of_bottom.count - of_top.first, stride = int(p.x.row_stride * sizeof(T));
  T const* const from = p.x.row(plane, of_top.first) + own;
  int next = 0;
  auto const copy_next = [&] {
    auto const to = uint32_t(__cvta_generic_to_shared(&ring[next % kRing][lane]));
    copy_async_if<sizeof(Vector<T, kOwn>)>(to, row_at(from, next, stride), own < width && next < rows, false);
    __pipeline_commit();
    ++next;
  };
  for (int i = 0; i < kRing - 1; ++i) copy_next();

  float upper[kOwn] = {}, lower[kOwn] = {};  // the sums of row y and of the next one
  int y = 0;
  auto const finish_row = [&] {
    if (y >= y0) {
      *reinterpret_cast<float4*>(line + kOwn * lane) = float4{upper[0], upper[1], upper[2], upper[3]};
      __syncwarp();
      T* const out = p.y.row(plane, y) + x0 + lane;
#pragma unroll
      for (int i = 0; i < kColumns; ++i) {
        if (x0 + 32 * i >= x1) break;
        float sum = 0;
#pragma unroll
        for (int k = 0; k < kTaps; ++k) {
          if (k >= p.columns.max_taps) break;
          sum += weights[i][k] * line[first[i] + k];
        }
        if (!(sum - sum == 0)) {  // a tap of weight 0 contributes nothing
          sum = 0;
#pragma unroll
          for (int k = 0; k < kTaps; ++k) sum += weights[i][k] != 0 ? weights[i][k] * line[first[i] + k] : 0;
        }
        if (x0 + 32 * i + lane < x1) out[32 * i] = round_to<T>(sum);
      }
      __syncwarp();
    }
#pragma unroll
    for (int k = 0; k < kOwn; ++k) upper[k] = lower[k], lower[k] = 0;
    ++y;
  };

  LinearTaps<float> of_lane;  // each thread holds those of one of 32 rows
#pragma unroll 1
  for (int r = 0; r <= rows; ++r) {
    if (r % 32 == 0) of_lane = linear_taps_of(p.rows, min(of_top.first + r + lane, int(p.x.height) - 1));
    int const a = r < rows ? __shfl_sync(0xffffffffu, of_lane.a, r) : y1;
    int const b = __shfl_sync(0xffffffffu, of_lane.b, r);
    float const t = __shfl_sync(0xffffffffu, a < b ? of_lane.t : 0, r);
    if (r == 0) y = a;
    while (y < a) finish_row();
    if (r == rows) break;
    __pipeline_wait_prior(kRing - 2);
    Vector<T, kOwn> const vector = ring[r % kRing][lane];
    copy_next();
#pragma unroll
    for (int k = 0; k < kOwn; ++k) upper[k] += (1 - t) * read(vector.v[k]);
    if (t != 0) {
#pragma unroll
      for (int k = 0; k < kOwn; ++k) lower[k] += t * read(vector.v[k]);
    }
  }
}

}  // namespace

template <class T>
int resize_linear_backward(Resize<T> const& p, CUstream_st* stream) {
  ResizeAxis const &rows = p.rows, &columns = p.columns;
  auto const shrinks = [](ResizeAxis const& a) {
    return a.backward && a.num >= a.den && a.filter <= ResizeFilter::bilinear && a.filter != ResizeFilter::area &&
           !a.antialias && a.max_taps <= 2;
  };
  // Small images have too few strips to occupy the GPU. For large images strips are faster.
  bool const is_small = p.y.rows() * p.y.row_size() <= 1 << 20;
  if (is_small && shrinks(rows) && shrinks(columns) && !p.minuend) {
    unsigned const across = unsigned(ceil_div(p.y.row_size(), 32 * kWarps)),
                   down = unsigned(ceil_div(p.y.height, kGatherRows));
    gather_readers<<<unsigned(p.y.count() * across * down), 32 * kWarps, 0, stream>>>(p, across, down);
    return cudaGetLastError();
  }
  auto const served = [](ResizeAxis const& a) {
    return a.backward && a.num > 0 && a.num <= a.den && a.filter <= ResizeFilter::bilinear &&
           a.filter != ResizeFilter::area;
  };
  if (!served(rows) || !served(columns) || columns.max_taps > kTaps || !is_vectorizable<kOwn>(p.x) || p.y.step != 1 ||
      p.x.row_stride * int64_t(sizeof(T)) > INT32_MAX)
    return kUnsupported;
  // So many columns that their reads are in kSpan columns of the gradient, as whole sectors of memory.
  int64_t const width = min(int64_t(kSpan), (kSpan - kOwn) * columns.num / columns.den - 1) / 16 * 16;
  if (width < 32) return kUnsupported;
  SourceStrips strips{int(width), 32, unsigned(ceil_div(p.y.width, width)), 0, 0};  // enough for the machine
  int64_t const across = p.y.count() * strips.across;
  while (strips.rows > 4 && across * ceil_div(p.y.height, strips.rows) < 8000) strips.rows /= 2;
  strips.down = unsigned(ceil_div(p.y.height, strips.rows));
  strips.count = unsigned(across * strips.down);
  transpose_pairs<<<unsigned(ceil_div(strips.count, kWarps)), 32 * kWarps, 0, stream>>>(p, strips);
  return cudaGetLastError();
}

template int resize_linear_backward(Resize<float> const&, CUstream_st*);
template int resize_linear_backward(Resize<Half> const&, CUstream_st*);
template int resize_linear_backward(Resize<BFloat16> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
