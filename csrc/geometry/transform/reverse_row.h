// Copies of a row in the other direction, by whole vectors, regardless of the element type. Included by flip_cpu.cpp
// and sampling_cpu.cpp, outside of namespaces.
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

template <class T>
constexpr int kRowLanes = (sizeof(T) < 4 ? 16 : kVectorBytes) / int(sizeof(T));
template <class T>
using RowVector = Lanes<typename bits_of<sizeof(T)>::type, kRowLanes<T>>;

template <class T>
KV_HD RowVector<T> reversed(T const* from) {
  RowVector<T> last_first;
  for (int i = 0; i < kRowLanes<T>; ++i) last_first[i] = typename bits_of<sizeof(T)>::type(kRowLanes<T> - 1 - i);
  return __builtin_shuffle(*reinterpret_cast<RowVector<T> const*>(from), last_first);
}

// Copies from both ends at once. On many processors a load waits for an earlier store with the same offset in another
// page. Where source and result begin at the same offsets, that would be every other load.
template <class T>
void reverse_row(T const* from, T* to, int64_t size) {
  constexpr int N = kRowLanes<T>;
  int64_t e = 0;
  for (; e + N <= size - N - e; e += N) {
    int64_t const f = size - N - e;
    RowVector<T> const left = reversed(from + e), right = reversed(from + f);
    *reinterpret_cast<RowVector<T>*>(to + e) = right;
    *reinterpret_cast<RowVector<T>*>(to + f) = left;
  }
  for (int64_t f = size - e; e < f; ++e) to[e] = from[size - 1 - e];
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
