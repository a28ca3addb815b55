// Color programs from planes of bytes to planes of bytes or of float32, on CUDA. A thread takes four adjacent pixels,
// which may begin anywhere: it reads the words around them, of the next pixels while the steps work on these.
#include "program.cuh"
#include "program_bytes.h"

namespace kv::color::cuda {
namespace {

constexpr int P = kPixelsPerThread<float>;
static_assert(P == 4);

template <int C>
struct Words {
  uint32_t words[C][2];  // those around the pixels of each channel
  unsigned shift[C];     // bits before the first pixel

  // Of a sample whose pixels begin at `from`.
  __device__ __forceinline__ Words(Pixels const& x, uint8_t const* from) {
#pragma unroll
    for (int k = 0; k < C; ++k)
      shift[k] = 8 * preceding_elements(from + k * x.channel_stride), words[k][0] = words[k][1] = 0;
  }
  // Pixels i ... i + 3, where they exist. The words of the last pixels may reach behind the plane.
  __device__ __forceinline__ void fetch(Pixels const& x, uint8_t const* from, int64_t i, int64_t pixels) {
#pragma unroll
    for (int k = 0; k < C; ++k) {
      if (k >= x.channels) break;
      uint8_t const* const first = from + k * x.channel_stride + i;
      if (i + 2 * P <= pixels) {
        auto const* const around = reinterpret_cast<uint32_t const*>(first - shift[k] / 8);
        words[k][0] = around[0], words[k][1] = around[1];
      } else {
        uint32_t four = 0;
#pragma unroll
        for (int j = 0; j < P; ++j)
          if (i + j < pixels) four |= uint32_t(first[j]) << 8 * j;
        words[k][0] = four << shift[k], words[k][1] = __funnelshift_l(four, 0u, shift[k]);
      }
    }
  }
  __device__ __forceinline__ void convert(float (&c)[C][P]) const {
#pragma unroll
    for (int k = 0; k < C; ++k) {
      uint32_t const four = __funnelshift_r(words[k][0], words[k][1], shift[k]);
#pragma unroll
      for (int j = 0; j < P; ++j) c[k][j] = scaled_byte_of(four, j, 1.f / 255);
    }
  }
};

// T: of the results.
template <int C, class T>
__global__ void __launch_bounds__(kThreads) run_bytes(__grid_constant__ Program<float> const p) {
  __shared__ Sample<float> sample;
  for (int64_t n = blockIdx.y; n < p.samples; n += gridDim.y) {
    int64_t const b = sample_of(p, n), stride = gridDim.x * kChunk<float>;
    auto const* const from = static_cast<uint8_t const*>(p.x.data) + p.x.offset(b);
    T* const to = static_cast<T*>(p.y.data) + p.y.offset(b);
    int64_t i = blockIdx.x * kChunk<float> + threadIdx.x * P;
    Words<C> ahead(p.x, from);
    ahead.fetch(p.x, from, i, p.pixels);
    sample.prepare(p, b, false);
    for (int64_t chunk = blockIdx.x * kChunk<float>; chunk < p.pixels; chunk += stride, i += stride) {
      float c[C][P];
      ahead.convert(c);
      ahead.fetch(p.x, from, i + stride, p.pixels);
      for (int s = 0; s < sample.length; ++s) {
        auto const entry = sample.order[s];
        EvaluateStep<float, C, P> values{c, sample.p + entry.first};
        run_step(entry.step, values);
      }
      int const left = int(min(p.pixels - i, int64_t(2 * P)));
#pragma unroll
      for (int k = 0; k < C; ++k) {
        if (k >= p.y.channels) break;
        T* const own = to + k * p.y.channel_stride + i;
        if constexpr (sizeof(T) == 1) {
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] *= 255;
          store_words(own, c[k], 0, left);
        } else if (left >= P) {
          store_vector(own, c[k]);
        } else {
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (j < left) own[j] = c[k][j];
        }
      }
    }
    if (p.contrast >= 0 && blockIdx.x == 0 && threadIdx.x == 0) p.means[b] = sample.mean;
  }
}

// Whether the planes of three channels of float32 are vectors of a thread's pixels.
bool has_vectors(Pixels const& y) {
  return y.type == DType::float32 && y.channels == 3 && (y.outer_stride | y.inner_stride | y.channel_stride) % P == 0 &&
         reinterpret_cast<uintptr_t>(y.data) % sizeof(Vector<float, P>) == 0;
}

}  // namespace

// Special case, H200: 1.02 (invert) to 1.8 (gray at 335x513) times as fast as the kernel of any type; to float32 1.33
// (rgb_to_ycbcr) to 1.39 (rgb_to_lab).
bool takes_bytes(Program<float> const& p) {
  if (p.measures_mean || p.x.type != DType::uint8 || p.x.step != 1 || p.y.step != 1) return false;
  return p.y.type == DType::uint8 || has_vectors(p.y);
}

int program_of_bytes(Program<float> const& p, CUstream_st* stream) {
  dim3 const grid = grid_of(p.samples, blocks_per_sample<float>(p.samples, p.pixels));
  auto* const kernel = p.y.type == DType::float32 ? run_bytes<3, float>
                       : p.x.channels == 1        ? run_bytes<1, uint8_t>
                                                  : run_bytes<3, uint8_t>;
  kernel<<<grid, kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace kv::color::cuda
