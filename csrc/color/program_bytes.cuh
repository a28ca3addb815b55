// Color programs from planes of bytes to planes of bytes or of float32, on CUDA. A thread takes four adjacent pixels,
// which may begin anywhere: it reads the words around them, of the next pixels while the steps work on these.
#pragma once

#include "program.cuh"

namespace kv::color::cuda {
namespace {

static_assert(kPixelsPerThread<float> == 4);

template <int C>
struct Words {
  static constexpr int P = kPixelsPerThread<float>;
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

// Of what a block does its part.
struct BytesOfSample {
  Pixels const &x, &y;
  uint8_t const* from;
  void* to;
  int64_t b, pixels;
  int block, blocks;
  float* part;  // where the program measures a mean, the block's part of it
  MeanParts<float> mean;
};

// What a block does of a sample, whose results are of type T: void where the program measures a mean. Planes of float32
// are vectors unless they begin Anywhere.
template <int C, class T, bool Anywhere>
__device__ __forceinline__ void run_block_of_bytes(Program<float> const& p, Sample<float>& sample,
                                                   BytesOfSample const& own) {
  constexpr int P = kPixelsPerThread<float>;
  constexpr bool kMeasures = __is_same(T, void);
  Pixels const &x = own.x, &y = own.y;
  int64_t const pixels = own.pixels, stride = own.blocks * kChunk<float>;
  int64_t i = own.block * kChunk<float> + threadIdx.x * P;
  float partial_mean = 0;
  Words<C> ahead(x, own.from);
  ahead.fetch(x, own.from, i, pixels);
  sample.prepare(p, own.b, false, own.mean);
  for (int64_t chunk = own.block * kChunk<float>; chunk < pixels; chunk += stride, i += stride) {
    float c[C][P];
    ahead.convert(c);
    ahead.fetch(x, own.from, i + stride, pixels);
    for (int s = 0; s < sample.length; ++s) {
      auto const entry = sample.order[s];
      if (kMeasures && entry.step == Step::contrast) break;
      EvaluateStep<float, C, P> values{c, sample.p + entry.first};
      run_step(entry.step, values);
    }
    int const left = int(min(pixels - i, int64_t(2 * P)));
#pragma unroll
    for (int k = 0; k < C; ++k) {
      if constexpr (kMeasures) {
#pragma unroll
        for (int j = 0; j < P; ++j)
          if (j < left) partial_mean += c[k][j] * p.gray_weights[k];
      } else {
        if (k >= y.channels) break;
        T* const to = static_cast<T*>(own.to) + k * y.channel_stride + i;
        if constexpr (sizeof(T) == 1) {
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] *= 255;
          store_words(to, c[k], 0, left);
        } else if (Anywhere && reinterpret_cast<uintptr_t>(to) % sizeof(Vector<float, P>) != 0) {  // so for all threads
          store_striped<P, kThreads / 32>(to, c[k], 0, int(min(pixels - i, kChunk<float>)));
        } else if (left >= P) {
          store_vector(to, c[k]);
        } else {
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (j < left) to[j] = c[k][j];
        }
      }
    }
  }
  if constexpr (kMeasures) {
    partial_mean = block_sum_to_all(partial_mean, sample.sums);
    if (threadIdx.x == 0) *own.part = partial_mean;
  } else if (p.contrast >= 0 && own.block == 0 && threadIdx.x == 0) {
    p.means[own.b] = sample.mean;
  }
}

}  // namespace
}  // namespace kv::color::cuda
