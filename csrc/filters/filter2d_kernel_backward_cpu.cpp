// The gradient to the kernel of a cross-correlation on the CPU: parts [begin, end), and the sums over parts. Compiled
// once per instruction set.
#include "filter2d_cpu.h"

namespace kv::filters::KV_ISA {
namespace {

constexpr int kGradRows = 16;  // rows of the gradient that share a tile

// products[k * kx + i] += the sum over elements of grad[y] * rows[y + k], shifted by i pixels, for KY by KX taps.
template <int KY, int KX, class F>
void multiply(F const* grad, int64_t grad_stride, int64_t count, F const* rows, int64_t row_stride, int64_t step,
              int64_t size, F* products, int kx) {
  constexpr int N = kLanes<F>;
  using V = Lanes<F, N>;
  V sum[KY][KX]{};
  V index;
  for (int n = 0; n < N; ++n) index[n] = F(n);
  int64_t const whole = size / N * N;
  auto const inside = index < F(size - whole);
  for (int64_t r = 0; r < count + KY - 1; ++r) {  // the rows r - k of the gradient read row r of the image by tap k
    F const* const x = rows + r * row_stride;
    F const* const g = grad + r * grad_stride;
    auto const add = [&](auto first, auto last) KV_INLINE {  // the taps first ... last - 1
      auto const add_vector = [&](int64_t e, auto load_x) KV_INLINE {
        V gs[KY];
        unroll<KY>([&](auto k) KV_INLINE {
          if constexpr (k.value >= first.value && k.value < last.value)
            gs[k.value] = load<N>(g - k.value * grad_stride + e);
        });
        unroll<KX>([&](auto i) KV_INLINE {
          V const xs = load_x(x + i.value * step + e);
          unroll<KY>([&](auto k) KV_INLINE {
            if constexpr (k.value >= first.value && k.value < last.value) sum[k.value][i.value] += gs[k.value] * xs;
          });
        });
      };
      for (int64_t e = 0; e < whole; e += N) add_vector(e, [&](F const* at) KV_INLINE { return load<N>(at); });
      if (whole <
          size)  // the gradient is padded with zeros, but 0 times the pixels that follow in the image may be NaN
        add_vector(whole, [&](F const* at) KV_INLINE { return inside ? load<N>(at) : V{}; });
    };
    if (r >= KY - 1 && r < count)
      add(Width<0>{}, Width<KY>{});
    else
      unroll<KY>([&](auto k) KV_INLINE {
        if (r >= k.value && r - k.value < count) add(k, Width<k.value + 1>{});
      });
  }
  unroll<KY>([&](auto k) KV_INLINE {
    unroll<KX>([&](auto i) KV_INLINE {
      for (int n = 0; n < N; ++n) products[k.value * kx + i.value] += sum[k.value][i.value][n];
    });
  });
}

// Calls f with min(n, 3) as a constant.
template <class F>
KV_HD void dispatch_up_to_three(int n, F f) {
  if (n >= 3)
    f(Width<3>{});
  else if (n == 2)
    f(Width<2>{});
  else
    f(Width<1>{});
}

}  // namespace

template <class T>
void filter2d_kernel_backward(Filter2dKernelBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<F>;
  KernelAxis const tx = p.axis_x, ty = p.axis_y, tz = p.axis_z;
  int64_t const step = p.x.step, width = p.grad.width, height = p.grad.height;
  int64_t const grad_stride = (width * step + N - 1) / N * N, row_stride = grad_stride + (tx.size - 1) * step;
  int64_t const tile_size = kGradRows * grad_stride + (kGradRows + ty.size - 1) * row_stride;
  Scratch<F> scratch(tile_size);
  for (int64_t e = 0; e < tile_size; ++e) scratch.data[e] = 0;  // the padding of the rows stays 0
  F *const grads = scratch.data, *const rows = grads + kGradRows * grad_stride;

  for (int64_t part = begin; part < end; ++part) {
    F* const products = p.parts + part * p.taps();
    for (int t = 0; t < p.taps(); ++t) products[t] = 0;
    int64_t const plane = part / p.parts_down(), first = part % p.parts_down() * p.part_rows;
    int64_t const z = plane % p.depth, last = min(first + p.part_rows, height);
    for (int64_t y = first; y < last; y += kGradRows) {
      int64_t const count = min(last - y, int64_t(kGradRows));
      for (int64_t r = 0; r < count; ++r)
        copy_pixels<T>(p.grad, plane, y + r, Border::constant, 0, width, grads + r * grad_stride);
      for (int kz = 0; kz < tz.size; ++kz) {
        int64_t const source = border_index(p.border, z + kz - tz.before, int64_t(p.depth));
        if (source < 0) continue;
        for (int64_t r = 0; r < count + ty.size - 1; ++r)
          copy_pixels<T>(p.x, plane - z + source, y - ty.before + r, p.border, -tx.before, width + tx.size - 1,
                         rows + r * row_stride);
        for (int ky = 0; ky < ty.size; ky += 3)
          for (int kx = 0; kx < tx.size; kx += 3)
            dispatch_up_to_three(ty.size - ky, [&](auto across_y) {
              dispatch_up_to_three(tx.size - kx, [&](auto across_x) {
                multiply<across_y.value, across_x.value>(grads, grad_stride, count, rows + ky * row_stride + kx * step,
                                                         row_stride, step, width * step,
                                                         products + (kz * ty.size + ky) * tx.size + kx, tx.size);
              });
            });
      }
    }
  }
}

template <class F>
void sum_partials(SumPartials<F> const& p, int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) {
    F const* const terms = p.terms + i / p.size * p.parts * p.size + i % p.size;
    double sum = 0;
    for (int64_t part = 0; part < p.parts; ++part) sum += terms[part * p.size];
    p.sums[i] = F(sum);
  }
}

KV_INSTANTIATE(filter2d_kernel_backward, Filter2dKernelBackward)
KV_INSTANTIATE_COMPUTED(sum_partials, SumPartials)

}  // namespace kv::filters::KV_ISA
