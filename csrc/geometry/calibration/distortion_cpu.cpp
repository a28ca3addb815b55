// Lens distortion on the CPU: points [begin, end) of all samples, by vectors. Compiled once per instruction set.
#include "core/lanes.h"
// After it, for vectors.
#include "geometry/calibration/distortion.h"

namespace kv::geometry::KV_ISA {
namespace {

// A domain that computes its end once, where a point needs it, and not for each vector of points.
template <class T>
struct LensDomain : Domain<T> {
  T mutable end = -1;

  using Domain<T>::Domain;
  KV_HD T limit() const {
    if (end < 0) end = Domain<T>::limit();
    return end;
  }
};

// N adjacent pixels of an image.
template <int N, class T>
KV_HD void pixels_at(LensPoints<T> const& p, int64_t i, Lanes<T, N>& x, Lanes<T, N>& y) {
  int64_t const row = i / p.width;
  y = Lanes<T, N>{} + T(row);
  if constexpr (N == 1) {
    x = T(i - row * p.width);
  } else {
    for (int k = 0; k < N; ++k) x[k] = T(i - row * p.width + k);
  }
}

// N points (x, y) that are adjacent in memory.
template <int N, class T>
KV_HD void load_points(T const* from, Lanes<T, N>& x, Lanes<T, N>& y) {
  if constexpr (N == 1) {
    x = from[0], y = from[1];
  } else {
    Lanes<T, N> const first = load<N>(from), second = load<N>(from + N);
    x = every_second<0>(first, second);
    y = every_second<1>(first, second);
  }
}
template <int N, class T, int... i>
KV_HD void store_points(T* to, Lanes<T, N> x, Lanes<T, N> y, std::integer_sequence<int, i...>) {
  if constexpr (N == 1) {
    to[0] = x, to[1] = y;
  } else {
    store<N>(to, __builtin_shufflevector(x, y, (i / 2 + i % 2 * N)...));
    store<N>(to + N, __builtin_shufflevector(x, y, ((N + i) / 2 + i % 2 * N)...));
  }
}

template <bool Distorts, int N, class T>
KV_HD void through(Lens<T> const& lens, LensDomain<T> const& domain, int64_t b, int64_t i) {
  auto const& p = lens.p;
  constexpr std::make_integer_sequence<int, N> lanes;
  Lanes<T, N> x, y;
  if (!p.points)
    pixels_at<N>(p, i - b * p.count, x, y);
  else
    load_points<N>(p.points + 2 * i, x, y);
  if constexpr (!Distorts)
    lens.undistort(x, y, domain);
  else
    p.points ? lens.distort(x, y) : lens.distort_within(x, y, domain);
  if (!p.points) {
    store<N>(p.result + b * p.count + i, x);
    store<N>(p.result + (b + 1) * p.count + i, y);
  } else {
    store_points<N>(p.result + 2 * i, x, y, lanes);
  }
}

// The end of the points from i on that share a lens and, in an image, a row.
template <class T>
KV_HD int64_t run_end(LensPoints<T> const& p, int64_t i, int64_t end) {
  int64_t const last = min(end, (i / p.count + 1) * p.count);
  return p.points ? last : min(last, i + p.width - i % p.count % p.width);
}

template <bool Distorts, class T>
KV_HD void through_lenses(LensPoints<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  for (int64_t i = begin; i < end;) {
    int64_t const b = i / p.count, last = run_end(p, i, end);
    Lens<T> const lens(p, b);
    LensDomain<T> const domain(lens.c);
    for (; i + N <= last; i += N) through<Distorts, N>(lens, domain, b, i);
    for (; i < last; ++i) through<Distorts, 1>(lens, domain, b, i);
  }
}

template <int N, class T>
KV_HD void add_pixels(Lens<T> const& lens, T const* grad, int64_t i, Lanes<T, N> (&sums)[kLensSums]) {
  Lanes<T, N> x, y;
  pixels_at<N>(lens.p, i, x, y);
  lens.accumulate_grads(x, y, Lanes<T, N>(load<N>(grad + i)), Lanes<T, N>(load<N>(grad + lens.p.count + i)), sums);
}

}  // namespace

template <class T>
void undistort_points(LensPoints<T> const& p, int64_t begin, int64_t end) {
  through_lenses<false>(p, begin, end);
}

template <class T>
void distort_points(LensPoints<T> const& p, int64_t begin, int64_t end) {
  through_lenses<true>(p, begin, end);
}

// Chunks [begin, end) of all samples.
template <class T>
void undistort_map_backward(LensBackward<T> const& p, int64_t begin, int64_t end) {
  constexpr int N = kLanes<T>;
  for (int64_t part = begin; part < end; ++part) {
    int64_t const b = part / p.parts, last = min(p.count, (part % p.parts + 1) * kLensChunk);
    Lens<T> const lens(p, b);
    Lanes<T, N> sums[kLensSums] = {};
    T rest[kLensSums] = {};
    for (int64_t i = part % p.parts * kLensChunk; i < last;) {
      int64_t const stop = min(last, i + p.width - i % p.width);
      for (; i + N <= stop; i += N) add_pixels<N>(lens, p.grad + 2 * b * p.count, i, sums);
      for (; i < stop; ++i) add_pixels<1>(lens, p.grad + 2 * b * p.count, i, rest);
    }
    for (int i = 0; i < kLensSums; ++i) {
      T sum = rest[i];
      for (int k = 0; k < N; ++k) sum += sums[i][k];
      p.sums[part * kLensSums + i] = sum;
    }
  }
}

template <class T>
void reduce_lens_grads(LensBackward<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    p.set_zeros(b);
    for (int i = 0; i < kLensSums; ++i) {
      double sum = 0;
      for (int64_t part = b * p.parts; part < (b + 1) * p.parts; ++part) sum += p.sums[part * kLensSums + i];
      p.set(b, i, sum);
    }
  }
}

KV_INSTANTIATE_COMPUTED(undistort_points, LensPoints)
KV_INSTANTIATE_COMPUTED(distort_points, LensPoints)
KV_INSTANTIATE_COMPUTED(undistort_map_backward, LensBackward)
KV_INSTANTIATE_COMPUTED(reduce_lens_grads, LensBackward)

}  // namespace kv::geometry::KV_ISA
