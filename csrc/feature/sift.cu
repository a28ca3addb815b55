// SIFT descriptors on CUDA: one block for each patch, with the patch and its gradients in shared memory. A thread
// gathers an entry of the histogram from the pixels of its cell; threads of a warp have angles of the same cells, so
// that most of their reads are broadcasts. There are no atomics.
#include "patch_gradient.cuh"
#include "sift.h"

namespace kv::feature::cuda {
namespace {

constexpr int kThreads = 128;

// The entries of a descriptor for normalize_sift.
template <class F>
struct Entries {
  int size;
  F (&memory)[kThreads / 32];
  template <class Call>
  __device__ __forceinline__ void each(Call f) const {
    for (int i = threadIdx.x; i < size; i += kThreads) f(i);
  }
  template <class Call>
  __device__ __forceinline__ F sum(Call f) const {
    F total = 0;
    each([&](int i) { total += f(i); });
    return block_sum_to_all(total, memory);
  }
};

// The arrays of a block.
template <class F>
struct SiftPatch {
  SiftGrid const& grid;
  SharedPatch<F> patch;
  F *magnitudes, *positions;  // (n, n); a position is an angle in bins
  F* pooling;                 // (cells, n)
  F* h;                       // (cells, bins, cells)

  static size_t bytes(SiftGrid const& g, bool backward) {
    return (3 * g.n * g.n + g.cells * g.n + (backward ? 2 : 1) * g.size()) * sizeof(F);
  }
  __device__ __forceinline__ SiftPatch(SiftGrid const& g, F* memory) : grid(g) {
    int const area = g.n * g.n;
    patch = {memory, g.n}, magnitudes = memory + area, positions = magnitudes + area, pooling = positions + area;
    h = pooling + g.cells * g.n;
  }

  template <class T>
  __device__ __forceinline__ void fill_histogram(T const* from) {
    patch.read_from(from);
    for (int i = threadIdx.x; i < grid.cells * grid.n; i += kThreads) {
      int const c = i / grid.n;
      pooling[i] = grid.template pooling<F>(c, i - c * grid.n);
    }
    __syncthreads();
    for_each_pixel(grid.n, [&](int i, int y, int x) {
      auto const polar = to_polar(patch_gradient(central_differences<F>(), patch.around(y, x)), F(kSiftEpsilon));
      F const position = polar.angle * (F(grid.bins) / F(2 * kPi));
      magnitudes[i] = polar.magnitude, positions[i] = position < 0 ? position + F(grid.bins) : position;
    });
    __syncthreads();
    for (int i = threadIdx.x; i < grid.size(); i += kThreads) {
      int const row = i / grid.cells, cx = i - row * grid.cells, cy = row / grid.bins, a = row - cy * grid.bins;
      int const x0 = grid.first(cx), x1 = grid.end(cx), y1 = grid.end(cy);
      F total = 0;
      for (int y = grid.first(cy); y < y1; ++y) {
        F sum = 0;
#pragma unroll 4
        for (int x = x0; x < x1; ++x) {
          F const apart = ::fabs(positions[y * grid.n + x] - F(a)), around = min(apart, F(grid.bins) - apart);
          sum += pooling[cx * grid.n + x] * magnitudes[y * grid.n + x] * max(1 - around, F(0));
        }
        total += pooling[cy * grid.n + y] * sum;
      }
      h[i] = total;
    }
  }
};

extern __shared__ double shared_memory[];

template <class T>
__global__ void __launch_bounds__(kThreads) sift_patch(__grid_constant__ Sift<T> const p) {
  using F = Compute<T>;
  __shared__ F sums[kThreads / 32];
  int64_t const k = blockIdx.x;
  SiftPatch<F> s(p.grid, reinterpret_cast<F*>(shared_memory));
  s.fill_histogram(p.patches + k * p.grid.n * p.grid.n);
  Entries<F> const all{p.grid.size(), sums};
  normalize_sift(s.h, p.clip, p.root, all);
  all.each([&](int i) { p.descriptors[k * all.size + p.grid.position(i)] = round_to<T>(s.h[i]); });
}

template <class T>
__global__ void __launch_bounds__(kThreads) sift_patch_backward(__grid_constant__ SiftBackward<T> const p) {
  using F = Compute<T>;
  __shared__ F sums[kThreads / 32];
  int64_t const k = blockIdx.x;
  int const n = p.grid.n, cells = p.grid.cells, bins = p.grid.bins;
  SiftPatch<F> s(p.grid, reinterpret_cast<F*>(shared_memory));
  s.fill_histogram(p.patches + k * n * n);
  Entries<F> const all{p.grid.size(), sums};
  F* const g = s.h + all.size;
  all.each([&](int i) { g[i] = read(p.grad[k * all.size + p.grid.position(i)]); });
  normalize_sift_vjp(s.h, g, p.clip, p.root, all);
  __syncthreads();

  // The gradients of a pixel replace its magnitude and its position.
  F const per_radian = F(bins) / F(2 * kPi);
  SharedPatch<F> const u{s.magnitudes, n}, v{s.positions, n};
  for_each_pixel(n, [&](int i, int y, int x) {
    F const m = s.magnitudes[i], position = s.positions[i];
    int const whole = int(position), first = whole >= bins ? whole - bins : whole;
    int const second = first + 1 == bins ? 0 : first + 1;
    F const t = position - F(whole);
    F grad_magnitude = 0, grad_position = 0;
    for (int cy = 0; cy < cells; ++cy) {
      F const weight_y = s.pooling[cy * n + y];
      if (weight_y == 0) continue;
      F const* const a = g + (cy * bins + first) * cells;
      F const* const b = g + (cy * bins + second) * cells;
      for (int cx = 0; cx < cells; ++cx) {
        F const weight = weight_y * s.pooling[cx * n + x];
        if (weight == 0) continue;
        F const difference = weight * (b[cx] - a[cx]);
        grad_magnitude += weight * a[cx] + t * difference;
        grad_position += difference;
      }
    }
    auto const gradient = patch_gradient(central_differences<F>(), s.patch.around(y, x));
    auto const back = to_polar_vjp(gradient, m, grad_magnitude, grad_position * m * per_radian);
    u.data[i] = back.x, v.data[i] = back.y;
  });
  __syncthreads();
  write_patch_gradient(p.grad_patches + k * n * n, central_differences<F>(), u, v);
}

}  // namespace

template <class T>
int sift(Sift<T> const& p, CUstream_st* stream) {
  size_t const bytes = SiftPatch<Compute<T>>::bytes(p.grid, false);
  if (int const error = allow_shared(sift_patch<T>, bytes)) return error;
  sift_patch<<<unsigned(p.count), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int sift_backward(SiftBackward<T> const& p, CUstream_st* stream) {
  size_t const bytes = SiftPatch<Compute<T>>::bytes(p.grid, true);
  if (int const error = allow_shared(sift_patch_backward<T>, bytes)) return error;
  sift_patch_backward<<<unsigned(p.count), kThreads, bytes, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(sift, Sift)
KV_INSTANTIATE(sift_backward, SiftBackward)

}  // namespace kv::feature::cuda
