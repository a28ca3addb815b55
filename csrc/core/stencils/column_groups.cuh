// Stencils over planar images whose rows begin anywhere, on CUDA. A thread goes down a group of P adjacent columns. It
// reads its pixels and those on either side itself, as words of 4 bytes that may begin within a word of memory, and
// keeps them as they are stored until it needs numbers:
//
//   words of memory    |  . a  |  b c  |  d e  |  f g  |  h .  |        float16, P = 4, R = 1
//   pixels                 a      b c     d e      f                     a and f belong to the neighbors
//
// The groups of all planes follow each other, so threads of a warp may be in different planes and none is idle where a
// row ends. The last group of a row ends with it, and overlaps the one before. Included by *.cu files.
#pragma once

#include "core/launch.cuh"

namespace kv {

// Columns of a group, unless a kernel says otherwise.
template <class T>
constexpr int kGroupPixels = sizeof(T) < 4 ? 8 : 4;

// Splits planes into groups of P columns and `rows` rows, one for each thread. Adjacent blocks are below each other.
template <int P, int Threads = 256>
struct ColumnGroups {
  unsigned across, down, groups, threads;  // groups of a row, row blocks of a plane, groups of all planes; of a block
  int rows, last, before_last;  // columns at which the last group of a row begins, and at most the ones before

  // Fewer rows where the images would not occupy the GPU, else about so many (height_near), of which each result reads
  // `taps`. The groups before the last one of a row end `reach` pixels before it: what they read on either side is in
  // bounds, but for the first group.
  ColumnGroups(int64_t planes, int64_t height, int64_t width, int rows, int reach, int taps, int resident)
      : ColumnGroups(planes, height, width, rows_of(planes * ceil_div(width, P), height, rows, taps, resident), reach,
                     Threads) {
    threads = unsigned(min(ceil_div(int64_t(groups), 32) * 32, int64_t(Threads)));
  }
  static int rows_of(int64_t groups, int64_t height, int most_rows, int taps, int resident) {
    int const rows = busy_rows(most_rows, [&](int n) { return groups * ceil_div(height, n); });
    return height_near(rows, ceil_div(groups, Threads), height, taps, resident);
  }
  KV_HD ColumnGroups(int64_t planes, int64_t height, int64_t width, int rows, int reach, int threads)
      : across(unsigned(ceil_div(width, P))),
        down(unsigned(ceil_div(int(height), rows))),
        groups(unsigned(planes * across)),
        threads(unsigned(threads)),
        rows(rows),
        last(int(width) - P),
        before_last(int(width) - (width % P == 0 ? P : P + reach)) {}
  // The rows of a thread, of which threads_of(rows) threads are needed.
  template <class ThreadsOf>
  static int busy_rows(int rows, ThreadsOf threads_of) {
    constexpr int kFewestRows = 8, kBusyThreads = 512;  // of a multiprocessor
    while (rows >= 2 * kFewestRows && threads_of(rows) < int64_t(kBusyThreads) * multiprocessors()) rows /= 2;
    return rows;
  }
  KV_HD unsigned blocks() const { return (groups + threads - 1) / threads * down; }

  // All threads have a group: those that are too many have the last one as well.
  __device__ __forceinline__ void locate(int64_t& plane, int& x, int& y) const { locate(blockIdx.x, plane, x, y); }
  __device__ __forceinline__ void locate(unsigned block, int64_t& plane, int& x, int& y) const {
    unsigned const q = block / down, group = min(q * threads + threadIdx.x, groups - 1), p = group / across;
    unsigned const at = group - p * across;
    plane = p;
    x = at + 1 == across ? last : min(int(at) * P, before_last);
    y = int(block - q * down) * rows;
  }
};

// Whether groups of P columns with R pixels on either side serve these images: the last two groups of a row may overlap
// others, but not reach its beginning.
template <int P, int R, class T>
bool supports_groups(Planes<T> const& x) {
  constexpr int kSize = int(sizeof(T)), kUnit = P * kSize > 8 ? 8 / kSize : 1;
  return x.step == 1 && x.width >= P + 2 * ((R + kUnit - 1) / kUnit * kUnit) &&
         x.row_stride * int64_t(kSize) <= INT32_MAX && x.width <= INT32_MAX / 2;
}

// The bytes that rows of the images are multiples of, and begin at: those of a group of P pixels, 8, of bytes 4, or 0
// for any. It is 0 for float64.
template <int P, class T, class... More>
int bytes_of_rows(Planes<T> const& first, Planes<More> const&... more) {
  constexpr int64_t kSize = sizeof(T), kGroup = P * kSize;
  auto const bits = [](auto const& p) {
    return int64_t(reinterpret_cast<uintptr_t>(p.data)) |
           (p.outer_stride | p.inner_stride | p.row_stride | p.width) * kSize;
  };
  int64_t const all = (bits(first) | ... | bits(more));
  if (kGroup > 16) return 0;
  return all % kGroup == 0 ? int(kGroup) : kGroup > 8 && all % 8 == 0 ? 8 : kSize == 1 && all % 4 == 0 ? 4 : 0;
}
// Calls f with them as a constant.
// Special case, H200: rows of 4 bytes 1.08 (gauss5) to 1.30 (box5) times as fast as any, 375x500.
template <int P, class F, class T, class... More>
auto with_row_bytes(F f, Planes<T> const& first, Planes<More> const&... more) {
  constexpr int kGroup = P * int(sizeof(T));
  int const bytes = bytes_of_rows<P>(first, more...);
  if constexpr (kGroup <= 16) {
    if (bytes == kGroup) return f(std::integral_constant<int, kGroup>{});
    if constexpr (kGroup > 8)
      if (bytes == 8) return f(std::integral_constant<int, 8>{});
    if constexpr (sizeof(T) == 1 && kGroup > 4)
      if (bytes == 4) return f(std::integral_constant<int, 4>{});
  }
  return f(std::integral_constant<int, 0>{});
}

// Reads rows of a thread's group: P pixels and R on either side. `Bytes` are those of bytes_of_rows.
template <class T, int P, int R, int Bytes = 0>
struct GroupRows {
  static constexpr int kPerWord = kv::kPerWord<T>;
  static constexpr bool kShifted = Bytes == 0 && kPerWord > 1;
  static constexpr int kPixels = P + 2 * R, kOwn = P / kPerWord, kSide = (R + kPerWord - 1) / kPerWord;
  static constexpr int kWords = Bytes > 0 ? kOwn + 2 * kSide : (kPixels + 2 * (kPerWord - 1)) / kPerWord;
  static constexpr int kSkip = Bytes > 0 ? kSide* kPerWord - R : 0;  // pixels of the words that precede the first
  static constexpr int kPacked = (kPixels + kSkip + kPerWord - 1) / kPerWord;
  // Of ColumnGroups: groups begin at multiples of `Bytes`.
  static constexpr int kReach = Bytes > 0 ? (R* int(sizeof(T)) + Bytes - 1) / Bytes* Bytes / int(sizeof(T)) : R;
  static_assert(Bytes == 0 || (kReach <= P && kSide <= kOwn));
  using Word = std::conditional_t<sizeof(T) == 8, uint64_t, uint32_t>;

  T const* const from;  // the first pixel of the group in the plane's first row
  int const stride, width, x;
  Border const border;
  int safe_from, safe_rows;  // rows that are read by words: theirs are in the memory of the images
  bool const left_end, right_end;

  struct Fetched {
    Word words[kWords];
    unsigned shift;  // modulo 32: bits of the first word that precede the first pixel
  };

  __device__ __forceinline__ GroupRows(Planes<T const> const& images, int64_t plane, int x, Border border)
      : from(images.plane(plane) + x),
        stride(int(images.row_stride * sizeof(T))),
        width(int(images.width)),
        x(x),
        border(border),
        safe_from(0),
        safe_rows(int(images.height)),
        left_end(x == 0),
        right_end(x + P == width) {
    if constexpr (Bytes == 0) {
      auto const address = [](T const* at) { return int64_t(reinterpret_cast<uintptr_t>(at)); };
      int64_t const begin = address(images.data),
                    end = address(images.row(images.count() - 1, images.height - 1) + width);
      int64_t const first = (address(from - R) & ~int64_t(3)) - begin,
                    last = address(from - R) + kWords * int(sizeof(Word)) - end;
      int const height = int(images.height);
      while (safe_from < height && first + int64_t(safe_from) * stride < 0) ++safe_from;
      int to = height;
      while (to > safe_from && last + int64_t(to - 1) * stride > 0) --to;
      safe_rows = border == Border::circular && (left_end || right_end) ? 0 : to - safe_from;
    }
  }

  __device__ __forceinline__ Fetched fetch(int y) const {
    Fetched f{};
    char const* const at = reinterpret_cast<char const*>(from) + uint64_t(unsigned(y)) * unsigned(stride);
    if constexpr (Bytes > 0) {
      using V = Vector<Word, Bytes / int(sizeof(Word))>;
      constexpr int N = Bytes / int(sizeof(Word));
#pragma unroll
      for (int i = 0; i < kOwn; i += N) {
        V const vector = *reinterpret_cast<V const*>(at + i * sizeof(Word));
#pragma unroll
        for (int k = 0; k < N; ++k) f.words[kSide + i + k] = vector.v[k];
      }
      bool const wraps = border == Border::circular;
      int const row_bytes = width * int(sizeof(T));
      auto const* const left = reinterpret_cast<Word const*>(at + (wraps && left_end ? row_bytes : 0)) - kSide;
      auto const* const right = reinterpret_cast<Word const*>(at - (wraps && right_end ? row_bytes : 0)) + kOwn;
#pragma unroll
      for (int i = 0; i < kSide; ++i) {
        if (!left_end || wraps) f.words[i] = left[i];
        if (!right_end || wraps) f.words[kSide + kOwn + i] = right[i];
      }
    } else {
      uint64_t const first = reinterpret_cast<uintptr_t>(at - R * int(sizeof(T)));
      if (unsigned(y - safe_from) < unsigned(safe_rows)) {
        f.shift = 8 * unsigned(first);
        auto const* const words = reinterpret_cast<Word const*>(uintptr_t(first & ~uint64_t(sizeof(Word) - 1)));
#pragma unroll
        for (int i = 0; i < kWords; ++i) f.words[i] = __ldg(words + i);
      } else {
        int column = x - R;
        asm("" : "+r"(column));  // else nvcc keeps the column of every pixel in registers
#pragma unroll
        for (int i = 0; i < kPixels; ++i) {
          int source = column + i;
          if (border == Border::circular) source += source < 0 ? width : source >= width ? -width : 0;
          if (unsigned(source) >= unsigned(width)) continue;
          T const pixel = reinterpret_cast<T const*>(at)[source - x];
          Word bits = 0;
          __builtin_memcpy(&bits, &pixel, sizeof(T));
          f.words[i / kPerWord] |= bits << i % kPerWord * 8 * int(sizeof(T)) % 32;
        }
      }
    }
    return f;
  }

  // As `kPacked` words that begin `kSkip` pixels before the first one. Out of bounds they have other pixels.
  static __device__ __forceinline__ void pack(Fetched const& f, Word (&packed)[kPacked]) {
#pragma unroll
    for (int i = 0; i < kPacked; ++i) {
      packed[i] = f.words[i];
      if constexpr (kShifted) packed[i] = __funnelshift_r(f.words[i], i + 1 < kWords ? f.words[i + 1] : 0u, f.shift);
    }
  }

  // As numbers: the pixels x - R ... x + P - 1 + R. Out of bounds they have other pixels.
  static __device__ __forceinline__ void unpack(Fetched const& f, Compute<T> (&v)[kPixels]) {
    Word packed[kPacked];
    pack(f, packed);
#pragma unroll
    for (int i = 0; i < kPixels; ++i) {
      Word const word = packed[(i + kSkip) / kPerWord];
      if constexpr (sizeof(T) == 1) {
        v[i] = byte_of<float>(word, (i + kSkip) % kPerWord);
      } else {
        T pixels[sizeof(Word) / sizeof(T)];
        __builtin_memcpy(pixels, &word, sizeof(word));
        v[i] = read(pixels[(i + kSkip) % kPerWord]);
      }
    }
  }
  __device__ __forceinline__ void spread(Fetched const& f, Compute<T> (&v)[kPixels]) const {
    unpack(f, v);
    fill_border(v);
  }
  // Pixels out of bounds follow the border. V: one of N values, or several that begin with it or end with it.
  template <int N = P, class V>
  __device__ __forceinline__ void fill_border(V (&v)[N + 2 * R]) const {
    if (border == Border::circular) return;  // fetched
    if (left_end) {
#pragma unroll
      for (int i = 0; i < R; ++i)
        v[i] = border == Border::constant ? V{} : border == Border::reflect ? v[2 * R - i] : v[R];
    }
    if (right_end) {
#pragma unroll
      for (int i = 0; i < R; ++i)
        v[R + N + i] = border == Border::constant ? V{} : border == Border::reflect ? v[R + N - 2 - i] : v[R + N - 1];
    }
  }
};

// Whether threads exchange the pixels of rows that begin anywhere, so that all that a warp stores is aligned. Groups of
// fewer bytes wait for instructions.
// Special case, H200: 1.13 (median3) to 1.32 (dilation3 of 299x299) times as fast as words of one thread, half types.
template <class T, int P, int Bytes>
constexpr bool kExchangesStores = Bytes == 0 && (sizeof(T) == 2 || (sizeof(T) == 1 && P == 16));

// Bytes of a store to rows that begin anywhere, of kernels that wait for instructions, and for memory.
// Special case, H200: 4 are 1.03 (box3, gauss5) to 1.07 (median5 of float16) times as fast as 8, 8 are 1.04 to 1.24
// times as fast as 4 (dilation3).
constexpr int kFewestInstructions = 4, kFewestStores = 8;

// Stores rows of a thread's group.
template <class T, int P, int Bytes, int Unit = kFewestInstructions>
struct GroupStore {
  static constexpr bool kExchanges = kExchangesStores<T, P, Bytes>;
  static constexpr int kSize = P * int(sizeof(T)), kWords = ceil_div(kSize, 4);
  static constexpr int kUnit = kExchanges ? Unit : 4;
  T* at;  // the group in the next row
  int const stride;
  bool first = true, last = true;  // whether the group before, and the next one, is not adjacent or of another warp

  // The threads of a warp construct it, and put rows, together.
  __device__ __forceinline__ GroupStore(Planes<T> const& images, int64_t plane, int x, int y)
      : at(images.row(plane, y) + x), stride(int(images.row_stride)) {
    if constexpr (kExchanges) {
      auto const address = static_cast<unsigned long long>(reinterpret_cast<uintptr_t>(at));
      first = __shfl_up_sync(~0u, address, 1) + kSize != address || threadIdx.x % 32 == 0;
      last = __shfl_down_sync(~0u, address, 1) != address + kSize || threadIdx.x % 32 == 31;
    }
  }

  __device__ __forceinline__ void put(Compute<T> const (&v)[P]) { put(rounded<T>(v)); }
  __device__ __forceinline__ void put(Vector<T, P> const& vector) {
    if constexpr (Bytes > 0) {
      constexpr int N = Bytes / int(sizeof(T));
#pragma unroll
      for (int i = 0; i < P; i += N) {
        Vector<T, N> part;
#pragma unroll
        for (int k = 0; k < N; ++k) part.v[k] = vector.v[i + k];
        store_vector(at + i, part);
      }
    } else if constexpr (sizeof(T) >= 4) {
      __builtin_assume(__isGlobal(at));
#pragma unroll
      for (int i = 0; i < P; ++i) at[i] = vector.v[i];
    } else {
      static_assert(kSize % 4 == 0);
      uint32_t own[kWords];
      __builtin_memcpy(own, &vector, kSize);
      put_units(own);
    }
    at += stride;
  }

 private:
  // Stores the units of memory that begin in the group, the last of which the next group completes. Bytes in no such
  // unit, where no group of the warp is adjacent, are stored by 4, 2 or 1:
  //
  //   units    | . . . a | b c d e | f g h i | j . . .
  //   groups           a   b c d e   f g h | i   j           the thread of a ... h stores b c d e and f g h i
  __device__ __forceinline__ void put_units(uint32_t const (&own)[kWords]) const {
    static_assert(kUnit == 4 || (kUnit == 8 && kSize >= 8));
    __builtin_assume(__isGlobal(at));
    constexpr int kWordsOfUnit = kUnit / 4;
    unsigned const low = unsigned(reinterpret_cast<uintptr_t>(at)), past = low & (kUnit - 1),
                   before = (0 - low) & (kUnit - 1);  // bytes of the group's last unit in it, and before its first one
    auto* const to = reinterpret_cast<uint8_t*>(at);
    uint8_t* const aligned = to + before;
    uint32_t words[kWords + kWordsOfUnit];  // of this group and the next, then from `aligned` on
#pragma unroll
    for (int i = 0; i < kWords + kWordsOfUnit; ++i) {
      words[i] = own[min(i, kWords - 1)];
      if (i >= kWords) words[i] = kExchanges ? __shfl_down_sync(~0u, own[max(i - kWords, 0)], 1) : 0;
    }
    if constexpr (kUnit == 8)
#pragma unroll
      for (int i = 0; i <= kWords; ++i) words[i] = before & 4 ? words[i + 1] : words[i];
#pragma unroll
    for (int i = 0; i < kWords; ++i) words[i] = __funnelshift_r(words[i], words[i + 1], 8 * before);
#pragma unroll
    for (int i = 0; i < kWords; i += kWordsOfUnit) {
      if (i + kWordsOfUnit == kWords && past > 0 && last) continue;
      if constexpr (kUnit == 4)
        *reinterpret_cast<uint32_t*>(aligned + 4 * i) = words[i];
      else
        store_vector(reinterpret_cast<uint32_t*>(aligned + 4 * i), Vector<uint32_t, 2>{words[i], words[i + 1]});
    }
    if (past == 0 || !(first || last)) return;
    unsigned const head = first ? before : 0, tail = last ? past : 0;
    uint8_t* const end = aligned + kSize - kUnit;
    uint32_t rest = words[kWords - 1];
    if constexpr (kUnit == 8) {
      if (head & 4) *reinterpret_cast<uint32_t*>(aligned - 4) = __funnelshift_r(own[0], own[1], 8 * before);
      if (tail & 4) *reinterpret_cast<uint32_t*>(end) = words[kWords - 2];
      if (!(past & 4)) rest = words[kWords - 2];
    }
    if (head & 2) *reinterpret_cast<uint16_t*>(to + (before & 1)) = uint16_t(own[0] >> (before & 1) * 8);
    if (tail & 2) *reinterpret_cast<uint16_t*>(end + (past & 4)) = uint16_t(rest);
    if constexpr (sizeof(T) == 1) {
      if (head & 1) to[0] = uint8_t(own[0]);
      if (tail & 1) to[kSize - 1] = uint8_t(own[kWords - 1] >> 24);
    }
  }
};

}  // namespace kv
