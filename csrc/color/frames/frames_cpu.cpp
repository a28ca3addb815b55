// Frames of video on the CPU: a row of the result at a time. Where columns and rows have weights of their own, the rows
// of codes are added first, into rows of numbers, and columns of these then. Compiled once per instruction set.
#include <type_traits>

#include "core/lanes.h"
#include "core/scratch.h"
#include "frames.h"

namespace kv::color::KV_ISA {
namespace {

template <class F, class S>
KV_HD F number_of(S const* code) {
  if constexpr (__is_same(S, uint16_t))
    return F(*code);
  else
    return F(load<1>(code));
}

// Calls f with a pointer of the type of codes. Only what reads them is compiled for all three.
template <class T, class Call>
KV_HD auto with_codes(PlanesToRgb<T> const& p, int plane, int64_t frame, int64_t row, Call f) {
  CodePlane const& codes = p.planes[plane];
  if constexpr (!__is_same(T, uint8_t))
    if (p.code_bytes == 0) return f(codes.template row<T>(frame, row), codes.column_stride);
  if (p.code_bytes == 2) return f(codes.template row<uint16_t>(frame, row), codes.column_stride);
  return f(codes.template row<uint8_t>(frame, row), codes.column_stride);
}

// to[i] += weight codes[i] for codes [begin, end) of a row, or = where it is the first row.
template <class T, class F>
KV_HD void add_row(PlanesToRgb<T> const& p, int plane, int64_t frame, int64_t row, F weight, bool is_first, F* to,
                   int64_t begin, int64_t end) {
  with_codes(p, plane, frame, row, [&](auto const* codes, int64_t step) KV_INLINE {
    using S = std::remove_cvref_t<decltype(*codes)>;
    int64_t i = begin;
    if constexpr (!__is_same(S, uint16_t) && __is_same(F, Compute<S>)) {
      constexpr int N = kLanes<S>;
      if (step == 1)
        for (; i + N <= end; i += N) {
          Lanes<F, N> const value = load<N>(codes + i) * weight;
          store<N>(to + i, is_first ? value : Lanes<F, N>(load<N>(to + i) + value));
        }
    }
    for (; i < end; ++i) {
      F const value = weight * number_of<F>(codes + i * step);
      to[i] = is_first ? value : to[i] + value;
    }
  });
}

// What all windows along an axis take: `count` entries from `first` on, whose weights are `stride` apart.
template <class F>
struct AxisWeights {
  int64_t const stride;
  Scratch<int> ranges;
  Scratch<F> weights;

  KV_HD AxisWeights(int64_t windows, int64_t stride) : stride(stride), ranges(2 * windows), weights(windows * stride) {}
  template <class Weight>
  KV_HD void set(int64_t i, int first, int last, Weight weight) {
    ranges.data[2 * i] = first;
    ranges.data[2 * i + 1] = last - first;
    for (int j = first; j < last; ++j) weights.data[i * stride + j - first] = weight(j);
  }
  // The transpose of `dot`.
  KV_HD void add(int64_t i, F value, F* row) const {
    int const first = ranges.data[2 * i], count = ranges.data[2 * i + 1];
    F const* const w = weights.data + i * stride;
    for (int j = 0; j < count; ++j) row[first + j] += w[j] * value;
  }
  KV_HD F dot(int64_t i, F const* row) const {
    int const first = ranges.data[2 * i], count = ranges.data[2 * i + 1];
    F const* const w = weights.data + i * stride;
    F sum = 0;
    for (int j = 0; j < count; ++j) sum += w[j] * row[first + j];
    return sum;
  }
};

// The rows of a box of one frame.
template <class T>
struct BoxRows {
  using F = Compute<T>;
  PlanesToRgb<T> const& p;
  int64_t frame;
  BoxAxis<F> x, y;
  AxisWeights<F> luma, chroma;
  Scratch<F> row;

  KV_HD BoxRows(PlanesToRgb<T> const& p, int64_t frame)
      : p(p),
        frame(frame),
        x(p.box_axis(frame, false)),
        y(p.box_axis(frame, true)),
        luma(p.rgb.width, x.largest_window(p.x.size)),
        chroma(p.rgb.width, x.largest_window(p.x.size) + 2),
        row(p.x.size) {
    for (int i = 0; i < p.rgb.width; ++i) {
      PixelWindow<F> const w = x.window(i);
      F const factor = F(1) / w.sum();
      luma.set(i, w.first, w.last, [&](int j) KV_INLINE { return w.weight(j) * factor; });
      chroma.set(i, w.first_chroma(p.x), w.last_chroma(p.x),
                 [&](int j) KV_INLINE { return w.chroma_weight(p.x, j) * factor; });
    }
  }
  // One plane along row i of the result.
  KV_HD void sum(int plane, int i, F* to) {
    PixelWindow<F> const w = y.window(i);
    F const factor = F(1) / w.sum();
    int const first = plane ? w.first_chroma(p.y) : w.first, last = plane ? w.last_chroma(p.y) : w.last;
    // Columns that no window takes are not read.
    PixelWindow<F> const all{F(0), F(0), x.low, x.high};
    int const begin = plane ? all.first_chroma(p.x) : x.low, end = plane ? all.last_chroma(p.x) : x.high;
    for (int r = first; r < last; ++r) {
      F const weight = (plane ? w.chroma_weight(p.y, r) : w.weight(r)) * factor;
      add_row(p, plane, frame, r, weight, r == first, row.data, begin, end);
    }
    AxisWeights<F> const& columns = plane ? chroma : luma;
    for (int64_t k = 0; k < p.rgb.width; ++k) to[k] = columns.dot(k, row.data);
  }
};

// One plane along row i of the whole frame.
template <class T, class F>
KV_HD void enlarge(PlanesToRgb<T> const& p, int64_t frame, int plane, int i, F* row, F* to) {
  if (plane == 0) return add_row(p, plane, frame, i, F(1), true, to, 0, p.x.size);
  PixelWindow<F> const w = window_at(F(i), p.y.size);
  int const first = w.first_chroma(p.y), last = w.last_chroma(p.y), count = p.x.chroma_size;
  F* const narrow = p.x.is_halved() ? row : to;
  for (int r = first; r < last; ++r) add_row(p, plane, frame, r, w.chroma_weight(p.y, r), r == first, narrow, 0, count);
  if (!p.x.is_halved()) return;
  for (int c = 0; c < count; ++c) {
    F const before = row[max(c - 1, 0)], here = row[c], after = row[min(c + 1, count - 1)];
    F even = here, odd = here;
    if (p.x.site == ChromaSite::cosited) odd = (here + after) * F(0.5);
    if (p.x.site == ChromaSite::between) {
      even = before * F(0.25) + here * F(0.75);
      odd = here * F(0.75) + after * F(0.25);
    }
    to[2 * c] = even;
    if (2 * c + 1 < p.x.size) to[2 * c + 1] = odd;
  }
}

}  // namespace

template <class T>
void planes_to_rgb(PlanesToRgb<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.rgb.width, height = p.rgb.height;
  Scratch<F> memory(4 * width + p.x.size);
  F *const sums = memory.data, *const inside = sums + 3 * width, *const narrow = inside + width;
  for (int64_t i = 0; i < width; ++i) inside[i] = 1;
  auto const store_row = [&](int64_t frame, int64_t y) KV_INLINE {
    T* to[3];
    for (int k = 0; k < 3; ++k) to[k] = p.rgb.row(3 * frame + k, y);
    for_each_vector<T>(0, width, [&](auto n, int64_t x) KV_INLINE {
      constexpr int N = decltype(n)::value;
      Lanes<F, N> const a = load<N>(sums + x), b = load<N>(sums + width + x), c = load<N>(sums + 2 * width + x),
                        share = load<N>(inside + x);
      for (int k = 0; k < 3; ++k) store<N>(to[k] + x, Lanes<F, N>(p.colors.channel(k, a, b, c, share)));
    });
  };
  for (int64_t r = begin; r < end;) {
    int64_t const frame = r / height, last = min(end, (frame + 1) * height);
    if (p.kind == FrameMap::boxes || p.kind == FrameMap::windows) {
      BoxRows<T> rows(p, frame);
      for (; r < last; ++r) {
        for (int plane = 0; plane < 3; ++plane) rows.sum(plane, int(r % height), sums + plane * width);
        store_row(frame, r % height);
      }
    } else if (p.kind == FrameMap::whole) {
      for (; r < last; ++r) {
        for (int plane = 0; plane < 3; ++plane) enlarge(p, frame, plane, int(r % height), narrow, sums + plane * width);
        store_row(frame, r % height);
      }
    } else {
      double exact[9];
      F inverse[9];
      invert_up_to_factor(p.map + frame * p.map_stride, p.is_affine, p.from_result, exact);
      for (int k = 0; k < 9; ++k) inverse[k] = F(exact[k]);
      for (; r < last; ++r) {
        for (int64_t i = 0; i < width; ++i) {
          Preimage<F> const at(inverse, F(i), F(r % height));
          PixelWindow<F> const wx = p.window_at(at.x, p.x), wy = p.window_at(at.y, p.y);
          F sum[3];
          sum_windows(
              wx, wy, p.x, p.y,
              [&](int plane, int y, int x) KV_INLINE {
                return with_codes(p, plane, frame, y, [&](auto const* codes, int64_t step) KV_INLINE {
                  return number_of<F>(codes + x * step);
                });
              },
              sum);
          for (int k = 0; k < 3; ++k) sums[k * width + i] = sum[k];
          inside[i] = wx.sum() * wy.sum();
        }
        store_row(frame, r % height);
      }
    }
  }
}

KV_INSTANTIATE_WITH_BYTES(planes_to_rgb, PlanesToRgb)

namespace {

// To one row of a plane of a frame that boxes read.
template <class T>
KV_HD void gradient_row(PlanesToRgbBackward<T> const& p, BoxRows<T> const& box, int64_t frame, int plane, int r,
                        Compute<T>* taken, Compute<T>* sums) {
  using F = Compute<T>;
  FrameAxis const& axis = p.forward.y;
  bool const is_halved = plane && axis.is_halved();
  int const first = is_halved ? 2 * r - 1 : r, last = is_halved ? 2 * r + 3 : r + 1;  // the pixels that may take it
  int64_t const height = p.grad.height, width = p.grad.width;
  ResultRange const results = box.y.results_of(first, last, int(height));
  for (int64_t x = 0; x < width; ++x) taken[x] = 0;
  for (int y = results.first; y < results.last; ++y) {
    PixelWindow<F> const w = box.y.window(y);
    F const weight = w.plane_weight(plane, axis, r) / w.sum();
    if (weight == F(0)) continue;
    for (int64_t x = 0; x < width; ++x)
      taken[x] += weight * p.taken(plane, frame, y, x, [](T const* at) KV_INLINE { return load<1>(at); });
  }
  int const count = p.width(plane);
  for (int64_t x = 0; x < count; ++x) sums[x] = 0;
  for (int64_t x = 0; x < width; ++x) (plane ? box.chroma : box.luma).add(x, taken[x], sums);
  T* const to = p.row(plane, frame, r);
  for (int64_t x = 0; x < count; ++x) store<1>(to + x, sums[x]);
}

// To a plane of a frame that matrices read: what results take is added up in their order.
template <class T>
KV_HD void scatter_plane(PlanesToRgbBackward<T> const& p, int64_t frame, int plane) {
  using F = Compute<T>;
  PlanesToRgb<T> const& f = p.forward;
  int64_t const height = p.height(plane), width = p.width(plane);
  Scratch<F> sums(height * width);
  for (int64_t i = 0; i < height * width; ++i) sums.data[i] = 0;
  double exact[9];
  F inverse[9];
  invert_up_to_factor(f.map + frame * f.map_stride, f.is_affine, f.from_result, exact);
  for (int k = 0; k < 9; ++k) inverse[k] = F(exact[k]);
  for (int64_t y = 0; y < p.grad.height; ++y)
    for (int64_t x = 0; x < p.grad.width; ++x) {
      Preimage<F> const at(inverse, F(x), F(y));
      PixelWindow<F> const wx = f.window_at(at.x, f.x), wy = f.window_at(at.y, f.y);
      F const taken = p.taken(plane, frame, y, x, [](T const* at) KV_INLINE { return load<1>(at); });
      int const first_row = plane ? wy.first_chroma(f.y) : wy.first, last_row = plane ? wy.last_chroma(f.y) : wy.last;
      int const first = plane ? wx.first_chroma(f.x) : wx.first, last = plane ? wx.last_chroma(f.x) : wx.last;
      for (int r = first_row; r < last_row; ++r) {
        F const of_row = taken * wy.plane_weight(plane, f.y, r);
        for (int c = first; c < last; ++c) sums.data[r * width + c] += of_row * wx.plane_weight(plane, f.x, c);
      }
    }
  T* const to = p.row(plane, frame, 0);
  for (int64_t i = 0; i < height * width; ++i) store<1>(to + i, sums.data[i]);
}

}  // namespace

template <class T>
void planes_to_rgb_backward(PlanesToRgbBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  if (p.forward.kind == FrameMap::matrices) {
    for (int64_t i = begin; i < end; ++i) scatter_plane(p, i / 3, int(i % 3));
    return;
  }
  int64_t const rows = p.rows_of_frame(), height = p.height(0), chroma_height = p.height(1);
  Scratch<F> memory(p.grad.width + p.width(0));
  for (int64_t i = begin; i < end;) {
    int64_t const frame = i / rows, last = min(end, (frame + 1) * rows);
    BoxRows<T> const box(p.forward, frame);
    for (; i < last; ++i) {
      int64_t const row = i - frame * rows, of_chroma = row - height;
      int const plane = of_chroma < 0 ? 0 : of_chroma < chroma_height ? 1 : 2;
      int64_t const r = plane ? of_chroma - (plane - 1) * chroma_height : row;
      gradient_row(p, box, frame, plane, int(r), memory.data, memory.data + p.grad.width);
    }
  }
}

KV_INSTANTIATE(planes_to_rgb_backward, PlanesToRgbBackward)

}  // namespace kv::color::KV_ISA
