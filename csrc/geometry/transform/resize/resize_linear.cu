// Bilinear and nearest images of any size on CUDA: means of at most two pixels along each axis.
//
// A warp traverses a strip of 32 * kColumns columns of the result downwards; the columns of a thread are 32 apart. It
// keeps the means along x of two rows of the image, which are blended to a row of the result. Where an image grows, its
// rows are prefetched to shared memory by asynchronous copies; else pixels are loaded a row ahead.
#include "core/row_prefetcher.cuh"
#include "geometry/transform/resize/resize.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kWarps = 4, kColumns = 4;

// Not inlined: the coordinates take most of the compile time.
__device__ __noinline__ LinearTaps<float> linear_taps_of(ResizeAxis const& axis, int i) {
  if (axis.filter == ResizeFilter::bilinear) return linear_taps<float>(axis, i);
  int const at = extent<float>(axis, i).first;
  return {at, at, 0};
}

// An index in bytes is added to an address by one instruction.
template <class T>
__device__ __forceinline__ T element(uintptr_t row, int i) {
  using Bits = std::conditional_t<sizeof(T) == 4, unsigned, std::conditional_t<sizeof(T) == 2, uint16_t, uint8_t>>;
  Bits const bits = __ldg(reinterpret_cast<Bits const*>(row + int64_t(i) * int(sizeof(T))));
  return *reinterpret_cast<T const*>(&bits);
}

// The taps of a thread's columns in a row.
template <class T>
struct PixelPairs {
  T left[kColumns], right[kColumns];
};

// Ahead: a strip's part of a row is one vector a thread, and no row is left out.
template <class T, bool Ahead>
__global__ void __launch_bounds__(32 * kWarps)
    resize_pairs(__grid_constant__ Resize<T> const p, Strips<kColumns> strips) {
  int64_t plane;
  int column, top;
  if (!strips.locate(plane, column, top)) return;
  int const lane = threadIdx.x % 32, size = int(p.y.row_size()), step = int(p.x.step);
  column -= (kColumns - 1) * lane;

  int left[kColumns], right[kColumns];
  float t[kColumns];
#pragma unroll
  for (int i = 0; i < kColumns; ++i) {
    int const e = min(column + 32 * i, size - 1), x = e / step;
    LinearTaps<float> const pair = linear_taps_of(p.columns, x);
    left[i] = pair.a * step + e - x * step;
    right[i] = pair.b * step + e - x * step;
    t[i] = pair.a < pair.b ? pair.t : 0.5f;  // one pixel, twice: not with weight 0, which would make NaN of inf
  }
  int const height = int(p.y.height), rows = min(int(strips.rows), height - top);
  LinearTaps<float> const of_lane =
      linear_taps_of(p.rows, min(top + lane, height - 1));  // each thread holds those of one row
  float const t_of_lane = of_lane.a < of_lane.b ? of_lane.t : 0;

  uintptr_t const in = reinterpret_cast<uintptr_t>(p.x.plane(plane));
  int const stride = int(p.x.row_stride * sizeof(T));

  constexpr int kVectorSize = 16 / int(sizeof(T)), kRing = 4;
  __shared__ Vector<T, kVectorSize> rings[Ahead ? kWarps : 1][Ahead ? kRing : 1][32];
  [[maybe_unused]] auto* const ring = rings[Ahead ? threadIdx.x / 32 : 0];
  [[maybe_unused]] unsigned next = __shfl_sync(0xffffffffu, of_lane.a, 0), last = 0;
  [[maybe_unused]] bool copies = false;
  [[maybe_unused]] uintptr_t own = in;
  [[maybe_unused]] auto const copy_next = [&] {
    auto const to = uint32_t(__cvta_generic_to_shared(&ring[next % kRing][lane]));
    copy_async_if<16>(to, reinterpret_cast<void const*>(own + int64_t(next) * stride), copies && next <= last, false);
    __pipeline_commit();
    ++next;
  };
  if constexpr (Ahead) {
    int const begin = __shfl_sync(0xffffffffu, left[0], 0) / kVectorSize * kVectorSize,
              vector = begin + kVectorSize * lane;
    last = __shfl_sync(0xffffffffu, of_lane.b, rows - 1);
    copies = vector <= __shfl_sync(0xffffffffu, right[kColumns - 1], 31);
    own = in + int64_t(vector) * int(sizeof(T));
#pragma unroll
    for (int i = 0; i < kColumns; ++i) left[i] -= begin, right[i] -= begin;
    for (int i = 0; i < kRing - 1; ++i) copy_next();
  }
  auto const fetch = [&](int y) {
    PixelPairs<T> row;
    if constexpr (Ahead) {
      __pipeline_wait_prior(kRing - 2);
      __syncwarp();
      copy_next();
      T const* const from = ring[unsigned(y) % kRing]->v;
#pragma unroll
      for (int i = 0; i < kColumns; ++i) row.left[i] = from[left[i]], row.right[i] = from[right[i]];
      return row;
    }
    uintptr_t const from = in + int64_t(y) * stride;
#pragma unroll
    for (int i = 0; i < kColumns; ++i) {
      row.left[i] = element<T>(from, left[i]);
      row.right[i] = element<T>(from, right[i]);
    }
    return row;
  };
  auto const means = [&](PixelPairs<T> const& row, float(&mean)[kColumns]) {
#pragma unroll
    for (int i = 0; i < kColumns; ++i) mean[i] = (1 - t[i]) * read(row.left[i]) + t[i] * read(row.right[i]);
  };

  float upper[kColumns], lower[kColumns];  // of rows a and b
  int a = -1, b = -1;
  // The state for a row of the result; missing rows are requested.
  PixelPairs<T> next_upper, next_lower;
  bool moves, has_upper, has_lower;
  float weight;  // of the lower one
  auto const ask = [&](int r) {
    int const target = __shfl_sync(0xffffffffu, of_lane.a, r);
    weight = __shfl_sync(0xffffffffu, t_of_lane, r);
    moves = target != a && target == b;
    has_upper = target != a && target != b;
    has_lower = weight != 0 && target + 1 != b;
    a = target;
    if (has_lower) b = target + 1;
    if (has_upper) next_upper = fetch(a);
    if (has_lower) next_lower = fetch(b);
  };

  T* out = p.y.row(plane, top) + column;
  ask(0);
#pragma unroll 1
  for (int r = 0; r < rows; ++r) {
    if (moves) {
#pragma unroll
      for (int i = 0; i < kColumns; ++i) upper[i] = lower[i];
    }
    if (has_upper) means(next_upper, upper);
    if (has_lower) means(next_lower, lower);
    float const of_lower = weight;
    if (r + 1 < rows) ask(r + 1);
#pragma unroll
    for (int i = 0; i < kColumns; ++i) {
      float mean = (1 - of_lower) * upper[i];
      if (of_lower != 0) mean += of_lower * lower[i];
      if (32 * i < size - column) out[32 * i] = round_to<T>(mean);
    }
    out += p.y.row_stride;
  }
}

}  // namespace

template <class T>
int resize_linear(Resize<T> const& p, CUstream_st* stream) {
  auto const served = [](ResizeAxis const& a) {
    // Where an image grows, antialiased windows are the others.
    return !a.backward && (a.filter <= ResizeFilter::nearest_exact ||
                           (a.filter == ResizeFilter::bilinear && (!a.antialias || a.num <= a.den)));
  };
  if (!served(p.rows) || !served(p.columns) ||
      max(p.x.row_stride * int64_t(sizeof(T)), p.y.row_size()) > INT32_MAX - 128)
    return kUnsupported;
  // Special case, H200: 0.85 (resize 224) to 2.3 (resize 224 of 4) times as fast as strips of any kind.
  int rows = 32;  // there must be enough strips for the machine
  int64_t const across = ceil_div(p.y.row_size(), 32 * kColumns);
  while (rows > 4 && p.y.count() * across * ceil_div(p.y.height, rows) < 12000) rows /= 2;
  Strips<kColumns> const strips(p.y.count(), p.y.height, p.y.row_size(), rows);
  constexpr int kVectorSize = 16 / int(sizeof(T));
  ResizeAxis const& a = p.columns;
  bool const grows = p.rows.num <= p.rows.den && a.num <= a.den &&
                     (32 * kColumns - 1) * a.num / a.den + 2 + kVectorSize <= 32 * kVectorSize;
  // Special case, H200: 1.12 (resize 1.4) to 1.25 (resize 1.4 nearest) times as fast as rows that are read as they are
  // needed.
  if (grows && is_vectorizable<kVectorSize>(p.x))
    resize_pairs<T, true><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips);
  else
    resize_pairs<T, false><<<strips.blocks(kWarps), 32 * kWarps, 0, stream>>>(p, strips);
  return cudaGetLastError();
}

template int resize_linear(Resize<float> const&, CUstream_st*);
template int resize_linear(Resize<Half> const&, CUstream_st*);
template int resize_linear(Resize<BFloat16> const&, CUstream_st*);
template int resize_linear(Resize<uint8_t> const&, CUstream_st*);

}  // namespace kv::geometry::cuda
