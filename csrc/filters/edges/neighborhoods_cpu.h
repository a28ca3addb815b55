// The 3 x 3 neighborhoods of pixels on the CPU and their transpose, by the index rule of a border: sobel_cpu.cpp,
// canny_cpu.cpp and feature/responses_cpu.cpp. Compiled once per instruction set.
#pragma once

#include "core/border.h"
#include "core/lanes.h"
#include "core/scratch.h"
#include "core/view.h"

namespace kv::filters::KV_ISA {
namespace {

template <class V>
struct PixelColumn {
  V above, middle, below;
};

template <Border border, class T>
class Neighborhoods {
  Planes<T const> const& x_;
  Scratch<T> zeros_;  // a row of the constant border

  KV_HD T const* row(int64_t plane, int64_t y) const {
    int64_t const source = border_index(border, y, x_.height);
    return source < 0 ? zeros_.data : x_.row(plane, source);
  }

 public:
  KV_HD explicit Neighborhoods(Planes<T const> const& x)
      : x_(x), zeros_(border == Border::constant ? x.row_size() : 0) {
    for (int64_t e = 0; border == Border::constant && e < x.row_size(); ++e) zeros_.data[e] = T{};
  }

  // Calls f(width, element, left, middle, right), three columns of pixels, over row y of a plane.
  template <class F>
  KV_HD void for_each(int64_t plane, int64_t y, F f) const {
    T const *const a = row(plane, y - 1), *const b = x_.row(plane, y), *const c = row(plane, y + 1);
    int64_t const step = x_.step, width = x_.width;
    auto const around = [&](auto lanes, int64_t e, int64_t left, int64_t right) KV_INLINE {
      constexpr int N = decltype(lanes)::value;
      using Column = PixelColumn<Lanes<Compute<T>, N>>;
      auto const at = [&](int64_t i) { return Column{load<N>(a + i), load<N>(b + i), load<N>(c + i)}; };
      f(lanes, e, left < 0 ? Column{} : at(left), at(e), right < 0 ? Column{} : at(right));
    };
    auto const at_border = [&](int64_t i) {
      int64_t const left = border_index(border, i - 1, width), right = border_index(border, i + 1, width);
      for (int64_t e = 0; e < step; ++e)
        around(Width<1>{}, i * step + e, left < 0 ? left : left * step + e, right < 0 ? right : right * step + e);
    };
    at_border(0);
    for_each_vector<T>(step, (width - 1) * step, [&](auto lanes, int64_t e) { around(lanes, e, e - step, e + step); });
    if (width > 1) at_border(width - 1);
  }
};

// From the gradients u and v of the two derivatives of each pixel to the gradient of the pixels, row by row. A row
// holds u and v between zeros. Its contributions to the rows around are kept in a ring of three, those to positions out
// of bounds with the pixels that these are read from.
template <Border border, class F>
class NeighborhoodsVjp {
  static_assert(border != Border::circular, "the ring has no rows of the opposite end");
  int64_t const step_, size_, width_, height_, padded_;
  Scratch<F> memory_;
  F *const zeros_, *const ring_;

  KV_HD F* across(int64_t y) const { return y < 0 || y >= height_ ? zeros_ : ring_ + y % 3 * 2 * size_; }

 public:
  F *const u, *const v;

  template <class T>
  KV_HD explicit NeighborhoodsVjp(Planes<T> const& x)
      : step_(x.step),
        size_(x.row_size()),
        width_(x.width),
        height_(x.height),
        padded_(size_ + 4 * step_),
        memory_(2 * padded_ + 8 * size_),
        zeros_(memory_.data + 2 * padded_),
        ring_(zeros_ + 2 * size_),
        u(memory_.data + 2 * step_),
        v(u + padded_) {
    for (int64_t e = 0; e < 2 * padded_ + 2 * size_; ++e) memory_.data[e] = 0;
  }

  // Takes row y, whose u and v are set. row_vjp(u left, u right, v left, v middle, v right) returns the contributions
  // `across` and `along` of a pixel to the rows around.
  template <class RowVjp>
  KV_HD void put(int64_t y, RowVjp row_vjp) const {
    F *const to_across = across(y), *const to_along = to_across + size_;
    auto const at = [&](auto lanes, int64_t e) {
      constexpr int N = decltype(lanes)::value;
      return row_vjp(load<N>(u + e - step_), load<N>(u + e + step_), load<N>(v + e - step_), load<N>(v + e),
                     load<N>(v + e + step_));
    };
    for_each_vector<F>(0, size_, [&](auto lanes, int64_t e) {
      constexpr int N = decltype(lanes)::value;
      auto const row = at(lanes, e);
      store<N>(to_across + e, row.across);
      store<N>(to_along + e, row.along);
    });
    int64_t const outside[] = {-1, width_};
    for (int64_t const i : outside) {
      int64_t const j = border_index(border, i, width_);
      for (int64_t e = 0; j >= 0 && e < step_; ++e) {
        auto const row = at(Width<1>{}, i * step_ + e);
        to_across[j * step_ + e] += row.across;
        to_along[j * step_ + e] += row.along;
      }
    }
  }

  // Stores the gradients of row y in `to`; the rows around have been put. rows_vjp(above, middle, below) returns those
  // of a position, from contributions of the type Row.
  template <template <class> class Row, class T, class RowsVjp>
  KV_HD void store_row(int64_t y, T* to, RowsVjp rows_vjp) const {
    struct Around {
      F const* rows[3];
    };
    Around readers[3];  // the positions that read the row
    int count = 0;
    for_each_reader(border, y, height_, int64_t(1), int64_t(1),
                    [&](int64_t i) { readers[count++] = {{across(i - 1), across(i), across(i + 1)}}; });
    for_each_vector<T>(0, size_, [&](auto lanes, int64_t e) {
      constexpr int N = decltype(lanes)::value;
      auto const of = [&](Around const& around) {
        auto const row = [&](int k) {
          return Row<Lanes<F, N>>{load<N>(around.rows[k] + e), load<N>(around.rows[k] + size_ + e)};
        };
        return rows_vjp(row(0), row(1), row(2));
      };
      Lanes<F, N> sum = of(readers[0]);
      for (int i = 1; i < count; ++i) sum += of(readers[i]);
      store<N>(to + e, sum);
    });
  }
};

}  // namespace
}  // namespace kv::filters::KV_ISA
