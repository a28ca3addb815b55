// How many correspondences fit models, and how well: the sum over those whose squared error e is at most t of 1 - e / t
// (MSAC; P. Torr and A. Zisserman, 2000), and how many they are. The error is
//
//   affine, homography       how far the point goes from where it should
//   lines                    the mean distance of both ends from the line
//   the others               Sampson's distance, of both points to the nearest ones that fit, to first order
//
// What is not a number fits nothing. Included by consensus_cpu.cpp, consensus.cu and consensus_op.cpp.
#pragma once

#include "minimal.h"

namespace kv {

template <class T>
struct Consensus {
  T const *points1, *points2;  // (2 or 4, N): coordinate by coordinate
  T const* models;             // (M, 9)
  Model model;
  T limit;  // t
  int64_t candidates, count;
  T* scores;  // (M, 2)
};

KV_KERNEL(consensus, Consensus)

template <class V, class F>
KV_HD V transfer_error(F const* m, V x, V y, V u, V v) {
  V const w = x * m[6] + (y * m[7] + m[8]);
  V const p = x * m[0] + (y * m[1] + m[2]) - w * u, q = x * m[3] + (y * m[4] + m[5]) - w * v;
  return (p * p + q * q) / (w * w);
}

template <class V, class F>
KV_HD V sampson_error(F const* m, V x, V y, V u, V v) {
  V const a = x * m[0] + (y * m[1] + m[2]), b = x * m[3] + (y * m[4] + m[5]);
  V const c = u * m[0] + (v * m[3] + m[6]), d = u * m[1] + (v * m[4] + m[7]);
  V const r = a * u + (b * v + (x * m[6] + (y * m[7] + m[8])));
  return r * r / (a * a + b * b + c * c + d * d);
}

// Of the line through (u, v) and (s, t), from an end at (x, y): the distance times the segment's length.
template <class V, class F>
KV_HD V line_error(F const* m, V x, V y, V u, V v, V s, V t) {
  V const w = x * m[6] + (y * m[7] + m[8]);
  V const p = (x * m[0] + (y * m[1] + m[2])) / w - u, q = (x * m[3] + (y * m[4] + m[5])) / w - v;
  V const distance = p * (t - v) - q * (s - u);
  return distance < 0 ? -distance : distance;
}

// read(points, k, i) gives coordinate k of the correspondences from i on.
template <class V, class T, class Read>
KV_HD V error_of(Consensus<T> const& p, T const* m, int64_t i, Read read) {
  V const x = read(p.points1, 0, i), y = read(p.points1, 1, i), u = read(p.points2, 0, i), v = read(p.points2, 1, i);
  if (p.model == Model::lines) {
    V const s = read(p.points2, 2, i), t = read(p.points2, 3, i);
    V const sum =
        line_error(m, x, y, u, v, s, t) + line_error(m, V(read(p.points1, 2, i)), V(read(p.points1, 3, i)), u, v, s, t);
    return sum * sum / (((s - u) * (s - u) + (t - v) * (t - v)) * 4);
  }
  return p.model <= Model::homography ? transfer_error(m, x, y, u, v) : sampson_error(m, x, y, u, v);
}

}  // namespace kv
