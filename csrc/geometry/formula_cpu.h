// Formulas on the CPU: samples [begin, end), four at a time. In double: the AVX-512 build uses the AVX2 code. Included
// by formula_*_cpu.cpp, which instantiate the formulas by subject, so that compilers run side by side.
#pragma once

#include "core/lanes.h"
#include "geometry/formulas.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {
namespace {

// Up to four samples from `begin` on. Past the end the last sample is read again, and nothing is written.
struct Samples {
  using Value = Double4;
  int64_t begin;
  int count;

  KV_HD int64_t at(int lane) const { return begin + (lane < count ? lane : count - 1); }

  template <class T>
  static KV_HD double number(T x) {
    if constexpr (sizeof(T) == 2)
      return load<1>(&x);
    else
      return x;
  }
  template <int N, class T>
  KV_HD void read_typed(T const* src, int64_t stride, int num_values, Double4* x) const {
    T const *const a = src + at(0) * stride, *const b = src + at(1) * stride, *const c = src + at(2) * stride,
                   *const d = src + at(3) * stride;
    for (int i = 0; i < N; ++i)
      x[i] = i < num_values ? Double4{number(a[i]), number(b[i]), number(c[i]), number(d[i])} : Double4{};
  }
  template <int N>
  KV_HD void read(TypedPointer const& n, int64_t stride, Double4* x, int num_values = N) const {
    switch (n.type) {
      case DType::float32:
        return read_typed<N>(static_cast<float const*>(n.data), stride, num_values, x);
      case DType::float64:
        return read_typed<N>(static_cast<double const*>(n.data), stride, num_values, x);
      case DType::float16:
        return read_typed<N>(static_cast<Half const*>(n.data), stride, num_values, x);
      case DType::bfloat16:
        return read_typed<N>(static_cast<BFloat16 const*>(n.data), stride, num_values, x);
      case DType::uint8:
        return;
    }
  }
  // The first `num_values` numbers; the others are 0.
  template <int N>
  KV_HD void read_first(TypedPointer const& n, int num_values, Double4* x) const {
    read<N>(n, num_values, x, num_values);
  }

  template <class T>
  static KV_HD void set(T* dst, double x) {
    if constexpr (sizeof(T) == 2)
      store<1>(dst, float(x));
    else
      *dst = T(x);
  }
  // Four numbers of each of four samples, by vectors of a sample's numbers.
  static KV_HD void write_square(float* to, int64_t stride, Double4 const* x) {
    using V = Lanes<float, 4>;
    V const a = __builtin_convertvector(x[0], V), b = __builtin_convertvector(x[1], V),
            c = __builtin_convertvector(x[2], V), d = __builtin_convertvector(x[3], V);
    V const ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), ab_high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
    V const cd = __builtin_shufflevector(c, d, 0, 4, 1, 5), cd_high = __builtin_shufflevector(c, d, 2, 6, 3, 7);
    store<4>(to, V(__builtin_shufflevector(ab, cd, 0, 1, 4, 5)));
    store<4>(to + stride, V(__builtin_shufflevector(ab, cd, 2, 3, 6, 7)));
    store<4>(to + 2 * stride, V(__builtin_shufflevector(ab_high, cd_high, 0, 1, 4, 5)));
    store<4>(to + 3 * stride, V(__builtin_shufflevector(ab_high, cd_high, 2, 3, 6, 7)));
  }

  // The first `num_values` of at most N numbers.
  template <int N, class T>
  KV_HD void write_typed(T* dst, int64_t stride, int num_values, Double4 const* x) const {
    T* const to = dst + begin * stride;
    if constexpr (sizeof(T) == 4)
      if (count == 4) {  // converts four numbers at once
        int i = 0;
        if constexpr (N >= 4)
          for (; i + 4 <= num_values; i += 4) write_square(to + i, stride, x + i);
        for (; i < num_values; ++i) {
          auto const y = __builtin_convertvector(x[i], Lanes<float, 4>);
          for (int lane = 0; lane < 4; ++lane) to[lane * stride + i] = y[lane];
        }
        return;
      }
    for (int lane = 0; lane < count; ++lane)
      for (int i = 0; i < num_values; ++i) set(to + lane * stride + i, x[i][lane]);
  }
  template <int N>
  KV_HD void write_row(TypedPointer const& n, int64_t stride, int64_t first, int num_values, Double4 const* x) const {
    void* const data = const_cast<void*>(n.data);
    switch (n.type) {
      case DType::float32:
        return write_typed<N>(static_cast<float*>(data) + first, stride, num_values, x);
      case DType::float64:
        return write_typed<N>(static_cast<double*>(data) + first, stride, num_values, x);
      case DType::float16:
        return write_typed<N>(static_cast<Half*>(data) + first, stride, num_values, x);
      case DType::bfloat16:
        return write_typed<N>(static_cast<BFloat16*>(data) + first, stride, num_values, x);
      case DType::uint8:
        return;
    }
  }
  template <int N>
  KV_HD void write(TypedPointer const& n, int num_values, Double4 const* x) const {
    write_row<N>(n, num_values, 0, num_values, x);
  }
  KV_HD void write_one(TypedPointer const& n, int64_t width, int i, Double4 x) const {
    write_row<1>(n, width, i, 1, &x);
  }
};

}  // namespace

template <class F>
void formula(FormulaParams<F> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; b += 4) evaluate_formula(p, Samples{b, int(min(end - b, int64_t(4)))});
}

template <class F>
void formula_backward(FormulaParams<F> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; b += 4) formula_vjp(p, Samples{b, int(min(end - b, int64_t(4)))});
}

}  // namespace kv::geometry::KV_ISA
#endif
