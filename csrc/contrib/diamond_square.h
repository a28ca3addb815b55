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

// A plane of h rows of w coarse pixels, which `pixel` reads, and of noise, which `noise` does.
template <class F, class Pixel, class Noise>
struct FractalPlane {
  Pixel pixel;
  Noise noise;
  F weight;
  int64_t h, w;

  template <class Index>
  KV_HD F mix(F mean, Index y, Index x) const {
    return mixed(mean, F(noise(y, x)), weight);
  }
  // Of odd coordinates.
  template <class Index>
  KV_HD F center(Index y, Index x) const {
    Index const v = y / 2, u = x / 2;
    return mix((F(pixel(v, u)) + F(pixel(v, u + 1)) + F(pixel(v + 1, u)) + F(pixel(v + 1, u + 1))) / 4, y, x);
  }
  template <class Index>
  KV_HD F at(Index y, Index x) const {
    return at(y, x, [this](Index row, Index column) KV_INLINE { return center(row, column); });
  }
  // The same, where centers are known.
  template <class Index, class Center>
  KV_HD F at(Index y, Index x, Center const& center_at) const {
    bool const odd_row = y % 2, odd_column = x % 2;
    if (odd_row && odd_column) return center_at(y, x);
    Index const v = y / 2, u = x / 2;
    if (!odd_row && !odd_column) return pixel(v, u);
    F total;
    bool before, after;
    if (odd_row) {
      before = x > 0, after = x < Index(2 * w - 2);
      total = F(pixel(v, u)) + F(pixel(v + 1, u));
      if (before) total += center_at(y, x - 1);
      if (after) total += center_at(y, x + 1);
    } else {
      before = y > 0, after = y < Index(2 * h - 2);
      total = F(0);
      if (before) total += center_at(y - 1, x);
      if (after) total += center_at(y + 1, x);
      total += F(pixel(v, u)) + F(pixel(v, u + 1));
    }
    return mix(before && after ? total / 4 : total / 3, y, x);
  }
};
template <class F, class Pixel, class Noise>
KV_HD FractalPlane<F, Pixel, Noise> fractal_plane(Pixel pixel, Noise noise, F weight, int64_t h, int64_t w) {
  return {pixel, noise, weight, h, w};
}

// Dense planes, whose elements `load` reads.
template <class T, class Load>
KV_HD auto fractal_plane(RefineFractal<T> const& p, int64_t plane, Load load) {
  T const *const coarse = p.coarse + plane * p.h * p.w, *const noise = p.noise + plane * p.height() * p.width();
  int64_t const w = p.w;
  return fractal_plane([=](int64_t y, int64_t x) KV_INLINE { return load(coarse + y * w + x); },
                       [=](int64_t y, int64_t x) KV_INLINE { return load(noise + y * (2 * w - 1) + x); },
                       p.weights[plane * p.weight_stride], p.h, p.w);
}

}  // namespace kv::contrib
