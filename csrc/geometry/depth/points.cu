// Points and normals of depth images on CUDA. A thread takes four adjacent pixels, in accesses of 16 bytes. Where rows
// are no such vectors, adjacent threads access adjacent elements: those of points take every 32nd pixel, those of
// normals, who share neighbors, exchange results in shared memory. So do points (H, W, 3), whose coordinates are
// adjacent in memory.
#include "core/block_reduce.cuh"
#include "core/row_vectors.cuh"
#include "geometry/depth/points.h"

namespace kv::geometry::cuda {
namespace {

constexpr int kThreads = 256, kRun = 4;  // pixels of a thread

// Groups of kRun adjacent pixels of a batch of images, in row-major order. A block takes groups of one image.
struct Runs {
  unsigned across, of_image, blocks_of_image, blocks;
  Runs(int64_t batch, int64_t height, int64_t width)
      : across(unsigned(ceil_div(width, kRun))),
        of_image(unsigned(height) * across),
        blocks_of_image(unsigned(ceil_div(of_image, kThreads))),
        blocks(unsigned(batch) * blocks_of_image) {}
  // Sets the thread's sample and its group within it.
  __device__ __forceinline__ void locate(int64_t& b, unsigned& run) const {
    unsigned const sample = blockIdx.x / blocks_of_image;
    b = sample;
    run = (blockIdx.x - sample * blocks_of_image) * kThreads + threadIdx.x;
  }
  // Sets the sample, the row and the first column. False for threads without pixels.
  __device__ __forceinline__ bool locate(int64_t& b, int& y, int& x) const {
    unsigned run;
    locate(b, run);
    unsigned const row = run / across;
    y = int(row), x = int(run - row * across) * kRun;
    return run < of_image;
  }
};

// Whether rows can be read in vectors of four.
template <class T>
bool is_vectorizable_by_4(Images<T> const& p) {
  int64_t const bytes = sizeof(T) * kRun > 16 ? 16 : sizeof(T) * kRun;
  auto const fits = [&](int64_t stride) { return stride * int64_t(sizeof(T)) % bytes == 0; };
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && fits(p.batch_stride) && fits(p.channel_stride) &&
         fits(p.row_stride) && p.step == 1 && p.width % kRun == 0;
}

// Reads kRun pixels from column x on. Columns past the border replicate it.
template <class T, class F>
__device__ __forceinline__ void load_run(T const* row, int64_t step, int x, int width, bool vectorized, F (&v)[kRun]) {
  Vector<std::remove_const_t<T>, kRun> vector{};
  if (vectorized)
    vector = *reinterpret_cast<Vector<T, kRun> const*>(row + x);
  else
    for (int i = 0; i < kRun; ++i) vector.v[i] = row[min(x + i, width - 1) * step];
#pragma unroll
  for (int i = 0; i < kRun; ++i) v[i] = read(vector.v[i]);
}

// The pixels of a thread: those of a group as a vector, or, of those of the groups of its warp, every 32nd.
template <bool Vectors>
struct ThreadPixels {
  static constexpr int apart = Vectors ? 1 : 32;
  int64_t b;
  int x[kRun], y[kRun], width, count;
  unsigned first;  // of the image's pixels

  __device__ __forceinline__ ThreadPixels(Runs const& runs, int height, int width) : width(width) {
    if constexpr (Vectors) {
      count = runs.locate(b, y[0], x[0]) ? kRun : 0;
      first = unsigned(y[0]) * width + x[0];
    } else {
      unsigned run;
      runs.locate(b, run);
      unsigned const lane = threadIdx.x % 32, pixels = unsigned(height) * width;
      first = (run - lane) * kRun + lane;
      count = first < pixels ? int(min((pixels - first + 31) / 32, unsigned(kRun))) : 0;
      y[0] = int(first / width), x[0] = int(first - unsigned(y[0]) * width);
    }
#pragma unroll
    for (int i = 1; i < kRun; ++i) {
      y[i] = y[i - 1], x[i] = x[i - 1] + apart;
      if constexpr (!Vectors)
        for (; x[i] >= width; x[i] -= width) ++y[i];
    }
  }
  template <class T, class F, int C>
  __device__ __forceinline__ void load(Images<T> const& image, F (&v)[C][kRun]) const {
    bool const is_dense = image.row_stride == width && image.step == 1;
#pragma unroll
    for (int k = 0; k < C; ++k) {
      if constexpr (Vectors) {
        load_run(image.row(b, k, y[0]), 1, x[0], 0, true, v[k]);
      } else if (is_dense) {
#pragma unroll
        for (int i = 0; i < kRun; ++i) v[k][i] = i < count ? read(image.row(b, k, 0)[first + i * apart]) : F(0);
      } else {
#pragma unroll
        for (int i = 0; i < kRun; ++i) v[k][i] = i < count ? read(image.row(b, k, y[i])[x[i] * image.step]) : F(0);
      }
    }
  }
  // Of results, whose planes are dense.
  template <class T, class F, int C>
  __device__ __forceinline__ void store(Images<T> const& image, F const (&v)[C][kRun]) const {
#pragma unroll
    for (int k = 0; k < C; ++k) {
      T* const to = image.row(b, k, 0) + first;
      if constexpr (Vectors) {
        store_vector(to, v[k]);
      } else {
#pragma unroll
        for (int i = 0; i < kRun; ++i)
          if (i < count) to[i * apart] = round_to<T>(v[k][i]);
      }
    }
  }
};

template <class T, bool Vectors>
__global__ void __launch_bounds__(kThreads) points_of(__grid_constant__ DepthPoints<T> const p, Runs const runs) {
  using F = Compute<T>;
  ThreadPixels<Vectors> const own(runs, int(p.y.height), int(p.y.width));
  if (own.count == 0) return;
  Rays<F> const rays(p.cameras + own.b * p.camera_stride, p.distance);
  F d[1][kRun], points[3][kRun];
  own.load(p.depth, d);
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    F ray[3];
    rays.at(F(own.x[i]), F(own.y[i]), ray);
#pragma unroll
    for (int k = 0; k < 3; ++k) points[k][i] = ray[k] * d[0][i];
  }
  own.store(p.y, points);
}

// Points (H, W, 3): one thread for each pixel. The block's coordinates go to shared memory first, so that adjacent
// threads write adjacent elements.
template <class T>
__global__ void __launch_bounds__(kThreads)
    adjacent_points_of(__grid_constant__ DepthPoints<T> const p, unsigned blocks_per_image) {
  using F = Compute<T>;
  __shared__ T coordinates[3 * kThreads];
  unsigned const b = blockIdx.x / blocks_per_image, width = unsigned(p.y.width), pixels = unsigned(p.y.height) * width,
                 first = (blockIdx.x - b * blocks_per_image) * kThreads, pixel = first + threadIdx.x;
  if (pixel < pixels) {
    unsigned const y = pixel / width, x = pixel - y * width;
    F const d = read(p.depth.row(b, 0, y)[x * p.depth.step]);
    F ray[3];
    Rays<F>(p.cameras + b * p.camera_stride, p.distance).at(F(x), F(y), ray);
#pragma unroll
    for (int k = 0; k < 3; ++k) coordinates[3 * threadIdx.x + k] = round_to<T>(ray[k] * d);
  }
  __syncthreads();
  T* const out = p.y.row(b, 0, 0) + 3 * int64_t(first);
  unsigned const count = 3 * min(pixels - first, unsigned(kThreads));
#pragma unroll
  for (unsigned i = threadIdx.x; i < 3 * kThreads; i += kThreads)
    if (i < count) out[i] = coordinates[i];
}

template <class T, bool Vectors>
__global__ void __launch_bounds__(kThreads)
    points_backward(__grid_constant__ DepthPointsBackward<T> const p, Runs const runs) {
  using F = Compute<T>;
  ThreadPixels<Vectors> const own(runs, int(p.grad.height), int(p.grad.width));
  if (own.count == 0) return;
  Rays<F> const rays(p.cameras + own.b * p.camera_stride, p.distance);
  F grad[3][kRun], sums[1][kRun];
  own.load(p.grad, grad);
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    F ray[3];
    rays.at(F(own.x[i]), F(own.y[i]), ray);
    sums[0][i] = ray[0] * grad[0][i] + ray[1] * grad[1][i] + ray[2] * grad[2][i];
  }
  own.store(p.grad_depth, sums);
}

template <class T>
__global__ void __launch_bounds__(kThreads)
    normals_of(__grid_constant__ DepthPoints<T> const p, Runs const runs, bool read_fours, bool write_fours) {
  using F = Compute<T>;
  int64_t b;
  int y, x;
  bool const is_in = runs.locate(b, y, x);
  if (write_fours && !is_in) return;
  int const width = int(p.y.width), height = int(p.y.height);
  if (!is_in) y = height - 1, x = width - 1;
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
  int const rows[] = {max(y - 1, 0), y, min(y + 1, height - 1)};
  auto const across = [&](int i) { return rays.across(F(clamp(x + i - 1, 0, width - 1))); };
  // The pixels and their neighbors. All are requested before the first is used.
  T const* from[3];
  T depth[3][kRun + 2];
  int64_t const step = p.depth.step;
#pragma unroll
  for (int j = 0; j < 3; ++j) {
    from[j] = p.depth.row(b, 0, rows[j]);
    depth[j][0] = from[j][max(x - 1, 0) * step];
    depth[j][kRun + 1] = from[j][min(x + kRun, width - 1) * step];
  }
  if (read_fours) {
    Vector<T, kRun> own[3];
#pragma unroll
    for (int j = 0; j < 3; ++j) own[j] = *reinterpret_cast<Vector<T, kRun> const*>(from[j] + x);
#pragma unroll
    for (int n = 0; n < 3 * kRun; ++n) depth[n / kRun][n % kRun + 1] = own[n / kRun].v[n % kRun];
  } else if (step == 1 && x + kRun <= width) {  // addresses differ by constants
#pragma unroll
    for (int n = 0; n < 3 * kRun; ++n) depth[n / kRun][n % kRun + 1] = from[n / kRun][x + n % kRun];
  } else {
#pragma unroll
    for (int n = 0; n < 3 * kRun; ++n)
      depth[n / kRun][n % kRun + 1] = from[n / kRun][min(x + n % kRun, width - 1) * step];
  }
  F z[kRun + 2][3], down[3], normals[3][kRun];
  auto const set_z = [&](auto unit) {
    Rays<F> known = rays;
    known.unit = unit;  // one branch for all pixels
#pragma unroll
    for (int j = 0; j < 3; ++j) {
      down[j] = known.down(F(rows[j]));
#pragma unroll
      for (int i = 0; i < kRun + 2; ++i) z[i][j] = known.z_of(across(i), down[j], F(read(depth[j][i])));
    }
  };
  p.distance ? set_z(std::true_type{}) : set_z(std::false_type{});
  auto const column = [&](int i) { return PointColumn<F>(across(i), down, z[i]); };
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    F along_x[3], along_y[3], normal[3];
    tangents_of(column(i), column(i + 1), column(i + 2), along_x, along_y);  // each derivative is computed once
    normal_of(along_x, along_y, normal);
#pragma unroll
    for (int k = 0; k < 3; ++k) normals[k][i] = normal[k];
  }
  if (write_fours) {
#pragma unroll
    for (int k = 0; k < 3; ++k) store_vector(p.y.row(b, k, y) + x, normals[k]);
  } else {
    AdjacentElements<kRun, kThreads / 32> const elements(y * p.y.row_stride + x, is_in ? min(width - x, kRun) : 0);
#pragma unroll
    for (int k = 0; k < 3; ++k) elements.store(p.y.row(b, k, 0), normals[k]);
  }
}

// A block takes a tile of kAcross x Tall pixels. First it computes the gradients to the derivatives in the tile and its
// border. From those, each thread computes the gradients of Tall / 8 pixels of a column.
constexpr int kAcross = 32;

template <class T, int Tall>
__global__ void __launch_bounds__(kThreads)
    normals_backward(__grid_constant__ DepthNormalsBackward<T> const p, unsigned across, unsigned down) {
  using F = Compute<T>;
  constexpr int kTileWidth = kAcross + 2, kTileHeight = Tall + 2, kRows = Tall / 8;
  __shared__ F gradients[6][kTileHeight][kTileWidth];
  unsigned const line = blockIdx.x / across;
  int64_t const b = line / down;
  int const x0 = int(blockIdx.x - line * across) * kAcross, y0 = int(line - unsigned(b) * down) * Tall;
  int const width = int(p.depth.width), height = int(p.depth.height);
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
#pragma unroll 1
  for (int n = threadIdx.x; n < kTileHeight * kTileWidth; n += kThreads) {
    int const row = n / kTileWidth, column = n - row * kTileWidth, x = x0 - 1 + column, y = y0 - 1 + row;
    F grad_x[3] = {}, grad_y[3] = {};
    if (x >= 0 && x < width && y >= 0 && y < height) {
      F along_x[3], along_y[3], grad[3];
      F down[3];
      T const* rows[3];
#pragma unroll
      for (int j = 0; j < 3; ++j) {
        int const below = clamp(y + j - 1, 0, height - 1);
        down[j] = rays.down(F(below));
        rows[j] = p.depth.row(b, 0, below);
      }
      auto const column_at = [&](int i) {
        int const at = clamp(x + i - 1, 0, width - 1);
        F const u = rays.across(F(at));
        F z[3];
#pragma unroll
        for (int j = 0; j < 3; ++j) z[j] = rays.z_of(u, down[j], F(read(rows[j][at * p.depth.step])));
        return PointColumn<F>(u, down, z);
      };
      tangents_of(column_at(0), column_at(1), column_at(2), along_x, along_y);
#pragma unroll
      for (int k = 0; k < 3; ++k) grad[k] = read(p.grad.row(b, k, y)[x * p.grad.step]);
      normal_vjp(along_x, along_y, grad, grad_x, grad_y);
    }
#pragma unroll
    for (int k = 0; k < 3; ++k) gradients[k][row][column] = grad_x[k], gradients[3 + k][row][column] = grad_y[k];
  }
  __syncthreads();
  int const left = threadIdx.x % 32, x = x0 + left, top = int(threadIdx.x / 32) * kRows;
  if (x >= width) return;
  Taken<F> const adjacent(x, width);
  F ray[3], differences[kRows + 2][3], means[kRows + 2][3];  // of each row of the pixels and of their neighbors
#pragma unroll
  for (int j = 0; j < kRows + 2; ++j)
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      differences[j][k] = means[j][k] = 0;
#pragma unroll
      for (int i = 0; i < 3; ++i) {
        differences[j][k] += adjacent.difference[i] * gradients[k][top + j][left + i];
        means[j][k] += adjacent.mean[i] * gradients[3 + k][top + j][left + i];
      }
    }
#pragma unroll
  for (int j = 0; j < kRows; ++j) {
    int const y = y0 + top + j;
    if (y >= height) return;
    Taken<F> const above(y, height);
    F grad_point[3] = {};
#pragma unroll
    for (int k = 0; k < 3; ++k)
#pragma unroll
      for (int i = 0; i < 3; ++i)
        grad_point[k] += above.mean[i] * differences[j + i][k] + above.difference[i] * means[j + i][k];
    if (p.to_points) {
#pragma unroll
      for (int k = 0; k < 3; ++k) p.to.row(b, k, y)[x * p.to.step] = round_to<T>(grad_point[k]);
    } else {
      rays.at(F(x), F(y), ray);
      p.to.row(b, 0, y)[x * p.to.step] = round_to<T>(dot3(ray, grad_point));
    }
  }
}

// Sums over a chunk of an image's pixels. A thread takes kRunsEach groups of kRun pixels.
constexpr int kRunsEach = 4;

template <class T>
__global__ void __launch_bounds__(kThreads)
    sum_to_cameras(__grid_constant__ DepthPointsCameraBackward<T> const p, bool vectorized) {
  using F = Compute<T>;
  int64_t const b = blockIdx.x / p.parts, part = blockIdx.x - b * p.parts;
  int const width = int(p.grad.width), height = int(p.grad.height), across = (width + kRun - 1) / kRun;
  Rays<F> const rays(p.cameras + b * p.camera_stride, p.distance);
  F sums[4] = {};
#pragma unroll 1
  for (int n = 0; n < kRunsEach; ++n) {
    int64_t const run = (part * kRunsEach + n) * kThreads + threadIdx.x;
    if (run >= int64_t(across) * height) break;
    int const y = int(run / across), x = int(run - int64_t(y) * across) * kRun;
    F grad[3][kRun], d[kRun];
    load_run(p.depth.row(b, 0, y), p.depth.step, x, width, vectorized, d);
#pragma unroll
    for (int k = 0; k < 3; ++k) load_run(p.grad.row(b, k, y), p.grad.step, x, width, vectorized, grad[k]);
#pragma unroll
    for (int i = 0; i < kRun; ++i) {
      F const g[] = {grad[0][i], grad[1][i], grad[2][i]};
      if (x + i < width) rays.add_gradients(F(x + i), F(y), d[i], g, sums);
    }
  }
  double const promoted[] = {sums[0], sums[1], sums[2], sums[3]};
  store_block_sums<kThreads>(promoted, p.partial + 4 * int64_t(blockIdx.x));
}

// A block sums the gradient of a camera; each of its warps takes one sum.
template <class T>
__global__ void __launch_bounds__(128) finish_cameras(__grid_constant__ DepthPointsCameraBackward<T> const p) {
  int64_t const b = blockIdx.x;
  int const k = threadIdx.x / 32;
  __shared__ double sums[4];
  double sum = 0;
  for (int64_t part = threadIdx.x % 32; part < p.parts; part += 32) sum += p.partial[4 * (b * p.parts + part) + k];
  sum = warp_reduce(sum, Sum());
  if (threadIdx.x % 32 == 0) sums[k] = sum;
  __syncthreads();
  if (threadIdx.x == 0)
    Rays<Compute<T>>(p.cameras + b * p.camera_stride, p.distance).store_gradients(sums, p.grad_camera + 9 * b);
}

// Launches f with what tells the pixels of its threads.
template <class T, class F>
int with_pixels(Images<T const> const& from, Images<T> const& to, F f) {
  if (to.height * to.width > INT32_MAX || to.row_stride != to.width || to.step != 1) return cudaErrorInvalidValue;
  if (is_vectorizable_by_4(from) && is_vectorizable_by_4(to))
    f(std::true_type{}, Runs(to.batch, to.height, to.width));
  else
    f(std::false_type{}, Runs(to.batch, 1, to.height * to.width));
  return cudaGetLastError();
}

}  // namespace

template <class T>
int depth_points(DepthPoints<T> const& p, CUstream_st* stream) {
  int64_t const pixels = p.y.height * p.y.width;
  if (p.y.step == 3 && p.y.channel_stride == 1 && p.y.row_stride == 3 * p.y.width && pixels <= INT32_MAX) {
    unsigned const blocks_per_image = unsigned(ceil_div(pixels, kThreads));
    adjacent_points_of<<<unsigned(p.y.batch) * blocks_per_image, kThreads, 0, stream>>>(p, blocks_per_image);
    return cudaGetLastError();
  }
  return with_pixels(p.depth, p.y, [&](auto vectors, Runs const& runs) {
    points_of<T, vectors.value><<<runs.blocks, kThreads, 0, stream>>>(p, runs);
  });
}

template <class T>
int depth_points_backward(DepthPointsBackward<T> const& p, CUstream_st* stream) {
  return with_pixels(p.grad, p.grad_depth, [&](auto vectors, Runs const& runs) {
    points_backward<T, vectors.value><<<runs.blocks, kThreads, 0, stream>>>(p, runs);
  });
}

template <class T>
int depth_normals(DepthPoints<T> const& p, CUstream_st* stream) {
  Runs const runs(p.y.batch, p.y.height, p.y.width);
  normals_of<T>
      <<<runs.blocks, kThreads, 0, stream>>>(p, runs, is_vectorizable_by_4(p.depth), is_vectorizable_by_4(p.y));
  return cudaGetLastError();
}

template <class T>
int depth_normals_backward(DepthNormalsBackward<T> const& p, CUstream_st* stream) {
  constexpr int kTall = sizeof(T) == 8 ? 16 : 32;  // 28 kB of shared memory
  unsigned const across = unsigned(ceil_div(p.depth.width, kAcross)), down = unsigned(ceil_div(p.depth.height, kTall));
  normals_backward<T, kTall><<<unsigned(p.depth.batch * across * down), kThreads, 0, stream>>>(p, across, down);
  return cudaGetLastError();
}

template <class T>
int depth_points_camera_backward(DepthPointsCameraBackward<T> const& p, CUstream_st* stream) {
  bool const vectorized = is_vectorizable_by_4(p.grad) && is_vectorizable_by_4(p.depth);
  sum_to_cameras<T><<<unsigned(p.grad.batch * p.parts), kThreads, 0, stream>>>(p, vectorized);
  finish_cameras<T><<<unsigned(p.grad.batch), 128, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(depth_points, DepthPoints)
KV_INSTANTIATE(depth_points_backward, DepthPointsBackward)
KV_INSTANTIATE(depth_normals, DepthPoints)
KV_INSTANTIATE(depth_normals_backward, DepthNormalsBackward)
KV_INSTANTIATE(depth_points_camera_backward, DepthPointsCameraBackward)

}  // namespace kv::geometry::cuda
