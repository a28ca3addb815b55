// Formulas on the CPU: samples [begin, end), four at a time. In double, which AVX-512 leaves to AVX2.
#include "core/lanes.h"
#include "geometry/formulas.h"

#if !defined(__AVX512F__)
namespace kv::KV_ISA {
namespace {

// Up to four samples from `begin` on; those that are missing at the end are read as the last one, and not written.
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
  KV_HD void read_typed(T const* from, int64_t stride, int known, Double4* x) const {
    T const *const a = from + at(0) * stride, *const b = from + at(1) * stride, *const c = from + at(2) * stride,
                   *const d = from + at(3) * stride;
    for (int i = 0; i < N; ++i)
      x[i] = i < known ? Double4{number(a[i]), number(b[i]), number(c[i]), number(d[i])} : Double4{};
  }
  template <int N>
  KV_HD void read(Numbers const& n, int64_t stride, Double4* x, int known = N) const {
    switch (n.type) {
      case DType::float32:
        return read_typed<N>(static_cast<float const*>(n.data), stride, known, x);
      case DType::float64:
        return read_typed<N>(static_cast<double const*>(n.data), stride, known, x);
      case DType::float16:
        return read_typed<N>(static_cast<Half const*>(n.data), stride, known, x);
      case DType::bfloat16:
        return read_typed<N>(static_cast<BFloat16 const*>(n.data), stride, known, x);
      case DType::uint8:
        return;
    }
  }
  // The first `known`; the others are 0.
  template <int N>
  KV_HD void read_some(Numbers const& n, int known, Double4* x) const {
    read<N>(n, known, x, known);
  }

  template <class T>
  static KV_HD void set(T* to, double x) {
    if constexpr (sizeof(T) == 2)
      store<1>(to, float(x));
    else
      *to = T(x);
  }
  template <class T>
  KV_HD void write_typed(T* to, int64_t stride, int numbers, Double4 const* x) const {
    for (int lane = 0; lane < count; ++lane)
      for (int i = 0; i < numbers; ++i) set(to + (begin + lane) * stride + i, x[i][lane]);
  }
  KV_HD void write_row(Numbers const& n, int64_t stride, int64_t first, int numbers, Double4 const* x) const {
    void* const data = const_cast<void*>(n.data);
    switch (n.type) {
      case DType::float32:
        return write_typed(static_cast<float*>(data) + first, stride, numbers, x);
      case DType::float64:
        return write_typed(static_cast<double*>(data) + first, stride, numbers, x);
      case DType::float16:
        return write_typed(static_cast<Half*>(data) + first, stride, numbers, x);
      case DType::bfloat16:
        return write_typed(static_cast<BFloat16*>(data) + first, stride, numbers, x);
      case DType::uint8:
        return;
    }
  }
  template <int N>
  KV_HD void write(Numbers const& n, int numbers, Double4 const* x) const {
    write_row(n, numbers, 0, numbers, x);
  }
  KV_HD void write_one(Numbers const& n, int64_t width, int i, Double4 x) const { write_row(n, width, i, 1, &x); }
};

}  // namespace

template <class F>
void formula(Formulas<F> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; b += 4) formula_of(p, Samples{b, int(min(end - b, int64_t(4)))});
}

template <class F>
void formula_backward(Formulas<F> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; b += 4) formula_vjp(p, Samples{b, int(min(end - b, int64_t(4)))});
}

KV_FORMULAS(KV_INSTANTIATE_FORMULA)

}  // namespace kv::KV_ISA
#endif
