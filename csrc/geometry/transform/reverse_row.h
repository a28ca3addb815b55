// Copies of a row in the other direction, by whole vectors, regardless of the element type. Included outside of
// namespaces.
#pragma once

#include "core/lanes.h"

namespace kv::geometry::KV_ISA {
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

// Vectors of at most 32 bytes: those of 64 cross two cache lines wherever they do not begin with one.
template <class T>
constexpr int kRowBytes = sizeof(T) < 4 || kVectorBytes < 32 ? 16 : 32;
template <class T, int bytes = kRowBytes<T>>
using RowVector = Lanes<typename bits_of<sizeof(T)>::type, bytes / int(sizeof(T))>;

template <class V, int... i>
KV_HD V reversed(V v, std::integer_sequence<int, i...>) {
  return __builtin_shufflevector(v, v, (int(sizeof...(i)) - 1 - i)...);
}
template <int bytes, class T>
KV_HD RowVector<T, bytes> reversed(T const* from) {
  using V = RowVector<T, bytes>;
  return reversed(reinterpret_cast<InMemory<V> const*>(from)->lanes,
                  std::make_integer_sequence<int, bytes / int(sizeof(T))>());
}

// Calls f(e) for vectors of a row, aligned in memory but for the first and the last one, which overlap their neighbors.
template <int64_t bytes, class T, class F>
KV_HD void for_each_row_vector(T const* to, int64_t size, F f) {
  constexpr int64_t N = bytes / int64_t(sizeof(T));
  f(int64_t(0));
#pragma GCC unroll 4
  for (int64_t e = (bytes - reinterpret_cast<intptr_t>(to) % bytes) / int64_t(sizeof(T)); e + N <= size; e += N) f(e);
  f(size - N);
}

// Stores go upwards in one stream. Two streams from both ends took half as long again in rows that do not begin at
// multiples of a vector, where every store touches two cache lines. `to_below`: the row below is read next. It is
// prefetched, because processors do not foresee its end, where it is read first; rows read upwards they foresee.
template <bool to_below = true, class T>
void reverse_row(T const* from, T* to, int64_t size) {
  using V = RowVector<T>;
  constexpr int64_t N = sizeof(V) / sizeof(T);
  if (size < N) {
    for (int64_t e = 0; e < size; ++e) to[e] = from[size - 1 - e];
    return;
  }
  for_each_row_vector<kRowBytes<T>>(to, size, [&](int64_t e) KV_INLINE {
    if constexpr (to_below) __builtin_prefetch(from + size + e);
    reinterpret_cast<InMemory<V>*>(to + e)->lanes = reversed<kRowBytes<T>>(from + size - N - e);
  });
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
