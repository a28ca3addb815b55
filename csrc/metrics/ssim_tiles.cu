// Structural similarity on CUDA with windows of any size, for images of any layout and dtype, at one scale or as the
// product of several.
//
// A block has a tile of eight rows. Along y each thread sums the windows of the eight pixels of a column: it reads the
// rows one after the other and adds each to all windows that contain it. The sums go to shared memory, and along x each
// thread sums the windows of eight pixels of a row in the same way. Scales are processed one after the other, with the
// intermediate results of a pixel in registers.
//
// The gradient takes two launches for as many planes, or rows of a plane, as the working memory holds. The first one
// writes the derivatives by the means, and for several scales the factor of each scale. The second one sums them.
#include "ssim_window.cuh"

namespace kv::metrics::cuda {
namespace {

// Row and column indices are those of the images; a 'valid' similarity starts at `offset`.
template <class F>
struct Work {
  StoredPlanes x, y;
  StoredPlanes result, other_result;  // the similarity; or the gradients, the latter without data if not needed
  StoredPlanes grad;                  // of the similarity
  DType stored;
  Border border;
  int offset, height, width;
  SsimConstants<F> constants;  // of the last scale; the others have no luminance
  SsimLoss<F> loss;
  F* partial;
  F const* of_loss;
  F* map;                                      // several scales: the loss, the mean over the planes of a sample
  F const* of_map;                             // its gradient
  Double4<F>* derivatives;                     // by the means, scale after scale
  F* scale_factors;                            // several scales: the factors of the derivatives
  int64_t first, band;                         // first plane and number of planes of a launch
  int top, bottom;                             // first and last row of the launch
  int stored_top, stored_bottom, stored_rows;  // rows with derivatives, and their maximum number
  int planes_per_block;                        // planes that a block processes one after the other
  unsigned across, down;
  int columns, stride;  // of a tile: its pixels, and the stride of rows in shared memory
  int scales, sizes[kMaxSsimScales];
  F weights[kMaxSsimWeights + kSide];  // of all scales; kernel arguments are constants

  __device__ __forceinline__ bool has_result(int y, int x) const {
    return y >= offset && y < height - offset && x >= offset && x < width - offset;
  }
  // The start of a plane's derivatives, and the index of a pixel from there.
  __device__ __forceinline__ int64_t plane_at(int scale, int64_t plane) const {
    return (scale * band + plane - first) * (int64_t(stored_rows) * (width - 2 * offset));
  }
  __device__ __forceinline__ int64_t pixel_at(int row, int column) const {
    return int64_t(row - stored_top) * (width - 2 * offset) + (column - offset);
  }
  // The factor of a pixel in D of ssim.h.
  __device__ __forceinline__ F ends(int y, int x, F factor) const {
    F result = 1;
    if (border != Border::reflect) return result;
    if (y == 0 || y == height - 1) result *= factor;
    if (x == 0 || x == width - 1) result *= factor;
    return result;
  }
};

// The first pixel of a plane. Planes are counted through all channels, also where channels are interleaved.
template <class T>
__device__ __forceinline__ T* channel(StoredPlanes const& p, int64_t plane, int64_t row = 0) {
  uint8_t* const first = p.plane(p.step == 1 ? plane : plane / p.step) + row * p.row_stride;
  return reinterpret_cast<T*>(first) + (p.step == 1 ? 0 : plane % p.step);
}

// The position of a block, and of its threads along x: each has the pixels of row y from column x on.
struct BlockPosition {
  int64_t plane;
  int x0, y0, x, y, line;  // line: start of its row in shared memory
  bool within;

  template <class F>
  __device__ __forceinline__ explicit BlockPosition(Work<F> const& p) {
    unsigned const tile = blockIdx.x / p.across, group = tile / p.down;
    int const thread = int(threadIdx.x), row = thread % kSide, column = thread / kSide * kSide;
    plane = p.first + int64_t(group) * p.planes_per_block;
    x0 = int(blockIdx.x - tile * p.across) * p.columns, y0 = p.top + int(tile - group * p.down) * kSide;
    x = x0 + column, y = y0 + row, line = row * p.stride + column;
    within = column < p.columns && x < p.width && y < p.bottom;
  }
};

using Rows = Row[kMaxSsimWeights + kSide];

// The rows in the last scale's windows of a tile: of the images, or of the derivatives.
template <class F>
__device__ __forceinline__ void list_rows(Work<F> const& p, BlockPosition const& position, bool derivatives,
                                          Rows& rows) {
  int const taps = p.sizes[p.scales - 1], above = position.y0 - taps / 2;
  int const first = derivatives ? p.stored_top : 0, end = derivatives ? p.stored_bottom : p.height;
  for (int i = int(threadIdx.x); i < kSide + taps - 1; i += int(blockDim.x)) {
    int const row = border_index(p.border, above + i, p.height);
    bool const in_bounds = row >= first && row < end;
    int64_t const of_x = derivatives ? (row - first) * (p.width - 2 * p.offset) : row * p.x.row_stride;
    rows[i] = {in_bounds ? unsigned(of_x) : 0, in_bounds ? unsigned(row * p.y.row_stride) : 0, in_bounds};
  }
}

// Adds to `sums` the sums over windows of scale s around the pixels of `position`. value(column) returns a function
// from a Row to the summands. Rows out of bounds are read as well: a branch would make each load wait for the previous
// one.
template <int M, class F, class Value>
__device__ __forceinline__ void sum_tile(Work<F> const& p, BlockPosition const& position, int s, int start, int offset,
                                         Rows const& all_rows, void* shared, Value value, F (&sums)[M][kSide]) {
  Vector<F, M>* const lines = static_cast<Vector<F, M>*>(shared);
  int const taps = p.sizes[s], left = position.x0 - taps / 2;
  Row const* const rows = all_rows + (p.sizes[p.scales - 1] - taps) / 2;
  auto const weight = [&](int t) { return p.weights[start + t]; };
  __syncthreads();  // publishes the rows, and waits for the readers of earlier lines
#pragma unroll 1
  for (int c = int(threadIdx.x); c < p.columns + taps - 1; c += int(blockDim.x)) {
    int const column = border_index(p.border, left + c, p.width);
    F down[M][kSide] = {};
    if (column >= offset && column < p.width - offset) {
      auto const of_row = value(column);
      auto const read = [&](int i) {
        Row const row = rows[i];
        return of_row(row);
      };
      sum_window<M>(taps, weight, read, down);
    }
#pragma unroll
    for (int j = 0; j < kSide; ++j) {
      Vector<F, M> sum;
#pragma unroll
      for (int m = 0; m < M; ++m) sum.v[m] = down[m][j];
      lines[j * p.stride + c] = sum;
    }
  }
  __syncthreads();
  if (position.within) sum_window<M>(taps, weight, [&](int i) { return lines[position.line + i]; }, sums);
}

// Computes the similarity, its loss or the derivatives by the means.
template <class T>
__global__ void __launch_bounds__(SsimTiles::kMaxThreads, 2) ssim_tiles(__grid_constant__ Work<Compute<T>> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) uint8_t shared[];
  Double4<F>* const lines = reinterpret_cast<Double4<F>*>(shared);
  F* const factors = reinterpret_cast<F*>(lines + kSide * p.stride) + threadIdx.x;  // per scale and pixel
  BlockPosition const position(p);
  __shared__ Rows rows;
  list_rows(p, position, false, rows);
  int const threads = int(blockDim.x);
  bool const several = p.map || p.of_map;
  F result[kSide] = {};
#pragma unroll 1
  for (int c = 0; c < p.planes_per_block; ++c) {
    int64_t const plane = position.plane + c;
    T const *const xs = channel<T const>(p.x, plane), *const ys = channel<T const>(p.y, plane);
    auto const pixels = [&](int column) {
      auto const *const x = reinterpret_cast<uint8_t const*>(xs + column * p.x.step),
                        *const y = reinterpret_cast<uint8_t const*>(ys + column * p.y.step);
      return [=](Row const& row) {
        F const a = read(*reinterpret_cast<T const*>(x + row.x)), b = read(*reinterpret_cast<T const*>(y + row.y));
        return Vector<F, 2>{row.in_bounds ? a : F(0), row.in_bounds ? b : F(0)};
      };
    };
    F similar[kSide];
#pragma unroll
    for (int j = 0; j < kSide; ++j) similar[j] = 1;
    int start = 0;
#pragma unroll 1
    for (int s = 0; s < p.scales; start += p.sizes[s++]) {
      F means[4][kSide] = {};
      auto const values = [&](int column) {
        return [pair = pixels(column)](Row const& row) {
          auto const [a, b] = pair(row).v;
          F const d = a - b;
          return Double4<F>{a, b, a * a + b * b, d * d};
        };
      };
      sum_tile<4>(p, position, s, start, 0, rows, shared, values, means);
      SsimConstants<F> constants = p.constants;
      if (s + 1 < p.scales) constants.c1 = 1, constants.luminance = 0;
      if (p.derivatives) __syncthreads();  // the derivatives reuse the lines
      if (position.within) {
#pragma unroll
        for (int j = 0; j < kSide; ++j) {
          Means<F> const m{means[0][j], means[1][j], means[2][j], means[3][j]};
          SsimTerms<F> const terms(m, constants);
          F const inverse = fast_reciprocal(terms.denominator), unlike = terms.numerator * inverse;
          int const x = position.x + j;
          if (!p.derivatives) {
            if (several)
              similar[j] *= 1 - unlike;
            else
              similar[j] = unlike;
            continue;
          }
          F g = 1;
          if (several)
            factors[(s * kSide + j) * threads] = 1 - unlike;
          else if (!p.grad.data)
            g = -p.loss.structure * p.of_loss[plane / p.loss.planes];
          else if (p.has_result(position.y, x))
            g = read(channel<T const>(p.grad, plane, position.y - p.offset)[(x - p.offset) * p.grad.step]);
          Means<F> const d = ssim_of_means_vjp(m, terms, inverse, g * p.ends(position.y, x, F(2)), constants.luminance);
          lines[position.line + j] = {d.x, d.y, d.squares, d.apart};
        }
      }
      if (!p.derivatives) continue;
      __syncthreads();
#pragma unroll 1
      for (int r = int(threadIdx.x) / 32; r < kSide; r += threads / 32)
#pragma unroll 1
        for (int i = int(threadIdx.x) % 32; i < p.columns; i += 32)
          if (position.y0 + r < p.bottom && p.has_result(position.y0 + r, position.x0 + i))
            p.derivatives[p.plane_at(s, plane) + p.pixel_at(position.y0 + r, position.x0 + i)] =
                lines[r * p.stride + i];
    }
    if (p.derivatives) {
      if (!several || !position.within) continue;
#pragma unroll 1
      for (int j = 0; j < kSide && position.x + j < p.width; ++j) {
        F const of_pixel =
            -p.loss.structure * p.of_map[(plane / p.loss.planes * p.height + position.y) * p.width + position.x + j];
#pragma unroll 1
        for (int s = 0; s < p.scales; ++s) {
          F factor = of_pixel;
#pragma unroll 1
          for (int t = 0; t < p.scales; ++t)
            if (t != s) factor *= factors[(t * kSide + j) * threads];
          p.scale_factors[p.plane_at(s, plane) + p.pixel_at(position.y, position.x + j)] = factor;
        }
      }
      continue;
    }
    F apart[1][kSide] = {};
    if (p.map) {
      auto const difference = [&](int column) {
        return [pair = pixels(column)](Row const& row) {
          auto const [a, b] = pair(row).v;
          return Vector<F, 1>{::fabs(a - b)};
        };
      };
      sum_tile<1>(p, position, p.scales - 1, start - p.sizes[p.scales - 1], 0, rows, shared, difference, apart);
#pragma unroll
      for (int j = 0; j < kSide; ++j) result[j] += p.loss.structure * (1 - similar[j]) + p.loss.absolute * apart[0][j];
      continue;
    }
    T* const to = p.result.data ? channel<T>(p.result, plane, position.y - p.offset) : nullptr;
#pragma unroll
    for (int j = 0; j < kSide; ++j) {
      int const x = position.x + j;
      if (!position.within || !p.has_result(position.y, x)) continue;
      if (to) {
        to[(x - p.offset) * p.result.step] = round_to<T>(1 - similar[j]);
      } else {
        result[0] += p.loss.structure * similar[j];
        if (p.loss.absolute != 0) {
          auto const [a, b] = pixels(x)(rows[position.y - position.y0 + p.sizes[0] / 2]).v;
          result[0] += p.loss.absolute * ::fabs(a - b);
        }
      }
    }
  }
  if (p.map && position.within) {
    F* const to = p.map + (position.plane / p.planes_per_block * p.height + position.y) * p.width + position.x;
#pragma unroll
    for (int j = 0; j < kSide; ++j)
      if (position.x + j < p.width) to[j] = result[j];
  }
  if (p.partial) {
    F const sum = warp_reduce(result[0], Sum());
    if (threadIdx.x % 32 == 0) p.partial[blockIdx.x * (threads / 32) + threadIdx.x / 32] = sum;
  }
}

// Computes the gradients from the derivatives.
template <class F>
__global__ void __launch_bounds__(SsimTiles::kMaxThreads, 2) ssim_tiles_back(__grid_constant__ Work<F> const p) {
  extern __shared__ __align__(16) uint8_t shared[];
  BlockPosition const position(p);
  __shared__ Rows rows;
  list_rows(p, position, true, rows);
  int64_t const plane = position.plane;
  F sums[4][kSide] = {}, apart[1][kSide] = {};
  int start = 0;
#pragma unroll 1
  for (int s = 0; s < p.scales; start += p.sizes[s++]) {
    int64_t const first = p.plane_at(s, plane);
    auto const derivatives = [&](int column) {
      int64_t const from = first + column - p.offset;
      Double4<F> const* const result = p.derivatives + from;
      F const* const scale_factors = p.scale_factors + (p.scale_factors ? from : 0);
      return [=, &p](Row const& row) {
        Double4<F> of_pixel = result[row.x];
        if (p.scale_factors) {
          F const factor = scale_factors[row.x];
#pragma unroll
          for (int m = 0; m < 4; ++m) of_pixel.v[m] *= factor;
        }
#pragma unroll
        for (int m = 0; m < 4; ++m) of_pixel.v[m] = row.in_bounds ? of_pixel.v[m] : F(0);
        return of_pixel;
      };
    };
    sum_tile<4>(p, position, s, start, p.offset, rows, shared, derivatives, sums);
  }
  if (p.of_map) {
    F const* const g = p.of_map + (plane / p.loss.planes * p.height + p.stored_top) * p.width;
    auto const gradient = [&](int column) {
      return [at = g + column](Row const& row) {
        F const of_pixel = at[row.x];
        return Vector<F, 1>{row.in_bounds ? of_pixel : F(0)};
      };
    };
    sum_tile<1>(p, position, p.scales - 1, start - p.sizes[p.scales - 1], 0, rows, shared, gradient, apart);
  }
  if (!position.within) return;
  F const of_absolute = p.of_loss ? p.loss.absolute * p.of_loss[plane / p.loss.planes] : F(0);
  dispatch_floating_dtype<F>(p.stored, [&](auto type) {
    using T = decltype(type);
    T const *const xs = channel<T const>(p.x, plane, position.y), *const ys = channel<T const>(p.y, plane, position.y);
    T* const to_x = channel<T>(p.result, plane, position.y);
    T* const to_y = p.other_result.data ? channel<T>(p.other_result, plane, position.y) : nullptr;
#pragma unroll
    for (int j = 0; j < kSide; ++j) {
      int const x = position.x + j;
      if (x >= p.width) break;
      F const a = read(xs[x * p.x.step]), b = read(ys[x * p.y.step]), d = a - b;
      F const scale = p.ends(position.y, x, F(0.5)), sign = d > 0 ? F(1) : d < 0 ? F(-1) : d;
      F const flat = sign * (of_absolute + p.loss.absolute * apart[0][j]);
      F const of_x = sums[0][j] + a * sums[2][j] + d * sums[3][j];
      F const of_y = sums[1][j] + b * sums[2][j] - d * sums[3][j];
      to_x[x * p.result.step] = round_to<T>(scale * of_x + flat);
      if (to_y) to_y[x * p.other_result.step] = round_to<T>(scale * of_y - flat);
    }
  });
}

template <class T>
Work<Compute<T>> work_of(SsimImages<T> const& images) {
  Work<Compute<T>> work{};
  work.x = stored_planes(images.x), work.y = stored_planes(images.y);
  work.stored = kDType<T>;
  work.border = images.border;
  work.offset = images.valid ? images.size / 2 : 0;
  work.height = work.bottom = int(images.x.height), work.width = int(images.x.width);
  work.constants = images.constants;
  work.scales = 1, work.sizes[0] = images.size;
  for (int t = 0; t < images.size; ++t) work.weights[t] = images.weights[t];
  return work;
}

template <class T>
Work<Compute<T>> work_of(SsimImages<T> const& images, SsimScales<Compute<T>> const& scales) {
  Work<Compute<T>> work = work_of(images);
  work.scales = scales.count;
  int at = 0;
  for (int s = 0; s < scales.count; ++s) {
    work.sizes[s] = scales.sizes[s];
    for (int t = 0; t < scales.sizes[s]; ++t) work.weights[at++] = scales.weights[s][t];
  }
  return work;
}

// Launches `kernel` for `planes` from work.first on; a block has memory for `factors` values per pixel of a thread.
template <class F, class Kernel>
int launch(Kernel kernel, Work<F>& work, int size, int64_t planes, int factors, CUstream_st* stream) {
  SsimTiles const tiles(work.bottom - work.top, work.width, size);
  work.across = unsigned(tiles.across), work.down = unsigned(tiles.down);
  work.columns = tiles.columns, work.stride = tiles.stride;
  int const bytes = int(sizeof(F)) * kSide * (4 * tiles.stride + factors * tiles.threads);
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes)) return error;
  kernel<<<unsigned(planes / work.planes_per_block * tiles.count()), tiles.threads, bytes, stream>>>(work);
  return cudaGetLastError();
}

template <class F>
int64_t planes_of(Work<F> const& work) {
  return work.x.count() * work.x.step;
}

// The number of planes per block, at most `band`, that keeps the multiprocessors busiest.
int64_t busiest(int64_t band, int64_t planes, int64_t blocks_of_plane) {
  if (band >= planes) return planes;
  int64_t const machine = multiprocessors();
  auto const rounds = [&](int64_t count) { return ceil_div(count * blocks_of_plane, machine); };
  int64_t best = band;
  for (int64_t count = band; 2 * count > band; --count)
    if (rounds(count) * best < rounds(best) * count) best = count;
  return best;
}

// Both launches of the gradient, for as many planes, or rows of a plane, as the memory for derivatives holds.
template <class T>
int launch_gradients(Work<Compute<T>>& work, int size, int64_t room, Compute<T>* derivatives, CUstream_st* stream) {
  using F = Compute<T>;
  bool const several = work.of_map;
  int64_t const planes = planes_of(work), row = int64_t(work.scales) * (work.width - 2 * work.offset);
  int64_t const most_rows = room / (row * (several ? 5 : 4));
  int const all = work.height - 2 * work.offset, reach = size / 2;
  int64_t const blocks = SsimTiles(work.height, work.width, size).count();
  work.planes_per_block = 1, work.band = busiest(max(most_rows / all, int64_t(1)), planes, blocks);
  work.stored_rows = int(min(most_rows, int64_t(all)));
  work.derivatives = reinterpret_cast<Double4<F>*>(derivatives);
  work.scale_factors = several ? derivatives + 4 * work.band * work.stored_rows * row : nullptr;
  int const rows = work.stored_rows < all ? work.stored_rows - 2 * reach : work.height;
  for (; work.first < planes; work.first += work.band)
    for (int top = 0; top < work.height; top += rows) {
      int64_t const count = min(work.band, planes - work.first);
      int const bottom = min(top + rows, work.height);
      work.top = work.stored_top = max(top - reach, work.offset);
      work.bottom = work.stored_bottom = min(bottom + reach, work.height - work.offset);
      if (int const error = launch(ssim_tiles<T>, work, size, count, several ? work.scales : 0, stream)) return error;
      work.top = top, work.bottom = bottom;
      if (int const error = launch(ssim_tiles_back<F>, work, size, count, 0, stream)) return error;
    }
  return 0;
}

}  // namespace

template <class T>
int ssim_in_tiles(Ssim<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Work<F> work = work_of(p.images);
  work.result = stored_planes(p.similarity);
  work.loss = p.loss, work.partial = p.similarity.data ? nullptr : p.partial;
  work.planes_per_block = 1;
  int const error = launch(ssim_tiles<T>, work, p.images.size, planes_of(work), 0, stream);
  if (error || p.similarity.data) return error;
  SsimTiles const tiles(p.images.x.height, p.images.x.width, p.images.size);
  int64_t const rows = work.x.count() / p.loss.planes, chunks = p.loss.planes * tiles.chunks();
  return sum_chunks(p.partial, rows, chunks, p.sums, stream);
}

template <class T>
int ssim_in_tiles_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  Work<Compute<T>> work = work_of(p.images);
  work.grad = stored_planes(p.grad);
  work.loss = p.loss, work.of_loss = p.of_loss;
  work.result = stored_planes(p.grad_x), work.other_result = stored_planes(p.grad_y);
  return launch_gradients<T>(work, p.images.size, p.room, p.derivatives, stream);
}

template <class T>
int ms_ssim(MsSsim<T> const& p, CUstream_st* stream) {
  Work<Compute<T>> work = work_of(p.images, p.scales);
  work.loss = p.loss, work.map = p.map;
  work.planes_per_block = int(p.loss.planes);
  return launch(ssim_tiles<T>, work, p.images.size, planes_of(work), 0, stream);
}

template <class T>
int ms_ssim_backward(MsSsimBackward<T> const& p, CUstream_st* stream) {
  Work<Compute<T>> work = work_of(p.images, p.scales);
  work.loss = p.loss, work.of_map = p.of_map;
  work.result = stored_planes(p.grad_x), work.other_result = stored_planes(p.grad_y);
  return launch_gradients<T>(work, p.images.size, p.room, p.derivatives, stream);
}

#define KV_SSIM_TILES(T)                                             \
  template int ssim_in_tiles(Ssim<T> const& p, CUstream_st* stream); \
  template int ssim_in_tiles_backward(SsimBackward<T> const& p, CUstream_st* stream);
KV_SSIM_TILES(float)
KV_SSIM_TILES(double)
KV_SSIM_TILES(Half)
KV_SSIM_TILES(BFloat16)
KV_INSTANTIATE(ms_ssim, MsSsim)
KV_INSTANTIATE(ms_ssim_backward, MsSsimBackward)

}  // namespace kv::metrics::cuda
