// The soft argmax of windows on CUDA: one thread for each window, one for each voxel in the backward pass. Windows of
// 3 x 3 and 5 x 5 around every pixel of images share their exponentials; threads traverse the rows from above and keep
// the state in registers.
#include "core/launch.cuh"
#include "geometry/subpix/soft_argmax.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256;
constexpr double kLog2E = 1.44269504088896340736;

// Blocks of 32 x 8 voxels of a plane, for volumes of any size. Planes are the last dimension of the grid.
struct Tiles {
  unsigned across, down, count;
  Tiles(int64_t volumes, int const (&size)[3])
      : across(unsigned(ceil_div(size[2], 32))),
        down(unsigned(ceil_div(size[1], 8))),
        count(unsigned(volumes * size[0] * across * down)) {}
  // False if the thread is outside of the volumes.
  __device__ __forceinline__ bool locate(int const (&size)[3], int64_t& volume, int& z, int& y, int& x) const {
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
  if (p.values) p.values[volume * w.coords() + at] = round_to<T>(sums.value * scale);
  F const starts[] = {F(z * w.stride[0] - w.before[0]), F(y * w.stride[1] - w.before[1]),
                      F(x * w.stride[2] - w.before[2])};
  auto const store = [&](int number, int axis) {
    F const index = starts[axis] + sums.index[axis] * scale;
    p.coords[(volume * w.axes + number) * w.coords() + at] = round_to<T>(index * p.scale[axis] + p.offset[axis]);
  };
  if (w.axes == 3) store(0, 0);
  store(w.axes - 2, 2);
  store(w.axes - 1, 1);
}

template <class T>
__global__ void __launch_bounds__(kThreads) windows_of(__grid_constant__ SoftArgmax<T> const p, Tiles tiles) {
  int64_t volume;
  int z, y, x;
  if (tiles.locate(p.windows.out, volume, z, y, x)) one_window(p, volume, z, y, x);
}

// --- windows around every pixel of images ----------------------------------------------------------------------------

constexpr int kRun = 4, kRows = 15, kStripThreads = 128;
constexpr float kMaxExponent =
    90;  // largest range of exponents, of base 2, in a strip: rounding them costs 3e-6 of a weight

// The numbers of a thread's columns, and R of each neighboring thread's: sums of 2R + 1 of them, and sums weighted by
// the index in the window.
template <int R>
struct Across {
  float v[kRun + 2 * R];
  __device__ __forceinline__ explicit Across(float const (&own)[kRun]) {
#pragma unroll
    for (int i = 0; i < kRun; ++i) v[R + i] = own[i];
#pragma unroll
    for (int i = 0; i < R; ++i) {
      v[i] = __shfl_up_sync(0xffffffffu, own[kRun - R + i], 1);
      v[R + kRun + i] = __shfl_down_sync(0xffffffffu, own[i], 1);
    }
  }
  __device__ __forceinline__ float sum(int n) const {
    float sum = v[n];
#pragma unroll
    for (int i = 1; i <= 2 * R; ++i) sum += v[n + i];
    return sum;
  }
  __device__ __forceinline__ float moment(int n) const {
    float sum = v[n + 1];
#pragma unroll
    for (int i = 2; i <= 2 * R; ++i) sum += v[n + i] * float(i);
    return sum;
  }
};

// A warp's columns and rows of an image. A thread takes kRun columns. The outermost `Help` threads on either side only
// provide columns to their neighbors. All windows of a strip share exponentials, relative to its largest number.
// Aligned: rows are vectors of kRun columns. Otherwise threads read columns one by one, and exchange those that they
// write in shared memory.
template <int Help, class T, bool Aligned>
struct ImageStrip {
  int height, width, x, y0, y1, count;  // count: how many of the thread's columns are in the image
  unsigned plane;
  bool in_bounds, writes;  // whether the thread has columns in the image, and whether it writes them
  int64_t size;
  T const* image;
  float sharpness, from;

  static constexpr int kColumns = (32 - 2 * Help) * kRun;
  static dim3 grid(Windows const& w) {
    int64_t const strips = w.volumes * ceil_div(w.size[2], kColumns) * ceil_div(w.size[1], kRows);
    return dim3(unsigned(ceil_div(strips, kStripThreads / 32)));
  }
  // False after the last strip.
  __device__ __forceinline__ bool locate(Windows const& w, T const* data, float temperature) {
    height = w.size[1], width = w.size[2];
    unsigned const warp = blockIdx.x * (kStripThreads / 32) + threadIdx.x / 32, lane = threadIdx.x % 32;
    unsigned const across = unsigned(width + kColumns - 1) / kColumns, down = unsigned(height + kRows - 1) / kRows;
    unsigned const line = warp / across;
    plane = line / down;
    if (plane >= w.volumes) return false;
    x = int(warp - line * across) * kColumns + (int(lane) - Help) * kRun;
    y0 = int(line - plane * down) * kRows;
    y1 = min(y0 + kRows, height);
    count = x >= 0 ? clamp(width - x, 0, kRun) : 0;
    in_bounds = count > 0;
    writes = in_bounds && lane >= Help && lane < 32 - Help;
    size = int64_t(height) * width;
    image = data + plane * size + x;
    sharpness = float(kLog2E) / temperature;
    return true;
  }
  // Whether column n of a thread that is in bounds is in the image.
  __device__ __forceinline__ bool has_column(int n) const { return Aligned || n < count; }
  // Finds the largest number of the strip and of `reach` rows above and below. False if the range is too large for
  // shared exponentials, or if numbers are so large that rounding their exponents loses precision.
  __device__ __forceinline__ bool find_largest(int reach) {
    float maximum = -INFINITY, minimum = INFINITY;
#pragma unroll 4
    for (int y = max(y0 - reach, 0); y < min(y1 + reach, height); ++y) {
      if (!in_bounds) break;
      Vector<T, kRun> const v = load(image, y);
#pragma unroll
      for (int i = 0; i < kRun; ++i)
        if (has_column(i))  // fmax and fmin ignore NaN
          maximum = ::fmax(maximum, read(v.v[i])), minimum = ::fmin(minimum, read(v.v[i]));
    }
    maximum = warp_reduce(maximum, [](float a, float b) { return ::fmax(a, b); });
    minimum = warp_reduce(minimum, [](float a, float b) { return ::fmin(a, b); });
    from = maximum * sharpness;
    return (maximum - minimum) * sharpness <= kMaxExponent && ::fabs(from) <= 0x1p24f;
  }
  __device__ __forceinline__ Vector<T, kRun> load(T const* plane, int y) const {
    T const* const at = plane + int64_t(y) * width;
    if constexpr (Aligned) {
      return *reinterpret_cast<Vector<T, kRun> const*>(at);
    } else {
      Vector<T, kRun> vector{};
#pragma unroll
      for (int i = 0; i < kRun; ++i)
        if (has_column(i)) vector.v[i] = at[i];
      return vector;
    }
  }
  // Stores the thread's columns. All threads of the warp call it, those that do not write only at unaligned rows.
  __device__ __forceinline__ void store(T* to, float const (&v)[kRun]) const {
    if constexpr (Aligned) {
      store_vector(to, v);
    } else {
      int const first = x - kRun * int(threadIdx.x % 32) + Help * kRun;
      unsigned const written = unsigned(min(width - first, kColumns));
      store_striped_if<kRun, kStripThreads / 32>(to, rounded<T>(v),
                                                 [&](int ahead) { return unsigned(x + ahead - first) < written; });
    }
  }
  __device__ __forceinline__ bool has(int y) const { return in_bounds && y >= 0 && y < height; }
  // Row y of a plane, 0 outside of the image.
  __device__ __forceinline__ Vector<T, kRun> row(T const* plane, int y) const {
    return has(y) ? load(plane, y) : Vector<T, kRun>{};
  }
  // The exponentials of row y, whose numbers are v, and their products with v; 0 outside of the image.
  template <bool Products>
  __device__ __forceinline__ void weights_of(Vector<T, kRun> const& v, int y, float (&weight)[kRun],
                                             float (&product)[kRun]) const {
    bool const has_row = has(y);
#pragma unroll
    for (int i = 0; i < kRun; ++i) {
      bool const inside = has_row && has_column(i);
      weight[i] = inside ? fast_exp2(read(v.v[i]) * sharpness - from) : 0.f;
      if constexpr (Products) product[i] = inside ? weight[i] * read(v.v[i]) : 0.f;
    }
  }
};

// Blocks of a multiprocessor for which the compiler saves registers at unaligned rows, where it spends them freely.
template <bool Values, bool Aligned>
constexpr int kResident = Aligned  ? 0
                          : Values ? 5
                                   : 6;

// Sums weights down columns first, then along rows. Strips that cannot share exponentials compute each window by
// itself.
template <class T, int R, bool Values, bool Aligned>
__global__ void __launch_bounds__(kStripThreads, kResident<Values, Aligned>)
    strips_down(__grid_constant__ SoftArgmax<T> const p) {
  constexpr int K = 2 * R + 1;
  ImageStrip<1, T, Aligned> strip;
  if (!strip.locate(p.windows, p.x, p.temperature)) return;
  int const x = strip.x, y0 = strip.y0, width = strip.width;
  int64_t const size = strip.size;
  if (!strip.find_largest(R)) {
    for (int y = y0; y < strip.y1 && strip.writes; ++y)
      for (int n = 0; n < strip.count; ++n) one_window(p, strip.plane, 0, y, x + n);
    return;
  }
  float weights[K][kRun], products[K][kRun];  // of the rows of a window; products: weights times x
#pragma unroll
  for (int j = 0; j < K - 1; ++j) {
    int const y = y0 - R + j;
    strip.template weights_of<Values>(strip.row(strip.image, y), y, weights[j + 1], products[j + 1]);
  }
  Vector<T, kRun> ahead = strip.row(strip.image, y0 + R);
  T* to_x = p.coords + 2 * strip.plane * size + int64_t(y0) * width + x;
  T* to_value = Values ? p.values + strip.plane * size + int64_t(y0) * width + x : nullptr;
#pragma unroll(K)
  for (int i = 0; i < kRows; ++i) {
    int const y = y0 + i;
    if (y >= strip.y1) break;
    float totals[kRun], moments[kRun], values[kRun];  // sums down columns
#pragma unroll
    for (int n = 0; n < kRun; ++n) {
#pragma unroll
      for (int j = 0; j < K - 1; ++j) {
        weights[j][n] = weights[j + 1][n];
        if constexpr (Values) products[j][n] = products[j + 1][n];
      }
    }
    strip.template weights_of<Values>(ahead, y + R, weights[K - 1], products[K - 1]);
    ahead = strip.row(strip.image, y + R + 1);
#pragma unroll
    for (int n = 0; n < kRun; ++n) {
      totals[n] = weights[0][n] + weights[1][n];
      moments[n] = weights[1][n];
      if constexpr (Values) values[n] = products[0][n] + products[1][n];
#pragma unroll
      for (int j = 2; j < K; ++j) {
        totals[n] += weights[j][n];
        moments[n] += weights[j][n] * float(j);
        if constexpr (Values) values[n] += products[j][n];
      }
    }
    Across<R> const total(totals), moment(moments);
    float coords_x[kRun], coords_y[kRun], means[kRun], scales[kRun];
#pragma unroll
    for (int n = 0; n < kRun; ++n) {
      scales[n] = __fdividef(1.f, total.sum(n));
      coords_x[n] = (float(x + n - R) + total.moment(n) * scales[n]) * p.scale[2] + p.offset[2];
      coords_y[n] = (float(y - R) + moment.sum(n) * scales[n]) * p.scale[1] + p.offset[1];
    }
    if constexpr (Values) {
      Across<R> const value(values);
#pragma unroll
      for (int n = 0; n < kRun; ++n) means[n] = value.sum(n) * scales[n];
    }
    if (!Aligned || strip.writes) {
      strip.store(to_x, coords_x);
      strip.store(to_x + size, coords_y);
      if constexpr (Values) strip.store(to_value, means);
    }
    to_x += width;
    if constexpr (Values) to_value += width;
  }
}

// --- gradients -------------------------------------------------------------------------------------------------------

template <class T>
__global__ void __launch_bounds__(kThreads) records_of(__grid_constant__ SoftArgmaxBackward<T> const p, Tiles tiles) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  int64_t volume;
  int z, y, x;
  if (!tiles.locate(w.out, volume, z, y, x)) return;
  auto const sums = sums_at(w, p.x + volume * w.voxels(), p.temperature, z, y, x);
  int64_t const at = (int64_t(z) * w.out[1] + y) * w.out[2] + x, coord = volume * w.coords() + at;
  auto const grad_of = [&](int number, int axis) {
    return read(p.grad_coords[(volume * w.axes + number) * w.coords() + at]) * p.scale[axis];
  };
  F const grad[] = {w.axes == 3 ? grad_of(0, 0) : F(0), grad_of(w.axes - 1, 1), grad_of(w.axes - 2, 2)};
  auto const record = record_of<F, F>(sums, grad, p.grad_values ? F(read(p.grad_values[coord])) : F(0));
  int64_t const count = w.volumes * w.coords();
  F const numbers[] = {record.maximum, record.coord[0], record.coord[1], record.coord[2], record.value, record.rest};
#pragma unroll
  for (int i = 0; i < kRecord; ++i) p.records[i * count + coord] = numbers[i];
}

template <class T>
__global__ void __launch_bounds__(kThreads) voxels_of(__grid_constant__ SoftArgmaxBackward<T> const p, Tiles tiles) {
  using F = Compute<T>;
  Windows const& w = p.windows;
  int64_t volume;
  int vz, vy, vx;
  if (!tiles.locate(w.size, volume, vz, vy, vx)) return;
  int64_t const at = volume * w.voxels() + (int64_t(vz) * w.size[1] + vy) * w.size[2] + vx;
  int64_t const count = w.volumes * w.coords();
  F const v = read(p.x[at]), sharpness = F(kLog2E) / p.temperature, per_temperature = 1 / p.temperature;
  Readers const zs(vz, w.stride[0], w.before[0], w.window[0], w.out[0]);
  Readers const ys(vy, w.stride[1], w.before[1], w.window[1], w.out[1]);
  Readers const xs(vx, w.stride[2], w.before[2], w.window[2], w.out[2]);
  F sum = 0;
  for (int z = zs.first; z < zs.last; ++z)
    for (int y = ys.first; y < ys.last; ++y)
      for (int x = xs.first; x < xs.last; ++x) {
        F const* const from = p.records + volume * w.coords() + (int64_t(z) * w.out[1] + y) * w.out[2] + x;
        WindowRecord<F> const record{
            from[0], {from[count], from[2 * count], from[3 * count]}, from[4 * count], from[5 * count]};
        sum += contribution_of<F, F>(record, v, fast_exp2((v - record.maximum) * sharpness),
                                     F(vz + w.before[0] - z * w.stride[0]), F(vy + w.before[1] - y * w.stride[1]),
                                     F(vx + w.before[2] - x * w.stride[2]), per_temperature);
      }
  p.grad_x[at] = round_to<T>(sum);
}

// The gradient of one voxel, from all windows that contain it.
template <class T>
__device__ __forceinline__ float one_pixel(SoftArgmaxBackward<T> const& p, int64_t plane, int vy, int vx) {
  Windows const& w = p.windows;
  T const* const image = p.x + plane * w.voxels();
  float const v = read(image[int64_t(vy) * w.size[2] + vx]), sharpness = float(kLog2E) / p.temperature;
  Readers const ys(vy, 1, w.before[1], w.window[1], w.out[1]), xs(vx, 1, w.before[2], w.window[2], w.out[2]);
  float sum = 0;
  for (int y = ys.first; y < ys.last; ++y)
    for (int x = xs.first; x < xs.last; ++x) {
      T const* const grads = p.grad_coords + 2 * plane * w.coords() + int64_t(y) * w.out[2] + x;
      float const grad[] = {0, read(grads[w.coords()]) * p.scale[1], read(grads[0]) * p.scale[2]};
      auto const record = record_of<float, float>(sums_at(w, image, p.temperature, 0, y, x), grad, 0.f);
      sum += contribution_of<float, float>(record, v, fast_exp2((v - record.maximum) * sharpness), 0,
                                           float(vy + w.before[1] - y), float(vx + w.before[2] - x), 1 / p.temperature);
    }
  return sum;
}

// A window has the sum of weights S and the moments X and Y. From the gradients gx and gy to its coordinates each pixel
// (j, i) of it gets exp (a i + b j + c) for a = gx / S, b = gy / S, c = -(gx X + gy Y) / S^2. These are summed over the
// windows that contain a pixel: down columns first, then along rows.
template <class T, int R, bool Aligned>
__global__ void __launch_bounds__(kStripThreads) strips_back(__grid_constant__ SoftArgmaxBackward<T> const p) {
  constexpr int K = 2 * R + 1;
  ImageStrip<2, T, Aligned> strip;
  if (!strip.locate(p.windows, p.x, p.temperature)) return;
  int const x = strip.x, y0 = strip.y0, width = strip.width;
  int64_t const size = strip.size;
  T* to = p.grad_x + strip.plane * size + int64_t(y0) * width + x;
  if (!strip.find_largest(2 * R)) {
    for (int y = y0; y < strip.y1 && strip.writes; ++y)
      for (int n = 0; n < strip.count; ++n)
        p.grad_x[strip.plane * size + int64_t(y) * width + x + n] = round_to<T>(one_pixel(p, strip.plane, y, x + n));
    return;
  }
  T const* const grad_x = p.grad_coords + 2 * strip.plane * size + x;
  T const* const grad_y = grad_x + size;
  float weights[K][kRun] = {}, none[kRun];
  float constants[K][kRun] = {}, linear[K][kRun] = {};  // b j + c, and a, summed for pixels that still miss windows
  float const per_temperature = 1 / p.temperature;
  // The next rows, read ahead: of the image, and of the gradients to windows.
  Vector<T, kRun> ahead = strip.row(strip.image, y0 - 2 * R);
  Vector<T, kRun> ahead_x = strip.row(grad_x, y0 - R), ahead_y = strip.row(grad_y, y0 - R);
#pragma unroll(K)
  for (int i = -4 * R; i < kRows; ++i) {
    // Weights of row y + 2R, then windows around row y + R, then the gradient of row y.
    int const y = y0 + i;
    if (y >= strip.y1) break;
#pragma unroll
    for (int j = 0; j < K - 1; ++j)
#pragma unroll
      for (int n = 0; n < kRun; ++n) weights[j][n] = weights[j + 1][n];
    strip.template weights_of<false>(ahead, y + 2 * R, weights[K - 1], none);
    ahead = strip.row(strip.image, y + 2 * R + 1);
    if (i < -2 * R) continue;
    float totals[kRun], moments[kRun];
#pragma unroll
    for (int n = 0; n < kRun; ++n) {
      totals[n] = weights[0][n] + weights[1][n];
      moments[n] = weights[1][n];
#pragma unroll
      for (int j = 2; j < K; ++j) {
        totals[n] += weights[j][n];
        moments[n] += weights[j][n] * float(j);
      }
    }
    Across<R> const total(totals), moment(moments);
    int const middle = y + R;
    Vector<T, kRun> const gx = ahead_x, gy = ahead_y;
    ahead_x = strip.row(grad_x, middle + 1), ahead_y = strip.row(grad_y, middle + 1);
    if (strip.has(middle)) {
#pragma unroll
      for (int n = 0; n < kRun; ++n) {
        float const scale = strip.has_column(n) ? __fdividef(1.f, total.sum(n)) : 0.f;
        float const a = read(gx.v[n]) * p.scale[2] * scale, b = read(gy.v[n]) * p.scale[1] * scale;
        float const c = -(a * (total.moment(n) * scale) + b * (moment.sum(n) * scale));
#pragma unroll
        for (int j = 0; j < K; ++j) {
          constants[j][n] += b * float(j) + c;
          linear[j][n] += a;
        }
      }
    }
    Across<R> const constant(constants[0]), weight_grad(linear[0]);
    if (i >= 0 && (!Aligned || strip.writes)) {
      float result[kRun];
#pragma unroll
      for (int n = 0; n < kRun; ++n)
        result[n] = weights[0][n] * per_temperature *
                    (constant.sum(n) + (float(2 * R) * weight_grad.sum(n) - weight_grad.moment(n)));
      strip.store(to, result);
    }
    if (i >= 0) to += width;
#pragma unroll
    for (int n = 0; n < kRun; ++n) {
#pragma unroll
      for (int j = 0; j < K - 1; ++j) constants[j][n] = constants[j + 1][n], linear[j][n] = linear[j + 1][n];
      constants[K - 1][n] = linear[K - 1][n] = 0;
    }
  }
}

}  // namespace

// Whether planes of these windows' images at the addresses are read in vectors.
template <class T, class... Data>
bool is_aligned(Windows const& w, Data const*... data) {
  return w.size[2] % kRun == 0 && ((reinterpret_cast<uintptr_t>(data) % alignof(Vector<T, kRun>) == 0) && ...);
}

template <class T>
int soft_argmax(SoftArgmax<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    bool const aligned = is_aligned<T>(p.windows, p.x, p.coords, p.values);
    auto const run = [&](auto radius, auto values) {
      auto* const kernel = aligned ? strips_down<T, radius.value, values.value, true>
                                   : strips_down<T, radius.value, values.value, false>;
      kernel<<<ImageStrip<1, T, true>::grid(p.windows), kStripThreads, 0, stream>>>(p);
      return cudaGetLastError();
    };
    std::integral_constant<int, 1> const one;
    std::integral_constant<int, 2> const two;
    int const radius = radius_of(p.windows);
    // Special case, H200: 4.7 (soft argmax3 values) to 7.5 (soft argmax3) times as fast as a thread a window.
    if (radius == 1) return p.values ? run(one, std::true_type{}) : run(one, std::false_type{});
    // Special case, H200: 8.4 (conv_soft_argmax2d) to 11 (soft argmax5) times as fast as a thread a window.
    if (radius == 2) return p.values ? run(two, std::true_type{}) : run(two, std::false_type{});
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
  if constexpr (sizeof(T) < 8)
    if (!p.records) {
      bool const aligned = is_aligned<T>(p.windows, p.x, p.grad_coords, p.grad_x), narrow = p.windows.before[1] == 1;
      auto* const kernel = narrow    ? aligned ? strips_back<T, 1, true> : strips_back<T, 1, false>
                              : aligned ? strips_back<T, 2, true>
                                     : strips_back<T, 2, false>;
      kernel<<<ImageStrip<2, T, true>::grid(p.windows), kStripThreads, 0, stream>>>(p);
      return cudaGetLastError();
    }
  Tiles const tiles(p.windows.volumes, p.windows.size);
  voxels_of<T><<<tiles.count, kThreads, 0, stream>>>(p, tiles);
  return cudaGetLastError();
}

KV_INSTANTIATE(soft_argmax, SoftArgmax)
KV_INSTANTIATE(soft_argmax_records, SoftArgmaxBackward)
KV_INSTANTIATE(soft_argmax_backward, SoftArgmaxBackward)

}  // namespace kv::geometry::cuda
