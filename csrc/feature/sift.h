// SIFT descriptors of square patches (D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004).
//
// A pixel with gradient (m, angle) votes for two of A angular bins and for the cells around it, S along each axis:
//
//   h[cy][a][cx] = sum over pixels of m p[cy][y] p[cx][x] (1 - |angle A / 2 pi - a|)+
//   p[c][x]      = g(x) (1 - |x - center_c| / (k / 2))+
//   center_c     = (n - 1) / 2 + (c - (S - 1) / 2) floor(n / S)
//   k            = 2 floor(n / (S + 1)), one more where a centered grid needs it
//
// Gradients are central differences; g is a Gaussian of sigma n / sqrt(2); ()+ is 0 for negative numbers.
//
// The descriptor is h over its length, clipped from above, over its length again; RootSIFT takes the square roots of
// its fractions of the sum (R. Arandjelovic and A. Zisserman, "Three things everyone should know to improve object
// retrieval", 2012).
#pragma once

#include "core/isa.h"
#include "patch_gradient.h"

namespace kv::feature {

// What divides into cells. The distance of their centers and the width of their windows, in pixels.
struct SiftGrid {
  int n, cells, bins, stride, width;

  KV_HD int size() const { return bins * cells * cells; }
  // The index in a descriptor of entry i of h.
  KV_HD int position(int i) const {
    int const x = i % cells, a = i / cells % bins, y = i / cells / bins;
    return (a * cells + y) * cells + x;
  }
  template <class F>
  KV_HD F pooling(int cell, int x) const {
    F const center = F(n - 1) / 2 + (F(cell) - F(cells - 1) / 2) * F(stride);
    F const distance = F(x) < center ? center - F(x) : F(x) - center, weight = 1 - distance * 2 / F(width);
    return weight > 0 ? weight * centered_gaussian(x, n, F(n) * F(0.70710678118654752440)) : F(0);
  }
  // The pixels [first, end) of a cell.
  KV_HD int first(int cell) const { return max(0, (n - width + (2 * cell - cells + 1) * stride) / 2); }
  KV_HD int end(int cell) const { return min(n, (n - width + (2 * cell - cells + 1) * stride) / 2 + width); }
};

template <class T>
struct Sift {
  T const* patches;  // (count, n, n)
  T* descriptors;    // (count, bins, cells, cells)
  int64_t count;
  SiftGrid grid;
  Compute<T> clip;
  bool root;
};

template <class T>
struct SiftBackward {
  T const* grad;
  T const* patches;
  T* grad_patches;
  int64_t count;
  SiftGrid grid;
  Compute<T> clip;
  bool root;
};

KV_KERNEL(sift, Sift)
KV_KERNEL(sift_backward, SiftBackward)

constexpr double kSiftEpsilon = 1e-10, kSmallestLength = 1e-12;

// h becomes the descriptor. all.each(f) calls f(i) for all entries and all.sum(f) returns the sum of f(i), both by one
// thread or by many, of which each has always the same entries.
template <class F, class Entries>
KV_HD void normalize_sift(F* h, F clip, bool root, Entries all) {
  F const first = 1 / max(sqrt(all.sum([&](int i) { return h[i] * h[i]; })), F(kSmallestLength));
  all.each([&](int i) { h[i] = min(h[i] * first, clip); });
  F const second = 1 / max(sqrt(all.sum([&](int i) { return h[i] * h[i]; })), F(kSmallestLength));
  all.each([&](int i) { h[i] *= second; });
  if (!root) return;
  F const scale = 1 / max(all.sum([&](int i) { return h[i]; }), F(kSmallestLength));
  all.each([&](int i) { h[i] = sqrt(h[i] * scale + F(kSiftEpsilon)); });
}

// g, the gradient to the descriptor, becomes that to h. Of a patch without gradients it is 0.
template <class F, class Entries>
KV_HD void normalize_sift_vjp(F const* h, F* g, F clip, bool root, Entries all) {
  F const length = sqrt(all.sum([&](int i) { return h[i] * h[i]; })), first = 1 / max(length, F(kSmallestLength));
  auto const clipped = [&](int i) { return min(h[i] * first, clip); };
  F const second = 1 / max(sqrt(all.sum([&](int i) { return clipped(i) * clipped(i); })), F(kSmallestLength));
  if (root) {
    F const scale = 1 / max(all.sum([&](int i) { return clipped(i) * second; }), F(kSmallestLength));
    all.each([&](int i) { g[i] *= F(0.5) / sqrt(clipped(i) * second * scale + F(kSiftEpsilon)); });
    F const along = all.sum([&](int i) { return g[i] * clipped(i) * second * scale; });
    all.each([&](int i) { g[i] = (g[i] - along) * scale; });
  }
  F const along = all.sum([&](int i) { return g[i] * clipped(i) * second; });
  all.each([&](int i) { g[i] = h[i] * first <= clip ? (g[i] - along * clipped(i) * second) * second : F(0); });
  F const radial = all.sum([&](int i) { return g[i] * h[i] * first; });
  all.each([&](int i) { g[i] = length > 0 ? (g[i] - radial * h[i] * first) * first : F(0); });
}

}  // namespace kv::feature
