// Flips on the CPU: 16 bytes at a time, whatever they are.
#include <cstring>

#include "core/lanes.h"
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

template <class T>
void reverse_row(T const* from, T* to, int64_t size) {
  using Bits = typename bits_of<sizeof(T)>::type;
  constexpr int N = 16 / int(sizeof(T));
  using V = Lanes<Bits, N>;
  V last_first;
  for (int i = 0; i < N; ++i) last_first[i] = Bits(N - 1 - i);
  int64_t e = 0;
  for (; e + N <= size; e += N)
    *reinterpret_cast<V*>(to + e) = __builtin_shuffle(*reinterpret_cast<V const*>(from + size - N - e), last_first);
  for (; e < size; ++e) to[e] = from[size - 1 - e];
}

// C: the channels of a pixel, 0 for any number.
template <int C, class T>
void reverse_pixels(T const* from, T* to, int64_t size, int64_t step) {
  int64_t const channels = C ? C : step;
  for (int64_t e = 0; e < size; e += channels)
    for (int64_t c = 0; c < channels; ++c) to[e + c] = from[size - channels - e + c];
}

}  // namespace

template <class T>
void flip(Flip<T> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.x.height;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r - plane * height;
    T const* const from = p.x.row(plane, p.rows ? height - 1 - y : y);
    T* const to = p.y.row(plane, y);
    if (!p.columns)
      memcpy(to, from, size_t(size) * sizeof(T));
    else if (step == 1)
      reverse_row(from, to, size);
    else if (step == 3)
      reverse_pixels<3>(from, to, size, step);
    else
      reverse_pixels<0>(from, to, size, step);
  }
}

KV_INSTANTIATE_WITH_BYTES(flip, Flip)

}  // namespace kv::KV_ISA
