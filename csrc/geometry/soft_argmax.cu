// The soft argmax of windows on CUDA: a thread a window, a thread a voxel in the backward pass. Windows of 3 x 3 and
// 5 x 5 around every pixel of float images share their exponentials and are walked down in registers.
#include "core/launch.cuh"
#include "soft_argmax.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;
constexpr double kLog2E = 1.44269504088896340736;

// Of volumes of a size: blocks of 32 x 8 voxels of a plane, planes last.
struct Tiles {
  unsigned across, down, count;
  Tiles(int64_t volumes, int const (&size)[3])
      : across(unsigned(ceil_div(size[2], 32))),
        down(unsigned(ceil_div(size[1], 8))),
        count(unsigned(volumes * size[0] * across * down)) {}
  // False outside of the volumes.
  __device__ __forceinline__ bool place(int const (&size)[3], int64_t& volume, int& z, int& y, int& x) const {
    unsigned const line = blockIdx.x / across, plane = line / down;
    volume = plane / unsigned(size[0]);
    z = int(plane - unsigned(volume) * unsigned(size[0]));
    y = int(line - plane * down) * 8 + threadIdx.x / 32;
    x = int(blockIdx.x - line * across) * 32 + threadIdx.x % 32;
    return x < size[2] && y < size[1];
  }
};

template <class T>
__device__ __forceinline__ auto sums_at(Windows const& w, T const* volume, Compute<T> temperature, int z, int y,
                                        int x) {
  using F = Compute<T>;
  Span const zs(z, w.stride[0], w.before[0], w.window[0], w.size[0]);
  Span const ys(y, w.stride[1], w.before[1], w.window[1], w.size[1]);
  Span const xs(x, w.stride[2], w.before[2], w.window[2], w.size[2]);
  T const* const start = volume + (int64_t(zs.start) * w.size[1] + ys.start) * w.size[2] + xs.start;
  auto const at = [&](int k, int j, int i) { return read(start[(int64_t(k) * w.size[1] + j) * w.size[2] + i]); };
  return WindowSums<F>(zs, ys, xs, F(kLog2E) / temperature, at, [](F v) { return fast_exp2(v); });
}

template <class T>
__device__ __forceinline__ void one_window(SoftArgmax<T> const& p, int64_t volume, int z, int y, int x) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  auto const sums = sums_at(w, p.x + volume * w.voxels(), p.temperature, z, y, x);
  F const scale = 1 / sums.total;
  int64_t const at = (int64_t(z) * w.out[1] + y) * w.out[2] + x;
  if (p.values) p.values[volume * w.places() + at] = round_to<T>(sums.value * scale);
  F const starts[] = {F(z * w.stride[0] - w.before[0]), F(y * w.stride[1] - w.before[1]),
                      F(x * w.stride[2] - w.before[2])};
  auto const store = [&](int number, int axis) {
    F const index = starts[axis] + sums.index[axis] * scale;
    p.places[(volume * w.axes + number) * w.places() + at] = round_to<T>(index * p.scale[axis] + p.offset[axis]);
  };
  if (w.axes == 3) store(0, 0);
  store(w.axes - 2, 2);
  store(w.axes - 1, 1);
}

template <class T>
__global__ void __launch_bounds__(kThreads) windows_of(__grid_constant__ SoftArgmax<T> const p, Tiles tiles) {
  int64_t volume;
  int z, y, x;
  if (tiles.place(p.windows.out, volume, z, y, x)) one_window(p, volume, z, y, x);
}

// --- windows around every pixel of images
// ---------------------------------------------------------------------------------------------------------------

constexpr int kRun = 4, kRows = 12, kStripThreads = 128;
constexpr float kMostExponent = 24;  // of base 2, beside a strip's largest: rounding it costs 2e-6 of a weight

template <class T>
Planes<T const> planes_of(SoftArgmax<T> const& p) {
  Windows const& w = p.windows;
  return {p.x, w.volumes, 1, w.voxels(), 0, w.size[2], w.size[1], w.size[2], 1};
}

// Weights are exponentials beside the largest number of the strip, so that all windows share them; where numbers are
// too far apart for that each window takes its own.
template <class T, int R>
__global__ void __launch_bounds__(kStripThreads)
    strips_down(__grid_constant__ SoftArgmax<T> const p, Planes<T const> const image, Strips<kRun> const strips) {
  using F = Compute<T>;
  constexpr int K = 2 * R + 1;
  int64_t plane;
  int x, y0;
  if (!strips.place(plane, x, y0)) return;
  int const height = int(image.height), width = int(image.width), y1 = min(y0 + int(strips.rows), height);
  int const first = max(y0 - R, 0), last = min(y1 + R, height);
  Strip<R, true, kRun> const strip(x, width, Border::replicate);
  F most = -INFINITY, least = INFINITY;
#pragma unroll 4
  for (int y = first; y < last; ++y) {
    F v[kRun + 2 * R];
    strip.load(v, image.row(plane, y));
#pragma unroll
    for (int i = 0; i < kRun + 2 * R; ++i) {  // NaN is left out
      most = strip.inside ? ::fmax(most, v[i]) : most;
      least = strip.inside ? ::fmin(least, v[i]) : least;
    }
  }
#pragma unroll
  for (int lane = 16; lane > 0; lane /= 2) {
    most = ::fmax(most, __shfl_xor_sync(0xffffffffu, most, lane));
    least = ::fmin(least, __shfl_xor_sync(0xffffffffu, least, lane));
  }
  F const sharpness = F(kLog2E) / p.temperature;
  if (!((most - least) * sharpness <= F(kMostExponent))) {
    for (int y = y0; y < y1 && strip.inside; ++y)
      for (int n = 0; n < kRun; ++n) one_window(p, plane, 0, y, x + n);
    return;
  }
  // Of a row's windows: their exponentials, these times the column, these times x.
  F total[K][kRun] = {}, column[K][kRun] = {}, value[K][kRun] = {};
  auto const next = [&](int y, F(&sums)[kRun], F(&by_column)[kRun], F(&by_value)[kRun]) {
#pragma unroll
    for (int n = 0; n < kRun; ++n) sums[n] = by_column[n] = by_value[n] = 0;
    if (y < 0 || y >= height) return;  // the same for the whole warp
    F v[kRun + 2 * R];
    strip.load(v, image.row(plane, y));
#pragma unroll
    for (int i = 0; i < kRun + 2 * R; ++i) {
      bool const there = x - R + i >= 0 && x - R + i < width;
      F const e = there ? fast_exp2((v[i] - most) * sharpness) : F(0), product = there ? e * v[i] : F(0);
#pragma unroll
      for (int n = 0; n < kRun; ++n)
        if (i - n >= 0 && i - n < K) {
          sums[n] += e;
          by_column[n] += e * F(i - n);
          by_value[n] += product;
        }
    }
  };
#pragma unroll
  for (int j = 0; j < K - 1; ++j) next(y0 - R + j, total[j], column[j], value[j]);
  int64_t const size = p.windows.places();
  T* places = p.places + 2 * plane * size;
#pragma unroll 1
  for (int y = y0; y < y1; ++y) {
    next(y + R, total[K - 1], column[K - 1], value[K - 1]);
    F to_x[kRun], to_y[kRun], to_value[kRun];
#pragma unroll
    for (int n = 0; n < kRun; ++n) {
      F sum = 0, by_x = 0, by_y = 0, by_value = 0;
#pragma unroll
      for (int j = 0; j < K; ++j) {
        sum += total[j][n];
        by_y += total[j][n] * F(j);
        by_x += column[j][n];
        by_value += value[j][n];
      }
      F const scale = 1 / sum;
      to_x[n] = (F(x + n - R) + by_x * scale) * p.scale[2] + p.offset[2];
      to_y[n] = (F(y - R) + by_y * scale) * p.scale[1] + p.offset[1];
      to_value[n] = by_value * scale;
    }
    int64_t const row = int64_t(y) * width;
    strip.store(places + row, to_x);
    strip.store(places + size + row, to_y);
    if (p.values) strip.store(p.values + plane * size + row, to_value);
#pragma unroll
    for (int j = 0; j < K - 1; ++j)
#pragma unroll
      for (int n = 0; n < kRun; ++n) {
        total[j][n] = total[j + 1][n];
        column[j][n] = column[j + 1][n];
        value[j][n] = value[j + 1][n];
      }
  }
}

// How far windows reach, if they are around every pixel of images that are strips, else 0.
template <class T>
int reach_of(SoftArgmax<T> const& p) {
  Windows const& w = p.windows;
  Planes<T const> places = planes_of(p), values = places;
  places.data = p.places;
  values.data = p.values ? p.values : p.places;
  if (w.axes != 2 || w.size[0] != 1 || w.window[0] != 1 || !is_strip<kRun>(planes_of(p)) || !is_strip<kRun>(places) ||
      !is_strip<kRun>(values))
    return 0;
  int const r = w.before[1];
  for (int axis = 1; axis < 3; ++axis)
    if (w.stride[axis] != 1 || w.before[axis] != r || w.window[axis] != 2 * r + 1) return 0;
  return r;
}

// --- gradients
// ---------------------------------------------------------------------------------------------------------------

template <class T>
__global__ void __launch_bounds__(kThreads) records_of(__grid_constant__ SoftArgmaxBackward<T> const p, Tiles tiles) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  int64_t volume;
  int z, y, x;
  if (!tiles.place(w.out, volume, z, y, x)) return;
  auto const sums = sums_at(w, p.x + volume * w.voxels(), p.temperature, z, y, x);
  int64_t const at = (int64_t(z) * w.out[1] + y) * w.out[2] + x, place = volume * w.places() + at;
  auto const grad_of = [&](int number, int axis) {
    return read(p.grad_places[(volume * w.axes + number) * w.places() + at]) * p.scale[axis];
  };
  F const grad[] = {w.axes == 3 ? grad_of(0, 0) : F(0), grad_of(w.axes - 1, 1), grad_of(w.axes - 2, 2)};
  auto const record = record_of<F, F>(sums, grad, p.grad_values ? F(read(p.grad_values[place])) : F(0));
  int64_t const count = w.volumes * w.places();
  F const numbers[] = {record.most, record.place[0], record.place[1], record.place[2], record.value, record.rest};
#pragma unroll
  for (int i = 0; i < kRecord; ++i) p.records[i * count + place] = numbers[i];
}

template <class T>
__global__ void __launch_bounds__(kThreads) voxels_of(__grid_constant__ SoftArgmaxBackward<T> const p, Tiles tiles) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  int64_t volume;
  int vz, vy, vx;
  if (!tiles.place(w.size, volume, vz, vy, vx)) return;
  int64_t const at = volume * w.voxels() + (int64_t(vz) * w.size[1] + vy) * w.size[2] + vx;
  int64_t const count = w.volumes * w.places();
  F const v = read(p.x[at]), sharpness = F(kLog2E) / p.temperature, per_temperature = 1 / p.temperature;
  Readers const zs(vz, w.stride[0], w.before[0], w.window[0], w.out[0]);
  Readers const ys(vy, w.stride[1], w.before[1], w.window[1], w.out[1]);
  Readers const xs(vx, w.stride[2], w.before[2], w.window[2], w.out[2]);
  F sum = 0;
  for (int z = zs.first; z < zs.last; ++z)
    for (int y = ys.first; y < ys.last; ++y)
      for (int x = xs.first; x < xs.last; ++x) {
        F const* const from = p.records + volume * w.places() + (int64_t(z) * w.out[1] + y) * w.out[2] + x;
        WindowRecord<F> const record{
            from[0], {from[count], from[2 * count], from[3 * count]}, from[4 * count], from[5 * count]};
        sum += share_of<F, F>(record, v, fast_exp2((v - record.most) * sharpness),
                              F(vz + w.before[0] - z * w.stride[0]), F(vy + w.before[1] - y * w.stride[1]),
                              F(vx + w.before[2] - x * w.stride[2]), per_temperature);
      }
  p.grad_x[at] = round_to<T>(sum);
}

}  // namespace

template <class T>
int soft_argmax(SoftArgmax<T> const& p, CUstream_st* stream) {
  if constexpr (__is_same(T, float)) {
    Strips<kRun> const strips(p.windows.volumes, p.windows.size[1], p.windows.size[2], kRows);
    unsigned const blocks = strips.blocks(kStripThreads / 32);
    int const reach = reach_of(p);
    if (reach == 1) strips_down<T, 1><<<blocks, kStripThreads, 0, stream>>>(p, planes_of(p), strips);
    if (reach == 2) strips_down<T, 2><<<blocks, kStripThreads, 0, stream>>>(p, planes_of(p), strips);
    if (reach == 1 || reach == 2) return cudaGetLastError();
  }
  Tiles const tiles(p.windows.volumes, p.windows.out);
  windows_of<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int soft_argmax_records(SoftArgmaxBackward<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.windows.volumes, p.windows.out);
  records_of<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

template <class T>
int soft_argmax_backward(SoftArgmaxBackward<T> const& p, CUstream_st* stream) {
  Tiles const tiles(p.windows.volumes, p.windows.size);
  voxels_of<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE(soft_argmax, SoftArgmax)
KV_INSTANTIATE(soft_argmax_records, SoftArgmaxBackward)
KV_INSTANTIATE(soft_argmax_backward, SoftArgmaxBackward)

}  // namespace kv::cuda
