// Structural similarity on the CPU. The means of a row are computed along y directly from the two images, then along x.
// The backward pass keeps the derivatives of as many rows as the window has, filtered along x. Volumes are filtered
// along z first; their backward pass filters along z last, and keeps as many slices as the window has. Compiled once
// per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "ssim.h"

namespace kv::metrics::KV_ISA {
namespace {

// out[e] = sum over t of weights[t] * rows[t][e] for e < count. Along y the rows are rows of an image; along x they are
// shifted copies of one row. Not inline: it is most of the work, and both passes call it along both axes.
template <class F>
__attribute__((noinline)) void sum_rows(F const* const* rows, F const* weights, int size, int64_t count, F* out) {
  constexpr int N = kLanes<F>, U = 6;
  int64_t e = 0;
  for (; e + U * N <= count; e += U * N) {
    Lanes<F, N> sums[U] = {};
    for (int t = 0; t < size; ++t)
      for (int u = 0; u < U; ++u) sums[u] += load<N>(rows[t] + e + u * N) * weights[t];
    for (int u = 0; u < U; ++u) store<N>(out + e + u * N, sums[u]);
  }
  if (e < count)
    for_each_vector<F>(e, count, [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      Lanes<F, M> sum{};
      for (int t = 0; t < size; ++t) sum += load<M>(rows[t] + e) * weights[t];
      store<M>(out + e, sum);
    });
}

// Rows of one size with a margin on either side.
template <class F>
struct Rows {
  int64_t const size, step, margin, stride;  // in elements; step: from one pixel to the next
  Scratch<F> memory;

  KV_HD Rows(int count, int64_t size, int64_t step, int64_t adjacent)
      : size(size),
        step(step),
        margin((adjacent * step + 15) / 16 * 16),
        stride((size + 15) / 16 * 16 + 2 * margin),
        memory(count * stride) {}

  KV_HD F* operator[](int64_t i) const { return memory.data + i * stride + margin; }

  // Fills the margins of row i, which has `width` pixels: `left` and `right` pixels of them.
  KV_HD void extend(int64_t i, Border border, int64_t width, int64_t left, int64_t right) const {
    F* const row = (*this)[i];
    for (int64_t at = -left; at < width + right; at = at == -1 ? width : at + 1) {
      int64_t const from = border_index(border, at, width);
      for (int64_t c = 0; c < step; ++c) row[at * step + c] = from < 0 ? F(0) : row[from * step + c];
    }
  }

  // Filters row i along x to `count` elements; each window starts `before` pixels earlier.
  KV_HD void filter(int64_t i, F const* weights, int taps, int64_t before, F const** shifted, int64_t count,
                    F* out) const {
    for (int t = 0; t < taps; ++t) shifted[t] = (*this)[i] + (t - before) * step;
    sum_rows(shifted, weights, taps, count, out);
  }
};

enum { kX, kSquares, kApart, kY, kMeans };  // order of the rows of means and of derivatives

// Computes the means, one row after the other.
template <class T>
struct MeansOfRows {
  using F = Compute<T>;
  SsimImages<T> const& p;
  int64_t const count;  // of a row of means
  Rows<F> along_z, along_y, means;
  Scratch<F const*> shifted;
  Scratch<F> weights;
  Scratch<T const*> pointers;
  Scratch<T> zeros;
  int64_t of_plane = -1, last = -1;  // along z, rows are filled up to `last` of plane `of_plane`

  MeansOfRows(SsimImages<T> const& p, int64_t width)
      : p(p),
        count(width * p.x.step),
        along_z(p.volumes ? kMeans * p.size : 0, p.x.row_size(), p.x.step, 0),
        along_y(kMeans, p.x.row_size(), p.x.step, p.size),
        means(kMeans, p.x.row_size(), p.x.step, 0),
        shifted(p.size),
        weights(p.size),
        pointers(2 * p.size),
        zeros(p.x.row_size()) {
    for (int64_t e = 0; e < p.x.row_size(); ++e) zeros.data[e] = T{};
  }

  // Sums the terms of the rows of both images in `pointers` into rows from `first` on.
  void sum_images(Rows<F> const& to, int64_t first) const {
    T const *const *const xs = pointers.data, *const *const ys = xs + p.size;
    for_each_vector<T>(0, p.x.row_size(), [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      Lanes<F, N> sums[kMeans] = {};
      for (int t = 0; t < p.size; ++t) {
        Lanes<F, N> const a = load<N>(xs[t] + e), b = load<N>(ys[t] + e), d = a - b;
        F const weight = p.weights[t];
        sums[kX] += a * weight;
        sums[kY] += b * weight;
        sums[kSquares] += (a * a + b * b) * weight;
        sums[kApart] += d * d * weight;
      }
      for (int m = 0; m < kMeans; ++m) store<N>(to[first + m] + e, sums[m]);
    });
  }
  void point(int t, int64_t plane, int64_t y) {
    pointers.data[t] = plane < 0 || y < 0 ? zeros.data : p.x.row(plane, y);
    pointers.data[p.size + t] = plane < 0 || y < 0 ? zeros.data : p.y.row(plane, y);
  }

  void sum_along_y(int64_t plane, int64_t y) {
    for (int t = 0; t < p.size; ++t) point(t, plane, border_index(p.border, y - p.before() + t, p.x.height));
    sum_images(along_y, 0);
  }
  // The same for slice z of a volume, from rows along z.
  void sum_along_z_and_y(int64_t plane, int64_t y) {
    int64_t const volume = plane / p.slices(), z = plane % p.slices(), first = y - p.before();
    if (plane != of_plane || last < first - 1) of_plane = plane, last = max(first, int64_t(0)) - 1;
    while (last < min(first + p.size, p.x.height) - 1) {
      ++last;
      for (int t = 0; t < p.size; ++t) {
        int64_t const slice = border_index(p.border, z - p.before() + t, p.depth);
        point(t, slice < 0 ? -1 : volume * p.depth + slice, last);
      }
      sum_images(along_z, last % p.size * kMeans);
    }
    for (int m = 0; m < kMeans; ++m) {
      int rows = 0;
      for (int t = 0; t < p.size; ++t) {
        int64_t const inside = border_index(p.border, first + t, p.x.height);
        if (inside < 0) continue;
        shifted.data[rows] = along_z[inside % p.size * kMeans + m];
        weights.data[rows++] = p.weights[t];
      }
      sum_rows(shifted.data, weights.data, rows, p.x.row_size(), along_y[m]);
    }
  }

  // Writes row y of a plane of the similarity.
  void row(int64_t plane, int64_t y) {
    p.volumes ? sum_along_z_and_y(plane, y) : sum_along_y(plane, y);
    for (int m = 0; m < kMeans; ++m) {
      if (!p.valid) along_y.extend(m, p.border, p.x.width, p.before(), p.before());
      along_y.filter(m, p.weights, p.size, p.before(), shifted.data, count, means[m]);
    }
  }

  // Stores the means of abs(x - y) in row y of a plane in row 0.
  void difference(int64_t plane, int64_t y) {
    T const *const *const xs = pointers.data, *const *const ys = xs + p.size;
    for (int t = 0; t < p.size; ++t) point(t, plane, border_index(p.border, y - p.before() + t, p.x.height));
    for_each_vector<T>(0, p.x.row_size(), [&](auto n, int64_t e) {
      constexpr int N = decltype(n)::value;
      Lanes<F, N> sum{};
      for (int t = 0; t < p.size; ++t) sum += vabs(Lanes<F, N>(load<N>(xs[t] + e) - load<N>(ys[t] + e))) * p.weights[t];
      store<N>(along_y[0] + e, sum);
    });
    along_y.extend(0, p.border, p.x.width, p.before(), p.before());
    along_y.filter(0, p.weights, p.size, p.before(), shifted.data, count, means[0]);
  }

  template <int N>
  KV_HD Means<Lanes<F, N>> at(int64_t e) const {
    return {load<N>(means[kX] + e), load<N>(means[kY] + e), load<N>(means[kSquares] + e), load<N>(means[kApart] + e)};
  }
};

// Writes row y of a plane of the gradients, from the sums of the derivatives. absolute(n, e) returns the derivative by
// abs(x - y).
template <class T, class Absolute>
KV_HD void write_gradients(SsimImages<T> const& images, Planes<T> const& grad_x, Planes<T> const& grad_y, int64_t plane,
                           int64_t y, Rows<Compute<T>> const& sums, Absolute absolute) {
  using F = Compute<T>;
  T const *const x = images.x.row(plane, y), *const other = images.y.row(plane, y);
  T *const to_x = grad_x.row(plane, y), *const to_y = grad_y.data ? grad_y.row(plane, y) : nullptr;
  for_each_vector<T>(0, images.x.row_size(), [&](auto n, int64_t e) {
    constexpr int N = decltype(n)::value;
    Lanes<F, N> const a = load<N>(x + e), b = load<N>(other + e), squares = load<N>(sums[kSquares] + e);
    Lanes<F, N> const difference = a - b, apart = difference * load<N>(sums[kApart] + e);
    Lanes<F, N> const one = broadcast<N>(F(1)), sign = difference > 0   ? one
                                                       : difference < 0 ? Lanes<F, N>(-one)
                                                                        : difference;
    Lanes<F, N> const of_absolute = absolute(n, e) * sign;
    store<N>(to_x + e, Lanes<F, N>(load<N>(sums[kX] + e) + a * squares + apart + of_absolute));
    if (to_y) store<N>(to_y + e, Lanes<F, N>(load<N>(sums[kY] + e) + b * squares - apart - of_absolute));
  });
}

// The transpose of the means: sums the derivatives of all windows that contain a row.
template <class T>
struct GradientRows {
  using F = Compute<T>;
  SsimBackward<T> const& p;
  SsimImages<T> const& images;
  int const size, lead, used;  // rows y - lead ... y - lead + size - 1 contribute to row y
  bool const mirrored;
  int64_t const step, width, height;
  MeansOfRows<T> means;
  Rows<F> derivatives, history;
  Rows<F> sums;  // the result: along x and y
  Scratch<F const*> pointers;
  Scratch<F> weights;

  explicit GradientRows(SsimBackward<T> const& p)
      : p(p),
        images(p.images),
        size(images.size),
        lead(images.valid ? size - 1 : size / 2),
        used(p.grad_y.data ? kMeans : kY),
        mirrored(images.border == Border::reflect),
        step(images.x.step),
        width(images.x.width),
        height(images.x.height),
        means(images, p.grad.width),
        derivatives(kMeans, images.x.row_size(), step, size),
        history(kMeans * size, images.x.row_size(), step, 0),
        sums(kMeans, images.x.row_size(), step, 0),
        pointers(size),
        weights(size) {}

  // D of the transpose in ssim.h.
  KV_HD bool at_border(int64_t i, int64_t n) const { return mirrored && (i == 0 || i == n - 1); }
  KV_HD void scale_ends(F* row, int64_t n, F factor) const {
    for (int64_t c = 0; mirrored && c < step; ++c) {
      row[c] *= factor;
      if (n > 1) row[(n - 1) * step + c] *= factor;
    }
  }
  KV_HD F of_loss(int64_t plane) const {
    return p.grad.data ? F(0) : p.of_loss[plane / images.slices() / p.loss.planes];
  }

  // The derivatives in row q of a plane, filtered along x.
  void fill(int64_t plane, int64_t q) {
    int64_t const columns = p.grad.width;
    T const* const g = p.grad.data ? p.grad.row(plane, q) : nullptr;
    F const of_pixel = -p.loss.structure * of_loss(plane);
    bool const at_end = images.volumes && at_border(plane % images.slices(), images.slices());
    F const twice = (at_border(q, p.grad.height) ? F(2) : F(1)) * (at_end ? F(2) : F(1));
    means.row(plane, q);
    for_each_vector<T>(0, means.count, [&](auto n, int64_t e) {
      constexpr int N = decltype(n)::value;
      Lanes<F, N> const of_result = (g ? load<N>(g + e) : broadcast<N>(of_pixel)) * twice;
      auto const m = means.template at<N>(e);
      SsimTerms<Lanes<F, N>> const terms(m, images.constants);
      Lanes<F, N> const inverse = 1 / terms.denominator;
      auto const d = ssim_of_means_vjp(m, terms, inverse, of_result, images.constants.luminance);
      store<N>(derivatives[kX] + e, d.x);
      store<N>(derivatives[kY] + e, d.y);
      store<N>(derivatives[kSquares] + e, d.squares);
      store<N>(derivatives[kApart] + e, d.apart);
    });
    for (int m = 0; m < used; ++m) {
      scale_ends(derivatives[m], columns, F(2));
      derivatives.extend(m, images.border, columns, lead, width - columns + size - 1 - lead);
      derivatives.filter(m, images.weights, size, lead, pointers.data, width * step, history[q % size * kMeans + m]);
    }
  }

  // Sums along an axis at index i of n, `count` elements wide. Derivatives exist for `rows` indices; `row(j)` points to
  // those of j.
  template <class Row>
  KV_HD void sum_along(int64_t i, int64_t n, int64_t rows, Row row, int64_t count, F* out) {
    int taps = 0;
    for (int t = 0; t < size; ++t) {
      int64_t const q = border_index(images.border, i - lead + t, rows);
      if (q < 0) continue;
      pointers.data[taps] = row(q);
      weights.data[taps++] = images.weights[t] * (at_border(i, n) ? F(0.5) : F(1));
    }
    sum_rows(pointers.data, weights.data, taps, count, out);
  }

  // Calls f(plane, y) with the sums of rows [begin, end), counted through all planes of the similarity.
  template <class Call>
  KV_HD void for_each(int64_t begin, int64_t end, Call f) {
    int64_t const rows = p.grad.height;
    int64_t filled = -1;  // the last row of the plane whose derivatives are stored
    for (int64_t r = begin; r < end; ++r) {
      int64_t const plane = r / height, y = r % height;
      if (r == begin || y == 0) filled = max(y - lead, int64_t(0)) - 1;
      for (int64_t const last = min(y - lead + size - 1, rows - 1); filled < last;) fill(plane, ++filled);
      for (int m = 0; m < used; ++m) {
        sum_along(y, height, rows, [&](int64_t q) { return history[q % size * kMeans + m]; }, width * step, sums[m]);
        scale_ends(sums[m], width, F(0.5));
      }
      f(plane, y);
    }
  }

  // Writes row y of a plane of the images' gradients.
  void write(int64_t plane, int64_t y, F of_loss) const {
    F const absolute = p.loss.absolute * of_loss;
    write_gradients(images, p.grad_x, p.grad_y, plane, y, sums, [=](auto, int64_t) { return absolute; });
  }
};

// The means in the windows of one scale after the other.
template <class T>
struct ImagesAtScales {
  using F = Compute<T>;
  SsimImages<T> images;
  SsimScales<F> const& scales;
  SsimConstants<F> const constants;
  MeansOfRows<T> means;  // of `images`; their memory fits the largest window

  ImagesAtScales(SsimImages<T> const& p, SsimScales<F> const& scales)
      : images(p), scales(scales), constants(p.constants), means(images, p.x.width) {}

  void take(int s) {
    images.size = scales.sizes[s], images.weights = scales.weights[s];
    images.constants = constants;
    if (s + 1 < scales.count) images.constants.c1 = 1, images.constants.luminance = 0;
  }
};

// Calls f(index constant N, element) for whole vectors, only over Rows, whose margins make room for the last vector. f
// may work in place.
template <class T, class F>
KV_HD void for_each_padded_vector(int64_t size, F f) {
  for (int64_t e = 0; e < size; e += kLanes<T>) f(Width<kLanes<T>>{}, e);
}

// The transpose of the means of all scales: sums the derivatives of all windows that contain a row.
template <class T>
struct MsGradientRows {
  using F = Compute<T>;
  MsSsimBackward<T> const& p;
  ImagesAtScales<T> at_scales;
  int const count, size, used;  // count: of scales; size: of the largest window
  int64_t const width, height;
  Rows<F> factors, derivatives, history, difference_history, sums;
  Scratch<F const*> pointers;
  Scratch<F> weights;

  explicit MsGradientRows(MsSsimBackward<T> const& p)
      : p(p),
        at_scales(p.images, p.scales),
        count(p.scales.count),
        size(p.images.size),
        used(p.grad_y.data ? kMeans : kY),
        width(p.images.x.width),
        height(p.images.x.height),
        factors(count + 1, width, 1, 0),
        derivatives(kMeans * count, width, 1, size),
        history(kMeans * count * size, width, 1, 0),
        difference_history(size, width, 1, 0),
        sums(kMeans + 1, width, 1, 0),
        pointers(count * size),
        weights(count * size) {}

  // The derivatives in row q of a plane, filtered along x.
  void fill(int64_t plane, int64_t q) {
    SsimImages<T> const& images = at_scales.images;
    for (int s = 0; s < count; ++s) {
      at_scales.take(s);
      at_scales.means.row(plane, q);
      for_each_vector<T>(0, width, [&](auto n, int64_t e) {
        constexpr int N = decltype(n)::value;
        auto const m = at_scales.means.template at<N>(e);
        SsimTerms<Lanes<F, N>> const terms(m, images.constants);
        Lanes<F, N> const inverse = 1 / terms.denominator;
        auto const d = ssim_of_means_vjp(m, terms, inverse, broadcast<N>(F(1)), images.constants.luminance);
        store<N>(factors[s] + e, Lanes<F, N>(1 - terms.numerator * inverse));
        store<N>(derivatives[s * kMeans + kX] + e, d.x);
        store<N>(derivatives[s * kMeans + kY] + e, d.y);
        store<N>(derivatives[s * kMeans + kSquares] + e, d.squares);
        store<N>(derivatives[s * kMeans + kApart] + e, d.apart);
      });
    }
    F const* const g = p.of_map + (plane / p.loss.planes * height + q) * width;
    for_each_vector<T>(0, width, [&](auto n, int64_t e) {
      constexpr int N = decltype(n)::value;
      store<N>(factors[count] + e, Lanes<F, N>(load<N>(g + e) * -p.loss.structure));
    });
    for (int s = 0; s < count; ++s) {
      at_scales.take(s);
      for_each_padded_vector<T>(width, [&](auto n, int64_t e) {
        constexpr int N = decltype(n)::value;
        Lanes<F, N> factor = load<N>(factors[count] + e);
        for (int t = 0; t < count; ++t)
          if (t != s) factor *= load<N>(factors[t] + e);
        for (int m = 0; m < used; ++m) {
          F* const to = derivatives[s * kMeans + m] + e;
          store<N>(to, Lanes<F, N>(load<N>(to) * factor));
        }
      });
      for (int m = 0; m < used; ++m) along_x(s * kMeans + m, history[(q % size * count + s) * kMeans + m]);
    }
    for_each_vector<T>(0, width, [&](auto n, int64_t e) {
      constexpr int N = decltype(n)::value;
      store<N>(derivatives[0] + e, load<N>(g + e));
    });
    along_x(0, difference_history[q % size]);
  }
  // Filters a row of derivatives in the window of the current scale.
  void along_x(int row, F* out) {
    SsimImages<T> const& images = at_scales.images;
    derivatives.extend(row, images.border, width, images.before(), images.before());
    derivatives.filter(row, images.weights, images.size, images.before(), pointers.data, width, out);
  }

  // Sums the rows around y that `row(s, q)` has stored, for scales from `first` on.
  template <class Row>
  void sum_down(int64_t y, int first, Row row, F* out) {
    int taps = 0;
    for (int s = first; s < count; ++s)
      for (int t = 0; t < p.scales.sizes[s]; ++t) {
        int64_t const q = y - p.scales.sizes[s] / 2 + t;
        if (q < 0 || q >= height) continue;
        pointers.data[taps] = row(s, q % size), weights.data[taps++] = p.scales.weights[s][t];
      }
    sum_rows(pointers.data, weights.data, taps, width, out);
  }

  // Rows [begin, end) of all planes.
  void write(int64_t begin, int64_t end) {
    int64_t filled = -1;  // the last row of the plane whose derivatives are stored
    int const R = size / 2;
    for (int64_t r = begin; r < end; ++r) {
      int64_t const plane = r / height, y = r % height;
      if (r == begin || y == 0) filled = max(y - R, int64_t(0)) - 1;
      while (filled < min(y + R, height - 1)) fill(plane, ++filled);
      for (int m = 0; m < used; ++m)
        sum_down(y, 0, [&](int s, int64_t slot) { return history[(slot * count + s) * kMeans + m]; }, sums[m]);
      sum_down(y, count - 1, [&](int, int64_t slot) { return difference_history[slot]; }, sums[kMeans]);
      write_gradients(p.images, p.grad_x, p.grad_y, plane, y, sums, [&](auto n, int64_t e) {
        constexpr int N = decltype(n)::value;
        return Lanes<F, N>(load<N>(sums[kMeans] + e) * p.loss.absolute);
      });
    }
  }
};

}  // namespace

template <class T>
void ssim(Ssim<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  MeansOfRows<T> means(p.images, p.similarity.width);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.similarity.height, y = r % p.similarity.height;
    means.row(plane, y);
    auto const unlike_at = [&](auto width, int64_t e) {
      constexpr int M = decltype(width)::value;
      SsimTerms<Lanes<F, M>> const terms(means.template at<M>(e), p.images.constants);
      return Lanes<F, M>(terms.numerator / terms.denominator);
    };
    if (p.similarity.data) {
      T* const out = p.similarity.row(plane, y);
      for_each_vector<T>(0, means.count, [&](auto width, int64_t e) {
        constexpr int M = decltype(width)::value;
        store<M>(out + e, Lanes<F, M>(1 - unlike_at(width, e)));
      });
      continue;
    }
    T const *const a = p.images.x.row(plane, y), *const b = p.images.y.row(plane, y);
    Lanes<F, N> unlike{}, apart{};
    F sum = 0;
    int64_t e = 0;
    for (; e + N <= means.count; e += N) {
      unlike += unlike_at(Width<N>{}, e);
      apart += vabs(Lanes<F, N>(load<N>(a + e) - load<N>(b + e)));
    }
    for (; e < means.count; ++e)
      sum += p.loss.structure * unlike_at(Width<1>{}, e) + p.loss.absolute * vabs(F(load<1>(a + e) - load<1>(b + e)));
    for (int l = 0; l < N; ++l) sum += p.loss.structure * unlike[l] + p.loss.absolute * apart[l];
    p.partial[r] = sum;
  }
}

// Rows [begin, end) of images, or slices of volumes.
template <class T>
void ssim_backward(SsimBackward<T> const& p, int64_t begin, int64_t end) {
  GradientRows<T> rows(p);
  if (!p.images.volumes)
    return rows.for_each(begin, end, [&](int64_t plane, int64_t y) { rows.write(plane, y, rows.of_loss(plane)); });

  using F = Compute<T>;
  int64_t const depth = p.images.depth, slices = p.images.slices(), height = rows.height, width = rows.width;
  Rows<F> const history(rows.size * rows.used * height, width, 1,
                        0);  // of as many slices as the window has, filtered along x and y
  auto const row_of = [&](int64_t q, int m, int64_t y) {
    return history[(q % rows.size * rows.used + m) * height + y];
  };
  int64_t filled = -1;  // the last slice of the volume that is stored
  for (int64_t plane = begin; plane < end; ++plane) {
    int64_t const volume = plane / depth, z = plane % depth;
    if (plane == begin || z == 0) filled = max(z - rows.lead, int64_t(0)) - 1;
    while (filled < min(z - rows.lead + rows.size - 1, slices - 1)) {
      int64_t const first = (volume * slices + ++filled) * height;
      rows.for_each(first, first + height, [&](int64_t, int64_t y) {
        for (int m = 0; m < rows.used; ++m) __builtin_memcpy(row_of(filled, m, y), rows.sums[m], width * sizeof(F));
      });
    }
    for (int64_t y = 0; y < height; ++y) {
      for (int m = 0; m < rows.used; ++m)
        rows.sum_along(z, depth, slices, [&](int64_t q) { return row_of(q, m, y); }, width, rows.sums[m]);
      rows.write(plane, y, rows.of_loss(volume * slices));
    }
  }
}

// Rows [begin, end) of the map.
template <class T>
void ms_ssim(MsSsim<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.images.x.width, height = p.images.x.height;
  ImagesAtScales<T> at_scales(p.images, p.scales);
  SsimImages<T> const& images = at_scales.images;
  MeansOfRows<T>& means = at_scales.means;
  Rows<F> const rows(2, width, 1, 0);
  F *const similar = rows[0], *const loss = rows[1];
  for (int64_t r = begin; r < end; ++r) {
    for (int64_t c = 0; c < p.loss.planes; ++c) {
      int64_t const plane = r / height * p.loss.planes + c, y = r % height;
      for (int s = 0; s < p.scales.count; ++s) {
        at_scales.take(s);
        means.row(plane, y);
        for_each_padded_vector<T>(width, [&](auto n, int64_t e) {
          constexpr int N = decltype(n)::value;
          SsimTerms<Lanes<F, N>> const terms(means.template at<N>(e), images.constants);
          Lanes<F, N> const result = 1 - terms.numerator / terms.denominator;
          store<N>(similar + e, s == 0 ? result : Lanes<F, N>(result * load<N>(similar + e)));
        });
      }
      means.difference(plane, y);
      for_each_padded_vector<T>(width, [&](auto n, int64_t e) {
        constexpr int N = decltype(n)::value;
        Lanes<F, N> const unlike = 1 - load<N>(similar + e), apart = load<N>(means.means[0] + e);
        Lanes<F, N> const of_plane = unlike * p.loss.structure + apart * p.loss.absolute;
        store<N>(loss + e, c == 0 ? of_plane : Lanes<F, N>(of_plane + load<N>(loss + e)));
      });
    }
    __builtin_memcpy(p.map + r * width, loss, width * sizeof(F));
  }
}

template <class T>
void ms_ssim_backward(MsSsimBackward<T> const& p, int64_t begin, int64_t end) {
  MsGradientRows<T>(p).write(begin, end);
}

KV_INSTANTIATE(ssim, Ssim)
KV_INSTANTIATE(ssim_backward, SsimBackward)
KV_INSTANTIATE(ms_ssim, MsSsim)
KV_INSTANTIATE(ms_ssim_backward, MsSsimBackward)

}  // namespace kv::metrics::KV_ISA
