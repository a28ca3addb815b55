// Chains of matrices and maps as one warp. The sampling coordinates of a pixel of the result are found by walking back
// through the links:
//
//   result  (x, y)  ->  last link  ->  ...  ->  first link  ->  (u, v)  image
//
//   matrix  maps the input of a link to its output; the walk applies its inverse
//   map     displacements (B, 2, H, W) in pixels, interpolated bilinearly with the replicate border; the walk applies
//           (x, y) -> (x, y) + d(x, y)
#pragma once

#include "geometry/transform/sampling.h"
#include "geometry/transform/taps.h"

namespace kv::geometry {

constexpr int kMaxLinks = 8;

template <class F>
struct Link {
  F const* data;      // matrices (B, 3, 3), or displacements (B, 2, H, W); dense
  int64_t stride;     // from a sample to the next, 0 where one serves all
  int height, width;  // of displacements; 0 for matrices

  KV_HD bool is_matrix() const { return height == 0; }
  KV_HD F const* of(int64_t b) const { return data + b * stride; }
  KV_HD Homography<double> inverse(int64_t b) const { return homography(of(b), use()); }
  static KV_HD MatrixUse use() { return {3, true, false, true, {}, {}}; }
};

// Links in the order of the walk: the first one is the last of the chain.
template <class F>
struct Chain {
  int count;
  Link<F> links[kMaxLinks];
};

// The sampling coordinates (B, 2, h, w), x and y, of the pixels of a result.
template <class T>
struct ComposedCoords {
  Chain<T> chain;
  Images<T> result;
};

// The gradients of the links from those of the coordinates. `grads` has those of each sample, null where they are not
// requested; those of displacements are accumulated. On CUDA each block of threads stores nine sums for every link, and
// a second kernel adds them up.
template <class T>
struct ComposedCoordsBackward {
  Chain<T> chain;
  Images<T const> grad;
  T* grads[kMaxLinks];
  double* sums;  // (B, parts, links, 9)
  int64_t parts;
};

// `coords` of Sample are not used.
template <class T>
struct ComposedWarp : Sample<T> {
  Chain<Compute<T>> chain;
};

constexpr int kBackwardPixels = 4096;  // of a block of composed_coords_backward on CUDA
// composed_warp on the CPU processes bands of rows whose coordinates stay in the cache.
constexpr int64_t kBandPixels = 8192;
KV_HD int64_t rows_of_band(int64_t width) { return max(int64_t(1), kBandPixels / width); }
KV_HD int64_t bands_of(int64_t height, int64_t width) {
  int64_t const rows = rows_of_band(width);
  return (height + rows - 1) / rows;
}

KV_KERNEL(composed_coords, ComposedCoords)
KV_KERNEL(composed_coords_backward, ComposedCoordsBackward)
KV_KERNEL(composed_warp, ComposedWarp)

// --- matrices --------------------------------------------------------------------------------------------------------

// Moves (x, y) by the inverse of a matrix.
template <class F, class V>
KV_HD void apply_inverse(Homography<F> const& h, V& x, V& y) {
  F const* const m = h.m;
  V u = x * m[0] + (y * m[1] + m[2]), v = x * m[3] + (y * m[4] + m[5]);
  if (!h.affine) {
    V const scale = reciprocal(V(x * m[6] + (y * m[7] + m[8])));
    u = u * scale;
    v = v * scale;
  }
  x = u;
  y = v;
}

// The vjp of apply_inverse at (x, y): replaces the gradients of its result by those of (x, y), and adds the gradient of
// the inverse matrix to `sums`.
template <class F, class S>
KV_HD void apply_inverse_vjp(Homography<F> const& h, F x, F y, F& grad_x, F& grad_y, S* sums) {
  F const* const m = h.m;
  F u = x, v = y;
  apply_inverse(h, u, v);
  F const scale = h.affine ? F(1) : reciprocal(F(x * m[6] + (y * m[7] + m[8])));
  F g[] = {grad_x * scale, grad_y * scale, -(grad_x * u + grad_y * v) * scale};
  for (int i = 0; i < 3; ++i) {
    if (g[i] - g[i] != 0) g[i] = 0;  // coordinates at infinity have no gradient
    sums[3 * i] += g[i] * x;
    sums[3 * i + 1] += g[i] * y;
    sums[3 * i + 2] += g[i];
  }
  grad_x = g[0] * m[0] + g[1] * m[3] + g[2] * m[6];
  grad_y = g[0] * m[1] + g[1] * m[4] + g[2] * m[7];
}

// --- maps ------------------------------------------------------------------------------------------------------------

#if defined(__CUDACC__)
#define KV_WALK __device__ __forceinline__
#else
#define KV_WALK KV_HD
#endif

// The first of the two pixels around a coordinate along an axis, and the weight t of the second one. Coordinates out of
// bounds are clamped; NaN becomes 0.
template <class F, class V>
KV_WALK auto linear_taps_at(int size, V x, V& t) {
  V const zero{};
  V const near = vclamp(x, zero, V(zero + F(size - 1)));
  auto first = floor_to_int<F>(near);
  decltype(first) const none{};
  first = min(first, decltype(first)(none + max(size - 2, 0)));
  t = near - to_float<F>(first);
  return first;
}

// The taps of displacements at a position: the offset of the first of four in a plane, and the weights of the second
// column and row.
template <class F, class V>
struct MapTaps {
  V tx, ty;
  decltype(floor_to_int<F>(V{})) at;

  KV_WALK MapTaps(Link<F> const& link, V x, V y) {
    auto const column = linear_taps_at<F>(link.width, x, tx), row = linear_taps_at<F>(link.height, y, ty);
    at = row * link.width + column;
  }
  static KV_WALK int right(Link<F> const& link) { return link.width > 1; }
  static KV_WALK int below(Link<F> const& link) { return link.height > 1 ? link.width : 0; }
};

// Adds the displacement at (x, y) to (x, y). read(plane, offsets) loads the elements of a plane at these offsets.
template <class F, class V, class Read>
KV_WALK void displace(Link<F> const& link, int64_t b, V& x, V& y, Read read) {
  MapTaps<F, V> const taps(link, x, y);
  int const right = taps.right(link), below = taps.below(link);
  F const* plane = link.of(b);
  V d[2];
  for (int axis = 0; axis < 2; ++axis, plane += int64_t(link.height) * link.width) {
    V const a = read(plane, taps.at), c = read(plane + below, taps.at);
    V const above = a + taps.tx * (read(plane + right, taps.at) - a);
    V const under = c + taps.tx * (read(plane + below + right, taps.at) - c);
    d[axis] = above + taps.ty * (under - above);
  }
  x = x + d[0];
  y = y + d[1];
}

// The vjp of displace at (x, y): adds to the gradients of its result to get those of (x, y). Calls add(offset,
// gradient) for all taps, with the offset from the displacements of the sample.
template <class F, class Add>
KV_WALK void displace_vjp(Link<F> const& link, int64_t b, F x, F y, F& grad_x, F& grad_y, Add add) {
  MapTaps<F, F> const taps(link, x, y);
  int const right = taps.right(link), below = taps.below(link), at = taps.at;
  int64_t const plane = int64_t(link.height) * link.width;
  F const* const d = link.of(b);
  F const grads[] = {grad_x, grad_y};
  F along_x = 0, along_y = 0;
  for (int axis = 0; axis < 2; ++axis) {
    int64_t const first = axis * plane + at;
    F const a = d[first], c = d[first + below], e = d[first + right], f = d[first + below + right], g = grads[axis];
    along_x += g * ((e - a) + taps.ty * ((f - c) - (e - a)));
    along_y += g * ((c - a) + taps.tx * ((f - e) - (c - a)));
    add(first, g * (1 - taps.tx) * (1 - taps.ty));
    add(first + right, g * taps.tx * (1 - taps.ty));
    add(first + below, g * (1 - taps.tx) * taps.ty);
    add(first + below + right, g * taps.tx * taps.ty);
  }
  grad_x += x >= 0 && x <= F(link.width - 1) ? along_x : F(0);
  grad_y += y >= 0 && y <= F(link.height - 1) ? along_y : F(0);
}

// --- chains ----------------------------------------------------------------------------------------------------------

// Moves N pixels back through a link, whose `inverse` is read if it is a matrix. The loads of N pixels are independent,
// so that they are in flight together.
template <int N, class F, class V, class Read>
KV_WALK void follow(Link<F> const& link, Homography<F> const& inverse_of_matrix, int64_t b, V (&x)[N], V (&y)[N],
                    Read read) {
  if (link.is_matrix()) {
    Homography<F> const inverse = inverse_of_matrix;
#pragma unroll
    for (int i = 0; i < N; ++i) apply_inverse(inverse, x[i], y[i]);
  } else {
#pragma unroll
    for (int i = 0; i < N; ++i) displace(link, b, x[i], y[i], read);
  }
}

// Replaces N pixels of the result by their sampling coordinates. `inverses` are the inverses of the links that are
// matrices.
template <int N, class F, class V, class Read>
KV_WALK void walk(Chain<F> const& chain, Homography<F> const* inverses, int64_t b, V (&x)[N], V (&y)[N], Read read) {
#pragma unroll 1
  for (int k = 0; k < chain.count; ++k) {
    Link<F> const link = chain.links[k];
    follow(link, inverses[k], b, x, y, read);
  }
}

// The gradients of the links from that of the coordinates of pixel (x, y). Adds those of inverse matrices to nine sums
// for each link, and calls add(link, offset, gradient) for those of displacements.
template <class F, class S, class Add>
KV_WALK void walk_vjp(Chain<F> const& chain, Homography<F> const* inverses, int64_t b, F x, F y, F grad_x, F grad_y,
                      S (*sums)[9], Add add) {
  F before_x[kMaxLinks], before_y[kMaxLinks];
  for (int k = 0; k < chain.count; ++k) {
    before_x[k] = x;
    before_y[k] = y;
    if (chain.links[k].is_matrix())
      apply_inverse(inverses[k], x, y);
    else
      displace(chain.links[k], b, x, y, [](F const* plane, int at) { return plane[at]; });
  }
  for (int k = chain.count - 1; k >= 0; --k) {
    if (chain.links[k].is_matrix())
      apply_inverse_vjp(inverses[k], before_x[k], before_y[k], grad_x, grad_y, sums[k]);
    else
      displace_vjp(chain.links[k], b, before_x[k], before_y[k], grad_x, grad_y,
                   [&](int64_t at, F g) { add(k, at, g); });
  }
}

#undef KV_WALK

// A homography in the type that kernels compute in.
template <class F>
KV_HD Homography<F> narrowed(Homography<double> const& h) {
  Homography<F> n;
  for (int i = 0; i < 9; ++i) n.m[i] = F(h.m[i]);
  n.affine = h.affine;
  return n;
}

}  // namespace kv::geometry
