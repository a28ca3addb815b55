// Frames of video: RGB of luma and chroma planes, of the whole frame or of what a box or a matrix takes of it. Included
// by frames_cpu.cpp, frames.cu and frames_op.cpp.
//
// A pixel of the result is a sum over luma pixels with weights that are a product of one for the row and one for the
// column. Chroma that belongs to two pixels along an axis is never enlarged: what enlarging it and the weights of luma
// pixels 2 c - 1 to 2 c + 2 make together is the weight of chroma sample c. Colors are affine in the codes, so their
// conversion, normalization and levels are one matrix behind the sums.
#pragma once

#include "core/isa.h"
#include "core/view.h"
#include "core/window.h"

namespace kv::color {

// Where chroma is along an axis: as its two pixels (repeated), at the first one, or between them.
enum class ChromaSite : int { nearest, cosited, between };
// What is taken of a frame: all of it; boxes; the whole pixels that matrices map to the result; what matrices map
// there.
enum class FrameMap : int { whole, boxes, windows, matrices };

// rgb = clamp(matrix (y, u, v) + offset inside + bias, lowest, highest), where `inside` is the sum of the weights.
template <class F>
struct FrameColors {
  F matrix[9], offset[3], bias[3], lowest[3], highest[3];

  template <class V>
  KV_HD V linear(int k, V const& y, V const& u, V const& v, V const& inside) const {
    return y * matrix[3 * k] + (u * matrix[3 * k + 1] + (v * matrix[3 * k + 2] + (inside * offset[k] + bias[k])));
  }
  template <class V>
  KV_HD V channel(int k, V const& y, V const& u, V const& v, V const& inside) const {
    V const c = linear(k, y, u, v, inside);
    V const raised = c < lowest[k] ? c * F(0) + lowest[k] : c;  // NaN stays
    return raised > highest[k] ? c * F(0) + highest[k] : raised;
  }
};

// A plane of codes with any strides, in elements: interleaved chroma is two planes with a column stride of 2.
struct CodePlane {
  void const* data;
  int64_t frame_stride, row_stride, column_stride;

  template <class S>
  KV_HD S const* row(int64_t frame, int64_t y) const {
    return static_cast<S const*>(data) + frame * frame_stride + y * row_stride;
  }
};

// The pixels of an axis of luma, and what chroma has of it.
struct FrameAxis {
  int size, chroma_size;  // equal, or chroma has half as many, rounded up
  ChromaSite site;
  KV_HD bool is_halved() const { return chroma_size < size; }
};

// An integer of a position, within [low, high]; low for NaN.
template <class F>
KV_HD int whole_within(F x, int low, int high) {
  return x > F(low) ? x < F(high) ? int(x) : high : low;
}
template <class F>
KV_HD F floor_of(F x) {
  if constexpr (sizeof(F) == 8)
    return __builtin_floor(x);
  else
    return __builtin_floorf(x);
}
template <class F>
KV_HD F round_to_even(F x) {
#if defined(__CUDA_ARCH__)
  if constexpr (sizeof(F) == 4) return ::rintf(x);
  return F(::rint(double(x)));
#else
  return F(__builtin_rint(double(x)));
#endif
}
template <class F>
KV_HD F magnitude(F x) {
  return x < F(0) ? -x : x;
}

// The pixels of an axis under a triangle around `center`, where pixel j is [j, j + 1]: those of [first, last).
template <class F>
struct PixelWindow {
  F center, inverse_support;
  int first, last;

  KV_HD F weight(int j) const {
    return j < first || j >= last ? F(0) : F(1) - magnitude(F(j) + F(0.5) - center) * inverse_support;
  }
  // The pixels before the center and those behind it are two arithmetic series.
  KV_HD F sum() const {
    int const count = last - first;
    if (count <= 0) return 0;
    int const before = whole_within(center - F(0.5) - F(first) + F(1), 0, count);
    F const distance = F(first) + F(0.5) - center;  // of the first pixel
    F const all = F(count) * (distance + F(count - 1) * F(0.5));
    F const left = F(before) * (distance + F(before - 1) * F(0.5));
    return F(count) - (all - 2 * left) * inverse_support;
  }

  // The samples of chroma that these pixels take, [first_chroma, last_chroma), and their weights.
  KV_HD int first_chroma(FrameAxis const& a) const {
    if (!a.is_halved()) return first;
    return a.site == ChromaSite::between ? max((first - 1) >> 1, 0) : first >> 1;
  }
  KV_HD int last_chroma(FrameAxis const& a) const {
    if (first >= last) return 0;  // no pixel, no sample
    if (!a.is_halved()) return last;
    return a.site == ChromaSite::nearest ? (last + 1) >> 1 : min((last >> 1) + 1, a.chroma_size);
  }
  // Of sample c of a plane.
  KV_HD F plane_weight(bool is_chroma, FrameAxis const& a, int c) const {
    return is_chroma ? chroma_weight(a, c) : weight(c);
  }
  KV_HD F chroma_weight(FrameAxis const& a, int c) const {
    if (!a.is_halved()) return weight(c);
    F const w0 = weight(2 * c), w1 = weight(2 * c + 1);
    if (a.site == ChromaSite::nearest) return w0 + w1;
    F const before = weight(2 * c - 1), after = weight(2 * c + 2);
    bool const is_last = c == a.chroma_size - 1;
    // The border repeats the outermost samples.
    if (a.site == ChromaSite::cosited) return w0 + before * F(0.5) + w1 * F(is_last ? 1 : 0.5);
    return (before + after) * F(0.25) + w0 * F(c == 0 ? 1 : 0.75) + w1 * F(is_last ? 1 : 0.75);
  }
};

struct ResultRange {
  int first, last;
};

// An axis of a box, [start, end], resampled to `count` pixels; start > end mirrors. Only pixels that the box touches
// count.
template <class F>
struct BoxAxis {
  F start, scale, support, inverse_support;
  int low, high;

  KV_HD BoxAxis(F start, F end, int count, int size, bool antialias)
      : start(start), scale((end - start) / F(count)), support(antialias ? max(F(1), magnitude(scale)) : F(1)) {
    F const top = start < end ? end : start;
    low = whole_within(floor_of(start < end ? start : end), 0, size - 1);
    high = whole_within(-floor_of(-top), low + 1, size);
    inverse_support = F(1) / support;
  }
  // `align_corners`: the centers of the window's outermost pixels are those of the result's.
  KV_HD BoxAxis(Window const& window, int count, bool align_corners, bool antialias)
      : low(window.first), high(window.first + window.size) {
    F const pixel = !align_corners ? F(window.size) / F(count) : count > 1 ? F(window.size - 1) / F(count - 1) : F(1);
    F const margin = align_corners ? (F(1) - pixel) * F(0.5) : F(0);  // of the window, around what the result takes
    scale = window.mirrored ? -pixel : pixel;
    start = window.mirrored ? F(high) - margin : F(low) + margin;
    support = antialias ? max(F(1), pixel) : F(1);
    inverse_support = F(1) / support;
  }
  KV_HD PixelWindow<F> window(int i) const {
    F const middle = start + (F(i) + F(0.5)) * scale, least = F(low) + F(0.5), most = F(high) - F(0.5);
    F const center = middle < least ? least : middle > most ? most : middle;
    return {center, inverse_support, whole_within(floor_of(center - support + F(0.5)), low, high - 1),
            whole_within(-floor_of(F(0.5) - center - support), low + 1, high)};
  }
  // The results, of `count`, whose windows may have pixels of [first, last).
  KV_HD ResultRange results_of(int first, int last, int count) const {
    F from = F(first) + F(0.5) - support, to = F(last) - F(0.5) + support;  // where their centers are
    // Those beyond the outermost pixels are moved to these.
    if (from <= F(low) + F(0.5)) from = -F(__builtin_inff());
    if (to >= F(high) - F(0.5)) to = F(__builtin_inff());
    F const a = (from - start) / scale - F(0.5), b = (to - start) / scale - F(0.5);
    F const least = floor_of(a < b ? a : b), most = floor_of(a < b ? b : a);
    if (!(least <= most)) return {0, count};
    return {whole_within(least - F(1), 0, count), whole_within(most + F(3), 0, count)};
  }
  // No window has more pixels.
  KV_HD int largest_window(int size) const { return whole_within(support * 2 + F(2), 1, size); }
};

// The pixels around a position, where pixel j is at j: those of the frame.
template <class F>
KV_HD PixelWindow<F> window_at(F position, int size) {
  F const floor = floor_of(position);
  int const first = whole_within(floor, -2, size);
  return {position + F(0.5), F(1), max(first, 0), min(first + (position > floor ? 2 : 1), size)};
}

template <class T>
struct PlanesToRgb {
  CodePlane planes[3];  // y, u, v
  int code_bytes;       // 1 and 2: unsigned integers; 0: codes are stored as T
  FrameAxis x, y;
  Planes<T> rgb;  // three planes a frame
  FrameMap kind;
  Compute<T> const* map;          // 4 edges (x1, y1, x2, y2) or a matrix for each result; null: the box is the frame
  int64_t map_stride;             // 0: one for all
  bool is_affine;                 // matrices have two rows
  bool antialias, align_corners;  // the latter of windows
  // Of matrices: they are from pixels of the result to those of the frame; the nearest pixel is taken; the border
  // continues outside.
  bool from_result, nearest, border;
  FrameColors<Compute<T>> colors;

  KV_HD BoxAxis<Compute<T>> box_axis(int64_t frame, bool is_y) const {
    FrameAxis const& axis = is_y ? y : x;
    Compute<T> const* const m = map ? map + frame * map_stride : nullptr;
    int const count = int(is_y ? rgb.height : rgb.width);
    if (kind == FrameMap::windows) {
      Window const window = window_of(double(m[4 * is_y]), double(m[3 * is_y + 2]), axis.size, count, align_corners);
      return {window, count, align_corners, antialias};
    }
    return {m ? m[is_y] : 0, m ? m[2 + is_y] : Compute<T>(axis.size), count, axis.size, antialias};
  }
  // The pixels around a position, where pixel j is at j: those of the frame.
  KV_HD PixelWindow<Compute<T>> window_at(Compute<T> position, FrameAxis const& axis) const {
    using F = Compute<T>;
    if (nearest) position = round_to_even(position);
    if (border) position = position < F(0) ? F(0) : position > F(axis.size - 1) ? F(axis.size - 1) : position;
    return color::window_at(position, axis.size);
  }
};

KV_KERNEL(planes_to_rgb, PlanesToRgb)

// Gradients to planes of T. Each sample of a plane takes what it gave to the results whose colors were not clamped.
template <class T>
struct PlanesToRgbBackward {
  PlanesToRgb<T> forward;  // with its results; the planes are not read
  Planes<T const> grad;
  T* planes[3];  // dense, one a frame

  KV_HD int height(int plane) const { return plane ? forward.y.chroma_size : forward.y.size; }
  KV_HD int width(int plane) const { return plane ? forward.x.chroma_size : forward.x.size; }
  KV_HD int rows_of_frame() const { return height(0) + 2 * height(1); }
  KV_HD T* row(int plane, int64_t frame, int64_t y) const {
    return planes[plane] + (frame * height(plane) + y) * width(plane);
  }
  // The gradient to what a result took of a plane. `value` reads a number.
  template <class Value>
  KV_HD Compute<T> taken(int plane, int64_t frame, int64_t y, int64_t x, Value value) const {
    FrameColors<Compute<T>> const& colors = forward.colors;
    Compute<T> sum = 0;
    for (int k = 0; k < 3; ++k) {
      Compute<T> const color = value(forward.rgb.row(3 * frame + k, y) + x);
      if (color > colors.lowest[k] && color < colors.highest[k])
        sum += colors.matrix[3 * k + plane] * value(grad.row(3 * frame + k, y) + x);
    }
    return sum;
  }
};

KV_KERNEL(planes_to_rgb_backward, PlanesToRgbBackward)

// The position in the frame of pixel (x, y) of the result.
template <class F>
struct Preimage {
  F x, y;
  // `inverse` is the inverse of the matrix, up to a factor.
  KV_HD Preimage(F const* inverse, F column, F row) {
    F const z = inverse[6] * column + inverse[7] * row + inverse[8];
    x = (inverse[0] * column + inverse[1] * row + inverse[2]) / z;
    y = (inverse[3] * column + inverse[4] * row + inverse[5]) / z;
  }
};
// The adjugate of a matrix, all NaN if it has no inverse; or the matrix as it is. An affine one has two rows.
template <class F, class M>
KV_HD void invert_up_to_factor(M const* matrix, bool is_affine, bool is_inverse, F* inverse) {
  F m[9];
  for (int i = 0; i < 9; ++i) m[i] = is_affine && i >= 6 ? F(i == 8) : F(matrix[i]);
  if (is_inverse) {
    for (int i = 0; i < 9; ++i) inverse[i] = m[i];
    return;
  }
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) {
      int const r = (k + 1) % 3, s = (k + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
      inverse[3 * i + k] = m[3 * r + c] * m[3 * s + d] - m[3 * r + d] * m[3 * s + c];
    }
  F const determinant = m[0] * inverse[0] + m[1] * inverse[3] + m[2] * inverse[6];
  if (determinant == F(0))
    for (int i = 0; i < 9; ++i) inverse[i] = F(__builtin_nanf(""));
}

// Sums of y, u and v over two windows. `load(plane, row, column)` reads a code.
template <class F, class Load>
KV_HD void sum_windows(PixelWindow<F> const& wx, PixelWindow<F> const& wy, FrameAxis const& x, FrameAxis const& y,
                       Load load, F (&sums)[3]) {
  sums[0] = sums[1] = sums[2] = 0;
  for (int r = wy.first; r < wy.last; ++r) {
    F in_row = 0;
    for (int c = wx.first; c < wx.last; ++c) in_row += wx.weight(c) * load(0, r, c);
    sums[0] += wy.weight(r) * in_row;
  }
  for (int r = wy.first_chroma(y); r < wy.last_chroma(y); ++r) {
    F const of_row = wy.chroma_weight(y, r);
    for (int c = wx.first_chroma(x); c < wx.last_chroma(x); ++c) {
      F const weight = of_row * wx.chroma_weight(x, c);
      sums[1] += weight * load(1, r, c);
      sums[2] += weight * load(2, r, c);
    }
  }
}

}  // namespace kv::color
