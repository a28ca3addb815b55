// The gradients of the bilateral blur to its images on CUDA; see bilateral.cuh and bilateral.h.
#include "bilateral.cuh"

namespace kv::cuda {
namespace {

// Calls f(i) for every position i at which pixel j of n stands, itself first, as for_each_reader does; but there is
// one place where f is called, so it may be long. In circles the image goes on instead, gradients and all.
template <class Body>
__device__ __forceinline__ void for_each_place(Border border, int j, int n, int reach, Body body) {
  bool const alone = border == Border::circular || (j > reach && j < n - 1 - reach);
  for (int k = 0; k < (alone ? 1 : 2 * reach + 1); ++k) {
    int const i = k == 0 ? j : k <= reach ? -k : n - 1 + k - reach;
    if (k == 0 || border_index(border, i, n) == j) body(i);
  }
}
template <class Params, class Body>
__device__ __forceinline__ void for_each_place(Params const& p, int y, int x, Body body) {
  for_each_place(p.border, y, int(p.x.height), p.ky / 2, [&](int at_y) {
    for_each_place(p.border, x, int(p.x.width), p.kx / 2, [&](int at_x) { body(at_y, at_x); });
  });
}

// The part of a pixel's window that has gradients: all of it around the pixel itself, what is inside of the image
// around another position at which it stands.
struct Window {
  int top, bottom, left, right;
  template <class Params>
  __device__ __forceinline__ Window(Params const& p, int y, int x, bool own)
      : top(y - p.ky / 2), bottom(y + p.ky / 2), left(x - p.kx / 2), right(x + p.kx / 2) {
    if (own) return;
    top = max(top, 0);
    left = max(left, 0);
    bottom = min(bottom, int(p.x.height) - 1);
    right = min(right, int(p.x.width) - 1);
  }
};

// --- tiles -----------------------------------------------------------------------------------------------------------

constexpr int kRun = 4;

// What a pixel q collects from a pixel p, see bilateral.h. Their values are scaled to unit falloff in colour: with one
// factor of the scale in b and the products with a, the derivative of the distance has the other one.
template <int C, bool L1>
__device__ __forceinline__ void collect(float space, float const (&p)[C], float const (&p_ab)[C + 1],
                                        float const (&q)[C], float const (&q_ab)[C + 1], bool own, float (&grad)[C]) {
  float const weight = fast_exp2(log_weight<C, L1>(space, p, q));
  float slope = -p_ab[C], distance = 0;
  if (own) slope -= q_ab[C];
#pragma unroll
  for (int c = 0; c < C; ++c) {
    slope += p_ab[c] * q[c];
    if (own) slope += q_ab[c] * p[c];
    if (L1) distance += fabsf(q[c] - p[c]);
  }
  slope *= weight * -1.38629436111989061883f;  // -2 log 2
  if (L1) slope *= distance;
#pragma unroll
  for (int c = 0; c < C; ++c) {
    float const difference = q[c] - p[c];
    float const pull = !L1 ? slope * difference : difference > 0 ? slope : difference < 0 ? -slope : 0.f;
    grad[c] += weight * p_ab[c] + pull;
  }
}

// Phases: the tile's pixels with two windows' reach around it; a and b with one window's reach; the gradients.
template <class T, int C, bool L1, int R>
__global__ void __launch_bounds__(kThreads, 3) bilateral_backward_tile(BilateralBackward<T> p, Tiles<kRun> tiles) {
  extern __shared__ float memory[];
  int const ry = R > 0 ? R : p.ky / 2, rx = R > 0 ? R : p.kx / 2;
  int const height = int(p.x.height), width = int(p.x.width);
  int64_t b;
  int y0, x0;
  tiles.locate(b, y0, x0);
  SharedPlanes const s{memory, y0 - 2 * ry, x0 - 2 * rx, rows_of(kRun) + 4 * ry, kColumns + 4 * rx};
  SharedPlanes const ab{memory + C * s.size(), y0 - ry, x0 - rx, rows_of(kRun) + 2 * ry, kColumns + 2 * rx};
  Falloff<float> const falloff = p.sigma.at(b);
  float const scale = sqrtf(falloff.color);
  load_planes<C>(s, p.x, b, p.border, 2 * rx, scale);
  __syncthreads();

  int const runs = (ab.rows + kRun - 1) / kRun;
  for (int task = threadIdx.x; task < runs * ab.columns; task += kThreads) {
    int const run = unsigned(task) / unsigned(ab.columns), x = ab.x + task - run * ab.columns;
    int const y = ab.y + min(run * kRun, ab.rows - kRun);  // the last run overlaps the one before
    float sum[kRun][C], total[kRun];
    sum_run<C, L1, R>(s, ry, rx, falloff, y, x, sum, total);
#pragma unroll
    for (int i = 0; i < kRun; ++i) {
      bool const inside = p.border == Border::circular || (y + i >= 0 && y + i < height && x >= 0 && x < width);
      float const inverse = __fdividef(1.f, total[i]);
      float* const to = ab.data + (y + i - ab.y) * ab.columns + x - ab.x;
      T const* const grad =
          p.grad.row(b, 0, pixel_at(p.border, y + i, height)) + pixel_at(p.border, x, width) * p.grad.step;
      float last = 0;
#pragma unroll
      for (int c = 0; c < C; ++c) {
        float const a = inside ? read(grad[c * p.grad.channel_stride]) * inverse : 0.f;
        to[c * ab.size()] = a;
        last += a * (sum[i][c] * inverse);
      }
      to[C * ab.size()] = inside ? last : 0.f;
    }
  }
  __syncthreads();

  int const x = x0 + threadIdx.x % kColumns, y = y0 + threadIdx.x / kColumns * kRun;
  if (x >= width || y >= height) return;
  float centre[kRun][C], centre_ab[kRun][C + 1], grad[kRun][C];
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
#pragma unroll
    for (int c = 0; c < C; ++c) {
      centre[i][c] = s.at(y + i, x)[c * s.size()];
      centre_ab[i][c] = ab.at(y + i, x)[c * ab.size()];
      grad[i][c] = 0;
    }
    centre_ab[i][C] = ab.at(y + i, x)[C * ab.size()];
  }
  auto const load = [&](int row, int column, float(&pixel)[C], float(&pixel_ab)[C + 1]) {
#pragma unroll
    for (int c = 0; c < C; ++c) {
      pixel[c] = s.at(row, column)[c * s.size()];
      pixel_ab[c] = ab.at(row, column)[c * ab.size()];
    }
    pixel_ab[C] = ab.at(row, column)[C * ab.size()];
  };
  for (int dx = -rx; dx <= rx; ++dx) {
    auto const pixel_row = [&](int row) {
      float pixel[C], pixel_ab[C + 1];
      load(y + row, x + dx, pixel, pixel_ab);
#pragma unroll
      for (int i = 0; i < kRun; ++i) {
        int const dy = row - i;
        if (dy < -ry || dy > ry) continue;
        float const space = falloff.space_y * float(dy * dy) + falloff.space_x * float(dx * dx);
        collect<C, L1>(space, pixel, pixel_ab, centre[i], centre_ab[i], true, grad[i]);
      }
    };
    if constexpr (R > 0) {
#pragma unroll
      for (int row = -R; row < kRun + R; ++row) pixel_row(row);
    } else {
      for (int row = -ry; row < kRun + ry; ++row) pixel_row(row);
    }
  }
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    if (y + i >= height) return;
    for_each_place(p, y + i, x, [&](int at_y, int at_x) {
      if (at_y == y + i && at_x == x) return;
      Window const window(p, at_y, at_x, false);
      for (int row = window.top; row <= window.bottom; ++row)
        for (int column = window.left; column <= window.right; ++column) {
          float pixel[C], pixel_ab[C + 1];
          load(row, column, pixel, pixel_ab);
          int const dy = row - at_y, dx = column - at_x;
          float const space = falloff.space_y * float(dy * dy) + falloff.space_x * float(dx * dx);
          collect<C, L1>(space, pixel, pixel_ab, centre[i], centre_ab[i], false, grad[i]);
        }
    });
    T* const out = p.grad_x.row(b, 0, y + i) + x * p.grad_x.step;
#pragma unroll
    for (int c = 0; c < C; ++c) out[c * p.grad_x.channel_stride] = round_to<T>(grad[i][c]);
  }
}

// --- plain kernels ---------------------------------------------------------------------------------------------------

constexpr int kSide = 16;  // a block computes a square of pixels

// One thread a pixel. 1 / n and b, with a window's reach around the square, are in shared memory.
template <class T, bool Joint>
__global__ void __launch_bounds__(kThreads)
    bilateral_backward_any(BilateralBackward<T> p, unsigned across, unsigned down) {
  using F = Compute<T>;
  extern __shared__ char bytes[];
  auto const& guide = guide_of<Joint>(p);
  int const ry = p.ky / 2, rx = p.kx / 2, height = int(p.x.height), width = int(p.x.width);
  int const rows = kSide + 2 * ry, columns = kSide + 2 * rx;
  unsigned const above = blockIdx.x / across;
  int64_t const b = above / down;
  int const y0 = int(above % down) * kSide - ry, x0 = int(blockIdx.x % across) * kSide - rx;
  F* const inverses = reinterpret_cast<F*>(bytes);
  F* const products = inverses + rows * columns;
  Falloff<F> const falloff = p.sigma.at(b);
  auto const grad_at = [&](int y, int x) {  // null where there is none
    bool const inside = p.border == Border::circular || (y >= 0 && y < height && x >= 0 && x < width);
    return inside ? pixel(p.grad, b, p.border, y, x) : nullptr;
  };

  for (int i = threadIdx.x; i < rows * columns; i += kThreads) {
    int const y = y0 + i / columns, x = x0 + i % columns;
    T const* const grad = grad_at(y, x);
    F inverse = 0, product = 0;
    for (int c = 0; grad && c < p.x.channels; c += kChunk) {
      F sum[kChunk];
      inverse = 1 / sum_window<Joint>(p, falloff, b, c, y, x, sum);
      for (int k = 0; k < kChunk; ++k)
        if (c + k < p.x.channels) product += value(p.grad, grad, c + k) * inverse * (sum[k] * inverse);
    }
    inverses[i] = inverse;
    products[i] = product;
  }
  __syncthreads();

  int const y = y0 + ry + threadIdx.x / kSide, x = x0 + rx + threadIdx.x % kSide;
  if (y >= height || x >= width) return;
  int const here = (y - y0) * columns + x - x0;
  auto const* const q = pixel(p.x, b, p.border, y, x);
  auto const* const q_guide = pixel(guide, b, p.border, y, x);
  T const* const q_grad = grad_at(y, x);
  F const rate = F(-2 * 0.69314718055994530942) * falloff.color;
  bool const wants_guide = !Joint || p.wants_guide;
  for (int c = 0; c < max(p.x.channels, guide.channels); c += kChunk) {
    F values[kChunk] = {}, pulls[kChunk] = {};
    for_each_place(p, y, x, [&](int at_y, int at_x) {
      bool const own = at_y == y && at_x == x;
      Window const window(p, at_y, at_x, own);
      for (int row = window.top; row <= window.bottom; ++row)
        for (int column = window.left; column <= window.right; ++column) {
          int const dy = row - at_y, dx = column - at_x, there = (row - y0) * columns + column - x0;
          auto const* const from = pixel(p.x, b, p.border, row, column);
          auto const* const from_guide = pixel(guide, b, p.border, row, column);
          T const* const from_grad = grad_at(row, column);
          F const d = distance(guide, p.l1, q_guide, from_guide);
          F const space = falloff.space_y * F(dy * dy) + falloff.space_x * F(dx * dx);
          F const weight = fast_exp2(space - (p.l1 ? d * d : d) * falloff.color);
          F slope = 0;
          if (wants_guide) {
            slope = -products[there] - (own ? products[here] : F(0));
            for (int k = 0; k < p.x.channels; ++k) {
              slope += value(p.grad, from_grad, k) * inverses[there] * value(p.x, q, k);
              if (own) slope += value(p.grad, q_grad, k) * inverses[here] * value(p.x, from, k);
            }
            slope *= weight * rate * (p.l1 ? d : F(1));
          }
          for (int k = 0; k < kChunk; ++k) {
            if (c + k < p.x.channels) values[k] += weight * value(p.grad, from_grad, c + k) * inverses[there];
            if (c + k < guide.channels) {
              F const difference = value(guide, q_guide, c + k) - value(guide, from_guide, c + k);
              pulls[k] += !p.l1 ? slope * difference : difference > 0 ? slope : difference < 0 ? -slope : F(0);
            }
          }
        }
    });
    for (int k = 0; k < kChunk; ++k) {
      F const value = Joint ? values[k] : values[k] + pulls[k];
      if (c + k < p.grad_x.channels) p.grad_x.row(b, c + k, y)[x * p.grad_x.step] = round_to<T>(value);
      if (c + k < p.grad_guide.channels) p.grad_guide.row(b, c + k, y)[x * p.grad_guide.step] = round_to<T>(pulls[k]);
    }
  }
}

// False where the tile does not fit into shared memory.
template <int C, bool L1, int R, class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  auto const kernel = bilateral_backward_tile<T, C, L1, R>;
  int64_t const ry = p.ky / 2, rx = p.kx / 2;
  int64_t const bytes = sizeof(float) * (C * (rows_of(kRun) + 4 * ry) * (kColumns + 4 * rx) +
                                         (C + 1) * (rows_of(kRun) + 2 * ry) * (kColumns + 2 * rx));
  if (!fits(kernel, bytes)) return false;
  Tiles<kRun> const tiles(p.x.batch, p.x.height, p.x.width);
  kernel<<<tiles.count, kThreads, bytes, stream>>>(p, tiles);
  return true;
}
template <int C, bool L1, class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  return p.ky == 5 && p.kx == 5 ? launch_tile<C, L1, 2>(p, stream) : launch_tile<C, L1, 0>(p, stream);
}
template <class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  if (p.joint) return false;
  if (p.x.channels == 1) return launch_tile<1, false>(p, stream);
  if (p.x.channels == 3) return p.l1 ? launch_tile<3, true>(p, stream) : launch_tile<3, false>(p, stream);
  return false;
}

template <bool Joint, class T>
int launch_any(BilateralBackward<T> const& p, CUstream_st* stream) {
  auto const kernel = bilateral_backward_any<T, Joint>;
  int64_t const bytes = 2 * sizeof(Compute<T>) * (kSide + p.ky - 1) * (kSide + p.kx - 1);
  if (!fits(kernel, bytes)) return cudaErrorInvalidConfiguration;  // windows of more than 100 x 100 pixels
  unsigned const across = unsigned(ceil_div(p.x.width, kSide)), down = unsigned(ceil_div(p.x.height, kSide));
  kernel<<<unsigned(p.x.batch * across * down), kThreads, bytes, stream>>>(p, across, down);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int bilateral_blur_backward(BilateralBackward<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(Compute<T>) == 4)
    if (launch_tile(p, stream)) return cudaGetLastError();
  return p.joint ? launch_any<true>(p, stream) : launch_any<false>(p, stream);
}

KV_INSTANTIATE(bilateral_blur_backward, BilateralBackward)

}  // namespace kv::cuda
