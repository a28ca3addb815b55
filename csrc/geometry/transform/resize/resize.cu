// Resizing on CUDA: resize_strips.cu, and specialized kernels for frequent cases in resize_octave.cu, resize_linear.cu
// and resize_linear_backward.cu. Here are the kernels for what these do not serve: windows of a hundred pixels, images
// with many channels side by side, float64.
//
// A warp adds up the weighted rows of a band to one line in shared memory; the pixels of its output row are weighted
// means of that line. Memory is read and written in order at any size; rows that adjacent bands have in common are in
// the L1. The weights are computed once for all rows and planes of a block's tile.
#include "core/launch.cuh"
#include "geometry/transform/resize/contributors.cuh"

namespace kv::geometry::cuda {
namespace {

constexpr int kWarps = 8, kThreads = 32 * kWarps;

// The tile of a block: ranges of elements, rows and planes.
struct ResizeTiles {
  unsigned across, down;
  int rows, planes;
  int span;  // capacity of a line in elements
};

// K: no band has more pixels, 0 for any number. Few weights stay in registers, and more elements take turns in a lane.
template <int K>
constexpr int kPixelsPerThread = K ? 4 : 1;

template <class T, int K>
__global__ void __launch_bounds__(kThreads, K > 4 ? 3 : 4)
    resize_tiles(__grid_constant__ Resize<T> const p, ResizeTiles tiles) {
  constexpr int P = kPixelsPerThread<K>, W = 32 * P;
  int const lane = threadIdx.x % 32, warp = threadIdx.x / 32, step = int(p.x.step), size = int(p.y.row_size());
  unsigned const q = blockIdx.x / tiles.across, group = q / tiles.down;
  int const e0 = int(blockIdx.x - q * tiles.across) * W, y0 = int(q - group * tiles.down) * tiles.rows;

  extern __shared__ float memory[];
  float* const weights_x = memory;                              // by tap and element
  float* const weights_y = weights_x + p.columns.max_taps * W;  // by row and tap
  float* const line = weights_y + p.rows.max_taps * tiles.rows + warp * tiles.span;
  int* const first_x = reinterpret_cast<int*>(memory + p.columns.max_taps * W + p.rows.max_taps * tiles.rows +
                                              kWarps * tiles.span);  // by element, and where the last one ends
  Contributors<float>* const bands_y = reinterpret_cast<Contributors<float>*>(first_x + W + 2);
  for (int i = threadIdx.x; i < W + tiles.rows; i += kThreads) {
    bool const column = i < W;
    int const e = min(e0 + i, size - 1), x = e / step, y = min(y0 + i - W, int(p.y.height) - 1);
    ResizeAxis const& axis = column ? p.columns : p.rows;
    int const index = column ? x : y, stride = column ? W : 1;
    float* const to = column ? weights_x + i : weights_y + (i - W) * p.rows.max_taps;
    Contributors<float> const band = find_contributors<float>(axis, index);
    for (int k = 0; k < axis.max_taps; ++k) to[k * stride] = k < band.count ? find_weight(axis, band, index, k) : 0;
    if (column) first_x[i] = band.first * step + e - x * step;
    if (!column) bands_y[i - W] = band;
    if (i == W - 1) first_x[W] = (band.first + band.count) * step;
  }
  __syncthreads();

  int const from = first_x[0] / step * step, length = min(first_x[W] - from, tiles.span);
  [[maybe_unused]] float weights[P][K ? K : 1];
  int first[P];
#pragma unroll
  for (int i = 0; i < P; ++i) {
    first[i] = first_x[32 * i + lane] - from;
#pragma unroll
    for (int k = 0; k < K; ++k) weights[i][k] = k < p.columns.max_taps ? weights_x[k * W + 32 * i + lane] : 0;
  }
  auto const mean = [&](int i, auto term) {
    float sum = 0;
    if constexpr (K > 0) {
#pragma unroll
      for (int k = 0; k < K; ++k) sum += term(line[first[i] + k * step], weights[i][k]);
    } else {
      for (int k = 0; k < p.columns.max_taps; ++k) sum += term(line[first[i] + k * step], weights_x[k * W + lane]);
    }
    return sum;
  };

  int64_t const plane0 = int64_t(group) * tiles.planes;
  int const planes = int(min(p.y.count() - plane0, int64_t(tiles.planes)));
  for (int n = warp; n < planes * tiles.rows; n += kWarps) {
    int const row = n % tiles.rows;
    int64_t const plane = plane0 + n / tiles.rows;
    if (y0 + row >= p.y.height) continue;
    Contributors<float> const band = bands_y[row];
    float const* const weights_of_row = weights_y + row * p.rows.max_taps;
    T const* const source = p.x.row(plane, band.first) + from;
    constexpr int U = 4;
    for (int c = lane; c < length; c += 32 * U) {
      float sum[U] = {};
      auto const add = [&](int k) {
        float const weight = weights_of_row[k];
        T const* const at = source + k * p.x.row_stride + c;
#pragma unroll
        for (int u = 0; u < U; ++u)
          if (weight != 0 && c + 32 * u < length) sum[u] += weight * float(read(at[32 * u]));
      };
      if constexpr (K > 0) {
#pragma unroll
        for (int k = 0; k < K; ++k)
          if (k < band.count) add(k);
      } else {
#pragma unroll 4
        for (int k = 0; k < band.count; ++k) add(k);
      }
#pragma unroll
      for (int u = 0; u < U; ++u)
        if (c + 32 * u < length) line[c + 32 * u] = sum[u];
    }
    __syncwarp();
    T* const out = p.y.row(plane, y0 + row) + e0;
#pragma unroll
    for (int i = 0; i < P; ++i) {
      float sum = mean(i, [](float value, float weight) { return value * weight; });
      // A tap of weight 0 contributes nothing, even if it is inf or NaN.
      if (!(sum - sum == 0)) sum = mean(i, [](float value, float weight) { return weight != 0 ? value * weight : 0; });
      if (e0 + 32 * i + lane >= size) break;
      T* const to = out + 32 * i + lane;
      *to = round_to<T>(p.minuend ? float(read(*p.minuend_at(to))) - sum : sum);
    }
    __syncwarp();
  }
}

// --- any sizes: one thread an element, the weights computed as they are needed ---------------------------------------

template <class T>
__global__ void resize_any(__grid_constant__ Resize<T> const p) {
  using F = Compute<T>;
  int64_t const i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x, size = p.y.row_size(), step = p.x.step;
  if (i >= p.y.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.y.height;
  int const y = int(r - plane * p.y.height), x = int(e / step);
  Contributors<F> const rows = find_contributors<F>(p.rows, y), columns = find_contributors<F>(p.columns, x);
  T const* const source = p.x.row(plane, rows.first) + columns.first * step + e - x * step;
  F sum = 0;
  for (int l = 0; l < columns.count; ++l) {
    F const weight_x = find_weight(p.columns, columns, x, l);
    F line = 0;
    for (int k = 0; k < rows.count && weight_x != 0; ++k) {
      F const weight = find_weight(p.rows, rows, y, k);
      if (weight != 0) line += F(read(source[k * p.x.row_stride + l * step])) * weight;
    }
    sum += line * weight_x;
  }
  T* const to = p.y.row(plane, y) + e;
  *to = round_to<T>(p.minuend ? F(read(*p.minuend_at(to))) - sum : sum);
}

// --- launches --------------------------------------------------------------------------------------------------------

// The largest range of elements of x that `elements` adjacent elements of y read.
template <class T>
int64_t span_of(Resize<T> const& p, int64_t elements) {
  ResizeAxis const& a = p.columns;
  int64_t const step = p.x.step, pixels = (elements - 1) / step + 1;
  int64_t const across =
      a.num == 0 ? p.x.width : ceil_div(pixels * (a.backward ? a.den : a.num), a.backward ? a.num : a.den);
  return min(across + a.max_taps + 2, p.x.width) * step;
}

template <int K, class T>
bool launch_tiles(Resize<T> const& p, CUstream_st* stream) {
  constexpr int W = 32 * kPixelsPerThread<K>;
  ResizeTiles tiles;
  tiles.across = unsigned(ceil_div(p.y.row_size(), W));
  // Tables serve more rows and planes where there are enough blocks to fill the device.
  tiles.rows = p.y.rows() * tiles.across > (1 << 15) ? 32 : 8;
  tiles.down = unsigned(ceil_div(p.y.height, tiles.rows));
  tiles.planes = int(clamp(p.y.count() * tiles.across * tiles.down >> 12, int64_t(1), int64_t(16)));
  // Elements after a band that are read with weight 0 are still within the line.
  int64_t const span = span_of(p, W) + (K ? K : p.columns.max_taps) * p.x.step;
  int64_t const numbers = int64_t(p.columns.max_taps) * W + int64_t(p.rows.max_taps) * tiles.rows + kWarps * span;
  int64_t const bytes = 4 * (numbers + W + 2) + int64_t(sizeof(Contributors<float>)) * tiles.rows;
  if (bytes > 48 << 10) return false;
  tiles.span = int(span);
  unsigned const blocks = unsigned(ceil_div(p.y.count(), tiles.planes)) * tiles.across * tiles.down;
  resize_tiles<T, K><<<blocks, kThreads, unsigned(bytes), stream>>>(p, tiles);
  return true;
}

}  // namespace

template <class T>
int resize(Resize<T> const& p, CUstream_st* stream) {
  bool done = false;
  if constexpr (sizeof(T) < 8) {
    if (int const error = resize_octave(p, stream); error != kUnsupported) return error;
    if constexpr (sizeof(T) <= 2)
      // Special case, H200: 1.2 (antialiased, 375x500) to 2.2 (pyrdown, 335x513) times as fast as strips, float16.
      if (int const error = resize_near_half(p, stream); error != kUnsupported) return error;
    if (int const error = resize_linear(p, stream); error != kUnsupported) return error;
    if constexpr (sizeof(T) > 1)
      if (int const error = resize_linear_backward(p, stream); error != kUnsupported) return error;
    if constexpr (sizeof(T) <= 2)
      // Special case, H200: 1.04 (float16, 500x500 to 450x450) to 2.4 (bytes, 375x500 to 131x175) times as fast as
      // strips.
      if (int const error = resize_columns(p, stream); error != kUnsupported) return error;
    // Special case, H200: 1.01 (extract_patches backward) to 6.8 (resize 0.07 aa backward) times as fast as tiles.
    if (int const error = resize_strips(p, stream); error != kUnsupported) return error;
    int const max_taps = max(p.rows.max_taps, p.columns.max_taps);
    done = max_taps <= 4   ? launch_tiles<4>(p, stream)
           : max_taps <= 8 ? launch_tiles<8>(p, stream)
                           : launch_tiles<0>(p, stream);
  }
  if (!done) resize_any<<<unsigned(ceil_div(p.y.rows() * p.y.row_size(), 256)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(resize, Resize)

}  // namespace kv::geometry::cuda
