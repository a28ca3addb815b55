// Color programs on CUDA. Included by program_forward.cuh and program_backward.cuh. A thread keeps P pixels in
// registers from step to step. All threads of a block work on one sample, so that they read the same step at a time.
// Storage types are converted on loading and storing, by vectors of up to 16 bytes if the memory is aligned.
#pragma once

#include "core/block_reduce.cuh"
#include "core/launch.cuh"

namespace kv::color {

// The functions of numbers that steps.h uses. In double, logarithms and powers are not inlined: inlined, they take
// longer to compile than everything else.
__device__ __forceinline__ float log2_of(float x) { return fast_log2(x); }
__device__ __forceinline__ float exp2_of(float x) { return fast_exp2(x); }
inline __device__ __noinline__ double log2_of(double x) { return fast_log2(x); }
inline __device__ __noinline__ double exp2_of(double x) { return fast_exp2(x); }
__device__ __forceinline__ float floor_of(float x) { return floorf(x); }
__device__ __forceinline__ double floor_of(double x) { return floor(x); }
__device__ __forceinline__ float absolute(float x) { return fabsf(x); }
__device__ __forceinline__ double absolute(double x) { return fabs(x); }
// With a relative error of 2^-23, in a fifth of the instructions of a division. x * reciprocal(x) may exceed 1.
__device__ __forceinline__ float reciprocal(float x) {
  float y;
  asm("rcp.approx.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ double reciprocal(double x) { return 1 / x; }
__device__ __forceinline__ float nan_max(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return b <= a ? a : a == a ? b : a;
#else
  float y;
  asm("max.NaN.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
#endif
}
__device__ __forceinline__ float nan_min(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return -nan_max(-a, -b);
#else
  float y;
  asm("min.NaN.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
#endif
}
__device__ __forceinline__ double nan_max(double a, double b) { return b <= a ? a : a == a ? b : a; }
__device__ __forceinline__ double nan_min(double a, double b) { return -nan_max(-a, -b); }

}  // namespace kv::color

#include "steps.h"

namespace kv::color::cuda {
namespace {

constexpr int kThreads = 256;
template <class F>
constexpr int kPixelsPerThread = int(kChunk<F> / kThreads);  // pixels

// --- a step on the pixels of a thread --------------------------------------------------------------------------------

template <class F, int C, int P>
struct EvaluateStep {
  static constexpr int kChannels = C;
  static constexpr bool kParameterGradient = false, kInputGradient = false;
  F (&c)[C][P];
  F const* p;

  template <class Formula>
  __device__ __forceinline__ void each(Formula f) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      F v[C];
      for (int k = 0; k < C; ++k) v[k] = c[k][j];
      f(v, p, p);
      for (int k = 0; k < C; ++k) c[k][j] = v[k];
    }
  }
  template <class Formula>
  __device__ __forceinline__ void each_value(Formula f) {
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) f(c[k][j], k, p, p);
  }
};

// g <- g J, with the Jacobian J of the step
template <class F, int C, int P>
struct StepInputGradient {
  static constexpr int kChannels = C;
  static constexpr bool kParameterGradient = false, kInputGradient = true;
  F const (&c)[C][P];
  F (&g)[C][P];
  F const* p;

  template <class Formula>
  __device__ __forceinline__ void each_vjp(Formula f) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      F v[C], grads[C];
      for (int k = 0; k < C; ++k) v[k] = c[k][j], grads[k] = g[k][j];
      f(v, grads, p);
      for (int k = 0; k < C; ++k) g[k][j] = grads[k];
    }
  }
  template <class Formula>
  __device__ __forceinline__ void each(Formula f) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      Dual<F, C> v[C];
      for (int k = 0; k < C; ++k) {
        v[k].value = c[k][j];
        for (int d = 0; d < C; ++d) v[k].d[d] = F(k == d);
      }
      f(v, p, p);
      F grads[C]{};
      for (int k = 0; k < C; ++k)
        for (int d = 0; d < C; ++d) grads[d] += g[k][j] * v[k].d[d];
      for (int k = 0; k < C; ++k) g[k][j] = grads[k];
    }
  }
  template <class Formula>
  __device__ __forceinline__ void each_value(Formula f) {
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) {
        Dual<F, 1> v{c[k][j], {F(1)}};
        f(v, k, p, p);
        g[k][j] *= v.d[0];
      }
  }
};

// The gradient of parameter `index` of the step, summed over the pixels.
template <class F, int C, int P>
struct StepParameterGradient {
  static constexpr int kChannels = C;
  static constexpr bool kParameterGradient = true, kInputGradient = false;
  F const (&c)[C][P];
  F const (&g)[C][P];
  F const* p;
  int index;
  F sum;

  struct Parameters {
    Dual<F, 1> q[kMaxStepTensorParameters];
  };
  __device__ __forceinline__ Parameters parameters() const {
    Parameters all;
    for (int k = 0; k < kMaxStepTensorParameters; ++k) all.q[k] = {p[k], {F(k == index)}};
    return all;
  }
  template <class Formula>
  __device__ __forceinline__ void each(Formula f) {
    Parameters const all = parameters();
#pragma unroll
    for (int j = 0; j < P; ++j) {
      Dual<F, 1> v[C];
      for (int k = 0; k < C; ++k) v[k] = {c[k][j], {F(0)}};
      f(v, all.q, p);
      for (int k = 0; k < C; ++k) sum += g[k][j] * v[k].d[0];
    }
  }
  template <class Formula>
  __device__ __forceinline__ void each_value(Formula f) {
    Parameters const all = parameters();
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) {
        Dual<F, 1> v{c[k][j], {F(0)}};
        f(v, k, all.q, p);
        sum += g[k][j] * v.d[0];
      }
  }
};

// --- memory <-> registers --------------------------------------------------------------------------------------------

// Whether F is wide enough to compute with T.
template <class F, class T>
constexpr bool kSupportsStorage = sizeof(T) <= sizeof(F);
template <class T>
constexpr int kScale = sizeof(T) == 1 ? 255 : 1;

// Whether P pixels are vectors in memory.
template <int P>
inline bool is_vectorizable(Pixels const& x, int64_t pixels) {
  int64_t const odd = pixels | x.outer_stride | x.inner_stride | (x.step == 1 ? x.channel_stride : 0);
  return odd % P == 0 && reinterpret_cast<uintptr_t>(x.data) % 16 == 0 && (x.step == 1 || x.step == x.channels);
}
template <class F, int P>
inline void set_access(Pixels& x, int64_t pixels) {
  DType const computed = sizeof(F) == 8 ? DType::float64 : DType::float32;
  x.access = !is_vectorizable<P>(x, pixels)      ? Access::elements
             : x.type == computed && x.step == 1 ? Access::plain_vectors
                                                 : Access::vectors;
}

// Pixels of planes as raw words, of the compute type or a 16-bit type. fetch issues the loads; convert waits for them,
// so that loads of the next pixels overlap with the steps on these.
template <class F, int C, int P>
struct PrefetchedPixels {
  static constexpr bool kOfHalves = sizeof(F) == 4;
  template <class T>
  static constexpr bool kSupported = sizeof(T) == sizeof(F) || kOfHalves;
  static constexpr uint32_t kOrdinaryBits = 0x3f3f3f3f;  // a number between 0 and 2 in every type
  uint32_t words[C][4];

  static __device__ __forceinline__ bool are_halves(Pixels const& x) {
    return kOfHalves && (x.type == DType::float16 || x.type == DType::bfloat16);
  }
  static __device__ __forceinline__ bool supports(Pixels const& x) {
    bool const halves = are_halves(x) && x.access == Access::vectors && x.step == 1;
    return x.channels == C && (halves || x.access == Access::plain_vectors);
  }
  // The words of pixels past the end.
  __device__ __forceinline__ void fill(uint32_t word) {
#pragma unroll
    for (int i = 0; i < 4 * C; ++i) words[i / 4][i % 4] = word;
  }
  __device__ __forceinline__ void fetch(Pixels const& x, int64_t offset, int64_t i, int64_t pixels) {
    if (i >= pixels) return;
    if (are_halves(x))
      fetch_as<Half>(x, offset + i);
    else
      fetch_as<F>(x, offset + i);
  }
  __device__ __forceinline__ void convert(Pixels const& x, F (&c)[C][P]) const {
    if (!are_halves(x))
      convert_from<F>(c);
    else if (x.type == DType::float16)
      convert_from<Half>(c);
    else
      convert_from<BFloat16>(c);
  }

  template <class T>
  __device__ __forceinline__ void fetch_as(Pixels const& x, int64_t from) {
    if constexpr (kSupported<T>) {
      using Words = Vector<uint32_t, int(P * sizeof(T) / 4)>;  // converted later, so that nothing waits for them here
#pragma unroll
      for (int k = 0; k < C; ++k, from += x.channel_stride) {
        auto const vector = *reinterpret_cast<Words const*>(static_cast<T const*>(x.data) + from);
        __builtin_memcpy(words[k], vector.v, sizeof(vector));
      }
    }
  }
  template <class T>
  __device__ __forceinline__ void convert_from(F (&c)[C][P]) const {
    if constexpr (kSupported<T>) {
#pragma unroll
      for (int k = 0; k < C; ++k) {
        Vector<T, P> vector;
        __builtin_memcpy(&vector, words[k], sizeof(vector));
#pragma unroll
        for (int j = 0; j < P; ++j) c[k][j] = F(read(vector.v[j]));
      }
    }
  }
};

// Loads pixels i, i + 1, ... of a sample that starts at element `offset` of x. Missing channels, and pixels past the
// end, become `fill`.
template <class F, int C, int P>
__device__ __forceinline__ void load_pixels(Pixels const& x, int64_t offset, int64_t i, int64_t pixels, F fill,
                                            F (&c)[C][P]) {
#pragma unroll
  for (int k = 0; k < C; ++k)
#pragma unroll
    for (int j = 0; j < P; ++j) c[k][j] = fill;
  if (i >= pixels) return;
  dispatch_dtype(x.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kSupportsStorage<F, T>) {
      constexpr F scale = F(1. / kScale<T>);
      T const* const from = static_cast<T const*>(x.data) + offset;
      if (x.access == Access::elements) {
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (k < x.channels && i + j < pixels)
              c[k][j] = F(read(from[k * x.channel_stride + (i + j) * x.step])) * scale;
      } else if (x.step == 1) {
#pragma unroll
        for (int k = 0; k < C; ++k) {
          if (k >= x.channels) break;
          auto const vector = *reinterpret_cast<Vector<T, P> const*>(from + k * x.channel_stride + i);
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = F(read(vector.v[j])) * scale;
        }
      } else {
        Vector<T, P> vector[C];
#pragma unroll
        for (int k = 0; k < C; ++k) vector[k] = *reinterpret_cast<Vector<T, P> const*>(from + C * i + k * P);
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = F(read(vector[(C * j + k) / P].v[(C * j + k) % P])) * scale;
      }
    }
  });
}

template <class F, int C, int P>
__device__ __forceinline__ void store_pixels(Pixels const& y, int64_t offset, int64_t i, int64_t pixels,
                                             F const (&c)[C][P]) {
  if (i >= pixels) return;
  if (y.access == Access::plain_vectors) {
    F* to = static_cast<F*>(y.data) + offset + i;
#pragma unroll
    for (int k = 0; k < C; ++k, to += y.channel_stride) {
      if (k >= y.channels) break;
      store_vector(to, c[k]);
    }
    return;
  }
  dispatch_dtype(y.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kSupportsStorage<F, T>) {
      constexpr F scale = kScale<T>;
      auto const rounded = [&](F v) { return round_to<T>(Compute<T>(v * scale)); };
      T* const to = static_cast<T*>(y.data) + offset;
      if (y.access != Access::vectors) {
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (k < y.channels && i + j < pixels) to[k * y.channel_stride + (i + j) * y.step] = rounded(c[k][j]);
      } else if (y.step == 1) {
#pragma unroll
        for (int k = 0; k < C; ++k) {
          if (k >= y.channels) break;
          Vector<T, P> vector;
#pragma unroll
          for (int j = 0; j < P; ++j) vector.v[j] = rounded(c[k][j]);
          *reinterpret_cast<Vector<T, P>*>(to + k * y.channel_stride + i) = vector;
        }
      } else {
        Vector<T, P> vector[C];
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) vector[(C * j + k) / P].v[(C * j + k) % P] = rounded(c[k][j]);
#pragma unroll
        for (int k = 0; k < C; ++k) *reinterpret_cast<Vector<T, P>*>(to + C * i + k * P) = vector[k];
      }
    }
  });
}

// --- parameters and steps of a sample --------------------------------------------------------------------------------

template <class F>
struct Sample {
  struct Entry {
    int index;  // of the step in the program
    Step step;
    int first;  // index of its first parameter
  };
  F p[kMaxParameters + kMaxStepTensorParameters];
  Entry order[kMaxSteps];
  int length;
  alignas(16) F sums[kThreads / 32];  // read by vectors, with nothing else in them
  F mean, grad_mean;                  // the latter per pixel

  __device__ __forceinline__ void prepare(Program<F> const& program, int64_t b, bool backward) {
    __syncthreads();  // the previous sample may still be in use
    int const t = int(threadIdx.x);
    int contrast = program.contrast;
    if (!program.order) {
      if (t < program.steps) order[t] = {t, program.step[t], program.first[t]};
      if (t == 0) length = program.steps;
    } else if (t == 0 || contrast >= 0) {
      int n = 0;
      contrast = -1;
      for (int i = 0; i < program.length; ++i) {
        int const index = program.step_at(b, i);
        if (index < 0) continue;
        if (program.step[index] == Step::contrast) contrast = index;
        if (t == 0) order[n++] = {index, program.step[index], program.first[index]};
      }
      if (t == 0) length = n;
    }
    int const mean_parameter = contrast < 0 ? -1 : program.first[contrast] + 1;
    if (t < kMaxParameters + kMaxStepTensorParameters && t != mean_parameter)
      p[t] = t < program.count ? program.parameter(b, t) : F(0);
    if (contrast >= 0 && !(program.measures_mean && !backward)) {
      F sum = 0;
      if (!program.measures_mean) {
        for (int64_t i = t; i < program.parts_count; i += kThreads) sum += program.parts[b * program.parts_count + i];
        sum = block_sum_to_all(sum, sums) / F(program.pixels);
      }
      if (t == 0) {
        mean = backward ? program.means[b] : sum;
        grad_mean = sum;
        p[mean_parameter] = mean;
      }
    } else if (t == 0) {
      mean = grad_mean = 0;
    }
    __syncthreads();
  }
};

// The sample of block n. A second run takes them in reverse, because the last samples of the first run may still be in
// the L2 cache.
template <class F>
__device__ __forceinline__ int64_t sample_of(Program<F> const& p, int64_t n) {
  return p.contrast >= 0 && !p.measures_mean ? p.samples - 1 - n : n;
}

inline dim3 grid_of(int64_t samples, int64_t across) {
  return dim3(unsigned(across), unsigned(min(samples, int64_t(65535))));
}

}  // namespace
}  // namespace kv::color::cuda
