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
constexpr int kReach = kPyrdown<Filter> ? 2 : 1;  // the most pixels of a window that are out of bounds on a side
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
    return {taps.a - kReach<Filter>,
            {u / 16, (4 * u + t) / 16, (6 * u + 4 * t) / 16, (4 * u + 6 * t) / 16, (u + 4 * t) / 16, t / 16}};
  } else {
    int64_t const n = axis.center(i);
    Window<Filter> window{int(axis.floor_div(n - axis.unit)) + 1, {}};
    float sum = 0;
#pragma unroll
    for (int t = 0; t < kTaps<Filter>; ++t) {
      int const at = window.first + t;
      window.weights[t] = at >= 0 && at < axis.source ? window_at<float>(axis, at * axis.den - n) : 0.f;
      sum += window.weights[t];
    }
    float const norm = 1 / sum;
#pragma unroll
    for (int t = 0; t < kTaps<Filter>; ++t) window.weights[t] *= norm;
    return window;
  }
}

template <class T, ResizeFilter Filter, int Bytes>
__global__ void __launch_bounds__(kThreads, 5)
    near_half_groups(__grid_constant__ Resize<T> const p, __grid_constant__ ColumnGroups<P, kThreads> const groups) {
  constexpr int kTaps = cuda::kTaps<Filter>, kReach = cuda::kReach<Filter>, kRead = cuda::kRead<Filter>;
  __shared__ Window<Filter> rows[2 * kRows + 2];
  int64_t plane;
  int x, y0;
  groups.locate(plane, x, y0);
  int const y1 = min(y0 + groups.rows, int(p.y.height)), height = int(p.x.height), width = int(p.x.width);
  for (int i = threadIdx.x; i < y1 - y0 + 2; i += int(blockDim.x)) {
    rows[i] = window_of<Filter>(p.rows, min(y0 + i, y1 - 1));
    if (y0 + i >= y1) rows[i].first = INT32_MAX / 2;  // begins after the last row that is read
  }
  __syncthreads();

  float weights[P][kTaps];
  bool late[P];  // whether the window begins at 2 j + 1
  int first;     // of the group
#pragma unroll
  for (int j = 0; j < P; ++j) {
    Window<Filter> const window = window_of<Filter>(p.columns, x + j);
    if (j == 0) first = window.first;
    late[j] = window.first - first > 2 * j;
#pragma unroll
    for (int t = 0; t < kTaps; ++t) weights[j][t] = window.weights[t];
  }
  bool const any_late = __any_sync(0xffffffffu, late[P - 1]);
  bool const left_end = first < 0, right_end = x + P == int(p.y.width);
  Border const border = p.columns.border;
  using Rows = GroupRows<T, kRead - 2 * kReach, kReach>;
  Rows const reader(p.x, plane, first + kReach, border);
  GroupStore<T, P, Bytes> out(p.y, plane, x, y0);

  int y = rows[0].first;
  int const end = rows[y1 - 1 - y0].first + kTaps;
  auto const fetch = [&](int y) {
    int const source = y < end ? border_index(p.rows.border, y, height) : -1;
    return source < 0 ? typename Rows::Fetched{} : reader.fetch(source);
  };
  typename Rows::Fetched ahead[kAhead];
#pragma unroll
  for (int i = 0; i < kAhead; ++i) ahead[i] = fetch(y + i);
  float sums[3][P] = {};  // of the rows of the result that are not complete
  int at = 0;             // the first of them
#pragma unroll 1
  while (y < end) {
#pragma unroll
    for (int slot = 0; slot < kAhead; ++slot, ++y) {
      if (slot > 0 && y >= end) break;
      float v[kRead], h[P];
      reader.unpack(ahead[slot], v);
      ahead[slot] = fetch(y + kAhead);
      // Out of bounds are two pixels at an end of the image at most: its coordinates are within.
      if constexpr (kPyrdown<Filter>) {
        if (left_end) {
          v[1] = border == Border::constant ? 0 : border == Border::reflect ? v[3] : v[2];
          v[0] = border == Border::constant ? 0 : border == Border::reflect ? v[4] : v[2];
        }
        if (right_end) {
          constexpr int kLast = 2 * (P - 1) + kTaps - 1;
          auto const fill = [&](auto last) {
            constexpr int i = last.value;  // of the last window
            v[i - 1] = border == Border::constant ? 0 : border == Border::reflect ? v[i - 3] : v[i - 2];
            v[i] = border == Border::constant ? 0 : border == Border::reflect ? v[i - 4] : v[i - 2];
          };
          if (late[P - 1])
            fill(std::integral_constant<int, kLast + 1>{});
          else
            fill(std::integral_constant<int, kLast>{});
        }
      } else {
        if (left_end) v[0] = 0;
        if (right_end) {
#pragma unroll
          for (int i = kRead - 3; i < kRead; ++i)
            if (first + i >= width) v[i] = 0;
        }
      }
#pragma unroll
      for (int j = 0; j < P; ++j) {
        if (any_late) {
#pragma unroll
          for (int t = 0; t < kTaps; ++t) {
            float const pixel = late[j] ? v[2 * j + t + 1] : v[2 * j + t];
            h[j] = t == 0 ? weights[j][0] * pixel : fmaf(weights[j][t], pixel, h[j]);
          }
        } else {
#pragma unroll
          for (int t = 0; t < kTaps; ++t)
            h[j] = t == 0 ? weights[j][0] * v[2 * j] : fmaf(weights[j][t], v[2 * j + t], h[j]);
        }
      }
      if constexpr (!kPyrdown<Filter> && sizeof(T) > 1) {
        float poison = 0;
#pragma unroll
        for (int j = 0; j < P; ++j) poison += h[j] * 0;
        if (poison != 0) {  // a tap of weight 0 contributes nothing, even if it is inf or NaN
#pragma unroll
          for (int j = 0; j < P; ++j) {
            h[j] = 0;
#pragma unroll
            for (int t = 0; t < kTaps; ++t) {
              float const pixel = late[j] ? v[2 * j + t + 1] : v[2 * j + t];
              if (weights[j][t] != 0) h[j] = fmaf(weights[j][t], pixel, h[j]);
            }
          }
        }
      }
#pragma unroll
      for (int s = 0; s < 3; ++s) {
        int const tap = y - rows[at + s].first;
        if (tap < 0) break;
        float const weight = rows[at + s].weights[tap];
        if (!kPyrdown<Filter> && weight == 0) continue;
#pragma unroll
        for (int j = 0; j < P; ++j) sums[s][j] = fmaf(weight, h[j], sums[s][j]);
      }
      if (y - rows[at].first == kTaps - 1) {
        out.put(rounded<T>(sums[0]));
        ++at;
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
