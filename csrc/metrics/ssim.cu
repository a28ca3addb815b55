// Structural similarity on CUDA: planar images, windows of 5, 7 and 11 pixels, one launch each way.
//
// A block walks down its columns, two of them a thread. Along y there are running sums in registers: a new row adds to
// all the rows that it belongs to, of which it completes the first. That row goes to shared memory, where the windows
// along x read it; what they read beyond the image is filled in there. The gradient does that twice, with the means and
// with the derivatives by them. Nothing depends on how pixels are stored but reading and writing them, so that is found
// out when it runs.
#include "ssim.h"
#include "sums.cuh"

namespace kv::cuda {
namespace {

constexpr int kThreads = 128;  // of a block, at most
constexpr int P = 2;           // columns of a thread
constexpr int kBeside = 16;    // numbers beside the columns of a block in shared memory
constexpr int kLine = P * kThreads + 2 * kBeside;

enum class Stored : int { floats, halves, bfloats };
template <class T>
constexpr Stored kStored = sizeof(T) == 4       ? Stored::floats
                           : __is_same(T, Half) ? Stored::halves
                                                : Stored::bfloats;

__device__ __forceinline__ float read_pixel(uint8_t const* row, int x, Stored stored) {
  if (stored == Stored::floats) return reinterpret_cast<float const*>(row)[x];
  if (stored == Stored::halves) return read(reinterpret_cast<Half const*>(row)[x]);
  return read(reinterpret_cast<BFloat16 const*>(row)[x]);
}
__device__ __forceinline__ void write_pixel(uint8_t* row, int x, float value, Stored stored) {
  if (stored == Stored::floats)
    reinterpret_cast<float*>(row)[x] = value;
  else if (stored == Stored::halves)
    reinterpret_cast<Half*>(row)[x] = round_to<Half>(value);
  else
    reinterpret_cast<BFloat16*>(row)[x] = round_to<BFloat16>(value);
}

using Bytes = Planes<uint8_t>;
template <class T>
Bytes as_bytes(Planes<T> const& p) {
  constexpr int64_t size = sizeof(T);
  return {reinterpret_cast<uint8_t*>(const_cast<std::remove_const_t<T>*>(p.data)),
          p.outer,
          p.inner,
          p.outer_stride * size,
          p.inner_stride * size,
          p.row_stride * size,
          p.height,
          p.width,
          p.step};
}

// Rows and columns are those of the images throughout: of a 'valid' similarity the first is at `offset`.
template <int K>
struct Work {
  Bytes x, y, result,
      other_result;  // the similarity; or the gradients to x and to y, the latter without data if unwanted
  Bytes grad;        // of the similarity
  Border border;
  int offset;
  Stored stored;
  SsimConstants<float> constants;
  SsimLoss<float> loss;
  float* partial;
  float const* of_loss;
  unsigned across, down;  // blocks of a plane
  int rows;               // of a block
  float weights[K];       // as arguments of a kernel they are constants, which cost no registers
};

// Where a block stands. A thread's columns are x and x + 1. Blocks overlap by what their windows reach beyond them.
template <int K>
struct Place {
  int64_t plane;
  int x, y0, y1, width, height, first, last;  // the block's own columns: from `first` to before `last`

  // `reach`: columns on either side of the block whose results are not right; even.
  __device__ __forceinline__ Place(Work<K> const& work, int reach)
      : width(int(work.x.width)), height(int(work.x.height)) {
    unsigned const line = blockIdx.x / work.across, column = blockIdx.x - line * work.across;
    plane = line / work.down;
    int const columns = P * int(blockDim.x), left = int(column) * (columns - 2 * reach);
    x = left + P * int(threadIdx.x);
    first = column == 0 ? 0 : left + reach;
    last = column + 1 == work.across ? width : left + columns - reach;
    y0 = int(line - unsigned(plane) * work.down) * work.rows;
    y1 = min(y0 + work.rows, height);
  }
  __device__ __forceinline__ bool owns(int column) const { return column >= first && column < last; }
};

// The sums along y: of the K - 1 rows that a row still belongs to, of which it completes the first.
template <int M, int K>
struct RunningSums {
  float sums[M][K - 1][P] = {};

  __device__ __forceinline__ void add(float const (&row)[M][P], float const (&weights)[K], float (&complete)[M][P]) {
#pragma unroll
    for (int m = 0; m < M; ++m)
#pragma unroll
      for (int t = 0; t < K; ++t)
#pragma unroll
        for (int j = 0; j < P; ++j) {
          float const sum = t < K - 1 ? fmaf(weights[t], row[m][j], sums[m][t][j]) : weights[t] * row[m][j];
          (t == 0 ? complete[m][j] : sums[m][max(t - 1, 0)][j]) = sum;
        }
  }
};

// Rows in shared memory: two, so that one can be written while the other is still read.
template <int M>
using Lines = float[2][M][kLine];

template <int M, int K>
struct Across {
  Lines<M>& lines;
  // The thread's place in a line; how far the image's end is from its first column. It is not clamped to what matters,
  // 0 to P: ptxas of CUDA 13.0 takes the wrong branch after that.
  int const at, beyond;
  int mirrors[P][2];  // where else its numbers stand, or -1: a pixel's mirror images at both ends of a row
  bool mirrored = false;
  int next = 0;

  __device__ __forceinline__ Across(Lines<M>& lines, int x, int width, Border border)
      : lines(lines), at(kBeside + P * int(threadIdx.x)), beyond(width - x) {
    for (int i = threadIdx.x; i < 2 * M * kLine; i += blockDim.x) lines[0][0][i] = 0;
    int const left = x - at, end = left + kBeside + P * int(blockDim.x) + kBeside;  // columns of the line
#pragma unroll
    for (int j = 0; j < P; ++j) {
      int const column = x + j, n = width - 1;
      mirrors[j][0] = mirrors[j][1] = -1;
      if (border != Border::reflect || column >= width) continue;
      if (column > 0 && column <= K / 2 && -column >= left) mirrors[j][0] = -column - left;
      if (column < n && n - column <= K / 2 && 2 * n - column < end) mirrors[j][1] = 2 * n - column - left;
      mirrored = mirrored || mirrors[j][0] >= 0 || mirrors[j][1] >= 0;
    }
    __syncthreads();
  }

  // The sums over the windows around the thread's columns of a row that all threads of the block have a part of.
  __device__ __forceinline__ void filter(float const (&row)[M][P], float const (&weights)[K], float (&sums)[M][P]) {
    float(&line)[M][kLine] = lines[next];
    next ^= 1;
    if (beyond >= P) {
#pragma unroll
      for (int m = 0; m < M; ++m) *reinterpret_cast<float2*>(&line[m][at]) = make_float2(row[m][0], row[m][1]);
    } else if (beyond == 1) {
#pragma unroll
      for (int m = 0; m < M; ++m) line[m][at] = row[m][0];
    }
    if (mirrored) {
#pragma unroll
      for (int j = 0; j < P; ++j)
#pragma unroll
        for (int side = 0; side < 2; ++side)
          if (mirrors[j][side] >= 0)
#pragma unroll
            for (int m = 0; m < M; ++m) line[m][mirrors[j][side]] = row[m][j];
    }
    __syncthreads();
    constexpr int kBefore = (K / 2 + 1) / 2 * 2, kFirst = kBefore - K / 2;  // pairs are read
#pragma unroll
    for (int m = 0; m < M; ++m) {
      float v[P + 2 * kBefore];
#pragma unroll
      for (int i = 0; i < P + 2 * kBefore; i += 2) {
        float2 const pair = *reinterpret_cast<float2 const*>(&line[m][at - kBefore + i]);
        v[i] = pair.x, v[i + 1] = pair.y;
      }
#pragma unroll
      for (int t = 0; t < K; ++t)
#pragma unroll
        for (int j = 0; j < P; ++j)
          sums[m][j] = t == 0 ? weights[0] * v[kFirst + j] : fmaf(weights[t], v[kFirst + t + j], sums[m][j]);
    }
  }
};

// The rows of both images, two of them on their way.
struct PixelRows {
  uint8_t const *const x, *const y;
  int64_t const x_stride, y_stride;
  int const column, width, height;
  Border const border;
  Stored const stored;
  int row;
  float a[3][P], b[3][P];

  template <int K>
  __device__ __forceinline__ PixelRows(Work<K> const& work, Place<K> const& place, int first)
      : x(work.x.plane(place.plane)),
        y(work.y.plane(place.plane)),
        x_stride(work.x.row_stride),
        y_stride(work.y.row_stride),
        column(place.x),
        width(place.width),
        height(place.height),
        border(work.border),
        stored(work.stored),
        row(first) {
    fetch(a[1], b[1]);
    fetch(a[2], b[2]);
  }
  __device__ __forceinline__ void fetch(float (&u)[P], float (&v)[P]) {
    int const from = border_index(border, row++, height);
    uint8_t const *const at_x = x + max(from, 0) * x_stride, *const at_y = y + max(from, 0) * y_stride;
#pragma unroll
    for (int j = 0; j < P; ++j) {
      bool const there = from >= 0 && column + j < width;
      u[j] = there ? read_pixel(at_x, column + j, stored) : 0.f;
      v[j] = there ? read_pixel(at_y, column + j, stored) : 0.f;
    }
  }
  // To the next row, the first time to the first one: a[0] and b[0].
  __device__ __forceinline__ void advance() {
#pragma unroll
    for (int j = 0; j < P; ++j) a[0][j] = a[1][j], b[0][j] = b[1][j], a[1][j] = a[2][j], b[1][j] = b[2][j];
    fetch(a[2], b[2]);
  }
  // What goes into the four means.
  __device__ __forceinline__ void values(float (&row)[4][P]) const {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      float const u = a[0][j], v = b[0][j], d = u - v;
      row[0][j] = u, row[1][j] = v, row[2][j] = fmaf(u, u, v * v), row[3][j] = d * d;
    }
  }
};

// Columns that are not right beside a block whose windows go along x once.
template <int K>
constexpr int kReach = (K / 2 + 1) / 2 * 2;

template <int K>
__global__ void __launch_bounds__(kThreads) ssim_down(__grid_constant__ Work<K> const work) {
  constexpr int R = K / 2;
  __shared__ __align__(16) Lines<4> lines;
  Place<K> const place(work, kReach<K>);
  Across<4, K> across(lines, place.x, place.width, work.border);
  RunningSums<4, K> down;
  PixelRows pixels(work, place, place.y0 - R);
  uint8_t* const out = work.result.data ? work.result.plane(place.plane) : nullptr;
  float apart = 0, unlike = 0;
#pragma unroll 1
  for (int y = place.y0 - 2 * R; y < place.y1; ++y) {  // the row that is completed
    pixels.advance();
    float row[4][P], summed[4][P], means[4][P];
    pixels.values(row);
    if (!out && y + R >= place.y0 && y + R < place.y1) {
#pragma unroll
      for (int j = 0; j < P; ++j) apart += place.owns(place.x + j) ? fabsf(pixels.a[0][j] - pixels.b[0][j]) : 0.f;
    }
    down.add(row, work.weights, summed);
    if (y < place.y0) continue;
    across.filter(summed, work.weights, means);
    if (y < work.offset || y >= place.height - work.offset) continue;
#pragma unroll
    for (int j = 0; j < P; ++j) {
      int const x = place.x + j;
      if (!place.owns(x) || x < work.offset || x >= place.width - work.offset) continue;
      float const similarity =
          ssim_of_means(Means<float>{means[0][j], means[1][j], means[2][j], means[3][j]}, work.constants);
      if (out)
        write_pixel(out + (y - work.offset) * work.result.row_stride, x - work.offset, similarity, work.stored);
      else
        unlike += 1 - similarity;
    }
  }
  if (!out) {
    float const sum = warp_sum(work.loss.structure * unlike + work.loss.absolute * apart);
    if (threadIdx.x % 32 == 0) work.partial[blockIdx.x * (blockDim.x / 32) + threadIdx.x / 32] = sum;
  }
}

// M: 3 for the gradient to x, 4 for both.
template <int K, int M>
__global__ void __launch_bounds__(kThreads) ssim_gradients(__grid_constant__ Work<K> const work) {
  constexpr int R = K / 2;
  __shared__ __align__(16) Lines<4> lines;
  __shared__ __align__(16) Lines<M> lines_of_derivatives;
  Place<K> const place(work, 2 * kReach<K>);
  int const width = place.width, height = place.height;
  Across<4, K> across(lines, place.x, width, work.border);
  Across<M, K> back_across(lines_of_derivatives, place.x, width, work.border);
  RunningSums<4, K> down;
  RunningSums<M, K> back_down;
  PixelRows pixels(work, place, place.y0 - 2 * R);
  bool const mirrored = work.border == Border::reflect;
  auto const at_end = [](int i, int n) { return i == 0 || i == n - 1; };
  uint8_t const* const g = work.grad.data ? work.grad.plane(place.plane) : nullptr;
  float const of_loss = g ? 0.f : work.of_loss[place.plane / work.loss.planes];
  uint8_t *const to_x = work.result.plane(place.plane), *const to_y =
                                                            M == 4 ? work.other_result.plane(place.plane) : nullptr;
#pragma unroll 1
  for (int y = place.y0 - 4 * R; y < place.y1; ++y) {  // the row of the gradient that is completed
    int const q = y + R;                               // that of the means
    pixels.advance();
    float row[4][P], summed[4][P], means[4][P];
    pixels.values(row);
    down.add(row, work.weights, summed);
    if (q < place.y0 - R) continue;
    across.filter(summed, work.weights, means);

    int const from = border_index(work.border, q, height);
    bool const inside = from >= work.offset && from < height - work.offset;
    float derivatives[M][P], complete[M][P], gradients[M][P];
#pragma unroll
    for (int j = 0; j < P; ++j) {
      int const x = place.x + j;
      Means<float> d{};
      if (inside && x >= work.offset && x < width - work.offset) {
        float of_pixel = -work.loss.structure * of_loss;
        if (g) of_pixel = read_pixel(g + (from - work.offset) * work.grad.row_stride, x - work.offset, work.stored);
        if (mirrored && at_end(q, height)) of_pixel *= 2;
        if (mirrored && at_end(x, width)) of_pixel *= 2;
        d = ssim_of_means_vjp(Means<float>{means[0][j], means[1][j], means[2][j], means[3][j]}, work.constants,
                              of_pixel);
      }
      derivatives[0][j] = d.x, derivatives[1][j] = d.squares, derivatives[2][j] = d.apart;
      if (M == 4) derivatives[M - 1][j] = d.y;
    }
    back_down.add(derivatives, work.weights, complete);
    if (y < place.y0) continue;
    back_across.filter(complete, work.weights, gradients);

#pragma unroll
    for (int j = 0; j < P; ++j) {
      int const x = place.x + j;
      if (!place.owns(x)) continue;
      float const a = read_pixel(pixels.x + y * pixels.x_stride, x, work.stored);
      float const b = read_pixel(pixels.y + y * pixels.y_stride, x, work.stored);
      float scale = 1;
      if (mirrored && at_end(y, height)) scale *= 0.5f;
      if (mirrored && at_end(x, width)) scale *= 0.5f;
      float const apart = (a - b) * gradients[2][j], both = 2 * scale;
      float const sign = work.loss.absolute * of_loss * (a > b ? 1.f : a < b ? -1.f : a - b);
      write_pixel(to_x + y * work.result.row_stride, x,
                  scale * gradients[0][j] + both * (a * gradients[1][j] + apart) + sign, work.stored);
      if (M == 4)
        write_pixel(to_y + y * work.other_result.row_stride, x,
                    scale * gradients[M - 1][j] + both * (b * gradients[1][j] - apart) - sign, work.stored);
    }
  }
}

inline int multiprocessors() {
  int device = 0, count = 1;
  cudaGetDevice(&device);
  cudaDeviceGetAttribute(&count, cudaDevAttrMultiProcessorCount, device);
  return count;
}

struct Grid {
  unsigned across, down, blocks;
  int rows, threads;

  // Of planes, by blocks of which `resident` fit a multiprocessor, and that many keep it busy. A block takes `more`
  // rows than it completes: as many rows as leave the least work to each multiprocessor.
  Grid(int64_t planes, int64_t height, int64_t width, int reach, int more, int resident) {
    threads = int(min(ceil_div(width, 32 * P) * 32, int64_t(kThreads)));
    int64_t const columns = P * threads, rest = max(width - columns, int64_t(0));
    across = unsigned(1 + ceil_div(rest, columns - 2 * reach));
    double least = INFINITY;
    int64_t const machine = multiprocessors();
    for (int64_t parts = 1; parts <= height / 8 + 1; ++parts) {
      int64_t const each = ceil_div(height, parts);
      int64_t const count = ceil_div(planes * across * ceil_div(height, each), machine);
      double const work = double(ceil_div(count, resident) * resident) * double(each + more);
      if (work < least) least = work, rows = int(each);
    }
    down = unsigned(ceil_div(height, rows));
    blocks = unsigned(planes * across * down);
  }
};

template <int K, class T>
Work<K> work_of(SsimImages<T> const& images, Grid const& grid) {
  Work<K> work{};
  work.x = as_bytes(images.x), work.y = as_bytes(images.y);
  work.border = images.border, work.offset = images.valid ? K / 2 : 0;
  work.stored = kStored<T>;
  work.constants = images.constants;
  work.across = grid.across, work.down = grid.down, work.rows = grid.rows;
  for (int t = 0; t < K; ++t) work.weights[t] = images.weights[t];
  return work;
}

template <int K, class T>
int launch(Ssim<T> const& p, CUstream_st* stream) {
  Planes<T const> const& x = p.images.x;
  Grid const grid(x.count(), x.height, x.width, kReach<K>, K - 1, 3);
  Work<K> work = work_of<K>(p.images, grid);
  work.result = as_bytes(p.similarity);
  work.loss = p.loss, work.partial = p.partial;
  ssim_down<K><<<grid.blocks, grid.threads, 0, stream>>>(work);
  if (!p.similarity.data) {
    int64_t const rows = x.count() / p.loss.planes, pieces = grid.blocks / rows * (grid.threads / 32);
    finish_sums<<<unsigned(rows), kSumThreads, 0, stream>>>(p.partial, pieces, Finish<float>{0, 1, false}, p.sums);
  }
  return cudaGetLastError();
}

template <int K, class T>
int launch(SsimBackward<T> const& p, CUstream_st* stream) {
  Planes<T const> const& x = p.images.x;
  Grid const grid(x.count(), x.height, x.width, 2 * kReach<K>, 2 * K - 2, 2);
  Work<K> work = work_of<K>(p.images, grid);
  work.result = as_bytes(p.grad_x), work.other_result = as_bytes(p.grad_y);
  work.grad = as_bytes(p.grad), work.loss = p.loss, work.of_loss = p.of_loss;
  if (p.grad_y.data)
    ssim_gradients<K, 4><<<grid.blocks, grid.threads, 0, stream>>>(work);
  else
    ssim_gradients<K, 3><<<grid.blocks, grid.threads, 0, stream>>>(work);
  return cudaGetLastError();
}

// Kernels of the size of the window; not for double.
template <class T, class Params>
int launch_size(Params const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) < 8) {
    Planes<T const> const& x = p.images.x;
    if (x.step != 1 || max(x.width, x.height) > INT32_MAX / 2) return cudaErrorInvalidValue;
    if (p.images.size == 5) return launch<5>(p, stream);
    if (p.images.size == 7) return launch<7>(p, stream);
    if (p.images.size == 11) return launch<11>(p, stream);
  }
  return cudaErrorInvalidValue;
}

}  // namespace

template <class T>
int ssim(Ssim<T> const& p, CUstream_st* stream) {
  return launch_size<T>(p, stream);
}

template <class T>
int ssim_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  return launch_size<T>(p, stream);
}

KV_INSTANTIATE(ssim, Ssim)
KV_INSTANTIATE(ssim_backward, SsimBackward)

}  // namespace kv::cuda
