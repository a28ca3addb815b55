// Derivative kernels. Each is a product of rows, one for every axis, that smooth (order 0) or differentiate (order 1,
// 2) along it: the family is one code and a set of rows per member. Included by spatial_gradient* and
// spatial_gradient3d*.
#pragma once

#include <type_traits>

#include "core/hd.h"

namespace kv {

// A row of weights centred on a pixel. What stands under a zero is not read.
template <int... W>
struct Row {
  static constexpr int size = sizeof...(W), reach = size / 2;
  static_assert(reach == 1 || reach == 2);

  // What the row gives for x^order / order!, whose derivative of that order is 1.
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

  // The transpose: what pixel j receives, at(i) being the gradient at j - reach + i, 0 outside the image. Replicated,
  // the first pixel also stands under the weights that come before its own, the last one under those that come after.
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

// A member of the family: the order of the whole derivative and the rows of order 0, 1, 2 along an axis.
template <int Order, class Row0, class Row1, class Row2 = Row1>
struct Derivative {
  static constexpr int order = Order, reach = Row0::reach;
  template <int Along>
  using row = std::conditional_t<Along == 0, Row0, std::conditional_t<Along == 1, Row1, Row2>>;
};

using Sobel1 = Derivative<1, Row<1, 2, 1>, Row<-1, 0, 1>>;
using Sobel2 = Derivative<2, Row<1, 4, 6, 4, 1>, Row<-1, -2, 0, 2, 1>, Row<1, 0, -2, 0, 1>>;
using Diff1 = Derivative<1, Row<0, 1, 0>, Row<-1, 0, 1>>;
using Diff2 = Derivative<2, Row<0, 1, 0>, Row<-1, 0, 1>, Row<1, -2, 1>>;

}  // namespace kv
