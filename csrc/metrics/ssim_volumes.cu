// Structural similarity of volumes on CUDA.
//
// A block has a tile of eight slices, eight rows and 32 columns, and keeps all sums in shared memory. First it sums
// across the slices, for all rows and columns in the tile's windows, then along y in place, then along x in registers.
// Along each axis a thread has eight adjacent elements.
//
// The gradient takes two launches for as many volumes as the working memory holds: one writes the derivatives by the
// means, the other one sums them.
#include "ssim_window.cuh"

namespace kv::metrics::cuda {
namespace {

constexpr int kThreads = SsimVolumeTiles::kThreads, kColumns = SsimVolumeTiles::kColumns;

// Indices are those of the volume; a 'valid' similarity starts at `offset` along every axis.
template <class F>
struct Work {
  StoredPlanes x, y;
  StoredPlanes result, other_result;  // the similarity; or the gradients, the latter without data if not needed
  StoredPlanes grad;                  // of the similarity
  DType stored;
  Border border;
  int offset, depth, height, width;
  SsimConstants<F> constants;
  SsimLoss<F> loss;
  F* partial;
  F const* of_loss;
  Double4<F>* derivatives;       // by the means: output of one launch, input of the other
  unsigned x_slice, y_slice;     // strides of slices in bytes
  int64_t first;                 // volume of the launch
  unsigned across, down, parts;  // tiles per volume
  int taps;
  F weights[SsimVolumeTiles::kMaxTaps + kSide];

  __device__ __forceinline__ bool has_result(int z, int y, int x) const {
    return z >= offset && z < depth - offset && y >= offset && y < height - offset && x >= offset && x < width - offset;
  }
  __device__ __forceinline__ int64_t result_plane(int64_t volume, int z) const {
    return volume * (depth - 2 * offset) + z - offset;
  }
  __device__ __forceinline__ Double4<F>* derivatives_at(int64_t volume, int z, int y, int x) const {
    int64_t const row = result_plane(volume - first, z) * (height - 2 * offset) + y - offset;
    return derivatives + row * (width - 2 * offset) + x - offset;
  }
  // The factor of a voxel in D of ssim.h.
  __device__ __forceinline__ F ends(int z, int y, int x, F factor) const {
    F result = 1;
    if (border != Border::reflect) return result;
    if (z == 0 || z == depth - 1) result *= factor;
    if (y == 0 || y == height - 1) result *= factor;
    if (x == 0 || x == width - 1) result *= factor;
    return result;
  }
};

template <class T>
__device__ __forceinline__ T* row_of(StoredPlanes const& p, int64_t plane, int64_t row) {
  return reinterpret_cast<T*>(p.plane(plane) + row * p.row_stride);
}

// Back: computes the gradients from the derivatives; otherwise the derivatives, the similarity or its loss.
template <class T, bool Back>
__global__ void __launch_bounds__(kThreads, 2) ssim_volumes(__grid_constant__ Work<Compute<T>> const p) {
  using F = Compute<T>;
  extern __shared__ __align__(16) uint8_t shared[];
  __shared__ Row slices[SsimVolumeTiles::kMaxTaps + kSide];
  Double4<F>* const sums = reinterpret_cast<Double4<F>*>(shared);  // (slices, rows, columns)
  int const taps = p.taps, R = taps / 2, rows = kSide + taps - 1, columns = kColumns + taps - 1, stride = columns + 1;
  auto const weight = [&](int t) { return p.weights[t]; };

  unsigned const tile = blockIdx.x / p.across, part = tile / p.down, of_launch = part / p.parts;
  int const x0 = int(blockIdx.x - tile * p.across) * kColumns, y0 = int(tile - part * p.down) * kSide,
            z0 = int(part - of_launch * p.parts) * kSide, thread = int(threadIdx.x);
  int64_t const volume = p.first + of_launch;
  int const offset = Back ? p.offset : 0;
  if (thread < kSide + taps - 1) {
    int const z = border_index(p.border, z0 - R + thread, p.depth);
    Row& slice = slices[thread];
    slice.in_bounds = z >= offset && z < p.depth - offset;
    unsigned const at = slice.in_bounds ? unsigned(z - offset) : 0;
    if constexpr (Back)
      slice.x = at * unsigned((p.height - 2 * offset) * (p.width - 2 * offset));
    else
      slice.x = at * p.x_slice, slice.y = at * p.y_slice;
  }
  __syncthreads();

#pragma unroll 1
  for (int i = thread; i < rows * columns; i += kThreads) {
    int const r = i / columns, c = i - r * columns;
    int const y = border_index(p.border, y0 - R + r, p.height), x = border_index(p.border, x0 - R + c, p.width);
    F across[4][kSide] = {};
    if (y >= offset && y < p.height - offset && x >= offset && x < p.width - offset) {
      if constexpr (Back) {
        Double4<F> const* const from = p.derivatives_at(volume, offset, y, x);
        auto const read_slice = [&](int i) {
          Row const slice = slices[i];
          Double4<F> result = from[slice.x];
#pragma unroll
          for (int m = 0; m < 4; ++m) result.v[m] = slice.in_bounds ? result.v[m] : F(0);
          return result;
        };
        sum_window<4>(taps, weight, read_slice, across);
      } else {
        auto const *const xs = reinterpret_cast<uint8_t const*>(row_of<T>(p.x, volume * p.depth, y) + x),
                          *const ys = reinterpret_cast<uint8_t const*>(row_of<T>(p.y, volume * p.depth, y) + x);
        auto const read_slice = [&](int i) {
          Row const slice = slices[i];
          F a = read(*reinterpret_cast<T const*>(xs + slice.x)), b = read(*reinterpret_cast<T const*>(ys + slice.y));
          a = slice.in_bounds ? a : F(0), b = slice.in_bounds ? b : F(0);
          F const d = a - b;
          return Double4<F>{a, b, a * a + b * b, d * d};
        };
        sum_window<4>(taps, weight, read_slice, across);
      }
    }
#pragma unroll
    for (int j = 0; j < kSide; ++j)
      sums[(j * rows + r) * stride + c] = {across[0][j], across[1][j], across[2][j], across[3][j]};
  }
  __syncthreads();
#pragma unroll 1
  for (int i = thread; i < kSide * columns; i += kThreads) {
    int const z = i / columns, c = i - z * columns;
    Double4<F>* const column = sums + z * rows * stride + c;
    F down[4][kSide] = {};
    sum_window<4>(taps, weight, [&](int i) { return column[i * stride]; }, down);
#pragma unroll
    for (int j = 0; j < kSide; ++j) column[j * stride] = {down[0][j], down[1][j], down[2][j], down[3][j]};
  }
  __syncthreads();

  // Neighboring threads have different rows: their simultaneous reads are from different banks.
  int const row = thread % kSide, slice = thread / kSide % kSide, column = thread / (kSide * kSide) * kSide;
  int const z = z0 + slice, y = y0 + row;
  Double4<F> const* const line = sums + (slice * rows + row) * stride + column;
  F result[4][kSide] = {};
  sum_window<4>(taps, weight, [&](int i) { return line[i]; }, result);
  F of_losses = 0;
  if (z < p.depth && y < p.height) {
    int64_t const plane = volume * p.depth + z;
    F const of_loss = p.of_loss ? p.of_loss[volume / p.loss.planes] : F(0);
    dispatch_floating_dtype<F>(p.stored, [&](auto type) {
      using S = decltype(type);
      if constexpr (!Back && !__is_same(S, T)) return;
      S const *const xs = row_of<S const>(p.x, plane, y), *const ys = row_of<S const>(p.y, plane, y);
#pragma unroll
      for (int j = 0; j < kSide; ++j) {
        int const x = x0 + column + j;
        if (x >= p.width) break;
        F const sums[] = {result[0][j], result[1][j], result[2][j], result[3][j]};
        if constexpr (Back) {
          F const a = read(xs[x]), b = read(ys[x]), d = a - b, scale = p.ends(z, y, x, F(0.5));
          F const flat = p.loss.absolute * of_loss * (d > 0 ? F(1) : d < 0 ? F(-1) : d);
          F const of_x = sums[0] + a * sums[2] + d * sums[3], of_y = sums[1] + b * sums[2] - d * sums[3];
          row_of<S>(p.result, plane, y)[x] = round_to<S>(scale * of_x + flat);
          if (p.other_result.data) row_of<S>(p.other_result, plane, y)[x] = round_to<S>(scale * of_y - flat);
        } else if (p.has_result(z, y, x)) {
          Means<F> const means{sums[0], sums[1], sums[2], sums[3]};
          SsimTerms<F> const terms(means, p.constants);
          F const inverse = fast_reciprocal(terms.denominator), unlike = terms.numerator * inverse;
          int64_t const to = p.result_plane(volume, z);
          if (p.derivatives) {
            F const g = p.grad.data ? read(row_of<T const>(p.grad, to, y - p.offset)[x - p.offset])
                                    : -p.loss.structure * of_loss;
            Means<F> const d =
                ssim_of_means_vjp(means, terms, inverse, g * p.ends(z, y, x, F(2)), p.constants.luminance);
            *p.derivatives_at(volume, z, y, x) = {d.x, d.y, d.squares, d.apart};
          } else if (p.result.data) {
            row_of<T>(p.result, to, y - p.offset)[x - p.offset] = round_to<T>(1 - unlike);
          } else {
            of_losses += p.loss.structure * unlike;
            if (p.loss.absolute != 0) of_losses += p.loss.absolute * ::fabs(F(read(xs[x])) - F(read(ys[x])));
          }
        }
      }
    });
  }
  if (!Back && p.partial) {
    of_losses = warp_reduce(of_losses, Sum());
    if (thread % 32 == 0) p.partial[blockIdx.x * (kThreads / 32) + thread / 32] = of_losses;
  }
}

template <class T>
unsigned slice_bytes(Planes<T> const& p) {
  return unsigned((p.inner == 1 ? p.outer_stride : p.inner_stride) * int64_t(sizeof(T)));
}

template <class T>
Work<Compute<T>> work_of(SsimImages<T> const& images) {
  Work<Compute<T>> work{};
  work.x = stored_planes(images.x), work.y = stored_planes(images.y);
  work.x_slice = slice_bytes(images.x), work.y_slice = slice_bytes(images.y);
  work.stored = kDType<T>;
  work.border = images.border;
  work.taps = images.size;
  for (int t = 0; t < images.size; ++t) work.weights[t] = images.weights[t];
  work.offset = images.valid ? images.size / 2 : 0;
  work.depth = int(images.depth), work.height = int(images.x.height), work.width = int(images.x.width);
  work.constants = images.constants;
  return work;
}

template <class T, bool Back>
int launch(Work<Compute<T>>& work, int64_t volumes, CUstream_st* stream) {
  SsimVolumeTiles const tiles(work.depth, work.height, work.width, work.taps, sizeof(Compute<T>));
  work.across = unsigned(tiles.across), work.down = unsigned(tiles.down), work.parts = unsigned(tiles.parts);
  int const bytes = int(tiles.bytes);
  if (int const error = cudaFuncSetAttribute(ssim_volumes<T, Back>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  ssim_volumes<T, Back><<<unsigned(volumes * tiles.count()), kThreads, bytes, stream>>>(work);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int ssim_of_volumes(Ssim<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Work<F> work = work_of(p.images);
  work.result = stored_planes(p.similarity);
  work.loss = p.loss, work.partial = p.similarity.data ? nullptr : p.partial;
  int64_t const volumes = work.x.count() / work.depth;
  int const error = launch<T, false>(work, volumes, stream);
  if (error || p.similarity.data) return error;
  SsimVolumeTiles const tiles(work.depth, work.height, work.width, work.taps, sizeof(F));
  return sum_chunks(p.partial, volumes / p.loss.planes, p.loss.planes * tiles.chunks(), p.sums, stream);
}

template <class T>
int ssim_of_volumes_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Work<F> work = work_of(p.images);
  work.grad = stored_planes(p.grad);
  work.loss = p.loss, work.of_loss = p.of_loss;
  work.derivatives = reinterpret_cast<Double4<F>*>(p.derivatives);
  work.result = stored_planes(p.grad_x), work.other_result = stored_planes(p.grad_y);
  int64_t const volumes = work.x.count() / work.depth;
  int64_t const results =
      int64_t(work.depth - 2 * work.offset) * (work.height - 2 * work.offset) * (work.width - 2 * work.offset);
  int64_t const per_launch = p.room / (4 * results);
  for (; work.first < volumes; work.first += per_launch) {
    int64_t const count = min(per_launch, volumes - work.first);
    if (int const error = launch<T, false>(work, count, stream)) return error;
    if (int const error = launch<F, true>(work, count, stream)) return error;
  }
  return 0;
}

#define KV_SSIM_VOLUMES(T)                                             \
  template int ssim_of_volumes(Ssim<T> const& p, CUstream_st* stream); \
  template int ssim_of_volumes_backward(SsimBackward<T> const& p, CUstream_st* stream);
KV_SSIM_VOLUMES(float)
KV_SSIM_VOLUMES(double)
KV_SSIM_VOLUMES(Half)
KV_SSIM_VOLUMES(BFloat16)

}  // namespace kv::metrics::cuda
