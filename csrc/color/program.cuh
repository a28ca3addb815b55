// Color programs on CUDA. A thread keeps P pixels in registers from step to step. All threads of a block work on one
// sample, so that they read the same step at a time. Storage types are converted on loading and storing, by vectors of
// up to 16 bytes if the memory is aligned.
#pragma once

#include <initializer_list>

#include "core/block_reduce.cuh"
#include "core/launch.cuh"
#include "core/nan_min_max.cuh"
#include "core/reciprocal.cuh"

namespace kv::color {

// The functions of numbers that steps.h uses. In double, logarithms and powers are not inlined: inlined, they take
// longer to compile than everything else.
__device__ __forceinline__ float log2_of(float x) {
  float y;
  asm("lg2.approx.ftz.f32 %0, %1;" : "=f"(y) : "f"(x));
  return y;
}
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
// The instruction takes denormal numbers for 0: where b is so small, both are scaled first.
__device__ __forceinline__ float quotient(float a, float b) {
  float const scale = fabsf(b) < 0x1p-100f ? 0x1p100f : 1.f;
  return a * scale * fast_reciprocal(b * scale);
}
__device__ __forceinline__ double quotient(double a, double b) { return a / b; }
using kv::nan_max;
using kv::nan_min;
// Minimum, maximum and comparisons take twice as long as sums and products, which saturate for free. Saturated, NaN is
// 0; the minimum makes it NaN again.
__device__ __forceinline__ float clamp_to_unit(float x) { return nan_min(__saturatef(x), fabsf(x)); }
__device__ __forceinline__ float saturate(float x) { return __saturatef(x); }
__device__ __forceinline__ float with_nan_of(float y, float x) { return __fmaf_rn(y, 0.f, x); }
__device__ __forceinline__ float clamp_to_unit_vjp(float x, float g) {
  float y;
  asm("{ .reg .pred clamped; setp.ne.f32 clamped, %1, %2; selp.f32 %0, 0f00000000, %3, clamped; }"
      : "=f"(y)
      : "f"(x), "f"(__saturatef(x)), "f"(g));
  return y;
}

__device__ __forceinline__ float equality(float a, float b) {
  float y;
  asm("set.eq.f32.f32 %0, %1, %2;" : "=f"(y) : "f"(a), "f"(b));
  return y;
}
__device__ __forceinline__ float share_of(float n) { return fast_reciprocal(fmaxf(n, 1.f)); }  // exact for 1 and 2

}  // namespace kv::color

#include "steps.h"

namespace kv::color::cuda {
namespace {

constexpr int kThreads = 256;
template <class F>
constexpr int kPixelsPerThread = int(kChunk<F> / kThreads);  // pixels

// --- a step on the pixels of a thread --------------------------------------------------------------------------------

template <class F, int C, int P, bool FrequentOnly = false>
struct EvaluateStep {
  static constexpr int kChannels = C;
  static constexpr bool kFrequentOnly = FrequentOnly;
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
template <class F, int C, int P, bool FrequentOnly = false>
struct StepInputGradient {
  static constexpr int kChannels = C;
  static constexpr bool kFrequentOnly = FrequentOnly;
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
  template <class Formula>
  __device__ __forceinline__ void each_value_vjp(Formula f) {
#pragma unroll
    for (int k = 0; k < C; ++k)
#pragma unroll
      for (int j = 0; j < P; ++j) f(c[k][j], g[k][j], k, p);
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

// The pixels, of a sample that starts at element `offset`, before the first whose P pixels are aligned vectors. P is 1
// or 4.
template <int P>
KV_HD int pixels_before_vectors(Pixels const& x, int64_t offset) {
  int64_t const element = int64_t(reinterpret_cast<uintptr_t>(x.data)) / size_of(x.type) + offset;
  return int((x.step == 1 ? -element : element) & (P - 1));  // element + 3 n is a multiple of 4 for n = element
}

// Chooses how a program accesses its images. Pixels are vectors if samples have them at the same pixels of all channels
// and of all images; the first pixels of a sample, and the last ones, may be no whole vector. Where the planes of a
// pixel begin differently, as those of odd sizes do, pixels are accessed element by element.
template <class F, int P>
inline void set_access(std::initializer_list<Pixels*> images, int64_t samples) {
  DType const computed = sizeof(F) == 8 ? DType::float64 : DType::float32;
  Pixels const& first = **images.begin();
  bool vectors = true;
  for (Pixels const* x : images) {
    if (!x->data || x->step == 0) continue;
    bool const planar = x->step == 1 && (x->channels == 1 || x->channel_stride % P == 0);
    vectors = vectors && (planar || (x->step == 3 && x->channels == 3));
    for (int64_t b : {int64_t(0), int64_t(1), x->inner})  // offsets are linear, so these decide for all samples
      if (b < samples)
        vectors =
            vectors && pixels_before_vectors<P>(*x, x->offset(b)) == pixels_before_vectors<P>(first, first.offset(b));
  }
  for (Pixels* x : images)
    x->access = !vectors                              ? Access::elements
                : x->type == computed && x->step == 1 ? Access::plain_vectors
                                                      : Access::vectors;
}

// Calls f with the channels of a kernel and whether it accesses single elements, as constants. In double all do.
template <class F, class Call>
void with_access(Pixels const& x, Call f) {
  auto const with_channels = [&](auto elements) {
    x.channels == 1 ? f(std::integral_constant<int, kChannelsOfValue<F>>{}, elements)
                    : f(std::integral_constant<int, 3>{}, elements);
  };
  if constexpr (sizeof(F) == 8)
    with_channels(std::true_type{});
  else
    x.access == Access::elements ? with_channels(std::true_type{}) : with_channels(std::false_type{});
}

// The pixels of a thread in a chunk of a sample: position, position + apart, ... With vectors they are adjacent, and
// chunks begin `skew` pixels before the sample, so that vectors are aligned. Otherwise the pixels of adjacent threads
// are adjacent, and a warp accesses elements of at most two cache lines at a time.
template <int P, bool Elements>
struct ThreadPixels {
  static constexpr int apart = Elements ? 32 : 1;
  int position, skew;
  // Of a sample that starts at element `offset`.
  __device__ __forceinline__ ThreadPixels(Pixels const& x, int64_t offset) {
    int const t = int(threadIdx.x);
    position = Elements ? t / 32 * 32 * P + t % 32 : t * P;
    skew = Elements ? 0 : -pixels_before_vectors<P>(x, offset) & (P - 1);
  }
};

__device__ __forceinline__ bool is_in(int64_t i, int64_t pixels) { return uint64_t(i) < uint64_t(pixels); }

// Calls f(j, its distance in elements from pixel i) for the pixels j of a thread that exist. Distances between single
// elements are constants where they can be.
template <int C, int P, bool Elements, class Call>
__device__ __forceinline__ void for_each_element(Pixels const& x, int64_t i, int64_t pixels, Call f) {
  auto const each = [&](auto step) {
    constexpr int apart = ThreadPixels<P, Elements>::apart;
#pragma unroll
    for (int j = 0; j < P; ++j)
      if (is_in(i + j * apart, pixels)) f(j, j * apart * step);
  };
  if (Elements && x.step == 1)
    each(std::integral_constant<int, 1>{});
  else if (Elements && C > 1 && x.step == C)
    each(std::integral_constant<int, C>{});
  else
    each(x.step);
}

// Pixels of planes, or single elements, as raw words of the compute type or a 16-bit type. fetch issues the loads;
// convert waits for them, so that loads of the next pixels overlap with the steps on these.
template <class F, int C, int P, bool Elements>
struct PrefetchedPixels {
  static constexpr bool kTakesHalf = sizeof(F) == 4;
  template <class T>
  static constexpr bool kSupported = sizeof(T) == sizeof(F) || kTakesHalf;
  static constexpr uint32_t kOrdinaryBits = 0x3f3f3f3f;  // a number between 0 and 2 in every type
  uint32_t words[C][4];                                  // of single elements: one or two for each

  static __device__ __forceinline__ bool is_half_type(Pixels const& x) {
    return kTakesHalf && (x.type == DType::float16 || x.type == DType::bfloat16);
  }
  static __device__ __forceinline__ bool supports(Pixels const& x) {
    bool const is_type = is_half_type(x) || x.type == (sizeof(F) == 8 ? DType::float64 : DType::float32);
    return x.channels == C && is_type && (Elements || x.step == 1);
  }
  // The words of pixels that do not exist.
  __device__ __forceinline__ void fill(uint32_t word) {
#pragma unroll
    for (int i = 0; i < 4 * C; ++i) words[i / 4][i % 4] = word;
  }
  __device__ __forceinline__ void fetch(Pixels const& x, int64_t offset, int64_t i, int64_t pixels) {
    if (is_half_type(x))
      fetch_as<Half>(x, offset, i, pixels);
    else
      fetch_as<F>(x, offset, i, pixels);
  }
  __device__ __forceinline__ void convert(Pixels const& x, F (&c)[C][P]) const {
    if (!is_half_type(x))
      convert_from<F>(x, c);
    else if (x.type == DType::float16)
      convert_from<Half>(x, c);
    else
      convert_from<BFloat16>(x, c);
  }

  // Pixels i, ... of a sample that starts at element `offset`. Words of pixels that do not exist stay as they are.
  template <class T>
  __device__ __forceinline__ void fetch_as(Pixels const& x, int64_t offset, int64_t i, int64_t pixels) {
    if constexpr (kSupported<T>) {
      T const* const from = static_cast<T const*>(x.data) + offset + i * x.step;
      if (!Elements && i >= 0 && i + P <= pixels) {
        using Words = Vector<uint32_t, int(P * sizeof(T) / 4)>;  // converted later, so that nothing waits for them here
#pragma unroll
        for (int k = 0; k < C; ++k) {
          auto const vector = *reinterpret_cast<Words const*>(from + k * x.channel_stride);
          __builtin_memcpy(words[k], vector.v, sizeof(vector));
        }
      } else if (!Elements) {
#pragma unroll
        for (int k = 0; k < C; ++k) {
          Vector<T, P> vector;
          __builtin_memcpy(&vector, words[k], sizeof(vector));
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (is_in(i + j, pixels)) vector.v[j] = from[k * x.channel_stride + j];
          __builtin_memcpy(words[k], &vector, sizeof(vector));
        }
      } else {
        for_each_element<C, P, Elements>(x, i, pixels, [&](int j, auto distance) {
#pragma unroll
          for (int k = 0; k < C; ++k) {
            T const element = from[k * x.channel_stride + distance];
            if constexpr (sizeof(T) == 2)  // a whole word, so that nothing waits for the element here
              words[k][j] = element.bits;
            else
              __builtin_memcpy(&words[k][j * kElementWords<T>], &element, sizeof(T));
          }
        });
      }
    }
  }
  template <class T>
  __device__ __forceinline__ void convert_from(Pixels const& x, F (&c)[C][P]) const {
    if constexpr (kSupported<T>) {
#pragma unroll
      for (int k = 0; k < C; ++k) {
        Vector<T, P> vector;
        if (!Elements) {
          __builtin_memcpy(&vector, words[k], sizeof(vector));
        } else {
#pragma unroll
          for (int j = 0; j < P; ++j) __builtin_memcpy(&vector.v[j], &words[k][j * kElementWords<T>], sizeof(T));
        }
#pragma unroll
        for (int j = 0; j < P; ++j) c[k][j] = F(read(vector.v[j]));
      }
    }
  }

 private:
  template <class T>
  static constexpr int kElementWords = sizeof(T) == 8 ? 2 : 1;
};

// Loads the pixels of a thread, of a sample that starts at element `offset`; i is the first one. With a step of 0 one
// number stands for all elements. Missing channels, and pixels that do not exist, become `fill`.
template <bool Elements, class F, int C, int P>
__device__ __forceinline__ void load_pixels(Pixels const& x, int64_t offset, int64_t i, int64_t pixels, F fill,
                                            F (&c)[C][P]) {
#pragma unroll
  for (int k = 0; k < C; ++k)
#pragma unroll
    for (int j = 0; j < P; ++j) c[k][j] = fill;
  dispatch_dtype(x.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kSupportsStorage<F, T>) {
      constexpr F scale = F(1. / kScale<T>);
      T const* const from = static_cast<T const*>(x.data) + offset + i * x.step;
      if (Elements || i < 0 || i + P > pixels) {
        for_each_element<C, P, Elements>(x, i, pixels, [&](int j, auto distance) {
#pragma unroll
          for (int k = 0; k < C; ++k)
            if (k < x.channels) c[k][j] = F(read(from[k * x.channel_stride + distance])) * scale;
        });
      } else if (x.step == 0) {
        F const number = F(read(*from)) * scale;
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j)
            if (k < x.channels) c[k][j] = number;
      } else if (x.step == 1) {
#pragma unroll
        for (int k = 0; k < C; ++k) {
          if (k >= x.channels) break;
          auto const vector = *reinterpret_cast<Vector<T, P> const*>(from + k * x.channel_stride);
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = F(read(vector.v[j])) * scale;
        }
      } else {
        Vector<T, P> vector[C];
#pragma unroll
        for (int k = 0; k < C; ++k) vector[k] = *reinterpret_cast<Vector<T, P> const*>(from + k * P);
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) c[k][j] = F(read(vector[(C * j + k) / P].v[(C * j + k) % P])) * scale;
      }
    }
  });
}

template <bool Elements, class F, int C, int P>
__device__ __forceinline__ void store_pixels(Pixels const& y, int64_t offset, int64_t i, int64_t pixels,
                                             F const (&c)[C][P]) {
  bool const whole = !Elements && i >= 0 && i + P <= pixels;
  if (whole && y.access == Access::plain_vectors) {
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
      T* const to = static_cast<T*>(y.data) + offset + i * y.step;
      if (!whole) {
        for_each_element<C, P, Elements>(y, i, pixels, [&](int j, auto distance) {
#pragma unroll
          for (int k = 0; k < C; ++k)
            if (k < y.channels) to[k * y.channel_stride + distance] = round_to<T>(Compute<T>(c[k][j] * scale));
        });
      } else if (y.step == 1) {
#pragma unroll
        for (int k = 0; k < C; ++k) {
          if (k >= y.channels) break;
          Compute<T> v[P];
#pragma unroll
          for (int j = 0; j < P; ++j) v[j] = Compute<T>(c[k][j] * scale);
          store_vector(to + k * y.channel_stride, v);
        }
      } else {
        Compute<T> v[C][P];
#pragma unroll
        for (int k = 0; k < C; ++k)
#pragma unroll
          for (int j = 0; j < P; ++j) v[(C * j + k) / P][(C * j + k) % P] = Compute<T>(c[k][j] * scale);
#pragma unroll
        for (int k = 0; k < C; ++k) store_vector(to + k * P, v[k]);
      }
    }
  });
}

// Applies frequent step `number`, one of [Begin, End). Three comparisons find it, which are fewer instructions than a
// jump by a table.
template <int Begin, int End, class P>
__device__ __forceinline__ void run_frequent_step(int number, P& pixels) {
  constexpr int kMiddle = (Begin + End) / 2;
  if constexpr (End - Begin == 1)
    run_step(frequent_step(Begin), pixels);
  else if (number < kMiddle)
    run_frequent_step<Begin, kMiddle>(number, pixels);
  else
    run_frequent_step<kMiddle, End>(number, pixels);
}
// Applies the step of an entry of Sample::order.
template <class Entry, class P>
__device__ __forceinline__ void run_entry(Entry const& entry, P& pixels) {
  if constexpr (takes_frequent_steps_only<P>())
    run_frequent_step<0, kFrequentStepCount>(entry.frequent, pixels);
  else
    run_step(entry.step, pixels);
}

// --- parameters and steps of a sample --------------------------------------------------------------------------------

// The partial sums of the mean of a sample, of so many pixels.
template <class F>
struct MeanParts {
  F const* parts;
  int64_t count, pixels;
};
template <class F>
__device__ __forceinline__ MeanParts<F> parts_of(Program<F> const& p, int64_t b) {
  return {p.parts + b * p.parts_count, p.parts_count, p.mean_pixels};
}

template <class F>
struct Sample {
  struct alignas(16) Entry {
    int index;  // of the step in the program
    Step step;
    int first;     // index of its first parameter
    int frequent;  // the number of the step among the frequent ones, if it is one
  };
  F p[kMaxParameters + kMaxStepTensorParameters];
  Entry order[kMaxSteps];
  int length, steps_before_mean;      // the latter are all of them without contrast
  int mean_parameter;                 // or -1 without contrast
  alignas(16) F sums[kThreads / 32];  // read by vectors, with nothing else in them
  F mean, grad_mean;                  // the latter per pixel

  __device__ __forceinline__ void prepare(Program<F> const& program, int64_t b, bool backward) {
    prepare(program, b, backward, parts_of(program, b));
  }
  __device__ __forceinline__ void prepare(Program<F> const& program, int64_t b, bool backward,
                                          MeanParts<F> const& of_mean) {
    constexpr unsigned kAll = 0xffffffffu;
    __syncthreads();  // the previous sample may still be in use
    int const t = int(threadIdx.x);
    if (t < 32) {  // a thread for each position, while other warps read the parameters
      int index = -1;
      if (program.has_order())
        index = t < program.length ? program.step_at(b, t) : -1;
      else if (t < program.steps)
        index = t;
      Step const step = program.step[max(index, 0)];
      unsigned const present = __ballot_sync(kAll, index >= 0);
      unsigned const around_mean = __ballot_sync(kAll, index >= 0 && step == Step::contrast);
      int const position = __popc(present & ((1u << t) - 1)), count = __popc(present);
      int const first = program.first[max(index, 0)];
      int const frequent = __popcll(kFrequentSteps & ((uint64_t(1) << int(step)) - 1));
      if (index >= 0) order[position] = {index, step, first, frequent};
      if (t == 0) {
        length = count;
        mean = grad_mean = 0;
        if (!around_mean) steps_before_mean = count, mean_parameter = -1;
      }
      if (around_mean && t == 31 - __clz(int(around_mean))) steps_before_mean = position, mean_parameter = first + 1;
    } else if (t < 32 + kMaxParameters + kMaxStepTensorParameters) {
      F const x = t - 32 < program.count ? program.parameter(b, t - 32) : F(0);
      p[t - 32] = program.inverted >> ((t - 32) % 64) & 1 ? reciprocal(x) : x;
    }
    __syncthreads();
    if (mean_parameter < 0 || (program.measures_mean && !backward)) return;
    F sum = 0;
    if (!program.measures_mean) {
      for (int64_t i = t; i < of_mean.count; i += kThreads) sum += of_mean.parts[i];
      sum = block_sum_to_all(sum, sums) / F(of_mean.pixels);
    }
    if (t == 0) {
      mean = backward ? program.means[b] : sum;
      grad_mean = sum;
      p[mean_parameter] = mean;
    }
    __syncthreads();
  }
};

template <class F>
bool has_frequent_steps_only(Program<F> const& p) {
  for (int i = 0; i < p.steps; ++i)
    if (!(kFrequentSteps >> int(p.step[i]) & 1)) return false;
  return true;
}
// Has the kernels for frequent steps read deviations as their reciprocals, which they need once a block.
template <class F>
void invert_deviations(Program<F>& p) {
  for (int i = 0; i < p.steps; ++i)
    if (p.step[i] == Step::standardize || p.step[i] == Step::standardize_rgb) {
      int const half = parameters_of(p.step[i]) / 2;  // means come first
      p.inverted |= ((uint64_t(1) << half) - 1) << (p.first[i] + half);
    }
}

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
