// The soft argmax of windows on the CPU: rows [begin, end) of the outputs, of the inputs in the backward pass. Uses
// vectors for adjacent windows inside the volume. Compiled once per instruction set.
#include "core/lanes.h"
#include "geometry/subpix/soft_argmax.h"

namespace kv::geometry::KV_ISA {
namespace {

struct Row {
  int64_t volume;
  int z, y;
  KV_HD Row(int64_t r, int const (&size)[3]) {
    volume = r / (int64_t(size[0]) * size[1]);
    z = int(r / size[1] % size[0]);
    y = int(r % size[1]);
  }
};

// Calls f(lanes, x) for the outputs of a row.
template <class T, class Call>
KV_HD void for_each_window(Windows const& w, Call f) {
  int const first = w.stride[2] > 1 ? w.out[2] : min(w.before[2], w.out[2]);
  int const last = min(max(w.size[2] - w.window[2] + 1 + w.before[2], first), w.out[2]);
  for (int x = 0; x < first; ++x) f(Width<1>{}, x);
  for_each_vector<T>(first, last, [&](auto lanes, int64_t x) { f(lanes, int(x)); });
  for (int x = last; x < w.out[2]; ++x) f(Width<1>{}, x);
}

template <int N, class T>
KV_HD auto sums_at(Windows const& w, T const* volume, Compute<T> sharpness, Row const& row, int x) {
  using F = Compute<T>;
  auto const span = [&](int axis, int out) {
    return Span(out, w.stride[axis], w.before[axis], w.window[axis], w.size[axis]);
  };
  Span const zs = span(0, row.z), ys = span(1, row.y), xs = span(2, x);
  T const* const start = volume + (int64_t(zs.start) * w.size[1] + ys.start) * w.size[2] + xs.start;
  auto const at = [&](int k, int j, int i) { return load<N>(start + (int64_t(k) * w.size[1] + j) * w.size[2] + i); };
  return WindowSums<Lanes<F, N>>(zs, ys, xs, sharpness, at, [](Lanes<F, N> v) { return vexp2<F, N>(v); });
}

constexpr double kLog2E = 1.44269504088896340736;

}  // namespace

template <class T>
void soft_argmax(SoftArgmax<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  F const sharpness = F(kLog2E) / p.temperature;
  for (int64_t r = begin; r < end; ++r) {
    Row const row(r, w.out);
    T const* const volume = p.x + row.volume * w.voxels();
    int64_t const at = (int64_t(row.z) * w.out[1] + row.y) * w.out[2];
    int const starts[] = {row.z * w.stride[0] - w.before[0], row.y * w.stride[1] - w.before[1]};
    for_each_window<T>(w, [&](auto lanes, int x) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      auto const sums = sums_at<N>(w, volume, sharpness, row, x);
      V const scale = F(1) / sums.total;
      if (p.values) store<N>(p.values + row.volume * w.coords() + at + x, V(sums.value * scale));
      for (int number = 0; number < w.axes; ++number) {
        int const axis = w.axis_of(number);
        V index = sums.index[axis] * scale;
        if (axis < 2)
          index += F(starts[axis]);
        else
          for (int n = 0; n < N; ++n) {
            F const start = F((x + n) * w.stride[2] - w.before[2]);
            if constexpr (N == 1)
              index += start;
            else
              index[n] += start;
          }
        store<N>(p.coords + (row.volume * w.axes + number) * w.coords() + at + x,
                 V(index * p.scale[axis] + p.offset[axis]));
      }
    });
  }
}

template <class T>
void soft_argmax_records(SoftArgmaxBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  F const sharpness = F(kLog2E) / p.temperature;
  int64_t const count = w.volumes * w.coords();
  for (int64_t r = begin; r < end; ++r) {
    Row const row(r, w.out);
    int64_t const at = (int64_t(row.z) * w.out[1] + row.y) * w.out[2];
    for_each_window<T>(w, [&](auto lanes, int x) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      auto const sums = sums_at<N>(w, p.x + row.volume * w.voxels(), sharpness, row, x);
      V grad[3] = {};
      for (int number = 0; number < w.axes; ++number) {
        int const axis = w.axis_of(number);
        grad[axis] = load<N>(p.grad_coords + (row.volume * w.axes + number) * w.coords() + at + x) * p.scale[axis];
      }
      int64_t const coord = row.volume * w.coords() + at + x;
      V const grad_value = p.grad_values ? load<N>(p.grad_values + coord) : V{};
      auto const record = record_of<V, F>(sums, grad, grad_value);
      V const numbers[] = {record.maximum,  record.coord[0], record.coord[1],
                           record.coord[2], record.value,    record.rest};
      for (int i = 0; i < kRecord; ++i) store<N>(p.records + i * count + coord, numbers[i]);
    });
  }
}

template <class T>
void soft_argmax_backward(SoftArgmaxBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  F const sharpness = F(kLog2E) / p.temperature, per_temperature = 1 / p.temperature;
  int64_t const count = w.volumes * w.coords();
  for (int64_t r = begin; r < end; ++r) {
    Row const row(r, w.size);
    Readers const zs(row.z, w.stride[0], w.before[0], w.window[0], w.out[0]);
    Readers const ys(row.y, w.stride[1], w.before[1], w.window[1], w.out[1]);
    auto const voxel = [&](auto lanes, int x) {
      constexpr int N = decltype(lanes)::value;
      using V = Lanes<F, N>;
      V const v = load<N>(p.x + r * w.size[2] + x);
      // Windows that contain the first voxel of a vector. Those of the other voxels follow them, because vectors are
      // only used where the stride is 1.
      Readers const xs(x, w.stride[2], w.before[2], w.window[2], w.out[2]);
      V sum{};
      for (int z = zs.first; z < zs.last; ++z)
        for (int y = ys.first; y < ys.last; ++y)
          for (int o = xs.first; o < xs.last; ++o) {
            F const* const at = p.records + row.volume * w.coords() + (int64_t(z) * w.out[1] + y) * w.out[2] + o;
            WindowRecord<V> const record{load<N>(at),
                                         {load<N>(at + count), load<N>(at + 2 * count), load<N>(at + 3 * count)},
                                         load<N>(at + 4 * count),
                                         load<N>(at + 5 * count)};
            V const e = vexp2<F, N>(V((v - record.maximum) * sharpness));
            sum += contribution_of<V, F>(record, v, e, F(row.z + w.before[0] - z * w.stride[0]),
                                         F(row.y + w.before[1] - y * w.stride[1]), F(x + w.before[2] - o * w.stride[2]),
                                         per_temperature);
          }
      store<N>(p.grad_x + r * w.size[2] + x, sum);
    };
    // Only voxels [first, last), all of whose windows exist, are computed in vectors.
    int const first = w.stride[2] > 1 ? w.size[2] : min(max(w.window[2] - 1 - w.before[2], 0), w.size[2]);
    int const last = max(min(w.out[2] - w.before[2], w.size[2]), first);
    for (int x = 0; x < first; ++x) voxel(Width<1>{}, x);
    for_each_vector<T>(first, last, [&](auto lanes, int64_t x) { voxel(lanes, int(x)); });
    for (int x = last; x < w.size[2]; ++x) voxel(Width<1>{}, x);
  }
}

KV_INSTANTIATE(soft_argmax, SoftArgmax)
KV_INSTANTIATE(soft_argmax_records, SoftArgmaxBackward)
KV_INSTANTIATE(soft_argmax_backward, SoftArgmaxBackward)

}  // namespace kv::geometry::KV_ISA
