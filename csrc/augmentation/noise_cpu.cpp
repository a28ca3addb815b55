// Noise on the CPU: chunks [begin, end) of the planes of samples. Compiled once per instruction set.
#include <cstddef>

#include "core/ceil_div.h"
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "augmentation/noise.h"

namespace kv::augmentation::KV_ISA {
namespace {

constexpr int kBlocksPerVector = kVectorBytes / 8;  // blocks at once: products of words take 64 bits
using Words = Lanes<uint64_t, kBlocksPerVector>;

// The products of the lower 32 bits of lanes with m.
KV_HD Words times(Words a, uint32_t m) {
#if defined(__AVX512F__)
  return (Words)_mm512_mul_epu32((__m512i)a, _mm512_set1_epi64(m));
#elif defined(__AVX2__)
  return (Words)_mm256_mul_epu32((__m256i)a, _mm256_set1_epi64x(m));
#elif defined(__SSE2__)
  return (Words)_mm_mul_epu32((__m128i)a, _mm_set1_epi64x(m));
#else
  return (a & 0xffffffffu) * m;
#endif
}

// The words of kBlocksPerVector blocks from `block` on; see philox in core/philox.h. Upper halves are garbage.
KV_HD void philox_blocks(DrawSource const& source, uint32_t draw, uint32_t block, Words (&w)[4]) {
  Words a = Words{} + draw, b = Words{} + block, c = Words{} + source.sample, d = Words{} + source.position;
  for (int i = 0; i < kBlocksPerVector; ++i) b[i] = uint32_t(block + uint32_t(i));
  uint32_t low = uint32_t(source.key), high = uint32_t(source.key >> 32);
  for (int round = 0; round < 10; ++round) {
    Words const first = times(a, 0xD2511F53u), second = times(c, 0xCD9E8D57u);
    a = (second >> 32) ^ b ^ low;
    c = (first >> 32) ^ d ^ high;
    b = second;
    d = first;
    low += 0x9E3779B9u;
    high += 0xBB67AE85u;
  }
  w[0] = a, w[1] = b, w[2] = c, w[3] = d;
}

constexpr int kChunk = kNoiseChunk, kBuffer = kChunk + 8 * kBlocksPerVector;

// Variates of the chunk that begins with `block`.
KV_HD void fill_normals(DrawSource const& source, uint32_t draw, uint32_t block, int count, float* to) {
  constexpr int N = 2 * kBlocksPerVector;
  using Ints = Lanes<int32_t, N>;
  for (int first = 0; first < count; first += 4 * N) {
    Words low[4], high[4];
    philox_blocks(source, draw, block + uint32_t(first / 4), low);
    philox_blocks(source, draw, block + uint32_t(first / 4 + kBlocksPerVector), high);
    // As twice as many lanes of 32 bits: lane 2 k is of block k, lane 2 k + 1 of block kBlocksPerVector + k.
    Ints words[4];
    for (int i = 0; i < 4; ++i) words[i] = __builtin_bit_cast(Ints, Words((low[i] & 0xffffffffu) | high[i] << 32));
    Lanes<float, N> n[4];
    for (int i = 0; i < 4; i += 2) normal_pair<N>(words[i], words[i + 1], n[i], n[i + 1]);
    float lanes[4][N];
    for (int i = 0; i < 4; ++i) store<N>(lanes[i], n[i]);
    for (int k = 0; k < kBlocksPerVector; ++k)
      for (int i = 0; i < 4; ++i) {
        to[first + 4 * k + i] = lanes[i][2 * k];
        to[first + 4 * (kBlocksPerVector + k) + i] = lanes[i][2 * k + 1];
      }
  }
}
KV_HD void fill_normals(DrawSource const& source, uint32_t draw, uint32_t block, int count, double* to) {
  for (int first = 0; first < count; first += 4) {
    double n[4];
    normals_of(source.words(draw, block + uint32_t(first / 4)), n);
    for (int i = 0; i < 4; ++i) to[first + i] = n[i];
  }
}

KV_HD void fill_words(DrawSource const& source, uint32_t draw, uint32_t block, int count, uint32_t* to) {
  for (int first = 0; first < count; first += 4 * kBlocksPerVector) {
    Words w[4];
    philox_blocks(source, draw, block + uint32_t(first / 4), w);
    for (int k = 0; k < kBlocksPerVector; ++k)
      for (int i = 0; i < 4; ++i) to[first + 4 * k + i] = uint32_t(w[i][k]);
  }
}

struct NormalVariates {
  template <class F>
  static KV_HD void fill(DrawSource const& source, uint32_t draw, uint32_t block, int count, F* to, bool) {
    fill_normals(source, draw, block, count, to);
  }
};

struct UniformVariates {
  template <class F>
  static KV_HD void fill(DrawSource const& source, uint32_t draw, uint32_t block, int count, F* to, bool in_unit) {
    uint32_t words[kBuffer];
    fill_words(source, draw, block, count, words);
    for (int i = 0; i < count; ++i) to[i] = in_unit ? unit_of<F>(words[i]) : symmetric_of<F>(words[i]);
  }
};

template <class T>
KV_HD void copy_chunk(PixelNoise<T> const& p, int64_t at, int count) {
  if (p.step == 1)
    __builtin_memcpy(p.y + at, p.x + at, size_t(count) * sizeof(T));
  else
    for (int i = 0; i < count; ++i) p.y[at + i * p.step] = p.x[at + i * p.step];
}

// Calls change(sample, channel, first pixel, number of pixels, position of the first one) for chunks of chosen samples,
// channel by channel, and copies those of the others.
template <class T, class Change>
KV_HD void for_each_chunk(PixelNoise<T> const& p, int64_t begin, int64_t end, Change const& change) {
  int64_t const chunks = ceil_div(p.pixels, kChunk);
  for (int64_t unit = begin; unit < end; ++unit) {
    int64_t const b = unit / chunks, first = unit % chunks * kChunk;
    int const count = int(min(p.pixels - first, int64_t(kChunk)));
    bool const is_chosen = p.is_chosen(b);
    for (int64_t c = 0; c < p.channels; ++c) {
      int64_t const at = p.offset(b, c) + first * p.step;
      is_chosen ? change(b, c, first, count, at) : copy_chunk(p, at, count);
    }
  }
}

template <class Variates, class T>
KV_HD void add_noise(PixelNoise<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  F noise[kBuffer];
  for_each_chunk(p, begin, end, [&](int64_t b, int64_t c, int64_t first, int count, int64_t at) KV_INLINE {
    F const range = p.has(NoiseForm::multiply) ? F(1) : p.full_range;
    F const mean = p.parameters[b * p.parameter_stride] * range,
            deviation = p.parameters[b * p.parameter_stride + 1] * range;
    Variates::fill(p.source(b), p.draw, p.numbered(c, first / 4), count, noise, p.has(NoiseForm::unit));
    for (int i = 0; i < count; ++i) noise[i] = noise[i] * deviation + mean;
    auto const pixels = [&](auto n, int64_t i) {
      constexpr int N = decltype(n)::value;
      int64_t const element = at + i * p.step;
      store<N>(p.y + element, p.noisy(Lanes<F, N>(load<N>(p.x + element)), Lanes<F, N>(load<N>(noise + i))));
    };
    if (p.step == 1)
      for_each_vector<T>(0, count, pixels);
    else
      for (int64_t i = 0; i < count; ++i) pixels(Width<1>{}, i);
  });
}

}  // namespace

template <class T>
void gaussian_noise(PixelNoise<T> const& p, int64_t begin, int64_t end) {
  add_noise<NormalVariates>(p, begin, end);
}

template <class T>
void uniform_noise(PixelNoise<T> const& p, int64_t begin, int64_t end) {
  add_noise<UniformVariates>(p, begin, end);
}

template <class T>
void salt_and_pepper(PixelNoise<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  uint32_t words[kBuffer], fill[kBuffer];
  struct Hit {
    int at;
    T value;
  } hits[kChunk];
  T pepper, salt;
  store<1>(&pepper, F(0));
  store<1>(&salt, p.salt);
  int hit_pixels = 0;
  for_each_chunk(p, begin, end, [&](int64_t b, int64_t c, int64_t first, int count, int64_t at) KV_INLINE {
    uint32_t const block = uint32_t(c * p.blocks() + first / 4);
    int num_hits = hit_pixels;
    if (c == 0 || p.has(NoiseForm::by_channel)) {
      SaltAndPepper const hit(p.parameters[b * p.parameter_stride], p.parameters[b * p.parameter_stride + 1]);
      fill_words(p.source(b), p.draw, block, count, words);
      num_hits = 0;
      for (int i = 0; i < count; ++i) {
        hits[num_hits] = {i, hit.is_salt(words[i]) ? salt : pepper};
        num_hits += hit.is_hit(words[i]);
      }
      hit_pixels = num_hits;
    }
    if (num_hits && p.has(NoiseForm::random)) {
      fill_words(p.source(b), p.draw + 1, block, count, fill);
      for (int i = 0; i < num_hits; ++i) store<1>(&hits[i].value, F(fill_of<F>(fill[hits[i].at]) * p.full_range));
    }
    if (num_hits && p.values)
      for (int i = 0; i < num_hits; ++i) store<1>(&hits[i].value, p.values[c * p.value_stride]);
    copy_chunk(p, at, count);
    for (int i = 0; i < num_hits; ++i) p.y[at + hits[i].at * p.step] = hits[i].value;
  });
}

template <class T>
void shot_noise(PixelNoise<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  uint32_t words[kBuffer];
  for_each_chunk(p, begin, end, [&](int64_t b, int64_t c, int64_t first, int count, int64_t at) KV_INLINE {
    F const step = p.parameters[b * p.parameter_stride], power = p.parameters[b * p.parameter_stride + 1];
    float const* const given = p.uniform ? p.numbers(b) + c * p.pixels + first : nullptr;
    if (!given) fill_words(p.source(b), p.draw, p.numbered(c, first / 4), count, words);
    for (int i = 0; i < count; ++i) {
      F const u = given ? given[i] : unit_of(words[i]);
      F const x = load<1>(p.x + at + i * p.step) / p.full_range;
      F const y = shot(
          x, u, step, power, [](F base, F exponent) { return F(__builtin_pow(base, exponent)); },
          [](F exponent) { return F(__builtin_exp(exponent)); }, [](F square) { return F(__builtin_sqrt(square)); });
      store<1>(p.y + at + i * p.step, Lanes<F, 1>(y * p.full_range));
    }
  });
}

template <class T>
void gaussian_noise_list(PixelNoiseList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::gaussian_noise(p.sample(b), first, last); });
}
template <class T>
void uniform_noise_list(PixelNoiseList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::uniform_noise(p.sample(b), first, last); });
}
template <class T>
void salt_and_pepper_list(PixelNoiseList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::salt_and_pepper(p.sample(b), first, last); });
}
template <class T>
void shot_noise_list(PixelNoiseList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end,
                  [&](int b, int64_t first, int64_t last) { KV_ISA::shot_noise(p.sample(b), first, last); });
}

KV_INSTANTIATE_WITH_BYTES(gaussian_noise, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(shot_noise, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(uniform_noise, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(salt_and_pepper, PixelNoise)
KV_INSTANTIATE_WITH_BYTES(gaussian_noise_list, PixelNoiseList)
KV_INSTANTIATE_WITH_BYTES(uniform_noise_list, PixelNoiseList)
KV_INSTANTIATE_WITH_BYTES(salt_and_pepper_list, PixelNoiseList)
KV_INSTANTIATE_WITH_BYTES(shot_noise_list, PixelNoiseList)

}  // namespace kv::augmentation::KV_ISA
