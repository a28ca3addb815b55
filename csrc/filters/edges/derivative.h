// Derivative kernels. Each is a product of weight rows, one for every axis, that smooth (order 0) or differentiate
// (order 1, 2) along it. One implementation serves all of them; a kernel is defined by its rows.
#pragma once

#include <type_traits>

#include "core/hd.h"

namespace kv::filters {

// The type of the derivatives of images of T. They may be negative and no whole numbers: those of bytes are floats.
template <class T>
using DerivativeOf = std::conditional_t<__is_same(T, uint8_t), float, T>;

// A row of weights centered on a pixel. Pixels under a zero weight are not read.
template <int... W>
struct WeightRow {
  static constexpr int size = sizeof...(W), reach = size / 2;
  static_assert(reach == 1 || reach == 2);

  // The result of the row for x^order / order!, whose derivative of that order is 1.
  static constexpr double unit(int order) {
    double sum = 0;
    int i = -reach;
    ((sum += order == 0 ? W : order == 1 ? W * i : W * i * i * 0.5, ++i), ...);
    return sum;
  }

  // The sum of weight i times at(i).
  template <class At>
  KV_HD static auto dot(At at) {
    decltype(at(0)) sum{};
    bool empty = true;
    int i = 0;
    (add<W>(sum, empty, i++, at), ...);
    return sum;
  }

  // The transpose: the gradient of pixel j, where at(i) is the gradient at j - reach + i, 0 out of bounds. With the
  // replicate border the first pixel is also read by the weights before its own, the last one by those after it.
  template <class At>
  KV_HD static auto dot_vjp(At at, bool first, bool last) {
    decltype(at(0)) sum{};
    bool empty = true;
    int i = size - 1;
    (add<W>(sum, empty, i--, at), ...);
    if (first) {
      add<before(reach)>(sum, empty, reach, at);
      if constexpr (reach == 2) add<before(1)>(sum, empty, 3, at);
    }
    if (last) {
      add<after(reach)>(sum, empty, reach, at);
      if constexpr (reach == 2) add<after(3)>(sum, empty, 1, at);
    }
    return sum;
  }

 private:
  // The sums of the weights before and after weight n.
  static constexpr int before(int n) {
    int sum = 0, i = 0;
    ((sum += i++ < n ? W : 0), ...);
    return sum;
  }
  static constexpr int after(int n) {
    int sum = 0, i = 0;
    ((sum += i++ > n ? W : 0), ...);
    return sum;
  }

  template <int Weight, class V, class At>
  KV_HD static void add(V& sum, bool& empty, int i, At at) {
    if constexpr (Weight != 0) {
      V const x = at(i);
      if constexpr (Weight == 1)
        sum = empty ? x : sum + x;
      else if constexpr (Weight == -1)
        sum = empty ? -x : sum - x;
      else
        sum = empty ? x * Weight : sum + x * Weight;
      empty = false;  // known to the compiler
    }
  }
};

// A derivative kernel: the order of the whole derivative and the rows of order 0, 1, 2 along an axis.
template <int Order, class Row0, class Row1, class Row2 = Row1>
struct Derivative {
  static constexpr int order = Order, reach = Row0::reach;
  template <int Along>
  using row = std::conditional_t<Along == 0, Row0, std::conditional_t<Along == 1, Row1, Row2>>;
};

using Sobel1 = Derivative<1, WeightRow<1, 2, 1>, WeightRow<-1, 0, 1>>;
using Sobel2 = Derivative<2, WeightRow<1, 4, 6, 4, 1>, WeightRow<-1, -2, 0, 2, 1>, WeightRow<1, 0, -2, 0, 1>>;
using Diff1 = Derivative<1, WeightRow<0, 1, 0>, WeightRow<-1, 0, 1>>;
using Diff2 = Derivative<2, WeightRow<0, 1, 0>, WeightRow<-1, 0, 1>, WeightRow<1, -2, 1>>;

}  // namespace kv::filters
