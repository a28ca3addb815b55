// Color programs on the CPU: a step at a time over a chunk of pixels, which stays in the L1 cache. Compiled once per
// instruction set.
#include "core/bytes.h"
#include "core/interleave.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::color {
namespace {

// The functions of Lanes that steps.h uses. In double, logarithms and powers are not inlined: inlined, they take longer
// to compile than the rest of this file.
template <class V>
__attribute__((noinline)) V called_log2(V x) {
  return vlog2<double, sizeof(V) / sizeof(double)>(x);
}
template <class V>
__attribute__((noinline)) V called_exp2(V x) {
  return vexp2<double, sizeof(V) / sizeof(double)>(x);
}
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V log2_of(V x) {
  if constexpr (sizeof(F) == 8)
    return called_log2(x);
  else
    return vlog2<F, sizeof(V) / sizeof(F)>(x);
}
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V exp2_of(V x) {
  if constexpr (sizeof(F) == 8)
    return called_exp2(x);
  else
    return vexp2<F, sizeof(V) / sizeof(F)>(x);
}
KV_HD float exp2_of(float x) { return vexp2<float, 1>(x); }
KV_HD double exp2_of(double x) { return vexp2<double, 1>(x); }
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V floor_of(V x) {
  return vfloor(x);
}
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V absolute(V x) {
  return vabs(x);
}
KV_HD float reciprocal(float x) { return 1 / x; }
KV_HD double reciprocal(double x) { return 1 / x; }
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V reciprocal(V x) {
  return 1 / x;
}
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V quotient(V a, V b) {
  return a / b;
}
// min and max keep a first operand that is NaN.
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V nan_max(V a, V b) {
  return b == b ? max(a, b) : b;
}
template <class V, class F = decltype(V{}[0] + 0)>
KV_HD V nan_min(V a, V b) {
  return b == b ? min(a, b) : b;
}

}  // namespace
}  // namespace kv::color

#include "steps.h"

namespace kv::color::KV_ISA {
namespace {

template <class F>
using Vector = Lanes<F, kLanes<F>>;

constexpr int kMaxStepParameters = 13;  // those of an affine step
static_assert(kMaxStepParameters >= kMaxStepTensorParameters);

template <class V>
KV_HD Scalar<V> sum_of(V const& v) {
  Scalar<V> sum = 0;
  for (int i = 0; i < int(sizeof(V) / sizeof(v[0])); ++i) sum += v[i];
  return sum;
}

// --- a step over a chunk: channel k starts at k * kChunk, n is rounded up to whole vectors ---------------------------

template <class F>
struct Chunk {
  F* data;
  int64_t stride = kChunk<F>;  // from channel to channel
  bool interleaved = false;    // three adjacent channels instead

  KV_HD F* channel(int k) const { return data + k * stride; }
};

// A vector of each channel. Special case: interleaved pixels in registers take .5 (gray) to .8 of the time that chunks
// in memory take them, one thread.
template <int C, class F>
KV_HD void load_pixels(Chunk<F const> c, int64_t i, Vector<F> (&v)[C]) {
  if constexpr (C == 3)
    if (c.interleaved) return load_interleaved<kLanes<F>>(c.data + 3 * i, v);
  for (int k = 0; k < C; ++k) v[k] = load<kLanes<F>>(c.channel(k) + i);
}
template <int C, class F>
KV_HD void store_pixels(Chunk<F> c, int64_t i, Vector<F> const (&v)[C], bool one_channel = false) {
  if constexpr (C == 3)
    if (c.interleaved) return store_interleaved<kLanes<F>>(c.data + 3 * i, v);
  for (int k = 0; k < C; ++k)
    if (k == 0 || !one_channel) store<kLanes<F>>(c.channel(k) + i, v[k]);
}

template <class F, int C>
struct EvaluateStep {
  static constexpr int kChannels = C;
  static constexpr bool kParameterGradient = false, kInputGradient = false;
  Chunk<F const> c;
  Chunk<F> result;  // may be c
  int64_t n;
  F const* p;
  bool one_channel = false;  // of the result

  // The parameters where no store to the result can change them, so that loops keep them in registers.
  struct Numbers {
    F n[kMaxStepParameters];
  };
  KV_HD Numbers numbers() const {
    Numbers all;
    for (int k = 0; k < kMaxStepParameters; ++k) all.n[k] = p[k];
    return all;
  }
  template <class Formula>
  KV_HD void each(Formula f) {
    constexpr int N = kLanes<F>;
    Numbers const q = numbers();
    for (int64_t i = 0; i < n; i += N) {
      Vector<F> v[C];
      load_pixels(c, i, v);
      f(v, q.n, q.n);
      store_pixels(result, i, v, one_channel);
    }
  }
  template <class Formula>
  KV_HD void each_value(Formula f) {
    constexpr int N = kLanes<F>;
    Numbers const q = numbers();
    if (C == 3 && (c.interleaved || result.interleaved)) {
      for (int64_t i = 0; i < n; i += N) {
        Vector<F> v[C];
        load_pixels(c, i, v);
#pragma GCC unroll 4
        for (int k = 0; k < C; ++k) f(v[k], k, q.n, q.n);
        store_pixels(result, i, v);
      }
      return;
    }
#pragma GCC unroll 4
    for (int k = 0; k < C; ++k)
      for (int64_t i = 0; i < n; i += N) {
        auto v = load<N>(c.channel(k) + i);
        f(v, k, q.n, q.n);
        store<N>(result.channel(k) + i, v);
      }
  }
};

// g <- g J, with the Jacobian J of the step
template <class F, int C>
struct StepInputGradient {
  static constexpr int kChannels = C;
  static constexpr bool kParameterGradient = false, kInputGradient = true;
  F const* c;
  F* g;
  int64_t n;
  F const* p;

  template <class Formula>
  KV_HD void each_vjp(Formula f) {
    constexpr int N = kLanes<F>;
    for (int64_t i = 0; i < n; i += N) {
      Vector<F> v[C], grads[C];
      for (int k = 0; k < C; ++k) v[k] = load<N>(c + k * kChunk<F> + i), grads[k] = load<N>(g + k * kChunk<F> + i);
      f(v, grads, p);
      for (int k = 0; k < C; ++k) store<N>(g + k * kChunk<F> + i, grads[k]);
    }
  }
  template <class Formula>
  KV_HD void each(Formula f) {
    constexpr int N = kLanes<F>;
    for (int64_t i = 0; i < n; i += N) {
      Dual<Vector<F>, C> v[C];
      Vector<F> grads[C]{};
      for (int k = 0; k < C; ++k) {
        v[k].value = load<N>(c + k * kChunk<F> + i);
        for (int d = 0; d < C; ++d) v[k].d[d] = broadcast<N>(F(k == d));
      }
      f(v, p, p);
      for (int k = 0; k < C; ++k) {
        auto const grad = load<N>(g + k * kChunk<F> + i);
        for (int d = 0; d < C; ++d) grads[d] = grads[d] + grad * v[k].d[d];
      }
      for (int k = 0; k < C; ++k) store<N>(g + k * kChunk<F> + i, grads[k]);
    }
  }
  template <class Formula>
  KV_HD void each_value(Formula f) {
    constexpr int N = kLanes<F>;
    for (int k = 0; k < C; ++k)
      for (int64_t i = k * kChunk<F>; i < k * kChunk<F> + n; i += N) {
        Dual<Vector<F>, 1> v{load<N>(c + i), {broadcast<N>(F(1))}};
        f(v, k, p, p);
        store<N>(g + i, Vector<F>(load<N>(g + i) * v.d[0]));
      }
  }
  template <class Formula>
  KV_HD void each_value_vjp(Formula f) {
    constexpr int N = kLanes<F>;
    for (int k = 0; k < C; ++k)
      for (int64_t i = k * kChunk<F>; i < k * kChunk<F> + n; i += N) {
        auto grad = load<N>(g + i);
        f(load<N>(c + i), grad, k, p);
        store<N>(g + i, grad);
      }
  }
};

// The gradient of parameter `index` of the step, summed over the chunk.
template <class F, int C>
struct StepParameterGradient {
  static constexpr int kChannels = C;
  static constexpr bool kParameterGradient = true, kInputGradient = false;
  F const* c;
  F const* g;
  int64_t n;
  F const* p;
  int index;
  F sum;

  using D = Dual<Vector<F>, 1>;
  struct Parameters {
    D q[kMaxStepTensorParameters];
  };
  KV_HD Parameters parameters() const {
    constexpr int N = kLanes<F>;
    Parameters all;
    for (int k = 0; k < kMaxStepTensorParameters; ++k) all.q[k] = {broadcast<N>(p[k]), {broadcast<N>(F(k == index))}};
    return all;
  }
  template <class Formula>
  KV_HD void each(Formula f) {
    constexpr int N = kLanes<F>;
    Parameters const all = parameters();
    Vector<F> total{};
    for (int64_t i = 0; i < n; i += N) {
      D v[C];
      for (int k = 0; k < C; ++k) v[k] = {load<N>(c + k * kChunk<F> + i), {Vector<F>{}}};
      f(v, all.q, p);
      for (int k = 0; k < C; ++k) total = total + load<N>(g + k * kChunk<F> + i) * v[k].d[0];
    }
    sum = sum_of(total);
  }
  template <class Formula>
  KV_HD void each_value(Formula f) {
    constexpr int N = kLanes<F>;
    Parameters const all = parameters();
    Vector<F> total{};
    for (int k = 0; k < C; ++k)
      for (int64_t i = k * kChunk<F>; i < k * kChunk<F> + n; i += N) {
        D v{load<N>(c + i), {Vector<F>{}}};
        f(v, k, all.q, p);
        total = total + load<N>(g + i) * v.d[0];
      }
    sum = sum_of(total);
  }
};

// Not inlined, because it is long and called from several places.
template <class P>
__attribute__((noinline)) void run_step_on_chunk(Step step, P& chunk) {
  run_step(step, chunk);
}

// --- memory <-> chunks -----------------------------------------------------------------------------------------------

// Whether F is wide enough to compute with T.
template <class F, class T>
constexpr bool kSupportsStorage = sizeof(F) == 8 || sizeof(T) < 8;
template <class T>
constexpr int kScale = sizeof(T) == 1 ? 255 : 1;

// Three adjacent channels, the layout of image files.
KV_HD bool is_interleaved(Pixels const& x) { return x.channels == 3 && x.channel_stride == 1 && x.step == 3; }

// Missing channels, and elements past the end, become `fill`.
template <class F>
__attribute__((noinline)) void load_chunk(Pixels const& x, int channels, int64_t b, int64_t first, int64_t count,
                                          F fill, F* c) {
  constexpr int N = kLanes<F>;
  int64_t const n = (count + N - 1) / N * N;
  for (int k = 0; k < channels; ++k)
    for (int64_t i = k < x.channels ? n - N : 0; i < n; i += N) store<N>(c + k * kChunk<F> + i, broadcast<N>(fill));
  dispatch_dtype(x.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kSupportsStorage<F, T>) {
      constexpr F scale = F(1. / kScale<T>);
      if (__is_same(F, Compute<T>) && is_interleaved(x)) {
        T const* const from = static_cast<T const*>(x.data) + x.offset(b) + 3 * first;
        for_each_vector<T>(0, count, [&](auto width, int64_t i) {
          constexpr int M = decltype(width)::value;
          if constexpr (__is_same(F, Compute<T>)) {
            Lanes<F, M> v[3];
            load_interleaved<M>(from + 3 * i, v);
            for (int k = 0; k < 3; ++k) store<M>(c + k * kChunk<F> + i, v[k] * scale);
          }
        });
        return;
      }
      for (int k = 0; k < x.channels; ++k) {
        T const* const from = static_cast<T const*>(x.data) + x.offset(b) + k * x.channel_stride + first * x.step;
        F* const to = c + k * kChunk<F>;
        if (__is_same(F, Compute<T>) && x.step == 1)
          for_each_vector<T>(0, count, [&](auto width, int64_t i) {
            constexpr int M = decltype(width)::value;
            __builtin_prefetch(from + i + kChunk<F>);  // the next chunk, while the steps work on this one
            if constexpr (__is_same(F, Compute<T>)) store<M>(to + i, load<M>(from + i) * scale);
          });
        else
          for (int64_t i = 0; i < count; ++i) to[i] = F(load<1>(from + i * x.step)) * scale;
      }
    }
  });
}

template <class F>
__attribute__((noinline)) void store_chunk(Pixels const& y, int64_t b, int64_t first, int64_t count, F const* c) {
  dispatch_dtype(y.type, [&](auto stored) {
    using T = decltype(stored);
    if constexpr (kSupportsStorage<F, T>) {
      constexpr F scale = kScale<T>;
      if (__is_same(F, Compute<T>) && is_interleaved(y)) {
        T* const to = static_cast<T*>(y.data) + y.offset(b) + 3 * first;
        for_each_vector<T>(0, count, [&](auto width, int64_t i) {
          constexpr int M = decltype(width)::value;
          if constexpr (__is_same(F, Compute<T>)) {
            Lanes<F, M> v[3];
            for (int k = 0; k < 3; ++k) v[k] = load<M>(c + k * kChunk<F> + i) * scale;
            store_interleaved<M>(to + 3 * i, v);
          }
        });
        return;
      }
      for (int k = 0; k < y.channels; ++k) {
        T* const to = static_cast<T*>(y.data) + y.offset(b) + k * y.channel_stride + first * y.step;
        F const* const from = c + k * kChunk<F>;
        if (__is_same(F, Compute<T>) && y.step == 1)
          for_each_vector<T>(0, count, [&](auto width, int64_t i) {
            constexpr int M = decltype(width)::value;
            __builtin_prefetch(to + i + kChunk<F>, 1);
            if constexpr (__is_same(F, Compute<T>)) store<M>(to + i, load<M>(from + i) * scale);
          });
        else
          for (int64_t i = 0; i < count; ++i) store<1>(to + i * y.step, Compute<T>(from[i] * scale));
      }
    }
  });
}

// Whether `count` pixels in memory are whole vectors of F, so that steps of C channels can work on them in place.
template <int C, class F>
KV_HD bool is_plain_chunk(Pixels const& x, int64_t count) {
  return x.type == (sizeof(F) == 4 ? DType::float32 : DType::float64) &&
         (x.step == 1 || (C == 3 && is_interleaved(x))) && count % kLanes<F> == 0;
}
template <class F>
KV_HD Chunk<F> chunk_at(Pixels const& x, int64_t b, int64_t first) {
  return {static_cast<F*>(x.data) + x.offset(b) + first * x.step, x.channel_stride, x.step == 3};
}

// --- programs --------------------------------------------------------------------------------------------------------

// Parameters and steps of a sample, the same for all its pixels.
template <class F>
struct Sample {
  F p[kMaxParameters + kMaxStepParameters]{};
  int order[kMaxSteps], length;
  F mean = 0, grad_mean = 0;  // the latter per pixel

  KV_HD Sample(Program<F> const& program, int64_t b, bool backward) : length(0) {
    for (int i = 0; i < program.count; ++i) p[i] = program.parameter(b, i);
    int contrast = -1;
    for (int i = 0; i < program.length; ++i)
      if (int const step = program.step_at(b, i); step >= 0) {
        order[length++] = step;
        if (program.step[step] == Step::contrast) contrast = step;
      }
    if (contrast < 0 || (program.measures_mean && !backward)) return;
    F sum = 0;
    for (int64_t i = 0; !program.measures_mean && i < program.parts_count; ++i)
      sum += program.parts[b * program.parts_count + i] / F(program.mean_pixels);
    mean = backward ? program.means[b] : sum;
    grad_mean = sum;
    p[program.first[contrast] + 1] = mean;
  }
};

// Calls f(sample, b, first pixel, pixels, chunk or part) for units of work [begin, end): chunks, or parts of the mean.
// Programs that keep nothing between steps may take all chunks of a sample in one call, `at_once`.
template <class F, class Work>
KV_HD void for_each_chunk(Program<F> const& p, bool backward, bool at_once, int64_t begin, int64_t end, Work f) {
  if (p.measures_mean)
    for (int64_t part = begin; part < end; ++part) p.parts[part] = 0;
  int64_t const chunks = chunks_of<F>(p.pixels), across = p.measures_mean ? p.parts_count : chunks;
  while (begin < end) {
    int64_t const b = begin / across, last = min(end, (b + 1) * across);
    Sample<F> const s(p, b, backward);
    if (at_once) {
      int64_t const first = (begin - b * across) * kChunk<F>;
      f(s, b, first, min((last - begin) * kChunk<F>, p.pixels - first), begin);
      begin = last;
    }
    for (; begin < last; ++begin)
      for (int64_t k = begin - b * across; k < chunks; k += p.measures_mean ? across : chunks)
        f(s, b, k * kChunk<F>, min(kChunk<F>, p.pixels - k * kChunk<F>), begin);
  }
}

// Whether the step's numbers are integers of 16 bits, as LumaOfLevels multiplies them; hsv_u8 has no numbers.
KV_HD bool has_words(Program<float> const& p) {
  bool words = true;
  for (float const* number = p.numbers; number < p.numbers + p.count; ++number)  // a NaN compares false
    words = words && *number >= -32768 && *number <= 32767 && float(int(*number)) == *number;
  return words;
}

// OpenCV's conversions of bytes stay in registers from image to result: they take few instructions, of which chunks in
// memory would be half. Special case: 3.7 to 4.6 times as fast, one thread.
KV_HD bool converts_bytes(Program<float> const& p) {
  auto const has_rows_of_bytes = [](Pixels const& x) {
    return x.type == DType::uint8 && (x.step == 1 || is_interleaved(x));
  };
  return p.steps == 1 && !p.has_order() && (p.step[0] == Step::luma_u8_fixed_point || p.step[0] == Step::hsv_u8) &&
         p.x.channels == 3 && has_rows_of_bytes(p.x) && has_rows_of_bytes(p.y) && has_words(p);
}

// Permutations of parts of 16 bytes, which hold four pixels of three interleaved channels: a channel as ints, and three
// channels of four bytes each as pixels. The second part is read from 4 bytes before its first pixel.
struct PixelOrders {
  alignas(32) uint8_t channel[3][32], pixels[32];

  constexpr PixelOrders() : channel{}, pixels{} {
    for (int i = 0; i < 32; ++i) {
      for (int k = 0; k < 3; ++k) channel[k][i] = i % 4 == 0 ? uint8_t(i % 16 / 4 * 3 + k + i / 16 * 4) : kNoByte;
      pixels[i] = i % 16 < 12 ? uint8_t(i % 3 * 4 + i % 16 / 3) : kNoByte;
    }
    for (int i = 16; i < 32; ++i) pixels[i] = pixels[i - 16];
  }
};
constexpr PixelOrders kPixelOrders;

using Levels = Lanes<int32_t, kPartInts>;

KV_HD void load_levels(uint8_t const* p, Levels (&c)[3]) {
  Lanes<uint8_t, 16 * kParts> pixels{};
  if constexpr (kParts == 1)
    __builtin_memcpy(&pixels, p, 12);
  else
    pixels = load_parts<kParts>(p, p + 8);
  for (int k = 0; k < 3; ++k)
    c[k] = __builtin_bit_cast(Levels, permuted_bytes(pixels, load_bytes<16 * kParts>(kPixelOrders.channel[k])));
}
KV_HD void store_levels(uint8_t* p, Levels const (&c)[3]) {
  auto const pixels = permuted_bytes(clamped_bytes<kPartInts>(c[0], c[1], c[2], Levels{}),
                                     load_bytes<16 * kParts>(kPixelOrders.pixels));
  for (int k = 0; k < kParts; ++k) __builtin_memcpy(p + 12 * k, reinterpret_cast<char const*>(&pixels) + 16 * k, 12);
}

// `formula` gives levels of the result from those of a pixel.
template <bool Interleaved, class Formula>
KV_HD void convert_bytes(Pixels const& x, Pixels const& y, int64_t b, int64_t first, int64_t count, Formula formula) {
  auto const* const from = static_cast<uint8_t const*>(x.data) + x.offset(b) + first * x.step;
  auto* const to = static_cast<uint8_t*>(y.data) + y.offset(b) + first * y.step;
  bool const writes_interleaved = is_interleaved(y);
  auto const convert = [&](int64_t i) {
    Levels c[3];
    if constexpr (Interleaved)
      load_levels(from + 3 * i, c);
    else
      for (int k = 0; k < 3; ++k) c[k] = load_ints<kPartInts>(from + k * x.channel_stride + i);
    formula(c);
    if (y.channels == 1)
      store_clamped<kPartInts>(to + i, c[0]);
    else if (writes_interleaved)
      store_levels(to + 3 * i, c);
    else
      for (int k = 0; k < 3; ++k) store_clamped<kPartInts>(to + k * y.channel_stride + i, c[k]);
  };
  for (int64_t i = 0; i + kPartInts <= count; i += kPartInts) convert(i);
  convert(count - kPartInts);
}

// luma_u8_fixed_point of levels, with weights in 32768ths for which has_words holds.
struct LumaOfLevels {
  Lanes<int16_t, 2 * kPartInts> red_green, blue;

  KV_HD explicit LumaOfLevels(float const* weights) {
    for (int i = 0; i < 2 * kPartInts; ++i)
      red_green[i] = int16_t(weights[i % 2]), blue[i] = i % 2 == 0 ? int16_t(weights[2]) : 0;
  }
  KV_HD void operator()(Levels (&c)[3]) const {
    using Words = Lanes<int16_t, 2 * kPartInts>;
    c[0] = (pair_products<kPartInts>(__builtin_bit_cast(Words, c[0] | c[1] << 16), red_green) +
            pair_products<kPartInts>(__builtin_bit_cast(Words, c[2]), blue) + 16384) >>
           15;
  }
};

// hsv_u8 of levels, in integers.
struct HsvOfLevels {
  KV_HD static Levels reciprocal(float factor, Levels x) {  // factor / x, rounded
    using V = Lanes<float, kPartInts>;
    return __builtin_convertvector(factor / __builtin_convertvector(x > 1 ? x : Levels{} + 1, V) + 0.5f, Levels);
  }
  KV_HD void operator()(Levels (&c)[3]) const {
    auto const high = [](Levels a, Levels b) { return a > b ? a : b; };
    auto const low = [](Levels a, Levels b) { return a < b ? a : b; };
    Levels const v = high(high(c[0], c[1]), c[2]), range = v - low(low(c[0], c[1]), c[2]);
    Levels const difference = v == c[0] ? c[1] - c[2] : v == c[1] ? c[2] - c[0] + 2 * range : c[0] - c[1] + 4 * range;
    Levels const hue = (difference * reciprocal(30 * 4096, range) + 2048) >> 12;
    c[0] = hue < 0 ? hue + 180 : hue;
    c[1] = (range * reciprocal(255 * 4096, v) + 2048) >> 12;
    c[2] = v;
  }
};

// At least a vector of pixels.
__attribute__((noinline)) void convert_bytes(Program<float> const& p, Sample<float> const& s, int64_t b, int64_t first,
                                             int64_t count) {
  auto const convert = [&](auto formula) {
    is_interleaved(p.x) ? convert_bytes<true>(p.x, p.y, b, first, count, formula)
                        : convert_bytes<false>(p.x, p.y, b, first, count, formula);
  };
  if (p.step[0] == Step::hsv_u8)
    convert(HsvOfLevels{});
  else
    convert(LumaOfLevels(s.p + p.first[0]));
}

// Whether a program is a function of one byte: of bytes to bytes, without a mean, of steps that compute every
// value in the same way. Its 256 values then take less time than the pixels. Special case: 2.7 (contrast) to 12 (gamma)
// times as fast, one thread.
KV_HD bool is_function_of_bytes(Program<float> const& p) {
  bool by_value = !p.measures_mean && p.contrast < 0;
  for (int k = 0; k < p.steps; ++k) by_value = by_value && is_per_value(p.step[k]);
  bool const by_channel = p.x.step == 1 && p.y.step == 1, interleaved = is_interleaved(p.x) && is_interleaved(p.y);
  return by_value && p.pixels >= 1024 && p.x.type == DType::uint8 && p.y.type == DType::uint8 &&
         (by_channel || interleaved);
}

__attribute__((noinline)) void map_bytes(Program<float> const& p, int64_t begin, int64_t end) {
  for_each_chunk(p, false, true, begin, end, [&](auto const& s, int64_t b, int64_t first, int64_t count, int64_t) {
    float c[kChunk<float>];
    for (int i = 0; i < 256; ++i) c[i] = float(i) / 255;
    for (int i = 0; i < s.length; ++i) {
      int const k = s.order[i];
      EvaluateStep<float, 1> values{{c}, {c}, 256, s.p + p.first[k]};
      run_step_on_chunk(p.step[k], values);
    }
    ByteTable table;
    for (int i = 0; i < 256; ++i) store<1>(table.values + i, c[i] * 255);
    auto const* const from = static_cast<uint8_t const*>(p.x.data) + p.x.offset(b) + first * p.x.step;
    auto* const to = static_cast<uint8_t*>(p.y.data) + p.y.offset(b) + first * p.y.step;
    if (p.x.step == 3) return table.map(from, to, 3 * count);
    for (int k = 0; k < p.x.channels; ++k) table.map(from + k * p.x.channel_stride, to + k * p.y.channel_stride, count);
  });
}

template <class F, int C>
void run(Program<F> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<F>;
  Scratch<F> scratch(C * kChunk<F>);
  F* const c = scratch.data;
  // The first step reads the image and the last one writes the result in place, if these hold numbers F. Special case:
  // 1.0 to 1.2 (normalize) times as fast, one thread.
  bool const one_channel = p.steps > 0 && outputs_one_channel(p.step[p.steps - 1]);
  bool const direct = !p.measures_mean && !p.has_order() && p.steps == 1 && (p.y.channels == C || one_channel) &&
                      p.x.channels == C && is_plain_chunk<C, F>(p.x, p.pixels) && is_plain_chunk<C, F>(p.y, p.pixels);
  if constexpr (sizeof(F) == 4)
    if (is_function_of_bytes(p)) return map_bytes(p, begin, end);
  bool in_registers = false;
  if constexpr (sizeof(F) == 4 && C == 3) in_registers = converts_bytes(p);
  auto const work = [&](Sample<F> const& s, int64_t b, int64_t first, int64_t count, int64_t part) {
    if constexpr (sizeof(F) == 4 && C == 3)
      if (in_registers && count >= kPartInts) return convert_bytes(p, s, b, first, count);
    bool const reads = p.x.channels == C && is_plain_chunk<C, F>(p.x, count) && s.length > 0 && !p.measures_mean;
    bool const writes =
        is_plain_chunk<C, F>(p.y, count) && s.length > 0 && !p.measures_mean && (p.y.channels == C || one_channel);
    if (!reads) load_chunk(p.x, C, b, first, count, F(0), c);
    for (int i = 0; i < s.length; ++i) {
      int const k = s.order[i];
      if (p.measures_mean && p.step[k] == Step::contrast) break;
      EvaluateStep<F, C> values{{c}, {c}, count, s.p + p.first[k], outputs_one_channel(p.step[k])};
      if (reads && i == 0) values.c = chunk_at<F const>(p.x, b, first);
      if (writes && i + 1 == s.length) values.result = chunk_at<F>(p.y, b, first);
      run_step_on_chunk(p.step[k], values);
    }
    if (p.contrast >= 0 && !p.measures_mean && first == 0) p.means[b] = s.mean;
    if (writes) return;
    if (!p.measures_mean) return store_chunk(p.y, b, first, count, c);
    Vector<F> sum{};
    int64_t i = 0;
    for (; i + N <= count; i += N)
      for (int k = 0; k < C; ++k) sum = sum + load<N>(c + k * kChunk<F> + i) * p.gray_weights[k];
    for (; i < count; ++i)
      for (int k = 0; k < C; ++k) p.parts[part] += c[k * kChunk<F> + i] * p.gray_weights[k];
    p.parts[part] += sum_of(sum);
  };
  for_each_chunk(p, false, direct || in_registers, begin, end, work);
}

template <class F, int C>
void run_backward(ProgramBackward<F> const& p, int64_t begin, int64_t end) {
  constexpr int64_t size = C * kChunk<F>;
  Program<F> const& q = p.forward;
  Scratch<F> scratch(size * (q.length + 1));
  F* const g = scratch.data + size * q.length;
  auto const work = [&](Sample<F> const& s, int64_t b, int64_t first, int64_t count, int64_t part) {
    if (p.reads_input) load_chunk(q.x, C, b, first, count, F(0.5), scratch.data);
    load_chunk(p.grad, C, b, first, count, F(0), g);
    int const last = p.last_input(s.length, [&](int i) { return s.order[i]; });
    for (int i = 0; i < last; ++i) {
      F* const c = scratch.data + size * i;
      EvaluateStep<F, C> values{{c}, {c + size}, count, s.p + q.first[s.order[i]]};
      run_step_on_chunk(q.step[s.order[i]], values);
    }
    for (int i = 0; p.partial_grads && i < p.columns; ++i) p.partial_grads[part * p.columns + i] = 0;
    for (int i = s.length; i-- > 0;) {
      int const k = s.order[i];
      F const* const c = scratch.data + size * min(i, last);
      StepParameterGradient<F, C> gradient{c, g, count, s.p + q.first[k], 1, 0};
      if (q.measures_mean && q.step[k] == Step::contrast) {
        run_step_on_chunk(q.step[k], gradient);
        q.parts[part] += gradient.sum;
        return;
      }
      for (int j = 0; p.partial_grads && takes_tensors(q.step[k]) && j < parameters_of(q.step[k]); ++j) {
        if (q.column[q.first[k] + j] < 0) continue;
        gradient.index = j;
        run_step_on_chunk(q.step[k], gradient);
        p.partial_grads[part * p.columns + q.column[q.first[k] + j]] += gradient.sum;
      }
      StepInputGradient<F, C> input_gradient{c, g, count, s.p + q.first[k]};
      run_step_on_chunk(q.step[k], input_gradient);
      if (q.step[k] == Step::contrast)
        for (int d = 0; d < C; ++d)
          for (int64_t j = 0; j < count; ++j) g[d * kChunk<F> + j] += q.gray_weights[d] * s.grad_mean;
    }
    if (p.needs_grad_x) store_chunk(p.grad_x, b, first, count, g);
  };
  for_each_chunk(q, true, false, begin, end, work);
}

}  // namespace

template <class F>
void program(Program<F> const& p, int64_t begin, int64_t end) {
  p.x.channels == 1 ? run<F, kChannelsOfValue<F>>(p, begin, end) : run<F, 3>(p, begin, end);
}
template <class F>
void program_backward(ProgramBackward<F> const& p, int64_t begin, int64_t end) {
  p.forward.x.channels == 1 ? run_backward<F, kChannelsOfValue<F>>(p, begin, end) : run_backward<F, 3>(p, begin, end);
}

template <class F>
void program_reduce(ProgramReduce<F> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) {
    F sum = 0;
    for (int64_t k = 0; k < p.summands; ++k) sum += p.first(i)[k * p.columns];
    p.sums[i] = sum;
  }
}

KV_INSTANTIATE_COMPUTED(program, Program)
KV_INSTANTIATE_COMPUTED(program_backward, ProgramBackward)
KV_INSTANTIATE_COMPUTED(program_reduce, ProgramReduce)

}  // namespace kv::color::KV_ISA
