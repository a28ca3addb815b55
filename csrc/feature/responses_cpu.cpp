// Responses of corners and blobs on the CPU: rows [begin, end) of all planes in order. Each stage keeps the rows that
// the next stage reads in a ring buffer. Compiled once per instruction set.
#include "filters/edges/neighborhoods_cpu.h"
#include "responses.h"

namespace kv::feature::KV_ISA {
namespace {

constexpr int R = kWindowReach, kTaps = 2 * R + 1;

// A ring buffer of N rows of `size` elements. Row y is in slot y mod N; y is at least -2 N.
template <int N, class F>
struct RowRing {
  F* data;
  int64_t size;
  KV_HD F* operator[](int64_t y) const { return data + (y + 2 * N) % N * size; }

  // Pointers to all rows of the ring, in the order of rows, with row y in the middle.
  struct Window {
    F const* rows[N];
  };
  KV_HD Window around(int64_t y) const {
    Window window;
    for (int i = 0; i < N; ++i) window.rows[i] = (*this)[y - N / 2 + i];
    return window;
  }
};

// Three rows of products, one for each element of a symmetric matrix, summed in the window along x.
template <class F>
struct WindowAlongX {
  F* padded;  // three rows with the reach of the window on either side
  int64_t size, step;

  static KV_HD int64_t elements(int64_t size, int64_t step) { return 3 * (size + 2 * R * step); }
  KV_HD F* row(int m) const { return padded + m * (size + 2 * R * step) + R * step; }
  template <int N>
  KV_HD void put(int64_t e, SymmetricMatrix<Lanes<F, N>> v) const {
    store<N>(row(0) + e, v.xx);
    store<N>(row(1) + e, v.yy);
    store<N>(row(2) + e, v.xy);
  }
  KV_HD void sum(F* to) const {
    for (int m = 0; m < 3; ++m) {
      F* const v = row(m);
      for (int i = 1; i <= R; ++i)
        for (int64_t e = 0; e < step; ++e) {
          v[e - i * step] = v[e + i * step];
          v[size + (i - 1) * step + e] = v[size - (i + 1) * step + e];
        }
      for_each_vector<F>(0, size, [&](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        Lanes<F, N> sum = load<N>(v + e) * window_weight<F>(R);
        for (int t = 1; t <= R; ++t)
          sum += (load<N>(v + e - t * step) + load<N>(v + e + t * step)) * window_weight<F>(R + t);
        store<N>(to + m * size + e, sum);
      });
    }
  }
};

// The sums in the window along y of rows that WindowAlongX has summed.
template <int N, class F>
KV_HD SymmetricMatrix<Lanes<F, N>> sum_down(F const* const (&rows)[kTaps], int64_t size, int64_t e) {
  SymmetricMatrix<Lanes<F, N>> sum{};
  for (int t = 0; t < kTaps; ++t) {
    F const* const row = rows[t] + e;
    F const weight = window_weight<F>(t);
    sum.xx += load<N>(row) * weight;
    sum.yy += load<N>(row + size) * weight;
    sum.xy += load<N>(row + 2 * size) * weight;
  }
  return sum;
}

// Calls put(width, element, dx, dy) for the first derivatives of a row.
template <class T, class Put>
KV_HD void differentiate_row(filters::KV_ISA::Neighborhoods<kDerivativeBorder, T> const& x, int64_t plane, int64_t y,
                             bool sobel, Put put) {
  using F = Compute<T>;
  x.for_each(plane, y, [&](auto width, int64_t e, auto left, auto middle, auto right) KV_INLINE {
    auto const column = [&](auto const& c) { return gradient_column(c.above, c.middle, c.below, sobel); };
    Lanes<F, decltype(width)::value> dx, dy;
    gradient(column(left), column(middle), column(right), sobel, gradient_scale<F>(sobel), dx, dy);
    put(width, e, dx, dy);
  });
}

template <class F, int N>
KV_HD Lanes<F, N> corner_of(SymmetricMatrix<Lanes<F, N>> m, CornerKind kind, F k) {
  return kind == CornerKind::harris ? harris(m, k) : gftt(m, vsqrt(gftt_discriminant(m)));
}
template <class F, int N>
KV_HD SymmetricMatrix<Lanes<F, N>> corner_of_vjp(SymmetricMatrix<Lanes<F, N>> m, CornerKind kind, F k,
                                                 Lanes<F, N> grad) {
  if (kind == CornerKind::harris) return harris_vjp(m, k, grad);
  Lanes<F, N> const discriminant = gftt_discriminant(m), root = vsqrt(discriminant);
  return gftt_vjp(m, discriminant == 0 ? Lanes<F, N>{} : 1 / root, grad);
}

template <class F, int N>
KV_HD SymmetricMatrix<Lanes<F, N>> products(Lanes<F, N> dx, Lanes<F, N> dy) {
  return {dx * dx, dy * dy, dx * dy};
}

}  // namespace

template <class T>
void corner_response(Response<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const size = p.x.row_size(), step = p.x.step, height = p.x.height;
  bool const sobel = p.arguments.sobel;
  Scratch<F> scratch(WindowAlongX<F>::elements(size, step) + 3 * kTaps * size);
  WindowAlongX<F> const window{scratch.data, size, step};
  RowRing<kTaps, F> const summed{scratch.data + window.elements(size, step), 3 * size};
  filters::KV_ISA::Neighborhoods<kDerivativeBorder, T> const x(p.x);
  auto const fill = [&](int64_t plane, int64_t y) {
    differentiate_row(x, plane, reflected(y, height), sobel, [&](auto width, int64_t e, auto dx, auto dy) {
      constexpr int N = decltype(width)::value;
      window.template put<N>(e, products<F, N>(dx, dy));
    });
    window.sum(summed[y]);
  };
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    if (r == begin || y == 0)
      for (int64_t i = y - R; i < y + R; ++i) fill(plane, i);
    fill(plane, y + R);
    F const k = p.arguments.k_of(plane), scale = p.arguments.scale_of(plane);
    T* const out = p.y.row(plane, y);
    auto const window_down = summed.around(y);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, corner_of<F, N>(sum_down<N>(window_down.rows, size, e), p.arguments.kind, k) * scale);
    });
  }
}

template <class T>
void corner_response_backward(ResponseBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const size = p.x.row_size(), step = p.x.step, height = p.x.height;
  bool const sobel = p.arguments.sobel;
  F const gradient_factor = gradient_scale<F>(sobel);
  int64_t const window_elements = WindowAlongX<F>::elements(size, step), ring_elements = kTaps * 3 * size;
  Scratch<F> scratch(window_elements + 2 * ring_elements + kTaps * 2 * size);
  WindowAlongX<F> const window{scratch.data, size, step};
  RowRing<kTaps, F> const summed{scratch.data + window_elements, 3 * size},
      summed_back{summed.data + ring_elements, 3 * size}, gradients{summed_back.data + ring_elements, 2 * size};
  filters::KV_ISA::Neighborhoods<kDerivativeBorder, T> const x(p.x);
  filters::KV_ISA::NeighborhoodsVjp<kDerivativeBorder, F> const pixels(p.x);

  auto const is_end = [&](int64_t y) { return y == 0 || y == height - 1; };
  // Scales the ends of the three rows in the window, along x.
  auto const scale_ends = [&](F* row, F factor) {
    for (int64_t e = 0; e < step; ++e) row[e] *= factor, row[size - step + e] *= factor;
  };
  // Products of the derivatives of row y, in the window along x.
  auto const differentiate = [&](int64_t plane, int64_t y) {
    F* const dx_row = gradients[y];
    differentiate_row(x, plane, reflected(y, height), sobel, [&](auto width, int64_t e, auto dx, auto dy) {
      constexpr int N = decltype(width)::value;
      store<N>(dx_row + e, dx);
      store<N>(dx_row + size + e, dy);
      window.template put<N>(e, products<F, N>(dx, dy));
    });
    window.sum(summed[y]);
  };
  // The gradient to the structure tensor of row y, in the window along x.
  auto const differentiate_response = [&](int64_t plane, int64_t y) {
    int64_t const source = reflected(y, height);
    T const* const grad = p.grad.row(plane, source);
    F const k = p.arguments.k_of(plane), scale = p.arguments.scale_of(plane) * (is_end(source) ? 2 : 1);
    auto const window_down = summed.around(y);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> const g = load<N>(grad + e) * scale;
      window.template put<N>(e, corner_of_vjp<F, N>(sum_down<N>(window_down.rows, size, e), p.arguments.kind, k, g));
    });
    for (int m = 0; m < 3; ++m) scale_ends(window.row(m), 2);
    window.sum(summed_back[y]);
  };
  // From the gradient to the products of row y to its contributions to the pixels around it.
  auto const differentiate_products = [&](int64_t y) {
    F const* const dx_row = gradients[y];
    F const factor = is_end(y) ? F(0.5) : F(1);
    auto const window_down = summed_back.around(y);
    for_each_vector<F>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      auto const m = sum_down<N>(window_down.rows, size, e);
      Lanes<F, N> const dx = load<N>(dx_row + e), dy = load<N>(dx_row + size + e);
      store<N>(pixels.u + e, (dx * m.xx * 2 + dy * m.xy) * factor);
      store<N>(pixels.v + e, (dy * m.yy * 2 + dx * m.xy) * factor);
    });
    scale_ends(pixels.u, F(0.5));
    scale_ends(pixels.v, F(0.5));
    pixels.put(y, [&](auto... neighbors) { return gradient_row_vjp(neighbors..., sobel); });
  };

  for (int64_t r = begin; r < end;) {
    int64_t const plane = r / height, y0 = r % height, y1 = min(height, y0 + end - r);
    for (int64_t y = y0 - 2 * R - 1; y < y1 + 2 * R + 1; ++y) {
      differentiate(plane, y);
      if (y - R < y0 - R - 1) continue;
      differentiate_response(plane, y - R);
      if (int64_t const at = y - 2 * R; at >= y0 - 1 && at >= 0 && at < height) differentiate_products(at);
      int64_t const at = y - 2 * R - 1;
      if (at < y0) continue;
      pixels.template store_row<GradientRow>(at, p.grad_x.row(plane, at), [&](auto above, auto middle, auto below) {
        return gradient_vjp(above, middle, below, sobel, gradient_factor);
      });
    }
    r += y1 - y0;
  }
}

namespace {

// Calls put(width, element, second derivatives) for a row. `padded` holds three rows with Kernel::reach pixels on
// either side.
template <class Kernel, class T, class Put>
KV_HD void differentiate_row_twice(Planes<T const> const& x, int64_t plane, int64_t y, Compute<T>* padded, Put put) {
  using F = Compute<T>;
  constexpr int reach = Kernel::reach;
  int64_t const size = x.row_size(), step = x.step, pitch = size + 2 * reach * step;
  T const* rows[2 * reach + 1];
  for (int i = 0; i <= 2 * reach; ++i) rows[i] = x.row(plane, clamp(y - reach + i, int64_t(0), x.height - 1));
  auto const row = [&](int channel) { return padded + channel * pitch + reach * step; };
  for_each_vector<T>(0, size, [&](auto width, int64_t e) {
    constexpr int N = decltype(width)::value;
    filters::for_each_channel<Kernel>([&](auto c) {
      auto const v = c.down().dot([&](int i) { return load<N>(rows[i] + e); });
      store<N>(row(c.value) + e, v * c.template scale<F>(true));
    });
  });
  for (int channel = 0; channel < 3; ++channel) {
    F* const v = row(channel);
    for (int64_t i = 0; i < reach * step; ++i) {
      v[i - reach * step] = v[i % step];
      v[size + i] = v[size - step + i % step];
    }
  }
  for_each_vector<T>(0, size, [&](auto width, int64_t e) {
    constexpr int N = decltype(width)::value;
    Lanes<F, N> derivatives[3];
    filters::for_each_channel<Kernel>([&](auto c) {
      derivatives[c.value] = c.along().dot([&](int i) { return load<N>(row(c.value) + e + (i - reach) * step); });
    });
    put(width, e, SymmetricMatrix<Lanes<F, N>>{derivatives[0], derivatives[2], derivatives[1]});
  });
}

template <class Kernel, class T>
KV_HD void hessian_rows(Response<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.x.height;
  Scratch<F> scratch(3 * (p.x.row_size() + 2 * Kernel::reach * p.x.step));
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    T* const out = p.y.row(plane, y);
    F const scale = p.arguments.scale_of(plane);
    differentiate_row_twice<Kernel>(p.x, plane, y, scratch.data, [&](auto width, int64_t e, auto hessian) {
      store<decltype(width)::value>(out + e, determinant(hessian) * scale);
    });
  }
}

template <class Kernel, class T>
KV_HD void hessian_rows_backward(ResponseBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int reach = Kernel::reach;
  int64_t const size = p.x.row_size(), step = p.x.step, height = p.x.height, pitch = size + 2 * reach * step;
  Scratch<F> scratch(6 * pitch + (2 * reach + 1) * 3 * size);
  F* const back = scratch.data + 3 * pitch;  // gradients to the second derivatives, zero out of bounds
  for (int64_t e = 0; e < 3 * pitch; ++e) back[e] = 0;
  RowRing<2 * reach + 1, F> const ring{back + 3 * pitch, 3 * size};
  auto const row = [&](int channel) { return back + channel * pitch + reach * step; };

  auto const fill = [&](int64_t plane, int64_t y) {
    F* const to = ring[y];
    if (y < 0 || y >= height) {
      for (int64_t e = 0; e < 3 * size; ++e) to[e] = 0;
      return;
    }
    T const* const grad = p.grad.row(plane, y);
    F const scale = p.arguments.scale_of(plane);
    differentiate_row_twice<Kernel>(p.x, plane, y, scratch.data, [&](auto width, int64_t e, auto hessian) {
      constexpr int N = decltype(width)::value;
      auto const d = determinant_vjp(hessian, Lanes<F, N>(load<N>(grad + e) * scale));
      store<N>(row(0) + e, d.xx);
      store<N>(row(1) + e, d.xy);
      store<N>(row(2) + e, d.yy);
    });
    filters::for_each_channel<Kernel>([&](auto c) {
      auto const pixel = [&](auto width, int64_t e, bool first, bool last) {
        constexpr int N = decltype(width)::value;
        auto const v =
            c.along().dot_vjp([&](int i) { return load<N>(row(c.value) + e + (i - reach) * step); }, first, last);
        store<N>(to + c.value * size + e, v * c.template scale<F>(true));
      };
      for (int64_t e = 0; e < step; ++e) pixel(Width<1>{}, e, true, size == step);
      for_each_vector<F>(step, size - step, [&](auto width, int64_t e) { pixel(width, e, false, false); });
      for (int64_t e = max(step, size - step); e < size; ++e) pixel(Width<1>{}, e, false, true);
    });
  };

  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    if (r == begin || y == 0)
      for (int64_t i = y - reach; i < y + reach; ++i) fill(plane, i);
    fill(plane, y + reach);
    T* const out = p.grad_x.row(plane, y);
    auto const around = ring.around(y);
    auto const sum_down = [&](bool first, bool last) KV_INLINE {
      for_each_vector<T>(0, size, [&](auto width, int64_t e) {
        constexpr int N = decltype(width)::value;
        Lanes<F, N> sum{};
        filters::for_each_channel<Kernel>([&](auto c) {
          sum += c.down().dot_vjp([&](int i) { return load<N>(around.rows[i] + c.value * size + e); }, first, last);
        });
        store<N>(out + e, sum);
      });
    };
    if (y > 0 && y < height - 1)
      sum_down(false, false);
    else
      sum_down(y == 0, y == height - 1);
  }
}

}  // namespace

template <class T>
void hessian_response(Response<T> const& p, int64_t begin, int64_t end) {
  dispatch_second_derivatives(p.arguments.sobel, [&](auto kernel) { hessian_rows<decltype(kernel)>(p, begin, end); });
}

template <class T>
void hessian_response_backward(ResponseBackward<T> const& p, int64_t begin, int64_t end) {
  dispatch_second_derivatives(p.arguments.sobel,
                              [&](auto kernel) { hessian_rows_backward<decltype(kernel)>(p, begin, end); });
}

template <class T>
void difference_of_gaussians(DifferenceOfGaussians<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int fine = kFineReach, coarse = kCoarseReach;
  int64_t const size = p.x.row_size(), step = p.x.step, height = p.x.height, pad = coarse * step;
  F const end_in = p.transposed ? 2 : 1, end_out = p.transposed ? F(0.5) : F(1);
  Scratch<F> scratch(size + 2 * pad + (2 * coarse + 1) * 2 * size);
  F* const v = scratch.data + pad;
  RowRing<2 * coarse + 1, F> const ring{scratch.data + size + 2 * pad, 2 * size};  // blurred along x: fine, coarse
  // The sum of weights[d] times the pixels d before and after, which at(d) and at(-d) load.
  auto const blur = [](auto const& weights, int reach, auto at) KV_INLINE {
    auto sum = at(0) * weights[0];
    for (int d = 1; d <= reach; ++d) sum += (at(-d) + at(d)) * weights[d];
    return sum;
  };

  auto const fill = [&](int64_t plane, int64_t y) {
    int64_t const source = reflected(y, height);
    T const* const in = p.x.row(plane, source);
    F const factor = end_factor(source, height, end_in);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(v + e, load<N>(in + e) * factor);
    });
    for (int64_t e = 0; e < step; ++e) v[e] *= end_in, v[size - step + e] *= end_in;
    for (int i = 1; i <= coarse; ++i)
      for (int64_t e = 0; e < step; ++e) {
        v[e - i * step] = v[e + i * step];
        v[size + (i - 1) * step + e] = v[size - (i + 1) * step + e];
      }
    F* const to = ring[y];
    for_each_vector<F>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      auto const at = [&](int d) { return load<N>(v + e + d * step); };
      store<N>(to + e, blur(p.fine, fine, at));
      store<N>(to + size + e, blur(p.coarse, coarse, at));
    });
  };

  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    if (r == begin || y == 0)
      for (int64_t i = y - coarse; i < y + coarse; ++i) fill(plane, i);
    fill(plane, y + coarse);
    T* const out = p.y.row(plane, y);
    F const factor = end_factor(y, height, end_out);
    F* const results = v;
    auto const around = ring.around(y);
    for_each_vector<F>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      auto const coarse_blur =
          blur(p.coarse, coarse, [&](int d) { return load<N>(around.rows[coarse + d] + size + e); });
      auto const fine_blur = blur(p.fine, fine, [&](int d) { return load<N>(around.rows[coarse + d] + e); });
      store<N>(results + e, (coarse_blur - fine_blur) * factor);
    });
    for (int64_t e = 0; e < step; ++e) results[e] *= end_out, results[size - step + e] *= end_out;
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      store<N>(out + e, load<N>(results + e));
    });
  }
}

KV_INSTANTIATE(difference_of_gaussians, DifferenceOfGaussians)
KV_INSTANTIATE(corner_response, Response)
KV_INSTANTIATE(corner_response_backward, ResponseBackward)
KV_INSTANTIATE(hessian_response, Response)
KV_INSTANTIATE(hessian_response_backward, ResponseBackward)

}  // namespace kv::feature::KV_ISA
