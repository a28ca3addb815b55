// Bilateral blur on CUDA; see bilateral.cuh.
#include "bilateral.cuh"

namespace kv::filters::cuda {
namespace {

// Pixels of a thread, and blocks on a multiprocessor at once: of windows that are known at compile time, whose code for
// a run is small, fewer pixels and more blocks.
constexpr int run_of(int reach) { return reach > 0 ? 4 : 8; }
constexpr int blocks_of(int reach) { return reach > 0 ? 5 : 3; }

template <class T, int C, bool L1, int R>
__global__ void __launch_bounds__(kThreads, blocks_of(R)) bilateral_tile(Bilateral<T> p, Tiles<run_of(R)> tiles) {
  constexpr int kRun = run_of(R);
  extern __shared__ float memory[];
  int const ry = R > 0 ? R : p.ky / 2, rx = R > 0 ? R : p.kx / 2;
  int64_t b;
  int y0, x0;
  tiles.locate(b, y0, x0);
  SharedPlanes const s{memory, y0 - ry, x0 - rx, rows_of(kRun) + 2 * ry, kColumns + 2 * rx};
  Falloff<float> const falloff = p.sigma.at(b);
  float const scale = sqrtf(falloff.color);
  load_planes<C>(s, p.x, b, p.border, rx, scale);
  __syncthreads();

  int const x = x0 + threadIdx.x % kColumns, y = y0 + threadIdx.x / kColumns * kRun;
  float sum[kRun][C], total[kRun];
  sum_run<C, L1, R>(s, ry, rx, falloff, y, x, sum, total);
  if (x >= p.x.width) return;
  T* out = p.y.row(b, 0, y) + x * p.y.step;
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    if (y + i >= p.x.height) return;
    if (p.totals.channels > 0) p.totals.row(b, 0, y + i)[x * p.totals.step] = round_to<T>(total[i]);
    float const inverse = __fdividef(1.f, total[i] * scale);
#pragma unroll
    for (int c = 0; c < C; ++c) out[c * p.y.channel_stride] = round_to<T>(sum[i][c] * inverse);
    out += p.y.row_stride;
  }
}

// One thread for each pixel and chunk of channels.
template <class T, bool Joint>
__global__ void bilateral_any(Bilateral<T> p) {
  using F = Compute<T>;
  int64_t const width = p.x.width, height = p.x.height, chunks = ceil_div(p.x.channels, kChunk);
  int64_t const i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x;
  if (i >= p.x.batch * chunks * height * width) return;
  int const x = int(i % width), y = int(i / width % height), c = int(i / (width * height) % chunks) * kChunk;
  int64_t const b = i / (width * height * chunks);
  F sum[kChunk];
  F const total = sum_window<Joint>(p, p.sigma.at(b), b, c, y, x, sum);
  if (c == 0 && p.totals.channels > 0) p.totals.row(b, 0, y)[x * p.totals.step] = round_to<T>(total);
#pragma unroll
  for (int k = 0; k < kChunk; ++k)
    if (c + k < p.x.channels) p.y.row(b, c + k, y)[x * p.y.step] = round_to<T>(sum[k] / total);
}

// False where the tile does not fit into shared memory.
template <int C, bool L1, int R, class T>
bool launch_tile(Bilateral<T> const& p, CUstream_st* stream) {
  constexpr int kRun = run_of(R);
  auto const kernel = bilateral_tile<T, C, L1, R>;
  int64_t const bytes = C * int64_t(rows_of(kRun) + p.ky - 1) * (kColumns + p.kx - 1) * sizeof(float);
  if (!fits(kernel, bytes)) return false;
  Tiles<kRun> const tiles(p.x.batch, p.x.height, p.x.width);
  kernel<<<tiles.count, kThreads, bytes, stream>>>(p, tiles);
  return true;
}
template <int C, bool L1, class T>
bool launch_tile(Bilateral<T> const& p, CUstream_st* stream) {
  // Special case, H200: 1.95 (bilateral5) to 2.2 (bilateral5gray) times as fast as any window in tiles.
  return p.ky == 5 && p.kx == 5 ? launch_tile<C, L1, 2>(p, stream) : launch_tile<C, L1, 0>(p, stream);
}
template <class T>
bool launch_tile(Bilateral<T> const& p, CUstream_st* stream) {
  // Special case, H200: 8.0 (bilateral7) to 17 (bilateral5gray) times as fast as a thread a pixel.
  if (p.joint) return false;
  if (p.x.channels == 1) return launch_tile<1, false>(p, stream);
  if (p.x.channels == 3) return p.l1 ? launch_tile<3, true>(p, stream) : launch_tile<3, false>(p, stream);
  return false;
}

}  // namespace

template <class T>
int bilateral_blur(Bilateral<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(Compute<T>) == 4)
    if (launch_tile(p, stream)) return cudaGetLastError();
  int64_t const pixels = p.x.batch * p.x.height * p.x.width, chunks = ceil_div(p.x.channels, kChunk);
  unsigned const blocks = unsigned(ceil_div(pixels * chunks, kThreads));
  if (p.joint)
    bilateral_any<T, true><<<blocks, kThreads, 0, stream>>>(p);
  else
    bilateral_any<T, false><<<blocks, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(bilateral_blur, Bilateral)

}  // namespace kv::filters::cuda
