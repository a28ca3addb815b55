// The homography that shows a quadrangle as an image: from pixels of the result to those of the source.
//
// From the unit square to corners p0 ... p3, clockwise from the top left, it is, up to a factor (Heckbert,
// "Fundamentals of Texture Mapping and Image Warping", 1989):
//
//   w (p1 - p0) + g p1    w (p3 - p0) + h p3    w p0        g = s x v    s = p0 - p1 + p2 - p3
//   g                     h                     w           h = u x s    u = p1 - p2
//                                                           w = u x v    v = p3 - p2
#pragma once

#include "core/isa.h"

namespace kv {

template <class F>
struct CropMatrix {
  F const* quads;  // (B, 4, 2)
  F* matrices;     // (B, 3, 3)
  int64_t batch;
  double across, down;  // from the first pixel of the result to the last one; 1 where these are the same
};

KV_KERNEL(crop_matrix, CropMatrix)

// In double, as products of coordinates cancel.
template <class F>
KV_HD void write_crop_matrix(CropMatrix<F> const& p, int64_t b) {
  double x[4], y[4];
  for (int i = 0; i < 4; ++i) {
    x[i] = double(p.quads[8 * b + 2 * i]);
    y[i] = double(p.quads[8 * b + 2 * i + 1]);
  }
  double const ux = x[1] - x[2], uy = y[1] - y[2], vx = x[3] - x[2], vy = y[3] - y[2];
  double const sx = x[0] - x[1] - vx, sy = y[0] - y[1] - vy;
  double const g = sx * vy - sy * vx, h = ux * sy - uy * sx, area = ux * vy - uy * vx;
  // Of a box without area all three are 0; it goes on as a parallelogram does.
  double const w = area == 0 && sx == 0 && sy == 0 ? 1 : area;
  double const scale = w == 0 ? 1 : w, gw = g / scale, hw = h / scale, ww = w / scale;  // exact for whole boxes
  F* const m = p.matrices + 9 * b;
  m[0] = F((ww * (x[1] - x[0]) + gw * x[1]) / p.across);
  m[1] = F((ww * (x[3] - x[0]) + hw * x[3]) / p.down);
  m[2] = F(ww * x[0]);
  m[3] = F((ww * (y[1] - y[0]) + gw * y[1]) / p.across);
  m[4] = F((ww * (y[3] - y[0]) + hw * y[3]) / p.down);
  m[5] = F(ww * y[0]);
  m[6] = F(gw / p.across);
  m[7] = F(hw / p.down);
  m[8] = F(ww);
}

}  // namespace kv
