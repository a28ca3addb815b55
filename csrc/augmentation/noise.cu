// Noise on CUDA: a thread computes four pixels of a plane, from the four words of one block. A block of threads of a
// list finds its sample in the table.
#include "augmentation/noise.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

// Four adjacent pixels of a plane, fewer at its end. Vectorized: planar images whose planes are whole vectors.
template <class T, bool Vectorized>
struct FourPixels {
  Vector<T, 4> v;
  T const* x;
  T* y;
  int64_t step;
  int count;

  __device__ __forceinline__ FourPixels(PixelNoise<T> const& p, int64_t b, int64_t c, int64_t block)
      : x(p.x + p.offset(b, c) + 4 * block * p.step),
        y(p.y + p.offset(b, c) + 4 * block * p.step),
        step(p.step),
        count(int(min(p.pixels - 4 * block, int64_t(4)))) {
    if constexpr (Vectorized) {
      v = *reinterpret_cast<Vector<T, 4> const*>(x);
    } else {
#pragma unroll
      for (int i = 0; i < 4; ++i)
        if (i < count) v.v[i] = x[i * step];
    }
  }
  __device__ __forceinline__ void store() const {
    if constexpr (Vectorized) {
      store_vector(y, v);
    } else {
#pragma unroll
      for (int i = 0; i < 4; ++i)
        if (i < count) y[i * step] = v.v[i];
    }
  }
};

// Changes the pixels of a thread, number i of those of sample b. They are numbered with channels fastest in
// channels-last images, so that a warp reads adjacent memory.
template <class Change>
struct EachChannel {
  template <bool Vectorized, class T>
  static __device__ __forceinline__ void run(PixelNoise<T> const& p, int64_t b, int64_t i) {
    int64_t const blocks = p.blocks();
    if (i >= p.channels * blocks) return;
    bool const planar = p.step == 1;
    int64_t const c = planar ? i / blocks : i % p.channels, block = planar ? i - c * blocks : i / p.channels;
    FourPixels<T, Vectorized> four(p, b, c, block);
    if (p.is_chosen(b)) Change::change(p, b, c, block, four);
    four.store();
  }
};

struct NormalVariates {
  template <class F>
  static __device__ __forceinline__ void of(PhiloxWords const& words, F (&n)[4], bool) {
    if constexpr (sizeof(F) == 8) {
      normals_of(words, n);
    } else {
#pragma unroll
      for (int i = 0; i < 4; i += 2) normal_pair<1>(int32_t(words.w[i]), int32_t(words.w[i + 1]), n[i], n[i + 1]);
    }
  }
};

struct UniformVariates {
  template <class F>
  static __device__ __forceinline__ void of(PhiloxWords const& words, F (&n)[4], bool in_unit) {
#pragma unroll
    for (int i = 0; i < 4; ++i) n[i] = in_unit ? unit_of<F>(words.w[i]) : symmetric_of<F>(words.w[i]);
  }
};

template <class Variates>
struct AddNoise {
  template <class T, bool Vectorized>
  static __device__ __forceinline__ void change(PixelNoise<T> const& p, int64_t b, int64_t c, int64_t block,
                                                FourPixels<T, Vectorized>& four) {
    using F = Compute<T>;
    F const range = p.has(NoiseForm::multiply) ? F(1) : p.full_range;
    F const mean = p.parameters[b * p.parameter_stride] * range,
            deviation = p.parameters[b * p.parameter_stride + 1] * range;
    F n[4];
    Variates::of(p.source(b).words(p.draw, p.numbered(c, block)), n, p.has(NoiseForm::unit));
#pragma unroll
    for (int k = 0; k < 4; ++k) four.v.v[k] = round_to<T>(p.noisy(F(read(four.v.v[k])), F(n[k] * deviation + mean)));
  }
};

struct CountPhotons {
  template <class T, bool Vectorized>
  static __device__ __forceinline__ void change(PixelNoise<T> const& p, int64_t b, int64_t c, int64_t block,
                                                FourPixels<T, Vectorized>& four) {
    using F = Compute<T>;
    F const step = p.parameters[b * p.parameter_stride], power = p.parameters[b * p.parameter_stride + 1];
    float const* const given = p.uniform ? p.numbers(b) + c * p.pixels + 4 * block : nullptr;
    PhiloxWords words{};
    if (!given) words = p.source(b).words(p.draw, p.numbered(c, block));
#pragma unroll
    for (int k = 0; k < 4; ++k) {
      if (k >= four.count) break;
      F const x = read(four.v.v[k]) / p.full_range;
      F const y = shot(
          x, F(given ? given[k] : unit_of(words.w[k])), step, power,
          [](F base, F exponent) { return ::pow(base, exponent); }, [](F exponent) { return ::exp(exponent); },
          [](F square) { return ::sqrt(square); });
      four.v.v[k] = round_to<T>(y * p.full_range);
    }
  }
};

struct HitPixels {
  template <bool Vectorized, class T>
  static __device__ __forceinline__ void run(PixelNoise<T> const& p, int64_t b, int64_t block) {
    if (block >= p.blocks()) return;
    bool const chosen = p.is_chosen(b);
    PhiloxWords words{};
    if (chosen) words = p.source(b).words(p.draw, uint32_t(block));
    SaltAndPepper const hit(p.parameters[b * p.parameter_stride], p.parameters[b * p.parameter_stride + 1]);
    T pepper = round_to<T>(Compute<T>(0)), salt = round_to<T>(p.salt);
    for (int64_t c = 0; c < p.channels; ++c) {
      FourPixels<T, Vectorized> four(p, b, c, block);
      uint32_t const number = uint32_t(c * p.blocks() + block);
      if (chosen && c && p.has(NoiseForm::by_channel)) words = p.source(b).words(p.draw, number);
      if (chosen && p.has(NoiseForm::random)) {
        PhiloxWords const fill = p.source(b).words(p.draw + 1, number);
#pragma unroll
        for (int k = 0; k < 4; ++k)
          if (hit.is_hit(words.w[k])) four.v.v[k] = round_to<T>(fill_of<Compute<T>>(fill.w[k]) * p.full_range);
      } else if (chosen) {
        if (p.values) pepper = salt = round_to<T>(p.values[c * p.value_stride]);
#pragma unroll
        for (int k = 0; k < 4; ++k)
          if (hit.is_hit(words.w[k])) four.v.v[k] = hit.is_salt(words.w[k]) ? salt : pepper;
      }
      four.store();
    }
  }
};

template <class T>
KV_HD bool has_whole_vectors(PixelNoise<T> const& p) {
  constexpr size_t bytes = alignof(Vector<T, 4>);
  return p.step == 1 && p.pixels % 4 == 0 && reinterpret_cast<uintptr_t>(p.x) % bytes == 0 &&
         reinterpret_cast<uintptr_t>(p.y) % bytes == 0;
}

template <class Change, class T, bool Vectorized>
__global__ void __launch_bounds__(kNoiseThreads) change_pixels(__grid_constant__ PixelNoise<T> const p) {
  Change::template run<Vectorized>(p, blockIdx.y, blockIdx.x * int64_t(kNoiseThreads) + threadIdx.x);
}

template <class Change, class T>
int run_change(PixelNoise<T> const& p, int64_t threads_of_sample, CUstream_st* stream) {
  dim3 const grid(unsigned(ceil_div(threads_of_sample, kNoiseThreads)), unsigned(p.batch));
  with_alignment<T>(has_whole_vectors(p), [&](auto vectorized) {
    change_pixels<Change, T, vectorized.value><<<grid, kNoiseThreads, 0, stream>>>(p);
  });
  return cudaGetLastError();
}

template <class Change, class T>
__global__ void __launch_bounds__(kNoiseThreads) change_list(__grid_constant__ PixelNoiseList<T> const p) {
  int const b = p.list.sample_of(int(blockIdx.x));
  PixelNoise<T> const one = p.sample(b);
  int64_t const first = int64_t(int(blockIdx.x) - p.list.first[b]) * (kListedRuns * kNoiseThreads) + threadIdx.x;
  bool const vectorized = sizeof(T) < 8 && has_whole_vectors(one);
#pragma unroll 1
  for (int run = 0; run < kListedRuns; ++run) {
    int64_t const i = first + run * kNoiseThreads;
    if (vectorized)
      Change::template run<(sizeof(T) < 8)>(one, 0, i);
    else
      Change::template run<false>(one, 0, i);
  }
}

template <class Change, class T>
int run_list(PixelNoiseList<T> const& p, CUstream_st* stream) {
  static_assert(sizeof(PixelNoiseList<T>) <= 32764, "more than a kernel's parameters");
  change_list<Change, T><<<unsigned(p.list.items), kNoiseThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

using AddNormal = EachChannel<AddNoise<NormalVariates>>;
using AddUniform = EachChannel<AddNoise<UniformVariates>>;

}  // namespace

template <class T>
int gaussian_noise(PixelNoise<T> const& p, CUstream_st* stream) {
  return run_change<AddNormal>(p, p.channels * p.blocks(), stream);
}
template <class T>
int uniform_noise(PixelNoise<T> const& p, CUstream_st* stream) {
  return run_change<AddUniform>(p, p.channels * p.blocks(), stream);
}
template <class T>
int salt_and_pepper(PixelNoise<T> const& p, CUstream_st* stream) {
  return run_change<HitPixels>(p, p.blocks(), stream);
}
template <class T>
int shot_noise(PixelNoise<T> const& p, CUstream_st* stream) {
  return run_change<EachChannel<CountPhotons>>(p, p.channels * p.blocks(), stream);
}

template <class T>
int gaussian_noise_list(PixelNoiseList<T> const& p, CUstream_st* stream) {
  return run_list<AddNormal>(p, stream);
}
template <class T>
int uniform_noise_list(PixelNoiseList<T> const& p, CUstream_st* stream) {
  return run_list<AddUniform>(p, stream);
}
template <class T>
int salt_and_pepper_list(PixelNoiseList<T> const& p, CUstream_st* stream) {
  return run_list<HitPixels>(p, stream);
}
template <class T>
int shot_noise_list(PixelNoiseList<T> const& p, CUstream_st* stream) {
  return run_list<EachChannel<CountPhotons>>(p, stream);
}

KV_INSTANTIATE_WITH_BYTES(gaussian_noise, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(shot_noise, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(uniform_noise, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(salt_and_pepper, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(gaussian_noise_list, PixelNoiseList)
KV_INSTANTIATE_WITH_BYTES(uniform_noise_list, PixelNoiseList)
KV_INSTANTIATE_WITH_BYTES(salt_and_pepper_list, PixelNoiseList)
KV_INSTANTIATE_WITH_BYTES(shot_noise_list, PixelNoiseList)

}  // namespace kv::augmentation::cuda
