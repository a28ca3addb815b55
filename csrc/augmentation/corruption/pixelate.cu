// Images of blocks on CUDA: a block of threads has some rows of a plane, and each of its warps a row of blocks after
// the other. It sums the rows of pixels that these read, then the columns of these sums, and shows the results in all
// rows.
#include "augmentation/corruption/pixelate.h"
#include "core/launch.cuh"
#include "core/stencils/filter_list.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kPixelateWarps = 8, kPixelateRows = 32;
constexpr size_t kPixelateBytes = 48 << 10;  // of shared memory, unless one warp needs more

// Some rows of the plane of a block of threads, of `parts` blocks for each plane. Vectorized: rows are whole vectors
// of four elements.
template <bool Vectorized, class T>
__device__ __forceinline__ void show_blocks(Pixelate<T> const& p, unsigned block_of_threads, unsigned parts) {
  using F = Compute<T>;
  constexpr int P = Vectorized ? 4 : 1;
  extern __shared__ __align__(16) char shared[];
  int const step = int(p.x.step), size = int(p.x.row_size()), warps = int(blockDim.x) / 32,
            warp = int(threadIdx.x) / 32, lane = int(threadIdx.x) % 32;
  F* const sums = reinterpret_cast<F*>(shared) + warp * size;
  // Of a row's elements, those of a row of blocks that they show; of a row's blocks, the pixels [begin, end) that they
  // read.
  uint16_t* const shown = reinterpret_cast<uint16_t*>(reinterpret_cast<F*>(shared) + warps * size);
  uint16_t *const begins = shown + size, *const ends = begins + p.x.width;
  int64_t const plane = block_of_threads / parts, b = plane / p.planes_per_sample;
  int const top = int(block_of_threads % parts) * kPixelateRows, bottom = min(top + kPixelateRows, int(p.y.height));
  BlockAxis const down = p.down(b), across = p.across(b);
  for (int i = int(threadIdx.x); i < size; i += int(blockDim.x)) {
    int const x = step == 1 ? i : i / step;
    shown[i] = uint16_t(int(across.block(x)) * step + i - x * step);
    if (i < int(across.count)) {
      BlockPixels const columns(across, i);
      begins[i] = uint16_t(columns.begin), ends[i] = uint16_t(columns.end);
    }
  }
  __syncthreads();
  unsigned const first = down.block(top);
  for (int y = top, next; y < bottom; y = next) {
    unsigned const block = down.block(y);
    for (next = y + 1; next < bottom && down.block(next) == block;) ++next;
    if (int((block - first) % unsigned(warps)) != warp) continue;
    BlockPixels const rows(down, block);
    __syncwarp();  // before other sums are overwritten
    for (int i = P * lane; i < size; i += 32 * P) {
      F sum[P] = {};
      for (unsigned row = rows.begin; row < rows.end; ++row) {
        F const weight = rows.weight(row);
        auto const v = *reinterpret_cast<Vector<T, P> const*>(p.x.row(plane, row) + i);
#pragma unroll
        for (int j = 0; j < P; ++j) sum[j] += weight * F(read(v.v[j]));
      }
#pragma unroll
      for (int j = 0; j < P; ++j) sums[i + j] = sum[j] / F(rows.total);
    }
    // Blocks overwrite sums that no later ones read.
    for (int first_block = 0; first_block < int(across.count) * step; first_block += 32) {
      int const i = first_block + lane, own = step == 1 ? i : i / step, channel = i - own * step;
      F sum = 0;
      __syncwarp();
      if (own < int(across.count)) {
        BlockPixels const columns(across, own, begins[own], ends[own]);
        for (unsigned x = columns.begin; x < columns.end; ++x)
          sum += F(columns.weight(x)) * sums[int(x) * step + channel];
        sum /= F(columns.total);
      }
      __syncwarp();
      if (own < int(across.count)) sums[i] = sum;
    }
    __syncwarp();
    for (int i = P * lane; i < size; i += 32 * P) {
      F value[P];
#pragma unroll
      for (int j = 0; j < P; ++j) value[j] = sums[shown[i + j]];
      for (int row = y; row < next; ++row) store_vector(p.y.row(plane, row) + i, value);
    }
  }
}

// Whether rows are whole vectors of four elements; a row of a channels-last image has all channels of its pixels.
template <class T>
KV_HD bool has_whole_rows(Planes<T> const& p) {
  constexpr int64_t bytes = alignof(Vector<std::remove_const_t<T>, 4>), size = sizeof(T);
  return reinterpret_cast<uintptr_t>(p.data) % bytes == 0 && p.outer_stride * size % bytes == 0 &&
         p.inner_stride * size % bytes == 0 && p.row_stride * size % bytes == 0 && p.row_size() % 4 == 0;
}

template <class T>
KV_HD unsigned parts_of(Pixelate<T> const& p) {
  return unsigned(ceil_div(p.y.height, int64_t(kPixelateRows)));
}

template <class T, bool Vectorized>
__global__ void __launch_bounds__(32 * kPixelateWarps) pixelate_batch(__grid_constant__ Pixelate<T> const p) {
  show_blocks<Vectorized>(p, blockIdx.x, parts_of(p));
}

template <class T>
__global__ void __launch_bounds__(32 * kPixelateWarps) pixelate_images(__grid_constant__ PixelateList<T> const p) {
  unsigned block;
  Pixelate<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  if (has_whole_rows(one->x) && has_whole_rows(one->y))
    show_blocks<true>(*one, block, parts_of(*one));
  else
    show_blocks<false>(*one, block, parts_of(*one));
}

// launch(threads of a block, bytes of its shared memory) for rows of so many elements and pixels at most.
template <class T, class Kernel, class Launch>
int with_memory_of_rows(int64_t elements, int64_t pixels, Kernel* kernel, Launch launch) {
  size_t const of_warp = size_t(elements) * sizeof(Compute<T>), of_all = 2 * size_t(elements + 2 * pixels);
  int const warps =
      of_all + of_warp < kPixelateBytes ? int(min((kPixelateBytes - of_all) / of_warp, size_t(kPixelateWarps))) : 1;
  size_t const bytes = of_all + size_t(warps) * of_warp;
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch(unsigned(32 * warps), bytes);
}

template <class T>
int launch_pixelate(Pixelate<T> const& p, auto vectorized, CUstream_st* stream) {
  auto* const kernel = pixelate_batch<T, vectorized.value>;
  return with_memory_of_rows<T>(p.x.row_size(), p.x.width, kernel, [&](unsigned threads, size_t bytes) {
    kernel<<<unsigned(p.y.count()) * parts_of(p), threads, bytes, stream>>>(p);
    return int(cudaGetLastError());
  });
}

}  // namespace

template <class T>
int pixelate(Pixelate<T> const& p, CUstream_st* stream) {
  int error = 0;
  with_alignment<T>(has_whole_rows(p.x) && has_whole_rows(p.y),
                    [&](auto vectorized) { error = launch_pixelate(p, vectorized, stream); });
  return error;
}

template <class T>
int pixelate_list(PixelateList<T> const& p, CUstream_st* stream) {
  int64_t elements = 1, pixels = 1;
  for (int b = 0; b < p.list.count; ++b) {
    Pixelate<T> const one = p.sample(b);
    elements = max(elements, one.x.row_size()), pixels = max(pixels, one.x.width);
  }
  auto* const kernel = pixelate_images<T>;
  return with_memory_of_rows<T>(elements, pixels, kernel, [&](unsigned threads, size_t bytes) {
    return launch_list(
        p, [](Pixelate<T> const& one) { return one.y.count() * parts_of(one); },
        [&](PixelateList<T> const& list, unsigned blocks) { kernel<<<blocks, threads, bytes, stream>>>(list); });
  });
}

KV_INSTANTIATE_WITH_BYTES(pixelate, Pixelate)
KV_INSTANTIATE_WITH_BYTES(pixelate_list, PixelateList)

}  // namespace kv::augmentation::cuda
