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

// The transpose: some rows of gradients. A warp has rows whose first reader is the same row of blocks, of which it sums
// what that one and the next one show.
template <bool Vectorized, class T>
__device__ __forceinline__ void show_gradients(Pixelate<T> const& p, unsigned block_of_threads, unsigned parts) {
  using F = Compute<T>;
  constexpr int P = Vectorized ? 4 : 1;
  extern __shared__ __align__(16) char shared[];
  int const step = int(p.x.step), size = int(p.x.row_size()), width = int(p.x.width), warps = int(blockDim.x) / 32,
            warp = int(threadIdx.x) / 32, lane = int(threadIdx.x) % 32;
  F* const sums = reinterpret_cast<F*>(shared) + 2 * warp * size;  // of two rows of blocks
  // Of a row's elements, where sums of their first readers begin; of a row's blocks, the first pixels that show them.
  uint16_t* const readers = reinterpret_cast<uint16_t*>(reinterpret_cast<F*>(shared) + 2 * warps * size);
  uint16_t* const begins = readers + size;
  int64_t const plane = block_of_threads / parts, b = plane / p.planes_per_sample;
  int const top = int(block_of_threads % parts) * kPixelateRows, bottom = min(top + kPixelateRows, int(p.y.height));
  BlockAxis const down = p.down(b), across = p.across(b);
  for (int i = int(threadIdx.x); i < size; i += int(blockDim.x)) {
    int const x = step == 1 ? i : i / step;
    readers[i] = uint16_t(int(across.first_reader(x)) * step + i - x * step);
    if (i < int(across.count)) begins[i] = uint16_t(across.first_shown(i));
  }
  if (threadIdx.x == 0) begins[across.count] = uint16_t(width);
  __syncthreads();
  auto const sum_shown = [&](unsigned block, F* to) {
    unsigned const first_row = down.first_shown(block), last_row = down.first_shown(block + 1);
    F const total = F(BlockPixels(down, block).total);
    __syncwarp();  // before other sums are overwritten
    for (int i = P * lane; i < size; i += 32 * P) {
      F sum[P] = {};
      for (unsigned row = first_row; row < last_row; ++row) {
        auto const v = *reinterpret_cast<Vector<T, P> const*>(p.x.row(plane, row) + i);
#pragma unroll
        for (int j = 0; j < P; ++j) sum[j] += F(read(v.v[j]));
      }
#pragma unroll
      for (int j = 0; j < P; ++j) to[i + j] = sum[j];
    }
    // Blocks overwrite sums that no later ones read.
    for (int first_block = 0; first_block < int(across.count) * step; first_block += 32) {
      int const i = first_block + lane, own = step == 1 ? i : i / step, channel = i - own * step;
      F sum = 0;
      __syncwarp();
      if (own < int(across.count)) {
        for (int x = begins[own]; x < int(begins[own + 1]); ++x) sum += to[x * step + channel];
        sum /= total * F(BlockPixels(across, own).total);
      }
      __syncwarp();
      if (own < int(across.count)) to[i] = sum;
    }
    __syncwarp();
  };
  unsigned const first = down.first_reader(top);
  for (int y = top, next; y < bottom; y = next) {
    unsigned const reader = down.first_reader(y);
    for (next = y + 1; next < bottom && down.first_reader(next) == reader;) ++next;
    if (int((reader - first) % unsigned(warps)) != warp) continue;
    bool is_read[2] = {};
    for (int row = y; row < next; ++row) {
      ReaderWeights const own(down, row, reader);
      is_read[0] = is_read[0] || own.v[0] != 0, is_read[1] = is_read[1] || own.v[1] != 0;
    }
    if (is_read[0]) sum_shown(reader, sums);
    if (is_read[1]) sum_shown(reader + 1, sums + size);
    for (int i = P * lane; i < size; i += 32 * P) {
      F of_reader[2][P] = {};  // of both rows of blocks
#pragma unroll
      for (int j = 0; j < P; ++j) {
        int const at = readers[i + j], x = step == 1 ? i + j : (i + j) / step;
        ReaderWeights const weights(across, x, step == 1 ? at : at / step);
#pragma unroll
        for (int k = 0; k < 2; ++k) {
          if (is_read[k] && weights.v[0] != 0) of_reader[k][j] = F(weights.v[0]) * sums[k * size + at];
          if (is_read[k] && weights.v[1] != 0) of_reader[k][j] += F(weights.v[1]) * sums[k * size + at + step];
        }
      }
      for (int row = y; row < next; ++row) {
        ReaderWeights const own(down, row, reader);
        F value[P];
#pragma unroll
        for (int j = 0; j < P; ++j) {
          value[j] = own.v[0] != 0 ? F(own.v[0]) * of_reader[0][j] : F(0);
          if (own.v[1] != 0) value[j] += F(own.v[1]) * of_reader[1][j];
        }
        store_vector(p.y.row(plane, row) + i, value);
      }
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

template <bool Backward, bool Vectorized, class T>
__device__ __forceinline__ void show(Pixelate<T> const& p, unsigned block) {
  if constexpr (Backward)
    show_gradients<Vectorized>(p, block, parts_of(p));
  else
    show_blocks<Vectorized>(p, block, parts_of(p));
}

template <bool Backward, class T, bool Vectorized>
__global__ void __launch_bounds__(32 * kPixelateWarps) pixelate_batch(__grid_constant__ Pixelate<T> const p) {
  show<Backward, Vectorized>(p, blockIdx.x);
}

template <bool Backward, class T>
__global__ void __launch_bounds__(32 * kPixelateWarps) pixelate_images(__grid_constant__ PixelateList<T> const p) {
  unsigned block;
  Pixelate<T> const* const one = sample_of_block(p, block);
  if (!one) return;
  if (has_whole_rows(one->x) && has_whole_rows(one->y))
    show<Backward, true>(*one, block);
  else
    show<Backward, false>(*one, block);
}

// launch(threads of a block, bytes of its shared memory) for rows of so many elements and pixels at most. A warp has a
// row of sums, or two of gradients.
template <bool Backward, class T, class Kernel, class Launch>
int with_memory_of_rows(int64_t elements, int64_t pixels, Kernel* kernel, Launch launch) {
  size_t const of_warp = (Backward ? 2 : 1) * size_t(elements) * sizeof(Compute<T>),
               of_all = 2 * size_t(elements + 2 * pixels);
  int const warps =
      of_all + of_warp < kPixelateBytes ? int(min((kPixelateBytes - of_all) / of_warp, size_t(kPixelateWarps))) : 1;
  size_t const bytes = of_all + size_t(warps) * of_warp;
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch(unsigned(32 * warps), bytes);
}

template <bool Backward, class T>
int launch_pixelate(Pixelate<T> const& p, CUstream_st* stream) {
  int error = 0;
  with_alignment<T>(has_whole_rows(p.x) && has_whole_rows(p.y), [&](auto vectorized) {
    auto* const kernel = pixelate_batch<Backward, T, vectorized.value>;
    error = with_memory_of_rows<Backward, T>(p.x.row_size(), p.x.width, kernel, [&](unsigned threads, size_t bytes) {
      kernel<<<unsigned(p.y.count()) * parts_of(p), threads, bytes, stream>>>(p);
      return int(cudaGetLastError());
    });
  });
  return error;
}

template <bool Backward, class T>
int launch_pixelate_list(PixelateList<T> const& p, CUstream_st* stream) {
  int64_t elements = 1, pixels = 1;
  for (int b = 0; b < p.list.count; ++b) {
    Pixelate<T> const one = p.sample(b);
    elements = max(elements, one.x.row_size()), pixels = max(pixels, one.x.width);
  }
  auto* const kernel = pixelate_images<Backward, T>;
  return with_memory_of_rows<Backward, T>(elements, pixels, kernel, [&](unsigned threads, size_t bytes) {
    return launch_list(
        p, [](Pixelate<T> const& one) { return one.y.count() * parts_of(one); },
        [&](PixelateList<T> const& list, unsigned blocks) { kernel<<<blocks, threads, bytes, stream>>>(list); });
  });
}

}  // namespace

template <class T>
int pixelate(Pixelate<T> const& p, CUstream_st* stream) {
  return launch_pixelate<false>(p, stream);
}
template <class T>
int pixelate_list(PixelateList<T> const& p, CUstream_st* stream) {
  return launch_pixelate_list<false>(p, stream);
}
template <class T>
int pixelate_backward(Pixelate<T> const& p, CUstream_st* stream) {
  return launch_pixelate<true>(p, stream);
}
template <class T>
int pixelate_backward_list(PixelateList<T> const& p, CUstream_st* stream) {
  return launch_pixelate_list<true>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(pixelate, Pixelate)
KV_INSTANTIATE_WITH_BYTES(pixelate_list, PixelateList)
KV_INSTANTIATE(pixelate_backward, Pixelate)
KV_INSTANTIATE(pixelate_backward_list, PixelateList)

}  // namespace kv::augmentation::cuda
