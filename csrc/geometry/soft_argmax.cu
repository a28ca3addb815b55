// The soft argmax of windows on CUDA: a thread a window, a thread a voxel in the backward pass.
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
__global__ void __launch_bounds__(kThreads) windows_of(__grid_constant__ SoftArgmax<T> const p, Tiles tiles) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  int64_t volume;
  int z, y, x;
  if (!tiles.place(w.out, volume, z, y, x)) return;
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
