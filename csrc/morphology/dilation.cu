// Dilation and erosion on CUDA: flat windows by tiles, along y and then along x; other windows, and channels-last
// images, tap by tap for each element. The gradient is computed in the same two ways where dilation_3x3.cu,
// dilation_backward_strips.cu and dilation_backward.cu do not support it.
#include "dilation_tiles.cuh"

namespace kv::morphology::cuda {
namespace {

constexpr int kThreads = 256;

// --- any window, tap by tap ------------------------------------------------------------------------------------------

// An element of a row: the i-th of all elements, or a pixel of a planar image.
struct Element {
  int64_t plane, row, at;
  int column;
  template <class T>
  __device__ __forceinline__ Element(Planes<T> const& p, int64_t i) {
    int64_t const size = p.row_size(), line = i / size;
    plane = line / p.height, row = line - plane * p.height, at = i - line * size;
    column = int(at / p.step);
  }
  __device__ __forceinline__ Element(int64_t plane, int row, int column)
      : plane(plane), row(row), at(column), column(column) {}
};

// Calls f(value) for the members of the window of an element, where value is the number that is compared.
template <class T, class Call>
__device__ __forceinline__ void for_each_tap(Planes<T const> const& x, StructuringElement<Compute<T>> const& window,
                                             int64_t planes, Element const& e, Call f) {
  using F = Compute<T>;
  int64_t const sample = e.plane / planes;
  F const sign = window.sign();
  T const* const from = x.plane(e.plane) + e.at;
  for (int i = 0; i < window.height; ++i) {
    int64_t const y = e.row + i - window.top;
    bool const row_in_bounds = y >= 0 && y < x.height;
    T const* const row = from + (row_in_bounds ? y : 0) * x.row_stride;
    for (int j = 0; j < window.width; ++j) {
      F const offset = window.offset(sample, i * window.width + j);
      if (offset == minus_infinity<F>()) continue;
      int const shift = j - window.left;
      bool const in_bounds = row_in_bounds && e.column + shift >= 0 && e.column + shift < x.width;
      f((in_bounds ? read(row[shift * x.step]) : window.value) * sign + offset);
    }
  }
}

// The three jobs below compute one element tap by tap. Those of the gradient also define the combination over flat
// windows of planar images: where the window is, the value of a pixel, and what is stored of a combined value.
template <class T>
struct Maximum {
  using F = Compute<T>;
  Dilation<T> p;

  KV_HD Planes<T const> const& image() const { return p.x; }
  __device__ __forceinline__ void by_taps(Element const& e) const {
    F most = minus_infinity<F>();
    for_each_tap<T>(p.x, p.window, p.planes, e, [&](F value) { most = combine(most, value); });
    p.y.row(e.plane, e.row)[e.at] = round_to<T>(most * p.window.sign());
  }
};

// The maximum of every window, and the gradient of each of its ties.
template <class T>
struct WindowMaxima {
  using F = Compute<T>;
  using Value = Ties<F>;
  DilationBackward<T> p;

  KV_HD Planes<T const> const& image() const { return p.x; }
  KV_HD int top() const { return p.window.top; }
  KV_HD int left() const { return p.window.left; }

  __device__ __forceinline__ Value outside() const { return {p.window.value * p.window.sign(), F(1)}; }
  __device__ __forceinline__ T const* source(int64_t plane) const { return p.x.plane(plane); }
  __device__ __forceinline__ Value load(T const* plane, int y, int x) const {
    return {read(plane[y * p.x.row_stride + x]) * p.window.sign(), F(1)};
  }
  __device__ __forceinline__ void store(Element const& e, Value const& ties) const {
    F* const entry = p.workspace + 2 * ((e.plane * p.x.height + e.row) * p.x.row_size() + e.at);
    entry[0] = ties.value;
    entry[1] = tie_gradient(read(p.grad.row(e.plane, e.row)[e.at]), ties.count);
  }
  __device__ __forceinline__ void by_taps(Element const& e) const {
    Value ties{minus_infinity<F>(), F(0)};
    for_each_tap<T>(p.x, p.window, p.planes, e, [&](F value) { ties.add(value, F(1)); });
    store(e, ties);
  }
};

// Sums these gradients for each pixel. A minimum of maxima is computed as the maximum of their negatives.
template <class T>
struct SumGradients {
  using F = Compute<T>;
  using Value = Ties<F>;
  DilationBackward<T> p;

  KV_HD Planes<T const> const& image() const { return p.x; }
  KV_HD int top() const { return p.window.height - 1 - p.window.top; }
  KV_HD int left() const { return p.window.width - 1 - p.window.left; }

  __device__ __forceinline__ Value outside() const { return {minus_infinity<F>(), F(0)}; }
  __device__ __forceinline__ F const* source(int64_t plane) const {
    return p.workspace + 2 * plane * p.x.height * p.x.row_size();
  }
  __device__ __forceinline__ Value load(F const* plane, int y, int x) const {
    F const* const entry = plane + 2 * (y * p.x.row_size() + x);
    F const most = entry[0];
    return most == most ? Value{-most, entry[1]} : outside();
  }
  __device__ __forceinline__ F own(Element const& e) const {
    return read(p.x.row(e.plane, e.row)[e.at]) * p.window.sign();
  }
  __device__ __forceinline__ void store(Element const& e, Value const& ties) const {
    p.grad_x.row(e.plane, e.row)[e.at] = round_to<T>(own(e) == -ties.value ? ties.count : F(0));
  }
  __device__ __forceinline__ void by_taps(Element const& e) const {
    StructuringElement<F> const& window = p.window;
    int64_t const sample = e.plane / p.planes;
    F const* const from = source(e.plane);
    F const x = own(e);
    F sum = 0;
    for (int i = 0; i < window.height; ++i) {
      int const down = window.top - i;
      if (e.row + down < 0 || e.row + down >= p.x.height) continue;
      for (int j = 0; j < window.width; ++j) {
        F const offset = window.offset(sample, i * window.width + j);
        int const shift = window.left - j;
        if (offset == minus_infinity<F>() || e.column + shift < 0 || e.column + shift >= p.x.width) continue;
        F const* const entry = from + 2 * ((e.row + down) * p.x.row_size() + e.at + shift * p.x.step);
        sum += x + offset == entry[0] ? entry[1] : F(0);
      }
    }
    p.grad_x.row(e.plane, e.row)[e.at] = round_to<T>(sum);
  }
};

template <class Job>
__global__ void __launch_bounds__(kThreads) by_taps(__grid_constant__ Job const job) {
  int64_t const i = blockIdx.x * int64_t(kThreads) + threadIdx.x;
  if (i < job.image().rows() * job.image().row_size()) job.by_taps(Element(job.image(), i));
}

// --- flat windows: a block computes a tile, along y from the image to shared memory, along x from there --------------

constexpr int kTileWidth = 128, kLargestTile = 256;  // of a window

// Two groups of rows: for windows of 15 x 15 pixels each thread takes one group along y and one along x.
constexpr int kMaximaRows = 30, kMaximaThreads = 288, kMaximaStride = kTileWidth + 1;
// Odd strides, so that the threads of a warp, which take different rows, read different banks. Groups may exceed the
// last column.
constexpr int maxima_stride(int window) { return (kTileWidth + 15 + window) | 1; }

// Out of bounds the border pixel is read, which every window that reaches there contains anyway. The value of pixels
// out of bounds is combined with the result at the end.
template <class T>
__global__ void __launch_bounds__(kMaximaThreads, 4)
    maxima_by_tiles(__grid_constant__ Dilation<T> const p, int across, int down) {
  using F = Compute<T>;
  extern __shared__ __align__(16) unsigned char bytes[];
  StructuringElement<F> const& window = p.window;
  int const height = int(p.x.height), width = int(p.x.width), stride = maxima_stride(window.width);
  Tile const tile(across, down, kMaximaRows, kTileWidth);
  int const y0 = tile.y, x0 = tile.x, rows = min(kMaximaRows, height - y0), columns = min(kTileWidth, width - x0);
  if (!is_flat(window, tile.plane / p.planes)) {
    for_each_pixel(rows, columns, [&](int y, int x) { Maximum<T>{p}.by_taps(Element(tile.plane, y0 + y, x0 + x)); });
    return;
  }

  F* const along_y = reinterpret_cast<F*>(bytes);     // (rows, stride)
  F* const results = along_y + kMaximaRows * stride;  // (rows, kMaximaStride)
  F const sign = window.sign(), outside = window.value * sign;
  int const top = y0 - window.top, left = x0 - window.left, step = int(p.x.row_stride);
  T const* const source = p.x.plane(tile.plane);
  dispatch_group_size(window.height, [&](auto group_size) {
    constexpr int N = decltype(group_size)::value;
    for_each_group(columns + window.width - 1, (rows + N - 1) / N, [&](int column, int group) {
      T const* const from = source + clamp(left + column, 0, width - 1);
      int const y = top + group * N;
      combine_windows<N>(
          window.height, [&](int i) { return read(from[unsigned(clamp(y + i, 0, height - 1) * step)]) * sign; },
          [&](int j, F value) {
            if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
          });
    });
  });
  __syncthreads();
  dispatch_group_size(window.width, [&](auto group_size) {
    constexpr int N = decltype(group_size)::value;
    for_each_group(rows, (columns + N - 1) / N, [&](int row, int group) {
      F const* const from = along_y + row * stride + group * N;
      combine_windows<N>(
          window.width, [&](int i) { return from[i]; },
          [&](int j, F value) {
            if (group * N + j < columns) results[row * kMaximaStride + group * N + j] = value;
          });
    });
  });
  __syncthreads();
  bool const inside =
      top >= 0 && left >= 0 && top + rows + window.height - 1 <= height && left + columns + window.width - 1 <= width;
  bool const whole = inside || outside == minus_infinity<F>();
  T* const out = p.y.row(tile.plane, y0) + x0;
  for_each_pixel(rows, columns, [&](int y, int x) {
    F most = results[y * kMaximaStride + x];
    if (!whole && (top + y < 0 || left + x < 0 || top + y + window.height > height || left + x + window.width > width))
      most = combine(most, outside);
    out[y * p.y.row_stride + x] = round_to<T>(most * sign);
  });
}

// --- the gradient of flat windows ------------------------------------------------------------------------------------

constexpr int kTiesRows = 32;
// Windows that a thread computes at once. Along x the number is odd, so that the threads of a warp read different
// banks.
constexpr int kDown = 8, kAcross = 7;
constexpr int tile_stride(int window) { return kTileWidth + kAcross + window; }

template <class Job>
__global__ void __launch_bounds__(kThreads) by_tiles(__grid_constant__ Job const job, int across, int down) {
  using Value = typename Job::Value;
  extern __shared__ __align__(16) unsigned char bytes[];
  auto const& window = job.p.window;
  auto const& image = job.image();
  int const height = int(image.height), width = int(image.width), stride = tile_stride(window.width);
  int64_t const line = blockIdx.x / across, plane = line / down;
  int const x0 = int(blockIdx.x - line * across) * kTileWidth, y0 = int(line - plane * down) * kTiesRows;
  int const rows = min(kTiesRows, height - y0), columns = min(kTileWidth, width - x0);

  auto const for_each_pixel = [&](auto f) {
    for (int i = threadIdx.x; i < kTileWidth * rows; i += kThreads) {
      int const y = i / kTileWidth, x = i % kTileWidth;
      if (x < columns) f(Element(plane, y0 + y, x0 + x), y * kTileWidth + x);
    }
  };
  if (!is_flat(window, plane / job.p.planes)) {
    for_each_pixel([&](Element const& e, int) { job.by_taps(e); });
    return;
  }

  Value* const along_y = reinterpret_cast<Value*>(bytes);  // (rows, stride)
  Value* const results = along_y + kTiesRows * stride;     // (rows, kTileWidth)
  auto const* const source = job.source(plane);
  int const top = y0 - job.top(), left = x0 - job.left();
  auto const combine_columns = [&](auto group_size) {
    constexpr int N = decltype(group_size)::value;
    for_each_group(columns + window.width - 1, (rows + N - 1) / N, [&](int column, int group) {
      int const x = left + column, y = top + group * N;
      bool const inside = x >= 0 && x < width;
      combine_windows<N>(
          window.height,
          [&](int i) { return inside && y + i >= 0 && y + i < height ? job.load(source, y + i, x) : job.outside(); },
          [&](int j, Value const& value) {
            if (group * N + j < rows) along_y[(group * N + j) * stride + column] = value;
          });
    });
  };
  if (window.height >= kDown)
    combine_columns(std::integral_constant<int, kDown>{});
  else
    combine_columns(std::integral_constant<int, 1>{});
  __syncthreads();
  auto const combine_rows = [&](auto group_size) {
    constexpr int N = decltype(group_size)::value;
    int const groups = (columns + N - 1) / N;
    for_each_group(groups, rows, [&](int group, int row) {
      Value const* const from = along_y + row * stride + group * N;
      combine_windows<N>(
          window.width, [&](int i) { return from[i]; },
          [&](int j, Value const& value) {
            if (group * N + j < columns) results[row * kTileWidth + group * N + j] = value;
          });
    });
  };
  if (window.width >= kAcross)
    combine_rows(std::integral_constant<int, kAcross>{});
  else
    combine_rows(std::integral_constant<int, 1>{});
  __syncthreads();
  for_each_pixel([&](Element const& e, int at) { job.store(e, results[at]); });
}

// float64 has no tiles: they would take a quarter of this file's compile time.
template <class T>
bool has_tiles(Planes<T const> const& image, StructuringElement<Compute<T>> const& window) {
  return sizeof(T) < 8 && image.step == 1 && max(window.height, window.width) <= kLargestTile &&
         image.height * image.row_stride <= INT32_MAX;
}

template <class Job>
int launch_taps(Job const& job, CUstream_st* stream) {
  unsigned const blocks = unsigned(ceil_div(job.image().rows() * job.image().row_size(), kThreads));
  by_taps<<<blocks, kThreads, 0, stream>>>(job);
  return cudaGetLastError();
}

template <class T, class Job>
int launch_ties(Job const& job, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8)
    if (has_tiles<T>(job.image(), job.p.window)) {
      int const bytes = int(sizeof(typename Job::Value)) * kTiesRows * (tile_stride(job.p.window.width) + kTileWidth);
      if (bytes <= max_shared_bytes())
        return launch_tiles(by_tiles<Job>, job, job.image(), kTiesRows, kTileWidth, kThreads, bytes, stream);
    }
  return launch_taps(job, stream);
}

}  // namespace

template <class T>
int dilation(Dilation<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) <= 2)
    if (is_3x3(p.window) && dilation_by_groups(p, stream)) return cudaGetLastError();
  if constexpr (sizeof(T) > 1)
    // Special case, H200: 4.2 (erosion3) to 7.7 (dilate cross3) times as fast as tiles.
    if (p.x.step == 1 && is_3x3(p.window)) return dilation_3x3(p, stream);
  if constexpr (sizeof(T) < 8)
    // Special case, H200: 1.05 (dilate disk7) to 118 (dilate15) times as fast as tap by tap.
    if (has_tiles<T>(p.x, p.window)) {
      int const bytes = int(sizeof(Compute<T>)) * kMaximaRows * (maxima_stride(p.window.width) + kMaximaStride);
      return launch_tiles(maxima_by_tiles<T>, p, p.x, kMaximaRows, kTileWidth, kMaximaThreads, bytes, stream);
    }
  return launch_taps(Maximum<T>{p}, stream);
}

template <class T>
int dilation_backward(DilationBackward<T> const& p, CUstream_st* stream) {
  if (p.workspace) {
    if (int error = launch_ties<T>(WindowMaxima<T>{p}, stream)) return error;
    return launch_ties<T>(SumGradients<T>{p}, stream);
  }
  if constexpr (sizeof(T) < 8)
    // Special case, H200: 4.0 (dilate cross3 backward) to 5.2 (erosion3 backward) times as fast as tiles.
    if (!is_3x3(p.window)) {
      auto const is_small = [](auto const& image) { return image.height * image.row_stride <= INT32_MAX; };
      int const size = p.window.height;
      bool const by_strips = p.window.width == size && (size == 7 || size == 15) && is_small(p.x) && is_small(p.grad) &&
                             // Special case, H200: 1.00 (dilate disk7 backward) to 2.9 (dilate7 backward) times as fast
                             // as tiles.
                             is_small(p.grad_x);
      if (by_strips)
        if (int error = dilation_backward_strips(p, stream)) return error;
      return dilation_backward_tiles(p, by_strips, stream);
    }
  return dilation_3x3_backward(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(dilation, Dilation)
KV_INSTANTIATE(dilation_backward, DilationBackward)

}  // namespace kv::morphology::cuda
