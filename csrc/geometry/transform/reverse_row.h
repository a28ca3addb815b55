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

// Stores go upwards in one stream. Two streams from both ends took half as long again in rows that do not begin at
// multiples of a vector, where every store touches two cache lines.
template <class T>
void reverse_row(T const* from, T* to, int64_t size) {
  constexpr int N = kRowLanes<T>;
  int64_t e = 0;
  for (; e + N <= size; e += N) *reinterpret_cast<RowVector<T>*>(to + e) = reversed(from + size - N - e);
  for (; e < size; ++e) to[e] = from[size - 1 - e];
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
