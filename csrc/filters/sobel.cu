// Sobel on CUDA. Each warp walks down a strip of 128 columns with three rows in registers, so a pixel is read from
// device memory once; channels-last images and strips take a plain kernel, one thread an element.
#include "core/launch.cuh"
#include "sobel.h"

namespace kv::cuda {
namespace {

constexpr int kRows = 16;

template <class F>
__device__ __forceinline__ F magnitude(F gx, F gy, F eps) {
  return sqrt(gx * gx + gy * gy + eps);
}

template <class T>
__global__ void __launch_bounds__(256) sobel_strip(Sobel<T> p, Strips strips, bool aligned) {
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(kRows, plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + kRows, height);
  T const* const in = p.x.plane(plane);
  T* const out = p.y.plane(plane);
  auto const row = [&](int y) { return in + clamp(y, 0, height - 1) * p.x.row_stride; };

  F a[6], b[6], c[6];
  load_strip<1>(a, row(y0 - 1), x, width, aligned, Border::replicate);
  load_strip<1>(b, row(y0), x, width, aligned, Border::replicate);
#pragma unroll 4
  for (int y = y0; y < y1; ++y) {
    load_strip<1>(c, row(y + 1), x, width, aligned, Border::replicate);
    F result[4];
#pragma unroll
    for (int i = 0; i < 4; ++i) {
      F gx, gy;
      sobel_gradients(a[i], a[i + 1], a[i + 2], b[i], b[i + 2], c[i], c[i + 1], c[i + 2], p.scale, gx, gy);
      result[i] = magnitude(gx, gy, p.eps);
    }
    store_four<T>(out + y * p.y.row_stride, x, width, aligned, result);
#pragma unroll
    for (int i = 0; i < 6; ++i) a[i] = b[i], b[i] = c[i];
  }
}

// u = g gx / magnitude and v = g gy / magnitude at one row, for the six columns a strip needs, from the rows of x
// around it.
template <class T>
__device__ __forceinline__ void weigh(SobelBackward<T> const& p, Compute<T> const (&a)[8], Compute<T> const (&b)[8],
                                      Compute<T> const (&c)[8], Compute<T> const (&g)[6], int x, int width,
                                      Compute<T> odd, Compute<T> (&u)[6], Compute<T> (&v)[6]) {
  using F = Compute<T>;
#pragma unroll
  for (int i = 0; i < 6; ++i) {
    F gx, gy;
    sobel_gradients(a[i], a[i + 1], a[i + 2], b[i], b[i + 2], c[i], c[i + 1], c[i + 2], p.scale, gx, gy);
    F const s = sobel_magnitude_vjp(g[i], magnitude(gx, gy, p.eps));
    u[i] = gx * s;
    v[i] = gy * s * odd;
  }
  // The continuation beyond the left and right rim; see sobel.h.
  if (x == 0) u[0] = -u[1], v[0] = v[1];
#pragma unroll
  for (int i = 2; i < 6; ++i)
    if (x + i - 1 == width) u[i] = -u[i - 1], v[i] = v[i - 1];
}

template <class T>
__global__ void __launch_bounds__(256) sobel_backward_strip(SobelBackward<T> p, Strips strips, bool aligned) {
  using F = Compute<T>;
  int64_t plane;
  int x, y0;
  if (!strips.place(kRows, plane, x, y0)) return;
  int const width = int(p.x.width), height = int(p.x.height), y1 = min(y0 + kRows, height);
  T const* const in = p.x.plane(plane);
  T const* const grad = p.grad.plane(plane);
  T* const out = p.grad_x.plane(plane);
  // Row y of u and v needs rows y - 1 to y + 1 of x around the row nearest to y inside the image.
  auto const load_x = [&](F(&v)[8], int y) {
    load_strip<2>(v, in + clamp(y, 0, height - 1) * p.x.row_stride, x, width, aligned, Border::replicate);
  };
  F a[8], b[8], c[8], g[6];
  F ua[6], ub[6], uc[6], va[6], vb[6], vc[6];
  auto const fill = [&](int y, F(&u)[6], F(&v)[6]) {
    load_strip<1>(g, grad + clamp(y, 0, height - 1) * p.grad.row_stride, x, width, aligned, Border::replicate);
    weigh(p, a, b, c, g, x, width, y < 0 || y >= height ? F(-1) : F(1), u, v);
  };
  if (y0 == 0) {
    load_x(a, 0);
    load_x(b, 0);
    load_x(c, 1);
    fill(-1, ua, va);
    fill(0, ub, vb);
  } else {
    load_x(a, y0 - 2);
    load_x(b, y0 - 1);
    load_x(c, y0);
    fill(y0 - 1, ua, va);
#pragma unroll
    for (int i = 0; i < 8; ++i) a[i] = b[i], b[i] = c[i];
    load_x(c, y0 + 1);
    fill(y0, ub, vb);
  }
#pragma unroll 2
  for (int y = y0; y < y1; ++y) {
    if (y + 1 < height) {
#pragma unroll
      for (int i = 0; i < 8; ++i) a[i] = b[i], b[i] = c[i];
      load_x(c, y + 2);
    }
    fill(y + 1, uc, vc);
    F result[4];
#pragma unroll
    for (int i = 0; i < 4; ++i)
      result[i] = sobel_gradients_vjp(ua[i], ua[i + 2], ub[i], ub[i + 2], uc[i], uc[i + 2], va[i], va[i + 1], va[i + 2],
                                      vc[i], vc[i + 1], vc[i + 2], p.scale);
    store_four<T>(out + y * p.grad_x.row_stride, x, width, aligned, result);
#pragma unroll
    for (int i = 0; i < 6; ++i) ua[i] = ub[i], ub[i] = uc[i], va[i] = vb[i], vb[i] = vc[i];
  }
}

// --- any layout: one thread an element
// ---------------------------------------------------------------------------------

template <class T>
__device__ __forceinline__ void gradients_at(Planes<T const> const& x, Compute<T> scale, int64_t plane, int64_t y,
                                             int64_t e, Compute<T>& gx, Compute<T>& gy) {
  int64_t const left = e >= x.step ? e - x.step : e, right = e + x.step < x.row_size() ? e + x.step : e;
  T const* const b = x.row(plane, y);
  T const* const a = y > 0 ? b - x.row_stride : b;
  T const* const c = y + 1 < x.height ? b + x.row_stride : b;
  sobel_gradients(read(a[left]), read(a[e]), read(a[right]), read(b[left]), read(b[right]), read(c[left]), read(c[e]),
                  read(c[right]), scale, gx, gy);
}

template <class T>
__global__ void sobel_any(Sobel<T> p) {
  int64_t const i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x, size = p.x.row_size();
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height, y = r % p.x.height;
  Compute<T> gx, gy;
  gradients_at<T>(p.x, p.scale, plane, y, e, gx, gy);
  p.y.row(plane, y)[e] = round_to<T>(magnitude(gx, gy, p.eps));
}

template <class T>
__global__ void sobel_backward_any(SobelBackward<T> p) {
  using F = Compute<T>;
  int64_t const i = int64_t(blockIdx.x) * blockDim.x + threadIdx.x, size = p.x.row_size(), step = p.x.step;
  if (i >= p.x.rows() * size) return;
  int64_t const e = i % size, r = i / size, plane = r / p.x.height, y = r % p.x.height;
  F u[3][3], v[3][3];
  for (int dy = 0; dy < 3; ++dy)
    for (int dx = 0; dx < 3; ++dx) {
      int64_t const yy = y + dy - 1, ee = e + (dx - 1) * step;
      bool const outside_y = yy < 0 || yy >= p.x.height, outside_x = ee < 0 || ee >= size;
      int64_t const iy = outside_y ? y : yy, ie = outside_x ? e : ee;
      F gx, gy;
      gradients_at<T>(p.x, p.scale, plane, iy, ie, gx, gy);
      F const s = sobel_magnitude_vjp(read(p.grad.row(plane, iy)[ie]), magnitude(gx, gy, p.eps));
      u[dy][dx] = gx * (outside_x ? -s : s);
      v[dy][dx] = gy * (outside_y ? -s : s);
    }
  p.grad_x.row(plane, y)[e] =
      round_to<T>(sobel_gradients_vjp(u[0][0], u[0][2], u[1][0], u[1][2], u[2][0], u[2][2], v[0][0], v[0][1], v[0][2],
                                      v[2][0], v[2][1], v[2][2], p.scale));
}

}  // namespace

template <class T>
int sobel(Sobel<T> const& p, CUstream_st* stream) {
  if (p.x.step == 1) {
    Strips const strips(p.x.count(), p.x.height, p.x.width, kRows);
    sobel_strip<<<strips.blocks(), 256, 0, stream>>>(p, strips, is_aligned(p.x) && is_aligned(p.y));
  } else {
    sobel_any<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), 256)), 256, 0, stream>>>(p);
  }
  return cudaGetLastError();
}

template <class T>
int sobel_backward(SobelBackward<T> const& p, CUstream_st* stream) {
  if (p.x.step == 1) {
    Strips const strips(p.x.count(), p.x.height, p.x.width, kRows);
    sobel_backward_strip<<<strips.blocks(), 256, 0, stream>>>(
        p, strips, is_aligned(p.x) && is_aligned(p.grad) && is_aligned(p.grad_x));
  } else {
    sobel_backward_any<<<unsigned(ceil_div(p.x.rows() * p.x.row_size(), 256)), 256, 0, stream>>>(p);
  }
  return cudaGetLastError();
}

KV_INSTANTIATE(sobel, Sobel)
KV_INSTANTIATE(sobel_backward, SobelBackward)

}  // namespace kv::cuda
