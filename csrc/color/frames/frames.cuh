// How kernels of frames read and write codes.
#pragma once

#include <utility>

#include "core/launch.cuh"
#include "core/nan_min_max.cuh"
#include "core/row_prefetcher.cuh"
#include "frames.h"

namespace kv::color::cuda {
namespace {

// Columns of a thread; of kernels that take whole rows, the threads and the warps of a block.
constexpr int kOwn = 8, kRowThreads = 256, kRowWarps = kRowThreads / 32;

// Calls f with the type of codes, as an object whose `type` it is.
template <class T, class Call>
int with_codes(int code_bytes, Call f) {
  if (code_bytes == 1) return f(std::type_identity<uint8_t>{});
  if (code_bytes == 2) return f(std::type_identity<uint16_t>{});
  if constexpr (!__is_same(T, uint8_t))
    return f(std::type_identity<T>{});
  else
    return cudaErrorInvalidValue;  // which the entry has refused
}

// By an or and a subtraction: the conversion instruction has a quarter of their rate.
template <class S>
__device__ __forceinline__ auto number_of(S code) {
  if constexpr (__is_same(S, uint8_t) || __is_same(S, uint16_t))
    return __uint_as_float(0x4b000000u | uint32_t(code)) - 8388608.f;
  else
    return read(code);
}

template <class S, class T>
struct Reader {
  PlanesToRgb<T> const& p;
  int64_t frame;
  __device__ __forceinline__ Compute<T> operator()(int plane, int row, int column) const {
    return Compute<T>(number_of(p.planes[plane].template row<S>(frame, row)[column * p.planes[plane].column_stride]));
  }
};

// A color of a sum of weights of 1.
template <class F>
__device__ __forceinline__ F channel_of(FrameColors<F> const& colors, int k, F y, F u, F v) {
  return nan_min(nan_max(colors.linear(k, y, u, v, F(1)), colors.lowest[k]), colors.highest[k]);
}

// Added to this, a number in [0, 255] is rounded to an integer in the lowest byte: the conversion instruction has an
// eighth of the rate.
constexpr float kRounding = 12582912;
__device__ __forceinline__ uint32_t four_bytes(uint32_t const (&bits)[4]) {
  return __byte_perm(__byte_perm(bits[0], bits[1], 0x0040), __byte_perm(bits[2], bits[3], 0x0040), 0x5410);
}
// Numbers in [0, 1], which are clamped to that, as bytes.
template <int N>
struct Levels {
  uint32_t words[N / 4];
};
template <int N>
__device__ __forceinline__ Levels<N> levels_of(float const (&numbers)[N]) {
  Levels<N> levels;
#pragma unroll
  for (int k = 0; k < N / 4; ++k) {
    uint32_t bits[4];
#pragma unroll
    for (int j = 0; j < 4; ++j) bits[j] = __float_as_uint(__saturatef(numbers[4 * k + j]) * 255.f + kRounding);
    levels.words[k] = four_bytes(bits);
  }
  return levels;
}

// Two numbers of a half type within bounds. They are rounded first, which changes nothing.
template <class T>
__device__ __forceinline__ uint32_t pair_within(float first, float second, float low, float high) {
  uint32_t pair;
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 800
  if constexpr (__is_same(T, Half))
    asm("{.reg .b32 l, h; cvt.rn.f16x2.f32 l, %3, %3; cvt.rn.f16x2.f32 h, %4, %4; cvt.rn.f16x2.f32 %0, %2, %1; "
        "max.NaN.f16x2 %0, %0, l; min.NaN.f16x2 %0, %0, h;}"
        : "=&r"(pair)
        : "f"(first), "f"(second), "f"(low), "f"(high));
  else
    asm("{.reg .b32 l, h; cvt.rn.bf16x2.f32 l, %3, %3; cvt.rn.bf16x2.f32 h, %4, %4; cvt.rn.bf16x2.f32 %0, %2, %1; "
        "max.NaN.bf16x2 %0, %0, l; min.NaN.bf16x2 %0, %0, h;}"
        : "=&r"(pair)
        : "f"(first), "f"(second), "f"(low), "f"(high));
#else
  auto const stored = [&](float x) { return uint32_t(round_to<T>(nan_min(nan_max(x, low), high)).bits); };
  pair = stored(first) | stored(second) << 16;
#endif
  return pair;
}

// Stores numbers within bounds at two rows, or at the first one; bytes are within [0, 255].
template <class T>
__device__ __forceinline__ void store_rows(T* to, int64_t stride, bool has_second, float const (&numbers)[2], float low,
                                           float high) {
  T stored[2];
  if constexpr (sizeof(T) == 2) {
    uint32_t const pair = pair_within<T>(numbers[0], numbers[1], low, high);
    stored[0].bits = uint16_t(pair), stored[1].bits = uint16_t(pair >> 16);
  } else {
#pragma unroll
    for (int r = 0; r < 2; ++r) {
      float const number = nan_min(nan_max(numbers[r], low), high);
      if constexpr (sizeof(T) == 1)
        stored[r] = uint8_t(__float_as_uint(number + kRounding));
      else
        stored[r] = number;
    }
  }
  *to = stored[0];
  if (has_second) to[stride] = stored[1];
}

// Numbers within bounds, rounded; bytes are within [0, 255].
template <class T, int N>
__device__ __forceinline__ Vector<T, N> within(float const (&numbers)[N], float low, float high) {
  Vector<T, N> stored;
  constexpr int kWords = N * int(sizeof(T)) / 4;
  uint32_t words[kWords];
#pragma unroll
  for (int k = 0; k < kWords; ++k) {
    if constexpr (sizeof(T) == 1) {
      uint32_t bits[4];
#pragma unroll
      for (int j = 0; j < 4; ++j)
        bits[j] = __float_as_uint(nan_min(nan_max(numbers[4 * k + j], low), high) + kRounding);
      words[k] = four_bytes(bits);
    } else if constexpr (sizeof(T) == 2) {
      words[k] = pair_within<T>(numbers[2 * k], numbers[2 * k + 1], low, high);
    } else {
      words[k] = __float_as_uint(nan_min(nan_max(numbers[k], low), high));
    }
  }
  __builtin_memcpy(&stored, words, sizeof(stored));
  return stored;
}

// --- codes by words --------------------------------------------------------------------------------------------------

// Words of which `bytes` bytes exist, at least one. `vectors`: all words are one aligned vector where they all exist.
template <int N>
__device__ __forceinline__ void fetch_words(char const* from, int bytes, bool vectors, uint32_t (&words)[N]) {
  if (vectors && bytes >= 4 * N) {
    auto const vector = *reinterpret_cast<Vector<uint32_t, N> const*>(from);
#pragma unroll
    for (int k = 0; k < N; ++k) words[k] = vector.v[k];
    return;
  }
  int const skew = int(reinterpret_cast<uintptr_t>(from) % 4), end = min(bytes, 4 * N + 4 - skew) + skew,
            whole = end / 4;
  auto const* const aligned = reinterpret_cast<uint32_t const*>(from - skew);
  uint32_t own[N + 1];
#pragma unroll
  for (int k = 0; k <= N; ++k) own[k] = k < whole ? aligned[k] : 0;
  if (end % 4 != 0) {  // the word at the end of the last row may not be there as a whole
    uint32_t part = 0;
    for (int i = 4 * whole; i < end; ++i)
      if (i >= skew) part |= uint32_t(uint8_t(from[i - skew])) << 8 * (i % 4);
#pragma unroll
    for (int k = 0; k <= N; ++k)
      if (k == whole) own[k] = part;
  }
#pragma unroll
  for (int k = 0; k < N; ++k) words[k] = __funnelshift_r(own[k], own[k + 1], 8 * skew);
}

// Row `row` of rows that are `stride` bytes apart, in one instruction.
__device__ __forceinline__ char const* row_of(char const* first, int row, int stride) {
  char const* at;
  asm("mad.wide.s32 %0, %1, %2, %3;" : "=l"(at) : "r"(row), "r"(stride), "l"(first));
  return at;
}

enum class CodeLayout : int { pairs, swapped_pairs, planes, packed };

// Where codes that are integers lie, if chroma has half of the columns.
struct CodeRowsPlan {
  CodeLayout layout;
  bool luma_vectors, chroma_vectors;  // rows begin at multiples of a thread's codes
  bool is_plain;                      // pairs of chroma, all rows begin at vectors and end with one
  // 2^23 as bits. As a constant it would take an instruction each time: one of a permutation's operands can be
  // constant, which is the selector.
  uint32_t exponent = 0x4b000000;
};
template <class T>
bool plan_rows(PlanesToRgb<T> const& p, CodeRowsPlan& plan) {
  CodePlane const &y = p.planes[0], &u = p.planes[1], &v = p.planes[2];
  int const size = p.code_bytes;
  if (size == 0 || !p.x.is_halved()) return false;
  auto const address = [](CodePlane const& x) { return reinterpret_cast<intptr_t>(x.data); };
  intptr_t const apart = address(v) - address(u);
  bool const same_rows = u.row_stride == v.row_stride && u.frame_stride == v.frame_stride;
  bool const are_pairs = y.column_stride == 1 && u.column_stride == 2 && v.column_stride == 2 && same_rows;
  if (are_pairs && (apart == size || apart == -size))
    plan.layout = apart > 0 ? CodeLayout::pairs : CodeLayout::swapped_pairs;
  else if (size == 1 && y.column_stride == 1 && u.column_stride == 1 && v.column_stride == 1 &&
           u.row_stride == v.row_stride)
    plan.layout = CodeLayout::planes;
  else if (size == 1 && y.column_stride == 2 && u.column_stride == 4 && v.column_stride == 4 && same_rows &&
           y.row_stride == u.row_stride && address(u) - address(y) == 1 && apart == 2 && p.x.size % 2 == 0)
    plan.layout = CodeLayout::packed;
  else
    return false;
  auto const is_addressable = [&](CodePlane const& x, int rows) {
    return x.row_stride >= 0 && x.row_stride * size * rows <= INT32_MAX;
  };
  if (!is_addressable(y, p.y.size) || !is_addressable(u, p.y.chroma_size)) return false;
  auto const are_vectors = [&](CodePlane const& x, int bytes, intptr_t first) {
    return (first | x.row_stride * size | x.frame_stride * size) % bytes == 0;
  };
  bool const is_packed = plan.layout == CodeLayout::packed, has_planes = plan.layout == CodeLayout::planes;
  plan.luma_vectors = are_vectors(y, kOwn * size * (is_packed ? 2 : 1), address(y));
  plan.chroma_vectors = has_planes ? are_vectors(u, kOwn / 2, address(u)) && are_vectors(v, kOwn / 2, address(v))
                                   : are_vectors(u, kOwn * size, min(address(u), address(v)));
  plan.is_plain = !is_packed && !has_planes && plan.luma_vectors && plan.chroma_vectors && p.x.size % kOwn == 0;
  return true;
}

// Where pairs of chroma are v and u, has kernels take the first one for u.
template <class T>
void take_first_for_u(PlanesToRgb<T>& p) {
  if (p.planes[2].data >= p.planes[1].data) return;
  std::swap(p.planes[1], p.planes[2]);
  for (int k = 0; k < 3; ++k) std::swap(p.colors.matrix[3 * k + 1], p.colors.matrix[3 * k + 2]);
}

// The codes of a thread's columns in a row: of luma, or u and v in turns.
template <class S>
struct OwnCodes {
  static constexpr int kWords = kOwn * int(sizeof(S)) / 4;
  uint32_t words[kWords];

  // By a permutation and a subtraction: the conversion instruction has a quarter of their rate.
  __device__ __forceinline__ float number(int j, uint32_t exponent) const {
    uint32_t const selector = sizeof(S) == 1 ? 0x7440u + uint32_t(j % 4) : j % 2 ? 0x7432u : 0x7410u;
    return __uint_as_float(__byte_perm(words[j * int(sizeof(S)) / 4], exponent, selector)) - 8388608.f;
  }
};

// Words of a thread for a row in a ring: a vector, or as many as codes that begin within a word may take.
KV_HD constexpr int slot_words(int code_bytes, bool is_plain) { return is_plain ? kOwn * code_bytes / 4 : 5; }

// Rows of codes, from the first own column on.
template <class S, bool Plain>
struct CodeRows {
  CodeLayout layout;
  char const *luma, *chroma, *v;  // the first own column of the first row
  int luma_stride, chroma_stride;
  int luma_bytes, chroma_bytes;  // of own columns that exist, and those behind them
  bool luma_vectors, chroma_vectors;

  template <class T>
  __device__ __forceinline__ CodeRows(PlanesToRgb<T> const& p, CodeRowsPlan const& plan, int64_t frame, int x)
      : layout(plan.layout), luma_vectors(plan.luma_vectors), chroma_vectors(plan.chroma_vectors) {
    constexpr int kBytes = sizeof(S);
    auto const plane = [&](int k) { return reinterpret_cast<char const*>(p.planes[k].template row<S>(frame, 0)); };
    auto const stride = [&](int k) { return int(p.planes[k].row_stride) * kBytes; };
    bool const is_packed = layout == CodeLayout::packed, has_planes = layout == CodeLayout::planes;
    luma = plane(0) + x * kBytes * (is_packed ? 2 : 1);
    chroma = is_packed ? luma : plane(layout == CodeLayout::swapped_pairs ? 2 : 1) + (has_planes ? x / 2 : x * kBytes);
    v = plane(2) + x / 2;
    luma_stride = stride(0), chroma_stride = stride(1);
    luma_bytes = (p.x.size - x) * kBytes * (is_packed ? 2 : 1);
    chroma_bytes = is_packed ? luma_bytes : has_planes ? p.x.chroma_size - x / 2 : (2 * p.x.chroma_size - x) * kBytes;
  }

  __device__ __forceinline__ char const* luma_row(int row) const { return row_of(luma, row, luma_stride); }
  __device__ __forceinline__ char const* chroma_row(int row) const { return row_of(chroma, row, chroma_stride); }

  static __device__ __forceinline__ void swap(OwnCodes<S>& codes) {
#pragma unroll
    for (uint32_t& word : codes.words) word = __byte_perm(word, 0, sizeof(S) == 1 ? 0x2301 : 0x1032);
  }
  // One code of each two of a packed row.
  static __device__ __forceinline__ void split(uint32_t const (&both)[2 * OwnCodes<S>::kWords], uint32_t selector,
                                               OwnCodes<S>& codes) {
#pragma unroll
    for (int k = 0; k < OwnCodes<S>::kWords; ++k) codes.words[k] = __byte_perm(both[2 * k], both[2 * k + 1], selector);
  }
  __device__ __forceinline__ void unpack(char const* row, uint32_t selector, OwnCodes<S>& codes) const {
    uint32_t both[2 * OwnCodes<S>::kWords];
    fetch_words(row, luma_bytes, luma_vectors, both);
    split(both, selector, codes);
  }
  static __device__ __forceinline__ void interleave(uint32_t u, uint32_t v, OwnCodes<S>& codes) {
    codes.words[0] = __byte_perm(u, v, 0x5140);
    codes.words[1] = __byte_perm(u, v, 0x7362);
  }
  __device__ __forceinline__ static void fetch_vector(char const* from, OwnCodes<S>& codes) {
    constexpr int N = OwnCodes<S>::kWords;
    auto const vector = *reinterpret_cast<Vector<uint32_t, N> const*>(from);
#pragma unroll
    for (int k = 0; k < N; ++k) codes.words[k] = vector.v[k];
  }
  // --- rows in a ring in shared memory, whose slots have `slot_words` of each thread of a warp ---
  static constexpr int kWords = OwnCodes<S>::kWords, kSlot = slot_words(sizeof(S), Plain);

  // What a thread has of a slot, in words from its own first slot on.
  static constexpr int kOfLane = Plain ? kWords : 1, kOfSlot = 32 * kSlot;
  template <int N>
  __device__ __forceinline__ static void ask_words(char const* from, int bytes, uint32_t to) {
    int const skew = int(reinterpret_cast<uintptr_t>(from) % 4), end = bytes + skew;
    int const count = (min(bytes, 4 * N) + skew + 3) / 4, whole = min(count, end / 4);
#pragma unroll
    for (int k = 0; k <= N; ++k) copy_async_if<4>(to + 128 * k, from - skew + 4 * k, k < whole, false);
    // The word at the end of the last row may not be there as a whole.
    if (whole < count) copy_start<4>(to + 128 * whole, from - skew + 4 * whole, end - 4 * whole);
  }
  template <int N>
  __device__ __forceinline__ static void words_of(char const* from, uint32_t const* ring, uint32_t (&words)[N]) {
    uint32_t own[N + 1];
#pragma unroll
    for (int k = 0; k <= N; ++k) own[k] = ring[32 * k];
#pragma unroll
    for (int k = 0; k < N; ++k)
      words[k] = __funnelshift_r(own[k], own[k + 1], 8 * int(reinterpret_cast<uintptr_t>(from) % 4));
  }
  // Starts the copy of the row that is `offset` bytes behind the first one. `to` is an address in shared memory.
  __device__ __forceinline__ void ask(int offset, bool is_chroma, uint32_t to) const {
    char const* const from = (is_chroma ? chroma : luma) + offset;
    if constexpr (Plain) {
      copy_async_if<4 * kWords>(to, from, 1, false);
    } else if (sizeof(S) == 1 && layout == CodeLayout::packed) {
      ask_words<2 * kWords>(from, luma_bytes, to);
    } else if (sizeof(S) == 1 && layout == CodeLayout::planes && is_chroma) {
      ask_words<1>(from, chroma_bytes, to);
      ask_words<1>(v + offset, chroma_bytes, to + 256);
    } else {
      ask_words<kWords>(from, is_chroma ? chroma_bytes : luma_bytes, to);
    }
  }
  // Such a row.
  __device__ __forceinline__ OwnCodes<S> asked(int offset, bool is_chroma, uint32_t const* own) const {
    OwnCodes<S> codes;
    char const* const from = (is_chroma ? chroma : luma) + offset;
    if constexpr (Plain) {
      fetch_vector(reinterpret_cast<char const*>(own), codes);
    } else if (sizeof(S) == 1 && layout == CodeLayout::packed) {
      uint32_t both[2 * kWords];
      words_of(from, own, both);
      split(both, is_chroma ? 0x7531 : 0x6420, codes);
      return codes;
    } else if (sizeof(S) == 1 && layout == CodeLayout::planes && is_chroma) {
      uint32_t a[1], b[1];
      words_of(from, own, a);
      words_of(v + offset, own + 64, b);
      interleave(a[0], b[0], codes);
      return codes;
    } else {
      words_of(from, own, codes.words);
    }
    if (is_chroma && layout == CodeLayout::swapped_pairs) swap(codes);
    return codes;
  }

  // --- rows in registers ---
  __device__ __forceinline__ OwnCodes<S> fetch_luma(int row) const {
    OwnCodes<S> codes;
    if constexpr (Plain)
      fetch_vector(luma_row(row), codes);
    else if (sizeof(S) == 1 && layout == CodeLayout::packed)
      unpack(luma_row(row), 0x6420, codes);
    else
      fetch_words(luma_row(row), luma_bytes, luma_vectors, codes.words);
    return codes;
  }
  __device__ __forceinline__ OwnCodes<S> fetch_chroma(int row) const {
    OwnCodes<S> codes;
    if constexpr (Plain) {
      fetch_vector(chroma_row(row), codes);
      if (layout == CodeLayout::swapped_pairs) swap(codes);
    } else if (sizeof(S) == 1 && layout == CodeLayout::packed) {
      unpack(chroma_row(row), 0x7531, codes);
    } else if (sizeof(S) == 1 && layout == CodeLayout::planes) {
      uint32_t a[1], b[1];
      fetch_words(chroma_row(row), chroma_bytes, chroma_vectors, a);
      fetch_words(row_of(v, row, chroma_stride), chroma_bytes, chroma_vectors, b);
      interleave(a[0], b[0], codes);
    } else {
      fetch_words(chroma_row(row), chroma_bytes, chroma_vectors, codes.words);
      if (layout == CodeLayout::swapped_pairs) swap(codes);
    }
    return codes;
  }
};

}  // namespace
}  // namespace kv::color::cuda
