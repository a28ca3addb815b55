// The gradient to the kernel of a cross-correlation on CUDA: partial sums, and the sums of these.
#include "filter2d_tile.cuh"

namespace kv::filters::cuda {
namespace {

// Sums each of eight numbers over the threads of a warp. Thread i returns sum i % 8.
__device__ __forceinline__ float warp_sums(float (&v)[8]) {
#pragma unroll
  for (int n = 4; n > 0; n /= 2) {
    bool const upper = threadIdx.x & n;
#pragma unroll
    for (int i = 0; i < n; ++i) {
      float const sent = upper ? v[i] : v[i + n];
      v[i] = (upper ? v[i + n] : v[i]) + shuffle_xor(sent, n);
    }
  }
  return warp_reduce<32, 8>(v[0], Sum());
}

// One block for each part. It goes through the tiles of the gradient, whose pixels it has in registers, and reads the
// rows of the image from shared memory: each is multiplied for N rows of the kernel at once.
template <class T, int N>
__global__ void __launch_bounds__(kThreads, 3)
    kernel_backward_tile(__grid_constant__ Filter2dKernelBackward<T> const p, __grid_constant__ Tiles const tiles) {
  extern __shared__ __align__(16) float shared[];
  int const kx = p.axis_x.size, ky = p.axis_y.size, taps = kx * ky, lane = threadIdx.x % 32, warp = threadIdx.x / 32;
  float *const tile = shared, *const sums = tile + tiles.rows * tiles.pitch, *const warp_totals = sums + warp * taps;
  int* const sources = reinterpret_cast<int*>(sums + kWarps * taps);
  for (int i = threadIdx.x; i < kWarps * taps; i += kThreads) sums[i] = 0;

  int64_t const part = blockIdx.x, plane = part / p.parts_down(), first = (part - plane * p.parts_down()) * p.part_rows;
  int const last = int(min(first + p.part_rows, p.grad.height)), width = int(p.grad.width);
  int const step = int(p.grad.step), columns = step * tiles.across;
  for (int y0 = int(first); y0 < last; y0 += kHeight) {
    for (int i = 0; i < columns; ++i) {
      int const x0 = i / step * kWidth, channel = i % step, y = y0 + warp * kDown;
      float g[kDown][kAcross];
#pragma unroll
      for (int o = 0; o < kDown; ++o)
#pragma unroll
        for (int c = 0; c < kAcross; ++c) {
          int const x = x0 + 32 * c + lane;
          g[o][c] = y + o < last && x < width ? read(p.grad.row(plane, y + o)[int64_t(x) * step + channel]) : 0.f;
        }
      __syncthreads();  // all threads have finished the previous tile
      load_tile(tile, sources, tiles, p.x, plane, channel, p.border, x0, y0 - p.axis_y.before);

      float const* const window = tile + tiles.lead - p.axis_x.before + lane;
      auto const add = [&](auto whole) {
        for (int first_tap = 0; first_tap < ky; first_tap += N)
          for (int x = 0; x < kx; ++x) {
            float const* row = window + (warp * kDown + first_tap) * tiles.pitch + x;
            float products[8] = {};
#pragma unroll
            for (int r = 0; r < kDown + N - 1; ++r, row += tiles.pitch)
#pragma unroll
              for (int c = 0; c < kAcross; ++c) {
                float const v = row[32 * c];
#pragma unroll
                for (int k = 0; k < N; ++k) {
                  int const o = r - k;
                  if (o < 0 || o >= kDown) continue;
                  // Out of the gradient's bounds pixels do not count, even if they are NaN.
                  bool const inside = decltype(whole)::value || (y + o < last && x0 + 32 * c + lane < width);
                  products[k] += inside ? g[o][c] * v : 0.f;
                }
              }
            float const sum = warp_sums(products);
            if (lane < N && first_tap + lane < ky) warp_totals[(first_tap + lane) * kx + x] += sum;
          }
      };
      if (y0 + kHeight <= last && x0 + kWidth <= width)
        add(std::true_type{});
      else
        add(std::false_type{});
    }
  }
  __syncthreads();
  for (int i = threadIdx.x; i < taps; i += kThreads)
    p.parts[part * taps + i] = (sums[i] + sums[taps + i]) + (sums[2 * taps + i] + sums[3 * taps + i]);
}

template <int N, class T>
int launch_tiles(Filter2dKernelBackward<T> const& p, Tiles const& tiles, CUstream_st* stream) {
  int64_t const bytes = tiles.bytes(kWarps * p.taps());
  auto const kernel = kernel_backward_tile<T, N>;
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  kernel<<<unsigned(p.count()), kThreads, bytes, stream>>>(p, tiles);
  return cudaGetLastError();
}

constexpr int kTapsPerThread = 8;  // of a thread, which reads the gradient once for all of them

// Any size and type: one block for each part and group of taps.
template <class T>
__global__ void __launch_bounds__(256)
    kernel_backward_any(__grid_constant__ Filter2dKernelBackward<T> const p, int groups) {
  using F = Compute<T>;
  int64_t const part = blockIdx.x / groups;
  int const first_tap = int(blockIdx.x - part * groups) * kTapsPerThread, taps = p.taps();
  int64_t const plane = part / p.parts_down(), first = (part - plane * p.parts_down()) * p.part_rows;
  int64_t const size = p.grad.row_size(), step = p.x.step, count = min(p.part_rows, p.grad.height - first) * size;
  int const z = int(plane % p.depth);
  F sums[kTapsPerThread] = {};
  for (int64_t i = threadIdx.x; i < count; i += 256) {
    int64_t const row = i / size, e = i - row * size, x = e / step, channel = e - x * step;
    F const g = read(p.grad.row(plane, first + row)[e]);
#pragma unroll
    for (int t = 0; t < kTapsPerThread; ++t) {
      int const tap = first_tap + t, line = tap / p.axis_x.size;
      if (tap >= taps) break;
      int const kx = tap % p.axis_x.size, ky = line % p.axis_y.size, kz = line / p.axis_y.size;
      int const from_x = border_index(p.border, int(x) + kx - p.axis_x.before, int(p.x.width)),
                from_y = border_index(p.border, int(first + row) + ky - p.axis_y.before, int(p.x.height)),
                from_z = border_index(p.border, z + kz - p.axis_z.before, p.depth);
      if (from_x >= 0 && from_y >= 0 && from_z >= 0)
        sums[t] += g * read(p.x.row(plane - z + from_z, from_y)[from_x * step + channel]);
    }
  }
  __shared__ F warp_totals[kTapsPerThread][8];
#pragma unroll
  for (int t = 0; t < kTapsPerThread; ++t) {
    sums[t] = warp_reduce(sums[t], Sum());
    if (threadIdx.x % 32 == 0) warp_totals[t][threadIdx.x / 32] = sums[t];
  }
  __syncthreads();
  if (threadIdx.x < kTapsPerThread && first_tap + int(threadIdx.x) < taps) {
    F sum = 0;
    for (int warp = 0; warp < 8; ++warp) sum += warp_totals[threadIdx.x][warp];
    p.parts[part * taps + first_tap + threadIdx.x] = sum;
  }
}

// One warp for each sum.
template <class F>
__global__ void sum_partials_kernel(SumPartials<F> p) {
  int64_t const i = int64_t(blockIdx.x) * 8 + threadIdx.x / 32;
  if (i >= p.count) return;
  F const* const terms = p.terms + i / p.size * p.parts * p.size + i % p.size;
  double sum = 0;
  for (int64_t part = threadIdx.x % 32; part < p.parts; part += 32) sum += terms[part * p.size];
  sum = warp_reduce(sum, Sum());
  if (threadIdx.x % 32 == 0) p.sums[i] = F(sum);
}

}  // namespace

template <class T>
int filter2d_kernel_backward(Filter2dKernelBackward<T> const& p, CUstream_st* stream) {
  if constexpr (!__is_same(T, double)) {
    // Special case, H200: 1.09 to 1.10 times as fast as groups of eight rows.
    int const kernel_rows = p.axis_y.size <= 5 ? 5 : 8;  // rows of the kernel; the last group may have fewer
    Tiles const tiles(p.x, p.grad, p.axis_x.before, p.axis_x.size - 1 - p.axis_x.before,
                      int(ceil_div(p.axis_y.size, kernel_rows)) * kernel_rows - 1);
    // Special case, H200: 12 (filter2d kernel b backward) to 33 (filter2d kernel11 b backward) times as fast as a
    // thread for some taps.
    if (p.axis_z.size == 1 && tiles.bytes(kWarps * p.taps()) <= max_shared_bytes(kMaxSharedBytes))
      return kernel_rows == 5 ? launch_tiles<5>(p, tiles, stream) : launch_tiles<8>(p, tiles, stream);
  }
  int const groups = int(ceil_div(p.taps(), kTapsPerThread));
  kernel_backward_any<<<unsigned(p.count() * groups), 256, 0, stream>>>(p, groups);
  return cudaGetLastError();
}

template <class F>
int sum_partials(SumPartials<F> const& p, CUstream_st* stream) {
  sum_partials_kernel<<<unsigned(ceil_div(p.count, 8)), 256, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE(filter2d_kernel_backward, Filter2dKernelBackward)
KV_INSTANTIATE_COMPUTED(sum_partials, SumPartials)

}  // namespace kv::filters::cuda
