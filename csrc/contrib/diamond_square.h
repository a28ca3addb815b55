// One step of the diamond-square algorithm, which puts a pixel between any two. contrib/diamond_square.py defines it.
//
//   a . b      The center of four pixels gets their mean, mixed with noise; then an edge . gets the mean of its four
//   . o .      neighbors, two pixels and two centers, or of three at the border, mixed with noise.
//   c . d
#pragma once

#include "core/isa.h"

namespace kv::contrib {

// Dense planes: coarse (N, h, w), fine and noise (N, 2 h - 1, 2 w - 1).
template <class T>
struct RefineFractal {
  T const *coarse, *noise;
  T* fine;
  Compute<T> const* weights;  // (N,) of the noise
  int64_t planes, h, w, weight_stride;

  KV_HD int64_t height() const { return 2 * h - 1; }
  KV_HD int64_t width() const { return 2 * w - 1; }
};

KV_KERNEL(refine_fractal, RefineFractal)

template <class F>
KV_HD F mixed(F mean, F noise, F weight) {
  return weight < F(0.5) ? mean + weight * (noise - mean) : noise - (noise - mean) * (1 - weight);
}

// A plane, whose elements `load` reads.
template <class T, class Load>
struct FractalPlane {
  using F = Compute<T>;
  T const *coarse, *noise;
  F weight;
  int64_t h, w;
  Load load;

  KV_HD F pixel(int64_t y, int64_t x) const { return load(coarse + y * w + x); }
  KV_HD F mix(F mean, int64_t y, int64_t x) const { return mixed(mean, F(load(noise + y * (2 * w - 1) + x)), weight); }
  // Of odd coordinates.
  KV_HD F center(int64_t y, int64_t x) const {
    int64_t const v = y / 2, u = x / 2;
    return mix((pixel(v, u) + pixel(v, u + 1) + pixel(v + 1, u) + pixel(v + 1, u + 1)) / 4, y, x);
  }
  KV_HD F at(int64_t y, int64_t x) const {
    bool const odd_row = y % 2, odd_column = x % 2;
    if (odd_row && odd_column) return center(y, x);
    int64_t const v = y / 2, u = x / 2;
    if (!odd_row && !odd_column) return pixel(v, u);
    F total;
    bool before, after;
    if (odd_row) {
      before = x > 0, after = x < 2 * w - 2;
      total = pixel(v, u) + pixel(v + 1, u);
      if (before) total += center(y, x - 1);
      if (after) total += center(y, x + 1);
    } else {
      before = y > 0, after = y < 2 * h - 2;
      total = F(0);
      if (before) total += center(y - 1, x);
      if (after) total += center(y + 1, x);
      total += pixel(v, u) + pixel(v, u + 1);
    }
    return mix(total / F(before && after ? 4 : 3), y, x);
  }
};

template <class T, class Load>
KV_HD FractalPlane<T, Load> fractal_plane(RefineFractal<T> const& p, int64_t plane, Load load) {
  return {p.coarse + plane * p.h * p.w,
          p.noise + plane * p.height() * p.width(),
          p.weights[plane * p.weight_stride],
          p.h,
          p.w,
          load};
}

}  // namespace kv::contrib
