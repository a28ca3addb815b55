// Flips and windows on the CPU: a vector at a time, whatever its bits are.
#include <cstring>

#include "core/lanes.h"
#include "core/scratch.h"
#include "flip.h"

namespace kv::KV_ISA {
namespace {

template <int bytes>
struct bits_of;
template <>
struct bits_of<1> {
  using type = uint8_t;
};
template <>
struct bits_of<2> {
  using type = uint16_t;
};
template <>
struct bits_of<4> {
  using type = uint32_t;
};
template <>
struct bits_of<8> {
  using type = uint64_t;
};

// From both ends at once: a load that follows a store to the same place of another page waits for it on many
// processors, and where images begin at the same places of pages that would be every other load.
template <class T>
void reverse_row(T const* from, T* to, int64_t size) {
  using Bits = typename bits_of<sizeof(T)>::type;
  constexpr int N = (sizeof(T) < 4 ? 16 : kVectorBytes) / int(sizeof(T));
  using V = Lanes<Bits, N>;
  V last_first;
  for (int i = 0; i < N; ++i) last_first[i] = Bits(N - 1 - i);
  int64_t e = 0;
  for (; e + N <= size - N - e; e += N) {
    int64_t const f = size - N - e;
    V const left = *reinterpret_cast<V const*>(from + e), right = *reinterpret_cast<V const*>(from + f);
    *reinterpret_cast<V*>(to + e) = __builtin_shuffle(right, last_first);
    *reinterpret_cast<V*>(to + f) = __builtin_shuffle(left, last_first);
  }
  for (int64_t f = size - e; e < f; ++e) to[e] = from[size - 1 - e];
}

// C: the channels of a pixel, 0 for any number. Elements go one by one, so they do that in memory of their own.
template <int C, class T>
void reverse_pixels(T const* from, T* to, int64_t size, int64_t step, T* line) {
  int64_t const channels = C ? C : step;
  T* const reversed = line + size;
  memcpy(line, from, size_t(size) * sizeof(T));
  for (int64_t e = 0; e < size; e += channels)
    for (int64_t c = 0; c < channels; ++c) reversed[e + c] = line[size - channels - e + c];
  memcpy(to, reversed, size_t(size) * sizeof(T));
}

// Elements left ... of a row of `in_size`, and zeros beyond it.
template <class T>
void copy_window(T const* from, int64_t in_size, int64_t left, T* to, int64_t size) {
  int64_t const begin = clamp(-left, int64_t(0), size), end = clamp(in_size - left, begin, size);
  memset(to, 0, size_t(begin) * sizeof(T));
  memcpy(to + begin, from + left + begin, size_t(end - begin) * sizeof(T));
  memset(to + end, 0, size_t(size - end) * sizeof(T));
}

}  // namespace

template <class T>
void flip(Flip<T> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.x.step, size = p.y.row_size(), height = p.y.height;
  Scratch<T> line(step == 1 || !p.columns ? 0 : 2 * size);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r - plane * height;
    int64_t const source = p.rows ? height - 1 - y : y + p.top;
    T* const to = p.y.row(plane, y);
    if (source < 0 || source >= p.x.height) {
      memset(to, 0, size_t(size) * sizeof(T));
      continue;
    }
    T const* const from = p.x.row(plane, source);
    if (!p.columns)
      copy_window(from, p.x.row_size(), p.left * step, to, size);
    else if (step == 1)
      reverse_row(from, to, size);
    else if (step == 3)
      reverse_pixels<3>(from, to, size, step, line.data);
    else
      reverse_pixels<0>(from, to, size, step, line.data);
  }
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

}  // namespace kv::KV_ISA
