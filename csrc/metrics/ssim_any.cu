// Structural similarity on CUDA for the cases that the other files do not support: windows too large for their memory.
//
// A block has 32 columns and up to eight rows, with one thread per pixel. Four values per pixel are summed in the
// windows: those of the means, or for the gradient the derivatives by the means. A block processes as many rows at a
// time as it has: their values go to shared memory and are summed along x from there, and each thread adds the sums of
// its column that are in the window of its pixel. For volumes the sums of each slice go to a ring buffer, split between
// the threads, and are summed across the slices.
//
// One launch writes the derivatives and another one sums them, so that no mean is computed twice. Volumes are processed
// in groups that fit the working memory.
#include "ssim.cuh"

namespace kv::metrics::cuda {
namespace {

constexpr int kColumns = 32;

template <class F>
using Double4 = Vector<F, 4>;

// Indices are those of the image or volume; a 'valid' similarity starts at `offset` along the axes of the window.
template <class F>
struct Work {
  StoredPlanes x, y;
  StoredPlanes result, other_result;  // the similarity; or the gradients, the latter without data if not needed
  StoredPlanes grad;                  // of the similarity
  Double4<F>* derivatives;            // by the means, contiguous: output of one launch, input of the other
  DType stored;
  Border border;
  int size, offset, offset_z, depth, height, width, deep;  // deep: the window's radius across planes
  double sigma;
  SsimConstants<F> constants;
  SsimLoss<F> loss;
  F* partial;
  F const* of_loss;
  unsigned across, down, parts;  // blocks per volume
  int64_t first;                 // volume of the launch
  int slices;                    // per part

  __device__ __forceinline__ bool has_result(int z, int y, int x) const {
    return y >= offset && y < height - offset && x >= offset && x < width - offset && z >= offset_z &&
           z < depth - offset_z;
  }
  __device__ __forceinline__ int64_t result_plane(int64_t volume, int z) const {
    return volume / x.step * (depth - 2 * offset_z) + z - offset_z;
  }
  __device__ __forceinline__ Double4<F>& derivatives_at(int64_t volume, int z, int y, int column) const {
    int64_t const slice = (volume - first) * (depth - 2 * offset_z) + z - offset_z;
    int64_t const row = slice * (height - 2 * offset) + y - offset;
    return derivatives[row * (width - 2 * offset) + column - offset];
  }
  // The factor of a pixel in D of ssim.h.
  __device__ __forceinline__ F ends(int z, int y, int x, F factor) const {
    F result = 1;
    if (border != Border::reflect) return result;
    if (y == 0 || y == height - 1) result *= factor;
    if (x == 0 || x == width - 1) result *= factor;
    if (deep > 0 && (z == 0 || z == depth - 1)) result *= factor;
    return result;
  }
};

// The element for pixel x in row y of a plane of a volume.
template <class F>
__device__ __forceinline__ F load(StoredPlanes const& p, DType stored, int64_t plane, int64_t channel, int y, int x) {
  uint8_t const* const row = p.plane(plane) + y * p.row_stride;
  F result;
  dispatch_floating_dtype<F>(
      stored, [&](auto type) { result = read(reinterpret_cast<decltype(type) const*>(row)[x * p.step + channel]); });
  return result;
}
template <class F>
__device__ __forceinline__ void save(StoredPlanes const& p, DType stored, int64_t plane, int64_t channel, int y, int x,
                                     F value) {
  uint8_t* const row = p.plane(plane) + y * p.row_stride;
  dispatch_floating_dtype<F>(stored, [&](auto type) {
    using T = decltype(type);
    reinterpret_cast<T*>(row)[x * p.step + channel] = round_to<T>(value);
  });
}

// Back: computes the gradients from the derivatives; otherwise the derivatives, the similarity or its loss.
template <class F, bool Back>
__global__ void __launch_bounds__(kColumns * 8) sum_windows(__grid_constant__ Work<F> const p) {
  extern __shared__ __align__(16) uint8_t shared[];
  int const threads = int(blockDim.x), rows = threads / kColumns, K = p.size, R = K / 2;
  int const line = kColumns + 2 * R, deep = p.deep, slots = 2 * deep + 1;
  int const lane = int(threadIdx.x) % kColumns, r = int(threadIdx.x) / kColumns;
  Double4<F>* const values = reinterpret_cast<Double4<F>*>(shared);  // (rows, line)
  Double4<F>* const lines = values + rows * line;                    // (rows, columns)
  Double4<F>* const ring = lines + threads;                          // (slots, threads)
  F* const weights = reinterpret_cast<F*>(ring + (deep ? slots * threads : 0));

  unsigned tile = blockIdx.x / p.across, part = tile / p.down;
  int const x0 = int(blockIdx.x - tile * p.across) * kColumns, y0 = int(tile - part * p.down) * rows;
  unsigned const of_launch = part / p.parts;
  int64_t const volume = p.first + of_launch, channel = volume % p.x.step, plane = volume / p.x.step * p.depth;
  int const z0 = int(part - of_launch * p.parts) * p.slices, z1 = min(z0 + p.slices, p.depth);
  int const x = x0 + lane, y = y0 + r;

  for (int t = threadIdx.x; t < K; t += threads) {
    double const d = double(t - R) / p.sigma;
    weights[t] = F(::exp(-d * d / 2));
  }
  __syncthreads();
  double sum = 0;
  for (int t = 0; t < K; ++t) sum += weights[t];
  __syncthreads();
  for (int t = threadIdx.x; t < K; t += threads) weights[t] = F(weights[t] / sum);

  auto const add = [](Double4<F>& to, F weight, Double4<F> const& what) {
#pragma unroll
    for (int m = 0; m < 4; ++m) to.v[m] += weight * what.v[m];
  };
  auto const value_at = [&](int z, int y, int x) {
    if constexpr (Back) {
      return p.has_result(z, y, x) ? p.derivatives_at(volume, z, y, x) : Double4<F>{};
    } else {
      F const a = load<F>(p.x, p.stored, plane + z, channel, y, x),
              b = load<F>(p.y, p.stored, plane + z, channel, y, x);
      return Double4<F>{a, b, a * a + b * b, (a - b) * (a - b)};
    }
  };
  F of_losses = 0;
  auto const finish = [&](int z, int y, Double4<F> const& sums) {
    if constexpr (Back) {
      if (y >= p.height || x >= p.width) return;
      F const a = load<F>(p.x, p.stored, plane + z, channel, y, x),
              b = load<F>(p.y, p.stored, plane + z, channel, y, x);
      F const d = a - b, scale = p.ends(z, y, x, F(0.5)), sign = d > 0 ? F(1) : d < 0 ? F(-1) : d;
      F const of_absolute = p.grad.data ? F(0) : p.loss.absolute * p.of_loss[volume / p.loss.planes] * sign;
      F const of_x = sums.v[0] + a * sums.v[2] + d * sums.v[3], of_y = sums.v[1] + b * sums.v[2] - d * sums.v[3];
      save(p.result, p.stored, plane + z, channel, y, x, scale * of_x + of_absolute);
      if (p.other_result.data) save(p.other_result, p.stored, plane + z, channel, y, x, scale * of_y - of_absolute);
    } else {
      if (!p.has_result(z, y, x)) return;
      Means<F> const means{sums.v[0], sums.v[1], sums.v[2], sums.v[3]};
      SsimTerms<F> const terms(means, p.constants);
      F const inverse = 1 / terms.denominator, unlike = terms.numerator * inverse;
      int64_t const to = p.result_plane(volume, z);
      if (p.derivatives) {
        F const g = p.grad.data ? load<F>(p.grad, p.stored, to, channel, y - p.offset, x - p.offset)
                                : -p.loss.structure * p.of_loss[volume / p.loss.planes];
        Means<F> const d = ssim_of_means_vjp(means, terms, inverse, g * p.ends(z, y, x, F(2)), p.constants.luminance);
        p.derivatives_at(volume, z, y, x) = {d.x, d.y, d.squares, d.apart};
      } else if (p.result.data) {
        save(p.result, p.stored, to, channel, y - p.offset, x - p.offset, 1 - unlike);
      } else {
        F apart = 0;
        if (p.loss.absolute != 0)
          apart =
              fabs(load<F>(p.x, p.stored, plane + z, channel, y, x) - load<F>(p.y, p.stored, plane + z, channel, y, x));
        of_losses += p.loss.structure * unlike + p.loss.absolute * apart;
      }
    }
  };

  for (int q = z0 - deep; q < z1 + deep; ++q) {
    int const z = border_index(p.border, q, p.depth);
    Double4<F> of_slice{};
    for (int first = y0 - R; z >= 0 && first < y0 + rows + R; first += rows) {
      for (int i = threadIdx.x; i < rows * line; i += threads) {
        int const row = border_index(p.border, first + i / line, p.height);
        int const column = border_index(p.border, x0 - R + i % line, p.width);
        values[i] = row < 0 || column < 0 ? Double4<F>{} : value_at(z, row, column);
      }
      __syncthreads();
      Double4<F> along_x{};
#pragma unroll 4
      for (int t = 0; t < K; ++t) add(along_x, weights[t], values[r * line + lane + t]);
      lines[threadIdx.x] = along_x;
      __syncthreads();
      int const top = first - (y - R), end = min(top + rows, K);
      for (int t = max(top, 0); t < end; ++t) add(of_slice, weights[t], lines[(t - top) * kColumns + lane]);
    }
    if (deep == 0) {
      finish(q, y, of_slice);
      continue;
    }
    ring[(q - z0 + deep) % slots * threads + threadIdx.x] = of_slice;
    if (q < z0 + deep) continue;
    Double4<F> sums{};
    for (int t = 0; t < K; ++t) add(sums, weights[t], ring[(q - z0 - deep + t) % slots * threads + threadIdx.x]);
    finish(q - deep, y, sums);
  }
  if (!Back && p.partial) {
    of_losses = warp_reduce(of_losses, Sum());
    if (lane == 0) p.partial[blockIdx.x * rows + r] = of_losses;
  }
}

template <class T>
Work<Compute<T>> work_of(SsimImages<T> const& images) {
  Work<Compute<T>> work{};
  work.x = stored_planes(images.x), work.y = stored_planes(images.y);
  work.stored = kDType<T>;
  work.border = images.border;
  work.size = images.size, work.sigma = images.sigma;
  work.offset = images.valid ? images.size / 2 : 0, work.offset_z = images.volumes ? work.offset : 0;
  work.deep = images.volumes ? images.size / 2 : 0;
  work.depth = int(images.depth), work.height = int(images.x.height), work.width = int(images.x.width);
  work.constants = images.constants;
  return work;
}

template <class F>
int64_t volumes_of(Work<F> const& work) {
  return work.x.count() / work.depth * work.x.step;
}

template <bool Back, class F>
int launch(Work<F>& work, int64_t volumes, CUstream_st* stream) {
  SsimBlocks const blocks(work.depth, work.height, work.width, work.size, work.deep, sizeof(F));
  work.across = unsigned(blocks.across), work.down = unsigned(blocks.down), work.parts = unsigned(blocks.parts);
  work.slices = blocks.slices;
  int const bytes = int(blocks.bytes);
  if (int const error = cudaFuncSetAttribute(sum_windows<F, Back>, cudaFuncAttributeMaxDynamicSharedMemorySize, bytes))
    return error;
  sum_windows<F, Back><<<unsigned(volumes * blocks.count()), kColumns * blocks.rows, bytes, stream>>>(work);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int ssim_any(Ssim<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Work<F> work = work_of(p.images);
  work.result = stored_planes(p.similarity);
  work.loss = p.loss, work.partial = p.similarity.data ? nullptr : p.partial;
  int const error = launch<false>(work, volumes_of(work), stream);
  if (error || p.similarity.data) return error;
  SsimBlocks const blocks(work.depth, work.height, work.width, work.size, work.deep, sizeof(F));
  int64_t const rows = work.x.count() / work.depth / p.loss.planes, chunks = p.loss.planes * blocks.chunks();
  return sum_chunks(p.partial, rows, chunks, p.sums, stream);
}

template <class T>
int ssim_any_backward(SsimBackward<T> const& p, CUstream_st* stream) {
  using F = Compute<T>;
  Work<F> work = work_of(p.images);
  work.grad = stored_planes(p.grad);
  work.loss = p.loss, work.of_loss = p.of_loss;
  work.derivatives = reinterpret_cast<Double4<F>*>(p.derivatives);
  work.result = stored_planes(p.grad_x), work.other_result = stored_planes(p.grad_y);
  int64_t const volumes = volumes_of(work);
  int64_t const results =
      int64_t(work.depth - 2 * work.offset_z) * (work.height - 2 * work.offset) * (work.width - 2 * work.offset);
  int64_t const per_launch = p.room / (4 * results);
  for (; work.first < volumes; work.first += per_launch) {
    int64_t const count = min(per_launch, volumes - work.first);
    if (int const error = launch<false>(work, count, stream)) return error;
    if (int const error = launch<true>(work, count, stream)) return error;
  }
  return 0;
}

#define KV_SSIM_ANY(T)                                          \
  template int ssim_any(Ssim<T> const& p, CUstream_st* stream); \
  template int ssim_any_backward(SsimBackward<T> const& p, CUstream_st* stream);
KV_SSIM_ANY(float)
KV_SSIM_ANY(double)
KV_SSIM_ANY(Half)
KV_SSIM_ANY(BFloat16)

}  // namespace kv::metrics::cuda
