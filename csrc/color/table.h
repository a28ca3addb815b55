// False colours: every pixel of a channel shows a colour of a table. Included by table_cpu.cpp, table.cu and
// table_op.cpp.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv {

template <class T>
struct ColorTable {
  Planes<T const> x;  // a plane is a channel
  Planes<T> y;        // three of them each
  T const* white;     // what is 1 in each channel
  T const* colors;    // red, green and blue of n colours
  int n;
  int64_t of_image, channels;  // images may have tables of their own, so far apart

  KV_HD T const* table(int64_t plane) const { return colors + plane / channels * of_image; }
};

KV_KERNEL(color_table, ColorTable)

// Which of n colours a value shows: 0 the first one, 1 the last one, and what lies between, evenly, all others but the
// last. NaN shows the first.
template <class F>
KV_HD int color_of(F v, int n) {
  if (v >= F(1)) return n - 1;
  F const place = v * F(n > 2 ? n - 2 : 1);
  if (!(place > F(0))) return 0;
  int const below = int(place);
  return min(below + (F(below) < place), n - 1);
}

}  // namespace kv
