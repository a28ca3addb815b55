// Included by program.cu, program_backward.cu and program_double.cu. Colour programs on CUDA: a thread takes P pixels
// in registers from step to step, and the steps are read one by one, by all threads of a block alike: they are in one
// sample. What is stored is a matter of loading and storing, by vectors of 16 bytes or less where memory allows it.
#pragma once

#include "core/launch.cuh"

namespace kv {

// What steps.h needs of numbers. In double logarithms and powers are called: inlined, they take longer to compile than
// all the rest.
__device__ __forceinline__ float log2_of(float x) { return fast_log2(x); }
__device__ __forceinline__ float exp2_of(float x) { return fast_exp2(x); }
inline __device__ __noinline__ double log2_of(double x) { return fast_log2(x); }
inline __device__ __noinline__ double exp2_of(double x) { return fast_exp2(x); }
__device__ __forceinline__ float floor_of(float x) { return floorf(x); }
__device__ __forceinline__ double floor_of(double x) { return floor(x); }
__device__ __forceinline__ float magnitude(float x) { return fabsf(x); }
__device__ __forceinline__ double magnitude(double x) { return fabs(x); }
// Right to 1 in 2^23, and a fifth of the instructions of a division; x times it may exceed 1.
__device__ __forceinline__ float reciprocal(float x) {
  float y;
  asm("rcp.approx.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
__device__ __forceinline__ double reciprocal(double x) { return 1 / x; }
__device__ __forceinline__ float larger(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return b <= a ? a : a == a ? b : a;
#else
  float y;
  asm("max.NaN.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
#endif
}
__device__ __forceinline__ float smaller(float a, float b) {
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ < 800
  return -larger(-a, -b);
#else
  float y;
  asm("min.NaN.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
#endif
}
__device__ __forceinline__ double larger(double a, double b) { return b <= a ? a : a == a ? b : a; }
__device__ __forceinline__ double smaller(double a, double b) { return -larger(-a, -b); }

}  // namespace kv

#include "steps.h"

namespace kv::cuda {
namespace {

constexpr int kThreads = 256;
template <class F>
constexpr int kTaken = int(kChunk<F> / kThreads);  // pixels of a thread

// --- a step over the pixels of a thread ------------------------------------------------------------------------------

template <class F, int C, int P>
struct Values {
  static constexpr int kChannels = C;
  static constexpr bool kOfParameters = false, kPulls = false;
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

// g <- g J
template <class F, int C, int P>
struct Pullback {
  static constexpr int kChannels = C;
  static constexpr bool kOfParameters = false, kPulls = true;
  F const (&c)[C][P];
  F (&g)[C][P];
  F const* p;

  template <class Formula>
  __device__ __forceinline__ void each_pulled(Formula f) {
#pragma unroll
    for (int j = 0; j < P; ++j) {
      F v[C], pulled[C];
      for (int k = 0; k < C; ++k) v[k] = c[k][j], pulled[k] = g[k][j];
      f(v, pulled, p);
      for (int k = 0; k < C; ++k) g[k][j] = pulled[k];
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
      F pulled[C]{};
      for (int k = 0; k < C; ++k)
        for (int d = 0; d < C; ++d) pulled[d] += g[k][j] * v[k].d[d];
      for (int k = 0; k < C; ++k) g[k][j] = pulled[k];
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

// The gradient of parameter `wanted` of the step, summed over the pixels.
template <class F, int C, int P>
struct Slope {
  static constexpr int kChannels = C;
  static constexpr bool kOfParameters = true, kPulls = false;
  F const (&c)[C][P];
  F const (&g)[C][P];
  F const* p;
  int wanted;
  F sum;

  struct Parameters {
    Dual<F, 1> q[kMostOfAStep];
  };
  __device__ __forceinline__ Parameters parameters() const {
    Parameters all;
    for (int k = 0; k < kMostOfAStep; ++k) all.q[k] = {p[k], {F(k == wanted)}};
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

// F computes with what T stores.
template <class F, class T>
constexpr bool kFits = sizeof(T) <= sizeof(F);
template <class T>
constexpr int kUnit = sizeof(T) == 1 ? 255 : 1;

// Whether P pixels are vectors in memory.
template <int P>
inline bool is_vectorizable(Pixels const& x, int64_t pixels) {
  int64_t const odd = pixels | x.outer_stride | x.inner_stride | (x.step == 1 ? x.channel_stride : 0);
  return odd % P == 0 && reinterpret_cast<uintptr_t>(x.data) % 16 == 0 && (x.step == 1 || x.step == x.channels);
}
template <class F, int P>
inline void set_access(Pixels& x, int64_t pixels) {
  DType const computed = sizeof(F) == 8 ? DType::float64 : DType::float32;
  x.access = !is_vectorizable<P>(x, pixels)      ? Access::each
             : x.type == computed && x.step == 1 ? Access::plain
                                                 : Access::vectors;
}

// Planes of pixels as they come from memory, of what is computed in or of halves: asked for in time, they are waited
// for where they become numbers.
template <class F, int C, int P>
struct Asked {
  static constexpr bool kOfHalves = sizeof(F) == 4;
  template <class T>
  static constexpr bool kAsks = sizeof(T) == sizeof(F) || kOfHalves;
  static constexpr uint32_t kSome = 0x3f3f3f3f;  // a number between 0 and 2 in every type
  uint32_t words[C][4];

  static __device__ __forceinline__ bool are_halves(Pixels const& x) {
    return kOfHalves && (x.type == DType::float16 || x.type == DType::bfloat16);
  }
  static __device__ __forceinline__ bool of(Pixels const& x) {
    bool const halves = are_halves(x) && x.access == Access::vectors && x.step == 1;
    return x.channels == C && (halves || x.access == Access::plain);
  }
  // What pixels are that there are not.
  __device__ __forceinline__ void fill(uint32_t word) {
#pragma unroll
    for (int i = 0; i < 4 * C; ++i) words[i / 4][i % 4] = word;
  }
  __device__ __forceinline__ void ask(Pixels const& x, int64_t at, int64_t i, int64_t pixels) {
    if (i >= pixels) return;
    if (are_halves(x))
      ask_for<Half>(x, at + i);
    else
      ask_for<F>(x, at + i);
  }
  __device__ __forceinline__ void take(Pixels const& x, F (&c)[C][P]) const {
    if (!are_halves(x))
      take_as<F>(c);
    else if (x.type == DType::float16)
      take_as<Half>(c);
    else
      take_as<BFloat16>(c);
  }

  template <class T>
  __device__ __forceinline__ void ask_for(Pixels const& x, int64_t from) {
    if constexpr (kAsks<T>) {
      using Words = Vector<uint32_t, int(P * sizeof(T) / 4)>;  // not taken apart before they are there
#pragma unroll
      for (int k = 0; k < C; ++k, from += x.channel_stride) {
        auto const vector = *reinterpret_cast<Words const*>(static_cast<T const*>(x.data) + from);
        __builtin_memcpy(words[k], vector.v, sizeof(vector));
      }
    }
  }
  template <class T>
  __device__ __forceinline__ void take_as(F (&c)[C][P]) const {
    if constexpr (kAsks<T>) {
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

// The pixels from i on of a sample, which begins `at` elements into x. Channels that there are not, and what is beyond
// the end, become `rest`.
template <class F, int C, int P>
__device__ __forceinline__ void load_pixels(Pixels const& x, int64_t at, int64_t i, int64_t pixels, F rest,
                                            F (&c)[C][P]) {
#pragma unroll
  for (int k = 0; k < C; ++k)
#pragma unroll
    for (int j = 0; j < P; ++j) c[k][j] = rest;
  if (i >= pixels) return;
  dispatch_dtype(x.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kFits<F, T>) {
      constexpr F unit = F(1. / kUnit<T>);
      T const* const from = static_cast<T const*>(x.data) + at;
      if (x.access == Access::each) {
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (k < x.channels && i + j < pixels)
              c[k][j] = F(read(from[k * x.channel_stride + (i + j) * x.step])) * unit;
      } else if (x.step == 1) {
#pragma unroll
        for (int k = 0; k < C; ++k) {
          if (k >= x.channels) break;
          auto const vector = *reinterpret_cast<Vector<T, P> const*>(from + k * x.channel_stride + i);
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = F(read(vector.v[j])) * unit;
        }
      } else {
        Vector<T, P> vector[C];
#pragma unroll
        for (int k = 0; k < C; ++k) vector[k] = *reinterpret_cast<Vector<T, P> const*>(from + C * i + k * P);
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = F(read(vector[(C * j + k) / P].v[(C * j + k) % P])) * unit;
      }
    }
  });
}

template <class F, int C, int P>
__device__ __forceinline__ void store_pixels(Pixels const& y, int64_t at, int64_t i, int64_t pixels,
                                             F const (&c)[C][P]) {
  if (i >= pixels) return;
  if (y.access == Access::plain) {
    F* to = static_cast<F*>(y.data) + at + i;
#pragma unroll
    for (int k = 0; k < C; ++k, to += y.channel_stride) {
      if (k >= y.channels) break;
      store_vector(to, c[k]);
    }
    return;
  }
  dispatch_dtype(y.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kFits<F, T>) {
      constexpr F unit = kUnit<T>;
      auto const rounded = [&](F v) { return round_to<T>(Compute<T>(v * unit)); };
      T* const to = static_cast<T*>(y.data) + at;
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

// --- what is the same for all pixels of a sample, and sums over a block ----------------------------------------------

template <class F>
struct Sample {
  struct Place {
    int at;  // of the step in the program
    Step step;
    int first;  // of its parameters
  };
  F p[kMostParameters + kMostOfAStep];
  Place order[kMostSteps];
  int length;
  alignas(16) F sums[kThreads / 32];  // read by vectors, with nothing else in them
  F mean, mean_slope;                 // and the mean's gradient, for each pixel

  // Of all threads, to all threads.
  __device__ __forceinline__ F sum_of_block(F v) {
    v = warp_sum(v);
    __syncthreads();
    if (threadIdx.x % 32 == 0) sums[threadIdx.x / 32] = v;
    __syncthreads();
    F total = 0;
#pragma unroll
    for (int i = 0; i < kThreads / 32; ++i) total += sums[i];
    return total;
  }

  __device__ __forceinline__ void prepare(Program<F> const& program, int64_t b, bool backward) {
    __syncthreads();  // the sample before may be in use
    int const t = int(threadIdx.x);
    int found = program.contrast;
    if (!program.order) {
      if (t < program.steps) order[t] = {t, program.step[t], program.first[t]};
      if (t == 0) length = program.steps;
    } else if (t == 0 || found >= 0) {
      int n = 0;
      found = -1;
      for (int i = 0; i < program.length; ++i) {
        int const at = program.step_at(b, i);
        if (at < 0) continue;
        if (program.step[at] == Step::contrast) found = at;
        if (t == 0) order[n++] = {at, program.step[at], program.first[at]};
      }
      if (t == 0) length = n;
    }
    int const of_mean = found < 0 ? -1 : program.first[found] + 1;
    if (t < kMostParameters + kMostOfAStep && t != of_mean) p[t] = t < program.count ? program.parameter(b, t) : F(0);
    if (found >= 0 && !(program.measures && !backward)) {
      F sum = 0;
      if (!program.measures) {
        for (int64_t i = t; i < program.parts_count; i += kThreads) sum += program.parts[b * program.parts_count + i];
        sum = sum_of_block(sum) / F(program.pixels);
      }
      if (t == 0) {
        mean = backward ? program.means[b] : sum;
        mean_slope = sum;
        p[of_mean] = mean;
      }
    } else if (t == 0) {
      mean = mean_slope = 0;
    }
    __syncthreads();
  }
};

// The sample of the block that is n-th of its grid. After a first run over them, which ended with the last ones, those
// may still be in the L2.
template <class F>
__device__ __forceinline__ int64_t sample_of(Program<F> const& p, int64_t n) {
  return p.contrast >= 0 && !p.measures ? p.samples - 1 - n : n;
}

inline dim3 grid_of(int64_t samples, int64_t across) {
  return dim3(unsigned(across), unsigned(min(samples, int64_t(65535))));
}

}  // namespace
}  // namespace kv::cuda
