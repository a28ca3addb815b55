// Vectors against single elements, for one instruction set: compiled once for each. Single elements are tested against
// the definition of the formats here (bytes) and in half_test.cpp.
#include <cmath>
#include <cstring>
#include <vector>

#include "check.h"
#include "core/bytes.h"

namespace {

// Bit patterns of every kind: NaN, infinities, subnormals, and random ones from a linear congruence.
template <class T>
std::vector<T> patterns(size_t count) {
  std::vector<T> values(count);
  auto* bytes = reinterpret_cast<unsigned char*>(values.data());
  uint32_t state = 1;
  for (size_t i = 0; i < count * sizeof(T); ++i) bytes[i] = (state = state * 1664525u + 1013904223u) >> 24;
  return values;
}

// What is stored is drawn from the floats that matter: around 0 to 255, at the ends of half's range, not finite.
template <class F>
std::vector<F> numbers(size_t count) {
  std::vector<F> values{0,     -0.0f,    0.5f,      1.5f,     2.5f,     254.5f,     255.5f,  -0.5f, -1,
                        1e-7f, 1e-4f,    65504,     65519,    65520,    -65520,     1e30f,   3.3f,  NAN,
                        -NAN,  INFINITY, -INFINITY, 0x1p-24f, 0x1p-25f, 0x1.8p-24f, 0x1p24f, 1e-40f};
  uint32_t state = 1;
  while (values.size() < count) {
    state = state * 1664525u + 1013904223u;
    values.push_back(F(int32_t(state)) / F(1 << 22));
  }
  return values;
}

template <class F>
bool same(F a, F b) {
  return (a != a && b != b) || std::memcmp(&a, &b, sizeof(F)) == 0;
}

template <class T, int N>
void vectors_are_elements() {
  using F = kv::Compute<T>;
  size_t const count = 4096;
  std::vector<T> const memory = patterns<T>(count);
  for (size_t i = 0; i + N <= count; ++i) {  // every alignment
    auto const v = kv::load<N>(&memory[i]);
    F lanes[N];
    std::memcpy(lanes, &v, sizeof(lanes));
    for (int k = 0; k < N; ++k) CHECK(same(lanes[k], kv::load<1>(&memory[i + k])), sizeof(T), N, i, k, lanes[k]);
  }
  std::vector<F> const values = numbers<F>(count);
  std::vector<T> wide(count), narrow(count);
  for (size_t i = 0; i + N <= count; i += N) {
    kv::Lanes<F, N> v;
    std::memcpy(&v, &values[i], sizeof(v));
    kv::store<N>(&wide[i], v);
    for (int k = 0; k < N; ++k) kv::store<1>(&narrow[i + k], values[i + k]);
  }
  for (size_t i = 0; i < count / N * N; ++i)
    CHECK(same(kv::load<1>(&wide[i]), kv::load<1>(&narrow[i])), sizeof(T), N, i, values[i]);
  // A store touches its own elements and no others.
  std::vector<T> row = memory;
  kv::store<N>(&row[64], kv::broadcast<N>(F(1)));
  CHECK(std::memcmp(&row[0], &memory[0], 64 * sizeof(T)) == 0, sizeof(T), N);
  CHECK(std::memcmp(&row[64 + N], &memory[64 + N], 64 * sizeof(T)) == 0, sizeof(T), N);
}

void bytes_round_half_to_even_and_saturate() {
  struct {
    float value;
    int byte;
  } const cases[] = {{0.5f, 0}, {1.5f, 2},  {2.5f, 2},  {254.5f, 254}, {254.6f, 255},   {255.5f, 255},  {1e9f, 255},
                     {-1, 0},   {-0.5f, 0}, {1e-7f, 0}, {0.50001f, 1}, {INFINITY, 255}, {-INFINITY, 0}, {NAN, 0}};
  for (auto [value, byte] : cases) {
    uint8_t stored = 77;
    kv::store<1>(&stored, value);
    CHECK(stored == byte, value, int(stored), byte);
  }
}

template <class F, int N>
void square_roots() {
  std::vector<F> const values = numbers<F>(256);
  for (size_t i = 0; i + N <= values.size(); i += N) {
    kv::Lanes<F, N> v;
    std::memcpy(&v, &values[i], sizeof(v));
    v = kv::vsqrt(v);
    F roots[N];
    std::memcpy(roots, &v, sizeof(roots));
    for (int k = 0; k < N; ++k) CHECK(same(roots[k], F(std::sqrt(values[i + k]))), N, values[i + k], roots[k]);
  }
}

template <class T>
void ranges_are_covered() {
  for (int64_t begin : {0, 3})
    for (int64_t end = begin; end < begin + 70; ++end) {
      std::vector<int> seen(128);
      kv::for_each_vector<T>(begin, end, [&](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        CHECK(N == kv::kLanes<T> || (N == 1 && end - begin < kv::kLanes<T>), N, begin, end);
        CHECK(begin <= e && e + N <= end, N, e, begin, end);
        for (int k = 0; k < N; ++k) ++seen[e + k];
      });
      for (int64_t e = 0; e < 128; ++e) CHECK((seen[e] > 0) == (begin <= e && e < end), begin, end, e);
    }
}

template <class T>
void all() {
  constexpr int N = kv::kLanes<T>;
  vectors_are_elements<T, 1>();
  vectors_are_elements<T, N / 2>();
  vectors_are_elements<T, N>();
  ranges_are_covered<T>();
}

// Integers of 16 bits and bytes, N words at a time, against formulas of one element.
template <int N>
void words() {
  using Words = kv::Lanes<int16_t, N>;
  auto const a = patterns<int16_t>(N * 64), b = patterns<int16_t>(N * 64 + 7);
  for (int k = 0; k < 64; ++k) {
    Words const x = kv::read_lanes<N>(&a[k * N]), y = kv::read_lanes<N>(&b[k * N + 7]);
    Words const product = kv::rounded_product<N>(x, y);
    auto const sums = kv::pair_products<N / 2>(x, y);
    for (int i = 0; i < N; ++i) {
      int const exact = int(x[i]) * y[i];
      CHECK(product[i] == (exact + 0x4000) >> 15, i, x[i], y[i], product[i]);
      if (i % 2 == 1) CHECK(sums[i / 2] == exact + int(x[i - 1]) * y[i - 1], i, sums[i / 2]);
    }
    uint8_t clamped[N / 2];
    kv::store_clamped<N / 2>(clamped, kv::Lanes<int32_t, N / 2>(sums >> 20));
    for (int i = 0; i < N / 2; ++i) {
      int const level = sums[i] >> 20;
      CHECK(clamped[i] == (level < 0 ? 0 : level > 255 ? 255 : level), level, int(clamped[i]));
    }
    using Bytes = kv::Lanes<uint8_t, 2 * N>;
    auto const bytes = __builtin_bit_cast(Bytes, x);
    Bytes index = __builtin_bit_cast(Bytes, y);
    for (int i = 0; i < 2 * N; ++i) index[i] = index[i] < 64 ? kv::kNoByte : index[i] % 16;
    Bytes const picked = kv::permuted_bytes(bytes, index);
    for (int i = 0; i < 2 * N; ++i)
      CHECK(picked[i] == (index[i] == kv::kNoByte ? 0 : bytes[i / 16 * 16 + index[i]]), i, int(index[i]));
    using Ints = kv::Lanes<int32_t, N / 2>;
    Ints const levels[] = {sums >> 20, sums >> 22, sums >> 23, sums};
    auto const mixed = kv::clamped_bytes<N / 2>(levels[0], levels[1], levels[2], levels[3]);
    for (int i = 0; i < 2 * N; ++i) {
      int const level = levels[i / 4 % 4][i / 16 * 4 + i % 4];
      CHECK(mixed[i] == (level < 0 ? 0 : level > 255 ? 255 : level), i, level, int(mixed[i]));
    }
    auto const* const from = reinterpret_cast<uint8_t const*>(&a[k]);
    Ints const ints = kv::load_ints<N / 2>(from);
    for (int i = 0; i < N / 2; ++i) CHECK(ints[i] == from[i], i, ints[i]);
    auto const parts = kv::load_parts<N / 8>(from, from + 3);
    for (int i = 0; i < 2 * N; ++i) CHECK(parts[i] == from[i % 16 + i / 16 * 3], i, int(parts[i]));
    uint8_t low[N];
    kv::store_low_bytes<N>(low, __builtin_bit_cast(kv::Lanes<uint16_t, N>, x) & 255);
    for (int i = 0; i < N; ++i) CHECK(low[i] == (x[i] & 255), i, int(low[i]));
    Words const loaded = kv::load_words<N>(from);
    for (int i = 0; i < N; ++i) CHECK(loaded[i] == from[i], i, loaded[i]);
  }
}

void byte_table() {
  kv::ByteTable table;
  uint8_t from[300], to[300];
  for (int i = 0; i < 256; ++i) table.values[i] = uint8_t(i * 37 + 11);
  for (int i = 0; i < 300; ++i) from[i] = uint8_t(i * 5);
  table.map(from, to, 300);
  for (int i = 0; i < 300; ++i) CHECK(to[i] == uint8_t(from[i] * 37 + 11), i, int(to[i]));
}

bool has_instruction_set() {
#if defined(__AVX512F__)
  return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
         __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
#elif defined(__AVX2__)
  return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("f16c");
#else
  return true;
#endif
}

}  // namespace

int main() {
  if (!has_instruction_set()) return 77;
  all<float>();
  all<double>();
  all<kv::Half>();
  all<kv::BFloat16>();
  all<uint8_t>();
  bytes_round_half_to_even_and_saturate();
  byte_table();
  words<8>();
  if constexpr (kv::kVectorBytes >= 32) words<16>();
  square_roots<float, 1>();
  square_roots<float, kv::kLanes<float>>();
  square_roots<double, kv::kLanes<double>>();
  return failures();
}
