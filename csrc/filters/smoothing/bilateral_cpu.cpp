// Bilateral blur on the CPU: rows [begin, end) of all images in order. Compiled once per instruction set.
//
// Rows are unpacked into planes of F that are extended by the border, so that windows need no border rule. For a vector
// of pixels the weights of all taps are computed first; then they weight each channel.
#include "bilateral.h"
#include "core/lanes.h"
#include "core/scratch.h"

namespace kv::filters::KV_ISA {
namespace {

// --- rows ------------------------------------------------------------------------------------------------------------

// A ring of rows: row y + capacity replaces row y. Vectors of pixels may reach `pad` pixels beyond either end, and the
// last vector may end after that.
template <class F>
struct Rows {
  int channels;
  int64_t capacity, pad, width, stride;
  Scratch<F> memory;

  Rows(int channels, int64_t capacity, int64_t pad, int64_t width)
      : channels(channels),
        capacity(capacity),
        pad(pad),
        width(width),
        stride(width + 2 * pad + kLanes<F>),
        memory(channels * capacity * stride) {}
  // Channel c follows `stride` elements after channel c - 1.
  F* row(int64_t y, int c = 0) const { return memory.data + ((y + capacity) % capacity * channels + c) * stride + pad; }

  void zero(int64_t y) const {
    for (F *p = row(y) - pad, *end = p + channels * stride; p < end; ++p) *p = 0;
  }
  // Extends row y at both ends by the border rule, and the last vector by zeros.
  void extend(int64_t y, Border border) const;
};

// The pixel at position i. With the circular border it may be more than one image away.
int64_t pixel_at(Border border, int64_t i, int64_t n) {
  return border == Border::circular ? (i % n + n) % n : border_index(border, i, n);
}

template <class F>
void Rows<F>::extend(int64_t y, Border border) const {
  for (int c = 0; c < channels; ++c) {
    F* const p = row(y, c);
    for (int64_t i = 1; i <= pad; ++i) {
      int64_t const left = pixel_at(border, -i, width), right = pixel_at(border, width - 1 + i, width);
      p[-i] = left < 0 ? F(0) : p[left];
      p[width - 1 + i] = right < 0 ? F(0) : p[right];
    }
    for (int64_t i = 0; i < kLanes<F>; ++i) p[width + pad + i] = 0;
  }
}

// Loads row y of image b, or its border row if y is out of bounds.
template <class F, class T>
void load_row(Rows<F> const& to, Images<T const> const& from, int64_t b, int64_t y, Border border) {
  int64_t const source = pixel_at(border, y, from.height);
  if (source < 0) return to.zero(y);
  for (int c = 0; c < to.channels; ++c) {
    F* const out = to.row(y, c);
    T const* const in = from.row(b, c, source);
    if (from.step == 1)
      for_each_vector<T>(0, to.width, [&](auto width, int64_t x) {
        constexpr int N = decltype(width)::value;
        store<N>(out + x, load<N>(in + x));
      });
    else
      for (int64_t x = 0; x < to.width; ++x) out[x] = load<1>(in + x * from.step);
  }
  to.extend(y, border);
}

template <class F, class T>
void store_row(Rows<F> const& from, Images<T> const& to, int64_t b, int64_t y) {
  for (int c = 0; c < from.channels; ++c) {
    F const* const in = from.row(y, c);
    T* const out = to.row(b, c, y);
    if (to.step == 1)
      for_each_vector<T>(0, from.width, [&](auto width, int64_t x) {
        constexpr int N = decltype(width)::value;
        store<N>(out + x, load<N>(in + x));
      });
    else
      for (int64_t x = 0; x < from.width; ++x) store<1>(out + x * to.step, in[x]);
  }
}

// --- windows ---------------------------------------------------------------------------------------------------------

template <class F>
using Vector = Lanes<F, kLanes<F>>;

// A vector of pixels and the rows of its window.
struct WindowPosition {
  int64_t x, y;         // the first pixel
  int64_t center;       // the window's center row: y itself, or a position out of bounds whose border row is y
  int64_t first, last;  // rows of the window
};

template <class F>
struct Window {
  int64_t ry, rx;
  bool l1;
  F color = 0;
  Scratch<F> space;            // spatial exponents of the taps
  Scratch<F> weights, extras;  // one vector for each tap

  Window(int ky, int kx, bool l1)
      : ry(ky / 2), rx(kx / 2), l1(l1), space(ky * kx), weights(ky * kx * kLanes<F>), extras(ky * kx * kLanes<F>) {}

  void set(Falloff<F> const& falloff) {
    color = falloff.color;
    F* to = space.data;
    for (int64_t dy = -ry; dy <= ry; ++dy)
      for (int64_t dx = -rx; dx <= rx; ++dx) *to++ = falloff.space_y * F(dy * dy) + falloff.space_x * F(dx * dx);
  }

  // Calls body(tap, dx) for the taps in row `row` of the window at `position`.
  template <class Body>
  KV_HD void for_each_tap(WindowPosition const& position, int64_t row, Body body) const {
    int64_t const rx = this->rx, middle = (row - position.center + ry) * (2 * rx + 1) + rx;
    for (int64_t dx = -rx; dx <= rx; ++dx) body(middle + dx, dx);
  }
};

// Calls body(Width<3>{}, c) for channels in threes and body(Width<1>{}, c) for the rest: constant counts let the
// compiler unroll loops.
template <class Body>
KV_HD void for_each_channels(int channels, Body body) {
  int c = 0;
  for (; c + 3 <= channels; c += 3) body(Width<3>{}, c);
  for (; c < channels; ++c) body(Width<1>{}, c);
}

// What is stored of a tap in addition to its weight.
enum class Extra {
  none,
  derivative,  // of the weight, by the difference that add_guide_gradient multiplies it with
  square,      // the squared distance in color
};

// The weights of the window's taps; returns their sum.
template <int G, bool l1, Extra extra, class F>
Vector<F> compute_weights(Window<F> const& w, Rows<F> const& guide, WindowPosition const& position) {
  constexpr int N = kLanes<F>;
  int const channels = G ? G : guide.channels;
  int64_t const stride = guide.stride;
  F const* const center = guide.row(position.y) + position.x;
  F const color = w.color, rate = F(-2 * 0.69314718055994530942) * color;
  Vector<F> total{};
  for (int64_t row = position.first; row <= position.last; ++row) {
    F const* const pixel = guide.row(row) + position.x;
    w.for_each_tap(position, row, [&](int64_t tap, int64_t dx) {
      Vector<F> distance{};
      for (int c = 0; c < channels; ++c) {
        Vector<F> const difference = load<N>(pixel + c * stride + dx) - load<N>(center + c * stride);
        distance += l1 ? vabs(difference) : difference * difference;
      }
      Vector<F> const square = l1 ? distance * distance : distance;
      Vector<F> const weight = vexp2<F, N>(w.space.data[tap] - square * color);
      store<N>(w.weights.data + tap * N, weight);
      if constexpr (extra == Extra::derivative)
        store<N>(w.extras.data + tap * N, (l1 ? weight * distance : weight) * rate);
      if constexpr (extra == Extra::square) store<N>(w.extras.data + tap * N, square);
      total += weight;
    });
  }
  return total;
}
template <int G, Extra extra, class F>
KV_HD Vector<F> compute_weights(Window<F> const& w, Rows<F> const& guide, WindowPosition const& position) {
  return w.l1 ? compute_weights<G, true, extra>(w, guide, position)
              : compute_weights<G, false, extra>(w, guide, position);
}
template <Extra extra, class F>
Vector<F> compute_weights(Window<F> const& w, Rows<F> const& guide, WindowPosition const& position) {
  return guide.channels == 3   ? compute_weights<3, extra>(w, guide, position)
         : guide.channels == 1 ? compute_weights<1, extra>(w, guide, position)
                               : compute_weights<0, extra>(w, guide, position);
}

// Adds K channels of `image` from c on, weighted by weights(tap), to `sum`; returns the sum of the weights.
template <int K, class F, class Weights>
KV_HD Vector<F> add_weighted(Window<F> const& w, Weights weights, Rows<F> const& image, int c,
                             WindowPosition const& position, Vector<F> (&sum)[K]) {
  int64_t const stride = image.stride;
  Vector<F> total{};
  for (int64_t row = position.first; row <= position.last; ++row) {
    F const* const pixel = image.row(row, c) + position.x;
    w.for_each_tap(position, row, [&](int64_t tap, int64_t dx) {
      Vector<F> const weight = weights(tap);
      total += weight;
      for (int k = 0; k < K; ++k) sum[k] += weight * load<kLanes<F>>(pixel + k * stride + dx);
    });
  }
  return total;
}
template <int K, class F>
KV_HD Vector<F> add_weighted(Window<F> const& w, Rows<F> const& image, int c, WindowPosition const& position,
                             Vector<F> (&sum)[K]) {
  return add_weighted(
      w, [&](int64_t tap) { return load<kLanes<F>>(w.weights.data + tap * kLanes<F>); }, image, c, position, sum);
}

// The weights of pairs of pixels (y, x) and (y + dy, x + dx), dy > 0 or dy = 0 <= dx. Each is used by two windows: that
// of (y, x) now and that of (y + dy, x + dx) later, so a ring of dy + 1 rows is kept for each dy.
template <class F>
struct Pairs {
  int64_t ry, rx, stride;
  Scratch<F> memory;
  Scratch<F const*> taps;  // the weights of each tap for the current row

  static int64_t rows(int64_t ry, int64_t rx) { return before(ry + 1, rx); }
  Pairs(int64_t ry, int64_t rx, int64_t stride)
      : ry(ry), rx(rx), stride(stride), memory(rows(ry, rx) * stride), taps((2 * ry + 1) * (2 * rx + 1)) {}

  F* row(int64_t y, int64_t dy, int64_t dx) const {
    int64_t const ring = before(dy, rx) + (dy > 0 ? dx + rx : dx) * (dy + 1);
    return memory.data + (ring + (y + ry) % (dy + 1)) * stride + rx;
  }
  // Computes row y of the pairs with dy >= from_dy.
  template <int G, bool l1>
  void fill(Window<F> const& w, Rows<F> const& guide, int64_t y, int64_t from_dy) {
    constexpr int N = kLanes<F>;
    int const channels = G ? G : guide.channels;
    int64_t const stride = guide.stride, end = guide.width + rx;
    F const color = w.color;
    for (int64_t dy = from_dy; dy <= ry; ++dy)
      for (int64_t dx = dy > 0 ? -rx : 0; dx <= rx; ++dx) {
        F const* const p = guide.row(y);
        F const* const q = guide.row(y + dy) + dx;
        F* const out = row(y, dy, dx);
        F const space = w.space.data[(dy + ry) * (2 * rx + 1) + dx + rx];
        for (int64_t x = -rx; x < end; x += N) {
          Vector<F> distance{};
          for (int c = 0; c < channels; ++c) {
            Vector<F> const difference = load<N>(q + c * stride + x) - load<N>(p + c * stride + x);
            distance += l1 ? vabs(difference) : difference * difference;
          }
          store<N>(out + x, vexp2<F, N>(space - (l1 ? distance * distance : distance) * color));
        }
      }
  }
  void fill(Window<F> const& w, Rows<F> const& guide, int64_t y, int64_t from_dy) {
    if (guide.channels == 3)
      w.l1 ? fill<3, true>(w, guide, y, from_dy) : fill<3, false>(w, guide, y, from_dy);
    else if (guide.channels == 1)
      fill<1, false>(w, guide, y, from_dy);
    else
      w.l1 ? fill<0, true>(w, guide, y, from_dy) : fill<0, false>(w, guide, y, from_dy);
  }
  // Points `taps` to the weights of row y.
  void locate_taps(int64_t y) {
    F const** tap = taps.data;
    for (int64_t dy = -ry; dy <= ry; ++dy)
      for (int64_t dx = -rx; dx <= rx; ++dx)
        *tap++ = dy > 0 || (dy == 0 && dx >= 0) ? row(y, dy, dx) : row(y + dy, -dy, -dx) + dx;
  }

 private:
  static int64_t before(int64_t dy, int64_t rx) { return dy > 0 ? rx + 1 + (2 * rx + 1) * (dy - 1) * (dy + 2) / 2 : 0; }
};

// Multiplies the derivatives of the weights by the gradients of the weights; see bilateral.h. `own` is false where the
// position is out of bounds. The last channel of `ab` is b.
template <int C, class F>
void multiply_weight_gradients(Window<F> const& w, Rows<F> const& x, Rows<F> const& ab, bool own,
                               WindowPosition const& position) {
  constexpr int N = kLanes<F>;
  int const channels = C ? C : x.channels;
  int64_t const stride_x = x.stride, stride_ab = ab.stride;
  F const* const x_center = x.row(position.y) + position.x;
  F const* const ab_center = ab.row(position.y) + position.x;
  for (int64_t row = position.first; row <= position.last; ++row) {
    F const* const x_pixel = x.row(row) + position.x;
    F const* const ab_pixel = ab.row(row) + position.x;
    w.for_each_tap(position, row, [&](int64_t tap, int64_t dx) {
      Vector<F> sum = -load<N>(ab_pixel + channels * stride_ab + dx);
      for (int c = 0; c < channels; ++c)
        sum += load<N>(ab_pixel + c * stride_ab + dx) * load<N>(x_center + c * stride_x);
      if (own) {
        sum -= load<N>(ab_center + channels * stride_ab);
        for (int c = 0; c < channels; ++c)
          sum += load<N>(ab_center + c * stride_ab) * load<N>(x_pixel + c * stride_x + dx);
      }
      store<N>(w.extras.data + tap * N, load<N>(w.extras.data + tap * N) * sum);
    });
  }
}
template <class F>
void multiply_weight_gradients(Window<F> const& w, Rows<F> const& x, Rows<F> const& ab, bool own,
                               WindowPosition const& position) {
  return x.channels == 3   ? multiply_weight_gradients<3>(w, x, ab, own, position)
         : x.channels == 1 ? multiply_weight_gradients<1>(w, x, ab, own, position)
                           : multiply_weight_gradients<0>(w, x, ab, own, position);
}

// Adds the gradient of the distances to K channels of the guide from c on.
template <int K, class F>
KV_HD void add_guide_gradient(Window<F> const& w, Rows<F> const& guide, int c, WindowPosition const& position,
                              Vector<F> (&sum)[K]) {
  constexpr int N = kLanes<F>;
  F const* const center = guide.row(position.y, c) + position.x;
  int64_t const stride = guide.stride;
  for (int64_t row = position.first; row <= position.last; ++row) {
    F const* const pixel = guide.row(row, c) + position.x;
    w.for_each_tap(position, row, [&](int64_t tap, int64_t dx) {
      Vector<F> const weight_grad = load<N>(w.extras.data + tap * N);
      for (int k = 0; k < K; ++k) {
        Vector<F> const difference = load<N>(center + k * stride) - load<N>(pixel + k * stride + dx);
        sum[k] += w.l1 ? (difference > 0   ? weight_grad
                          : difference < 0 ? -weight_grad
                                           : Vector<F>{})
                       : weight_grad * difference;
      }
    });
  }
}

}  // namespace

template <class T>
void bilateral_blur(Bilateral<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<F>;
  int64_t const height = p.x.height, width = p.x.width;
  Window<F> w(p.ky, p.kx, p.l1);
  Rows<F> const x(p.x.channels, p.ky, 2 * w.rx, width),
      joint_guide(p.joint ? p.guide.channels : 0, p.ky, 2 * w.rx, width);
  Rows<F> const& guide = p.joint ? joint_guide : x;
  Rows<F> const y(p.x.channels, 1, 0, width);
  bool const shared = Pairs<F>::rows(w.ry, w.rx) * x.stride * sizeof(F) <= (1 << 20);
  Pairs<F> pairs(shared ? w.ry : 0, shared ? w.rx : 0, x.stride);
  int64_t next = 0;  // the next row to load
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, row = r % height;
    bool const first = r == begin || row == 0;
    if (first) {
      w.set(p.sigma.at(b));
      next = row - w.ry;
    }
    for (; next <= row + w.ry; ++next) {
      load_row(x, p.x, b, next, p.border);
      if (p.joint) load_row(joint_guide, p.guide, b, next, p.border);
    }
    if (shared) {
      if (first)
        for (int64_t dy = w.ry; dy > 0; --dy) pairs.fill(w, guide, row - dy, dy);
      pairs.fill(w, guide, row, 0);
      pairs.locate_taps(row);
    }
    for (int64_t e = 0; e < width; e += N) {
      WindowPosition const position{e, row, row, row - w.ry, row + w.ry};
      if (!shared) compute_weights<Extra::none>(w, guide, position);
      for_each_channels(x.channels, [&](auto k, int c) {
        constexpr int K = decltype(k)::value;
        Vector<F> sum[K]{};
        auto const pair_weight = [&](int64_t tap) { return load<N>(pairs.taps.data[tap] + e); };
        Vector<F> const total =
            shared ? add_weighted(w, pair_weight, x, c, position, sum) : add_weighted(w, x, c, position, sum);
        for (int i = 0; i < K; ++i) store<N>(y.row(row, c + i) + e, sum[i] / total);
      });
    }
    store_row(y, p.y, b, row);
  }
}

template <class T>
void bilateral_blur_backward(BilateralBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<F>;
  int64_t const height = p.x.height, width = p.x.width;
  bool const circular = p.border == Border::circular, needs_guide = !p.joint || p.needs_guide;
  Window<F> w(p.ky, p.kx, p.l1);
  int64_t const rx = w.rx, ry = w.ry;
  Rows<F> const x(p.x.channels, 4 * ry + 1, 2 * rx, width);
  Rows<F> const joint_guide(p.joint ? p.guide.channels : 0, 4 * ry + 1, 2 * rx, width);
  Rows<F> const& guide = p.joint ? joint_guide : x;
  Rows<F> const ab(p.x.channels + 1, 2 * ry + 1, 2 * rx, width), grad(p.x.channels, 1, 0, width);
  Rows<F> const grad_x(p.x.channels, 1, rx, width), grad_guide(joint_guide.channels, 1, rx, width);

  // a and b of row y of image b; see bilateral.h
  auto const forward = [&](int64_t b, int64_t y) {
    if (!circular && (y < 0 || y >= height)) return ab.zero(y);
    load_row(grad, p.grad, b, y, p.border);
    for (int64_t e = 0; e < width; e += N) {
      WindowPosition const position{e, y, y, y - ry, y + ry};
      Vector<F> const total = compute_weights<Extra::none>(w, guide, position);
      Vector<F> last{};
      for_each_channels(x.channels, [&](auto k, int c) {
        constexpr int K = decltype(k)::value;
        Vector<F> sum[K]{};
        add_weighted(w, x, c, position, sum);
        for (int i = 0; i < K; ++i) {
          Vector<F> const a = load<N>(grad.row(y, c + i) + e) / total;
          store<N>(ab.row(y, c + i) + e, a);
          last += a * (sum[i] / total);
        }
      });
      store<N>(ab.row(y, x.channels) + e, last);
    }
    ab.extend(y, circular ? Border::circular : Border::constant);
  };

  // Adds the gradients that position `at` receives to row y, the border row of that position.
  auto const accumulate = [&](int64_t y, int64_t at) {
    bool const own = at == y;
    for (int64_t e = -rx; e < width + rx; e += N) {
      WindowPosition const position{e, y, at, own ? at - ry : max(at - ry, int64_t(0)),
                                    own ? at + ry : min(at + ry, height - 1)};
      if (needs_guide) {
        compute_weights<Extra::derivative>(w, guide, position);
        multiply_weight_gradients(w, x, ab, own, position);
      } else {
        compute_weights<Extra::none>(w, guide, position);
      }
      auto const add_to = [&](Rows<F> const& to, auto... add) {
        for_each_channels(to.channels, [&](auto k, int c) {
          constexpr int K = decltype(k)::value;
          Vector<F> sum[K]{};
          (add(c, sum), ...);
          for (int i = 0; i < K; ++i) {
            F* const at = to.row(y, c + i) + e;
            store<N>(at, load<N>(at) + sum[i]);
          }
        });
      };
      auto const image_grads = [&](int c, auto& sum) { add_weighted(w, ab, c, position, sum); };
      auto const guide_grads = [&](int c, auto& sum) { add_guide_gradient(w, guide, c, position, sum); };
      if (!p.joint) {
        add_to(grad_x, image_grads, guide_grads);
      } else {
        if (p.needs_x) add_to(grad_x, image_grads);
        if (needs_guide) add_to(grad_guide, guide_grads);
      }
    }
  };

  // With the circular border a and b repeat, so nothing is accumulated.
  Border const accumulation = circular ? Border::constant : p.border;
  auto const accumulate_and_store = [&](Rows<F> const& from, Images<T> const& to, int64_t b, int64_t y) {
    for (int c = 0; c < from.channels; ++c) {
      F* const out = from.row(y, c);
      auto const accumulate_column = [&](int64_t x) {
        F sum = 0;
        for_each_reader(accumulation, x, width, rx, rx, [&](int64_t at) { sum += out[at]; });
        out[x] = sum;
      };
      int64_t const left = min(rx + 1, width);
      for (int64_t x = 0; x < left; ++x) accumulate_column(x);
      for (int64_t x = max(left, width - rx - 1); x < width; ++x) accumulate_column(x);
    }
    store_row(from, to, b, y);
  };

  int64_t next = 0, next_ab = 0;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    if (r == begin || y == 0) {
      w.set(p.sigma.at(b));
      next = y - 2 * ry;
      next_ab = y - ry;
    }
    for (; next <= y + 2 * ry; ++next) {
      load_row(x, p.x, b, next, p.border);
      if (p.joint) load_row(joint_guide, p.guide, b, next, p.border);
    }
    for (; next_ab <= y + ry; ++next_ab) forward(b, next_ab);
    grad_x.zero(y);
    grad_guide.zero(y);
    for_each_reader(accumulation, y, height, ry, ry, [&](int64_t at) { accumulate(y, at); });
    if (p.needs_x) accumulate_and_store(grad_x, p.grad_x, b, y);
    if (p.needs_guide) accumulate_and_store(grad_guide, p.grad_guide, b, y);
  }
}

template <class T>
void bilateral_blur_sigma_sums(BilateralSigmas<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<F>;
  int64_t const height = p.x.height, width = p.x.width;
  Window<F> w(p.ky, p.kx, p.l1);
  Rows<F> const x(p.x.channels, p.ky, w.rx, width), joint_guide(p.joint ? p.guide.channels : 0, p.ky, w.rx, width);
  Rows<F> const grad(p.x.channels, 1, 0, width);
  Rows<F> const& guide = p.joint ? joint_guide : x;
  Scratch<F> weight_grads(p.ky * p.kx * N);  // gradients of the weights
  int64_t next = 0;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const b = r / height, y = r % height;
    if (r == begin || y == 0) {
      w.set(p.sigma.at(b));
      next = y - w.ry;
    }
    for (; next <= y + w.ry; ++next) {
      load_row(x, p.x, b, next, p.border);
      if (p.joint) load_row(joint_guide, p.guide, b, next, p.border);
    }
    load_row(grad, p.grad, b, y, p.border);
    F sums[3] = {};
    for (int64_t e = 0; e < width; e += N) {
      WindowPosition const position{e, y, y, y - w.ry, y + w.ry};
      Vector<F> const total = compute_weights<Extra::square>(w, guide, position);
      for (int64_t i = 0; i < p.ky * p.kx * N; ++i) weight_grads.data[i] = 0;
      for (int c = 0; c < x.channels; ++c) {
        Vector<F> sum[1]{};
        add_weighted(w, x, c, position, sum);
        Vector<F> const mean = sum[0] / total, a = load<N>(grad.row(y, c) + e) / total;
        for (int64_t row = position.first; row <= position.last; ++row)
          w.for_each_tap(position, row, [&](int64_t tap, int64_t dx) {
            F* const weight_grad = weight_grads.data + tap * N;
            store<N>(weight_grad, load<N>(weight_grad) + a * (load<N>(x.row(row, c) + e + dx) - mean));
          });
      }
      Vector<F> totals[3]{};
      for (int64_t row = position.first; row <= position.last; ++row)
        w.for_each_tap(position, row, [&](int64_t tap, int64_t dx) {
          Vector<F> const weight_grad = load<N>(weight_grads.data + tap * N) * load<N>(w.weights.data + tap * N);
          totals[0] += weight_grad * load<N>(w.extras.data + tap * N);
          totals[1] += weight_grad * F((row - y) * (row - y));
          totals[2] += weight_grad * F(dx * dx);
        });
      for (int i = 0; i < 3; ++i)
        for (int64_t lane = 0; lane < min(int64_t(N), width - e); ++lane) sums[i] += totals[i][lane];
    }
    for (int i = 0; i < 3; ++i) store<1>(p.sums + (b * 3 + i) * height + y, sums[i]);
  }
}

KV_INSTANTIATE_WITH_BYTES(bilateral_blur, Bilateral)
KV_INSTANTIATE(bilateral_blur_backward, BilateralBackward)
KV_INSTANTIATE(bilateral_blur_sigma_sums, BilateralSigmas)

}  // namespace kv::filters::KV_ISA
