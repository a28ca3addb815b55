// Patches on CUDA: a thread copies a pack of a patch's row, or sums one of the image's.
#include "core/launch.cuh"
#include "patches.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;

template <class T, int P>
__global__ void __launch_bounds__(kThreads) extract(__grid_constant__ Extract<T> const p, int64_t rows) {
  PatchGrid const& grid = p.grid;
  int const packs = grid.width / P;
  int64_t const at = blockIdx.x * int64_t(kThreads) + threadIdx.x, row = at / packs;
  if (row >= rows) return;
  int const x = int(at - row * packs) * P;
  int64_t const q = row / grid.height, patch = q / grid.channels, line = patch / grid.across, sample = line / grid.down;
  int const j = int(patch - line * grid.across), i = int(line - sample * grid.down);
  int const y = i * grid.step_y - grid.top + int(row - q * grid.height), column = j * grid.step_x - grid.left + x;
  Pack<T, P> pack{};
  if (y >= 0 && y < p.image.height) {
    T const* const from = p.image.row(sample * grid.channels + (q - patch * grid.channels), y);
    if (column >= 0 && column < p.image.width) pack = *reinterpret_cast<Pack<T, P> const*>(from + column);
  }
  *reinterpret_cast<Pack<T, P>*>(p.patches + row * grid.width + x) = pack;
}

template <class T, int P>
__global__ void __launch_bounds__(kThreads) combine(__grid_constant__ Combine<T> const p) {
  using F = Compute<T>;
  PatchGrid const& grid = p.grid;
  int const packs = int(p.image.width) / P;
  int64_t const at = blockIdx.x * int64_t(kThreads) + threadIdx.x, row = at / packs;
  if (row >= p.image.rows()) return;
  int64_t const plane = row / p.image.height;
  int const x = int(at - row * packs) * P, y = int(row - plane * p.image.height);
  int const right = x + grid.left, below = y + grid.top;
  int const last_i = PatchGrid::last(below, grid.step_y, grid.down);
  int const last_j = PatchGrid::last(right, grid.step_x, grid.across);
  F sums[P] = {};
  for (int i = PatchGrid::first(below, grid.height, grid.step_y); i <= last_i; ++i)
    for (int j = PatchGrid::first(right, grid.width, grid.step_x); j <= last_j; ++j) {
      T const* const from = p.patches + grid.row(plane, i, j, y) * grid.width + right - j * grid.step_x;
      Pack<T, P> const pack = *reinterpret_cast<Pack<T, P> const*>(from);
#pragma unroll
      for (int k = 0; k < P; ++k) sums[k] += read(pack.v[k]);
    }
  store_pack(p.image.row(plane, y) + x, sums);
}

// Calls f with the pixels of a pack: those of 16 bytes where each is in the same patches as a whole, else one.
template <class T, class F>
void with_packs(Planes<T> const& image, void const* patches, PatchGrid const& grid, F f) {
  constexpr int P = 16 / int(sizeof(T));
  bool const packed = is_strip<P>(image) && reinterpret_cast<uintptr_t>(patches) % 16 == 0 && grid.width % P == 0 &&
                      grid.step_x % P == 0 && grid.left % P == 0;
  if (packed)
    f(std::integral_constant<int, P>{});
  else
    f(std::integral_constant<int, 1>{});
}

}  // namespace

template <class T>
int extract_patches(Extract<T> const& p, CUstream_st* stream) {
  int64_t const rows = p.image.count() * p.grid.down * p.grid.across * p.grid.height;
  with_packs(p.image, p.patches, p.grid, [&](auto pixels) {
    constexpr int P = decltype(pixels)::value;
    unsigned const blocks = unsigned(ceil_div(rows * (p.grid.width / P), kThreads));
    extract<T, P><<<blocks, kThreads, 0, stream>>>(p, rows);
  });
  return cudaGetLastError();
}

template <class T>
int combine_patches(Combine<T> const& p, CUstream_st* stream) {
  with_packs(p.image, p.patches, p.grid, [&](auto pixels) {
    constexpr int P = decltype(pixels)::value;
    unsigned const blocks = unsigned(ceil_div(p.image.rows() * (p.image.width / P), kThreads));
    combine<T, P><<<blocks, kThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(extract_patches, Extract)
KV_INSTANTIATE(combine_patches, Combine)

}  // namespace kv::cuda
