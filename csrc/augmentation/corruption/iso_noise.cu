// The noise of a sensor on CUDA: a thread has four pixels, for the words of one block. A first kernel leaves sums of
// the lightness of chunks of pixels, a block each; the second one adds those of a sample up in each block.
#include "color/program.cuh"
#include "core/block_reduce.cuh"
#include "core/launch.cuh"
// Included after those, whose functions its formulas use.
#include "augmentation/corruption/iso_noise.h"

namespace kv::augmentation::cuda {
namespace {

constexpr int kIsoThreads = int(kIsoPixels / 4);

// The colors of four adjacent pixels, fewer at the end of a plane. Vectorized: planar images, whose planes are whole
// vectors.
template <class T, bool Vectorized>
struct FourColors {
  Vector<T, 4> v[3];
  int64_t at;  // of the first element
  int count;

  __device__ __forceinline__ FourColors(PixelNoise<T> const& p, int64_t b, int64_t pixel)
      : at(p.offset(b, 0) + pixel * p.step), count(int(min(p.pixels - pixel, int64_t(4)))) {
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      T const* const x = p.x + at + c * p.channel_stride;
      if constexpr (Vectorized) {
        v[c] = *reinterpret_cast<Vector<T, 4> const*>(x);
      } else {
#pragma unroll
        for (int k = 0; k < 4; ++k)
          if (k < count) v[c].v[k] = x[k * p.step];
      }
    }
  }
  __device__ __forceinline__ void get(int k, Compute<T> full_range, Compute<T> (&c)[3]) const {
#pragma unroll
    for (int i = 0; i < 3; ++i) c[i] = Compute<T>(read(v[i].v[k])) / full_range;
  }
  __device__ __forceinline__ void store(PixelNoise<T> const& p) const {
#pragma unroll
    for (int c = 0; c < 3; ++c) {
      T* const y = p.y + at + c * p.channel_stride;
      if constexpr (Vectorized) {
        store_vector(y, v[c]);
      } else {
#pragma unroll
        for (int k = 0; k < 4; ++k)
          if (k < count) y[k * p.step] = v[c].v[k];
      }
    }
  }
};

// Of chunk i of sample b, by a block.
template <bool Vectorized, class T>
__device__ __forceinline__ void add_lightness(IsoNoise<T> const& p, int64_t b, int64_t i) {
  using F = Compute<T>;
  double sums[2] = {};
  for (int64_t pixel = p.begin(i) + 4 * threadIdx.x; pixel < p.end(i); pixel += kIsoPixels) {
    FourColors<T, Vectorized> const four(p.noise, b, pixel);
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      if (k >= four.count) break;
      F c[3];
      four.get(k, p.noise.full_range, c);
      within_units(c);
      double const lightness = Hls<F>(c).lightness;
      sums[0] += lightness, sums[1] += lightness * lightness;
    }
  }
  store_block_sums<kIsoThreads>(sums, p.sums + 2 * (b * p.chunks + i));
}

// What the pixels of sample b have in common, for all threads of a block.
template <class T>
__device__ __forceinline__ IsoSample<Compute<T>> iso_sample(IsoNoise<T> const& p, int64_t b) {
  double const* const sums = sum_rows<kIsoThreads, 2>(p.sums + 2 * b * p.chunks, p.chunks);
  Compute<T> const* const parameters = p.noise.parameters + b * p.noise.parameter_stride;
  return {parameters[0], parameters[1], sums[0], sums[1], double(p.noise.pixels)};
}
// The uniform and the normal numbers of four pixels, of which an image has `count`.
template <class T, class F>
__device__ __forceinline__ void iso_numbers(PixelNoise<T> const& noise, int64_t b, int64_t pixel, int count, F (&u)[4],
                                            F (&n)[4]) {
  if (noise.uniform) {
    float const* const maps = noise.numbers(b);
#pragma unroll
    for (int k = 0; k < 4; ++k)
      if (k < count) u[k] = maps[pixel + k], n[k] = maps[noise.pixels + pixel + k];
    return;
  }
  PhiloxWords const words = noise.source(b).words(noise.draw, uint32_t(pixel / 4));
  PhiloxWords const own = noise.source(b).words(noise.draw + 1, uint32_t(pixel / 4));
#pragma unroll
  for (int k = 0; k < 4; ++k) u[k] = unit_of(words.w[k]);
  if constexpr (sizeof(F) == 8) {
    normals_of(own, n);
  } else {
#pragma unroll
    for (int k = 0; k < 4; k += 2) normal_pair<1>(int32_t(own.w[k]), int32_t(own.w[k + 1]), n[k], n[k + 1]);
  }
}

template <bool Vectorized, class T>
__device__ __forceinline__ void add_counts(IsoNoise<T> const& p, int64_t b, int64_t i) {
  using F = Compute<T>;
  PixelNoise<T> const& noise = p.noise;
  IsoSample<F> const sample = iso_sample(p, b);
  bool const is_chosen = noise.is_chosen(b);
  for (int64_t pixel = p.begin(i) + 4 * threadIdx.x; pixel < p.end(i); pixel += kIsoPixels) {
    FourColors<T, Vectorized> four(noise, b, pixel);
    if (is_chosen) {
      F u[4] = {}, n[4] = {};
      iso_numbers(noise, b, pixel, four.count, u, n);
#pragma unroll
      for (int k = 0; k < 4; ++k) {
        F c[3];
        four.get(k, noise.full_range, c);
        sample.change(
            c, u[k], n[k], [](F exponent) { return ::exp(exponent); }, [](F square) { return ::sqrt(square); });
#pragma unroll
        for (int j = 0; j < 3; ++j) four.v[j].v[k] = round_to<T>(c[j] * noise.full_range);
      }
    }
    four.store(noise);
  }
}
template <bool Vectorized, class T>
__device__ __forceinline__ void find_gradients(IsoNoiseBackward<T> const& p, int64_t b, int64_t i) {
  using F = Compute<T>;
  PixelNoise<T> const& noise = p.noise;
  IsoSample<F> const sample = iso_sample(p, b);
  bool const is_chosen = noise.is_chosen(b);
  for (int64_t pixel = p.begin(i) + 4 * threadIdx.x; pixel < p.end(i); pixel += kIsoPixels) {
    FourColors<T, Vectorized> grads(p.given(), b, pixel);
    if (is_chosen) {
      FourColors<T, Vectorized> const four(noise, b, pixel);
      F u[4] = {}, n[4] = {};
      iso_numbers(noise, b, pixel, four.count, u, n);
#pragma unroll 1
      for (int k = 0; k < four.count; ++k) {
        F c[3], g[3];
        four.get(k, F(1), c), grads.get(k, F(1), g);
        sample.vjp(
            c, g, u[k], n[k], [](F exponent) { return ::exp(exponent); }, [](F square) { return ::sqrt(square); });
#pragma unroll
        for (int j = 0; j < 3; ++j) grads.v[j].v[k] = round_to<T>(g[j]);
      }
    }
    grads.store(noise);
  }
}

template <class T, bool Vectorized>
__global__ void __launch_bounds__(kIsoThreads) lightness_of_chunks(__grid_constant__ IsoNoise<T> const p) {
  add_lightness<Vectorized>(p, blockIdx.y, blockIdx.x);
}
template <class T, bool Vectorized>
__global__ void __launch_bounds__(kIsoThreads) counts_of_chunks(__grid_constant__ IsoNoise<T> const p) {
  add_counts<Vectorized>(p, blockIdx.y, blockIdx.x);
}

template <class T, bool Vectorized>
__global__ void __launch_bounds__(kIsoThreads) gradients_of_chunks(__grid_constant__ IsoNoiseBackward<T> const p) {
  find_gradients<Vectorized>(p, blockIdx.y, blockIdx.x);
}

template <class T>
KV_HD bool has_whole_vectors(PixelNoise<T> const& n) {
  constexpr size_t bytes = alignof(Vector<T, 4>);
  return n.step == 1 && n.pixels % 4 == 0 && reinterpret_cast<uintptr_t>(n.x) % bytes == 0 &&
         reinterpret_cast<uintptr_t>(n.y) % bytes == 0;
}

template <class T>
KV_HD bool has_whole_vectors(IsoNoise<T> const& p) {
  return has_whole_vectors(p.noise);
}
template <class T>
KV_HD bool has_whole_vectors(IsoNoiseBackward<T> const& p) {
  return has_whole_vectors(p.noise) && has_whole_vectors(p.given());
}

template <class T, template <class> class Params, class Launch>
int launch_chunks(Params<T> const& p, Launch const& launch) {
  with_alignment<T>(has_whole_vectors(p),
                    [&](auto vectorized) { launch(vectorized, dim3(unsigned(p.chunks), unsigned(p.noise.batch))); });
  return cudaGetLastError();
}

// A block has a chunk of one of the images of a list.
template <class T, template <class> class List, class Run>
__device__ __forceinline__ void run_listed(List<T> const& p, Run const& run) {
  int const b = p.sample_of(int(blockIdx.x));
  auto const one = p.sample(b);
  int64_t const i = int(blockIdx.x) - p.first_of(b);
  if (sizeof(T) < 8 && has_whole_vectors(one))
    run(std::bool_constant<(sizeof(T) < 8)>(), one, i);
  else
    run(std::false_type(), one, i);
}
template <class T, template <class> class List>
__global__ void __launch_bounds__(kIsoThreads) lightness_of_list(__grid_constant__ List<T> const p) {
  run_listed(p, [](auto vectorized, IsoNoise<T> const& one, int64_t i) { add_lightness<vectorized.value>(one, 0, i); });
}
template <class T>
__global__ void __launch_bounds__(kIsoThreads) counts_of_list(__grid_constant__ IsoNoiseList<T> const p) {
  run_listed(p, [](auto vectorized, IsoNoise<T> const& one, int64_t i) { add_counts<vectorized.value>(one, 0, i); });
}
template <class T>
__global__ void __launch_bounds__(kIsoThreads) gradients_of_list(__grid_constant__ IsoNoiseBackwardList<T> const p) {
  run_listed(p, [](auto vectorized, IsoNoiseBackward<T> const& one, int64_t i) {
    find_gradients<vectorized.value>(one, 0, i);
  });
}

}  // namespace

template <class T>
int sum_lightness(IsoNoise<T> const& p, CUstream_st* stream) {
  return launch_chunks(p, [&](auto vectorized, dim3 blocks) {
    lightness_of_chunks<T, vectorized.value><<<blocks, kIsoThreads, 0, stream>>>(p);
  });
}
template <class T>
int iso_noise(IsoNoise<T> const& p, CUstream_st* stream) {
  return launch_chunks(p, [&](auto vectorized, dim3 blocks) {
    counts_of_chunks<T, vectorized.value><<<blocks, kIsoThreads, 0, stream>>>(p);
  });
}

template <class T>
int sum_lightness_list(IsoNoiseList<T> const& p, CUstream_st* stream) {
  static_assert(sizeof(IsoNoiseList<T>) <= 32764, "more than a kernel's parameters");
  lightness_of_list<<<unsigned(p.noise.list.items), kIsoThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int iso_noise_list(IsoNoiseList<T> const& p, CUstream_st* stream) {
  counts_of_list<T><<<unsigned(p.noise.list.items), kIsoThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

template <class T>
int iso_noise_backward(IsoNoiseBackward<T> const& p, CUstream_st* stream) {
  return launch_chunks(p, [&](auto vectorized, dim3 blocks) {
    gradients_of_chunks<T, vectorized.value><<<blocks, kIsoThreads, 0, stream>>>(p);
  });
}
template <class T>
int sum_lightness_again(IsoNoiseBackwardList<T> const& p, CUstream_st* stream) {
  static_assert(sizeof(IsoNoiseBackwardList<T>) <= 32764, "more than a kernel's parameters");
  lightness_of_list<<<unsigned(p.items), kIsoThreads, 0, stream>>>(p);
  return cudaGetLastError();
}
template <class T>
int iso_noise_list_backward(IsoNoiseBackwardList<T> const& p, CUstream_st* stream) {
  gradients_of_list<T><<<unsigned(p.items), kIsoThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

KV_INSTANTIATE_WITH_BYTES(sum_lightness, IsoNoise)
KV_INSTANTIATE_WITH_BYTES(iso_noise, IsoNoise)
KV_INSTANTIATE_WITH_BYTES(sum_lightness_list, IsoNoiseList)
KV_INSTANTIATE_WITH_BYTES(iso_noise_list, IsoNoiseList)
KV_INSTANTIATE(iso_noise_backward, IsoNoiseBackward)
KV_INSTANTIATE(sum_lightness_again, IsoNoiseBackwardList)
KV_INSTANTIATE(iso_noise_list_backward, IsoNoiseBackwardList)

}  // namespace kv::augmentation::cuda
