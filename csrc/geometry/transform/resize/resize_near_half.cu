// pyrdown and antialiased bilinear resizing of half types and bytes by a factor near two on CUDA, where coordinates
// drift along a row, so that windows are no constants (those of exactly two are in resize_octave.cu). A thread goes
// down a group of four pixels of the result (core/stencils/column_groups.cuh), whose windows begin at 2 j or 2 j + 1.
#include "core/stencils/column_groups.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int P = 4, kRows = 24;           // pixels of a group; about the rows of a block
constexpr int kAhead = 2, kThreads = 128;  // rows in flight; of a block
template <ResizeFilter Filter>
constexpr bool kPyrdown = Filter == ResizeFilter::pyrdown;
template <ResizeFilter Filter>
constexpr int kTaps = kPyrdown<Filter> ? 6 : 5;
template <ResizeFilter Filter>
constexpr int kRead = 2 * (P - 1) + kTaps<Filter> + 1;  // pixels that a group may read

template <ResizeFilter Filter>
struct Window {
  int first;
  float weights[kTaps<Filter>];
};
template <ResizeFilter Filter>
__device__ __forceinline__ Window<Filter> window_of(ResizeAxis const& axis, int i) {
  if constexpr (kPyrdown<Filter>) {  // the mean of two binomials
    LinearTaps<float> const taps = linear_taps<float>(axis, i);
    float const t = taps.t, u = 1 - t;
    return {taps.a - 2,
            {u / 16, (4 * u + t) / 16, (6 * u + 4 * t) / 16, (4 * u + 6 * t) / 16, (u + 4 * t) / 16, t / 16}};
  } else {
    int64_t const n = axis.center(i);
    Window<Filter> window{int(axis.floor_div(n - axis.unit)) + 1, {}};
    float sum = 0;
#pragma unroll
    for (int t = 0; t < kTaps<Filter>; ++t) {
      int const at = window.first + t;
      float const distance = float(double(at * axis.den - n) * axis.per_unit);
      window.weights[t] = at >= 0 && at < axis.source ? filter_at(ResizeFilter::bilinear, true, distance) : 0.f;
      sum += window.weights[t];
    }
    float const norm = 1 / sum;
#pragma unroll
    for (int t = 0; t < kTaps<Filter>; ++t) window.weights[t] *= norm;
    return window;
  }
}

// Pixels out of bounds give their weights to those that the border reads instead: the two at an end of the image that
// the window of the pixel beside it has.
__device__ __forceinline__ void fold_border(Window<ResizeFilter::pyrdown>& window, Border border, bool left,
                                            bool right) {
  float(&w)[6] = window.weights;
  auto const move = [&](float& from, float& reflected, float& edge) {
    reflected += border == Border::reflect ? from : 0;
    edge += border == Border::replicate ? from : 0;
    from = 0;
  };
  if (left) move(w[0], w[4], w[2]), move(w[1], w[3], w[2]);
  if (right) move(w[5], w[1], w[3]), move(w[4], w[2], w[3]);
}

// A row of the source: its weights in the three rows of the result that are not complete, and whether it completes the
// first of them.
struct alignas(16) SourceRow {
  float weights[3];
  unsigned completes;
};

template <class T, ResizeFilter Filter, int Bytes>
__global__ void __launch_bounds__(kThreads, 5)
    near_half_groups(__grid_constant__ Resize<T> const p, __grid_constant__ ColumnGroups<P, kThreads> const groups) {
  constexpr int kTaps = cuda::kTaps<Filter>, kRead = cuda::kRead<Filter>, kPairs = kTaps / 2 + 1;
  // Bytes are filtered along x as integers, two pixels and two weights at a time: their rows are units of 2^-15.
  constexpr bool kByInteger = sizeof(T) == 1;
  __shared__ Window<Filter> rows[2 * kRows + 2];
  __shared__ SourceRow source_rows[2 * kRows * 9 / 4 + 2 * kTaps];
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  int const y1 = min(y0 + groups.rows, int(p.y.height));
  for (int i = threadIdx.x; i < y1 - y0 + 2; i += int(blockDim.x)) {
    rows[i] = window_of<Filter>(p.rows, min(y0 + i, y1 - 1));
    if constexpr (kPyrdown<Filter>) fold_border(rows[i], p.rows.border, y0 + i == 0, y0 + i == int(p.y.height) - 1);
    if (y0 + i >= y1) rows[i].first = INT32_MAX / 2;  // begins after the last row that is read
  }
  __syncthreads();
  int const begin = rows[0].first, end = rows[y1 - 1 - y0].first + kTaps;
  for (int i = threadIdx.x; i < end - begin; i += int(blockDim.x)) {
    int at = max((i - kTaps) * 4 / 9, 0);  // the first row of the result that is not complete, or one before
    while (rows[at].first + kTaps <= begin + i) ++at;
    SourceRow row{{}, begin + i - rows[at].first == kTaps - 1 ? 1u : 0u};
    for (int s = 0; s < 3; ++s) {
      int const tap = begin + i - rows[at + s].first;
      if (tap < 0) break;
      row.weights[s] = rows[at + s].weights[tap] * (kByInteger ? 0x1p-15f : 1.f);
    }
    source_rows[i] = row;
  }
  __syncthreads();

  float weights[P][2 * kPairs];  // of the pixels from 2 j on; 0 for those that are not in the window
  uint32_t pairs[P][kPairs];
  int first;  // of the group
#pragma unroll
  for (int j = 0; j < P; ++j) {
    Window<Filter> window = window_of<Filter>(p.columns, x + j);
    if (j == 0) first = window.first;
    bool const late = window.first - first > 2 * j;  // begins at 2 j + 1
    if constexpr (kPyrdown<Filter>)
      fold_border(window, p.columns.border, j == 0 && x == 0, j == P - 1 && x + P == int(p.y.width));
#pragma unroll
    for (int t = 0; t < 2 * kPairs; ++t) {
      float const before = t > 0 && t <= kTaps ? window.weights[clamp(t - 1, 0, kTaps - 1)] : 0;
      weights[j][t] = late ? before : t < kTaps ? window.weights[min(t, kTaps - 1)] : 0;
    }
    if constexpr (kByInteger)
#pragma unroll
      for (int t = 0; t < 2 * kPairs; t += 2)
        pairs[j][t / 2] = __float2uint_rn(weights[j][t] * 0x1p15f) | __float2uint_rn(weights[j][t + 1] * 0x1p15f) << 16;
  }
  using Rows = GroupRows<T, kRead, 0>;
  Rows const reader(p.x, plane, first, Border::constant);
  GroupStore<T, P, Bytes, kFewestStores> out(p.y, plane, x, y0);

  int y = begin;
  int const last = min(end, int(p.x.height)) - 1;
  auto const fetch = [&](int y) { return reader.fetch(clamp(y, 0, last)); };  // those out of bounds have no weight
  typename Rows::Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y + i);
  float sums[3][P] = {};  // of the rows of the result that are not complete
#pragma unroll 1
  while (y < end) {
#pragma unroll
    for (int slot = 0; slot < kAhead; ++slot, ++y) {
      if (slot > 0 && y >= end) break;
      SourceRow const row = source_rows[y - begin];
      float h[P];
      bool finite = true;
      if constexpr (kByInteger) {
        uint32_t packed[Rows::kPacked];
        reader.pack(ahead[slot], packed);
        ahead[slot] = fetch(y + kAhead);
#pragma unroll
        for (int j = 0; j < P; ++j) {
          uint32_t sum = 0x4b000000;  // as a float 2^23
#pragma unroll
          for (int pair = j; pair < j + kPairs; ++pair)
            sum = pair % 2 ? __dp2a_hi(pairs[j][pair - j], packed[pair / 2], sum)
                           : __dp2a_lo(pairs[j][pair - j], packed[pair / 2], sum);
          h[j] = __uint_as_float(sum) - float(1 << 23);
        }
      } else {
        float v[kRead];
        reader.unpack(ahead[slot], v);
        ahead[slot] = fetch(y + kAhead);
#pragma unroll
        for (int j = 0; j < P; ++j)
#pragma unroll
          for (int t = 0; t <= kTaps; ++t)
            h[j] = t == 0 ? weights[j][0] * v[2 * j] : fmaf(weights[j][t], v[2 * j + t], h[j]);
        if constexpr (sizeof(T) > 1) {
          float poison = 0;
#pragma unroll
          for (int j = 0; j < P; ++j) poison += h[j] * 0;
          finite = poison == 0;
        }
        if (!finite) {  // inf and NaN with weight 0 contribute nothing
#pragma unroll
          for (int j = 0; j < P; ++j) {
            h[j] = 0;
#pragma unroll
            for (int t = 0; t <= kTaps; ++t)
              if (weights[j][t] != 0) h[j] = fmaf(weights[j][t], v[2 * j + t], h[j]);
          }
        }
      }
#pragma unroll
      for (int s = 0; s < 3; ++s)
        if (finite || row.weights[s] != 0) {
#pragma unroll
          for (int j = 0; j < P; ++j) sums[s][j] = fmaf(row.weights[s], h[j], sums[s][j]);
        }
      if (row.completes) {
        out.put(rounded<T>(sums[0]));
#pragma unroll
        for (int j = 0; j < P; ++j) sums[0][j] = sums[1][j], sums[1][j] = sums[2][j], sums[2][j] = 0;
      }
    }
  }
}

}  // namespace

template <class T>
int resize_near_half(Resize<T> const& p, CUstream_st* stream) {
  auto const serves = [&](ResizeAxis const& axis) {
    return (axis.filter == ResizeFilter::pyrdown || (axis.filter == ResizeFilter::bilinear && axis.antialias)) &&
           axis.filter == p.columns.filter && !axis.backward && axis.origin == axis.source - axis.result &&
           axis.source >= 2 * axis.result && 4 * axis.source <= 9 * axis.result && axis.result >= P &&
           axis.source >= 16;
  };
  bool const planar = p.x.step == 1 && p.y.step == 1 && !p.minuend;
  if (!planar || !serves(p.rows) || !serves(p.columns)) return kUnsupported;
  if (p.x.row_stride * int64_t(sizeof(T)) > INT32_MAX) return kUnsupported;
  constexpr int kBytes = P * int(sizeof(T));
  auto const launch = [&](auto filter) {
    auto const run = [&](auto bytes) {
      auto* const kernel = near_half_groups<T, filter.value, bytes.value>;
      static int const resident = resident_blocks(kernel, kThreads);
      ColumnGroups<P, kThreads> const groups(p.y.count(), p.y.height, p.y.width, kRows, 0, 4, resident);
      kernel<<<groups.blocks(), groups.threads, 0, stream>>>(p, groups);
    };
    bytes_of_rows<P>(p.y) == kBytes ? run(std::integral_constant<int, kBytes>{})
                                    : run(std::integral_constant<int, 0>{});
  };
  if (p.columns.filter == ResizeFilter::pyrdown)
    launch(std::integral_constant<ResizeFilter, ResizeFilter::pyrdown>{});
  else
    launch(std::integral_constant<ResizeFilter, ResizeFilter::bilinear>{});
  return cudaGetLastError();
}

template int resize_near_half(Resize<Half> const&, CUstream_st*);
template int resize_near_half(Resize<BFloat16> const&, CUstream_st*);
template int resize_near_half(Resize<uint8_t> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
