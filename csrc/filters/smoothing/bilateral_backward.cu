// The gradients of the bilateral blur to its images on CUDA; see bilateral.cuh and bilateral.h.
#include "bilateral.cuh"

namespace kv::filters::cuda {
namespace {

// Calls f(i) for every position i whose border pixel is j of n, j itself first, as for_each_reader does. There is a
// single call of f in the code, so f may be long. With the circular border images and gradients repeat: only j itself
// counts.
template <class Body>
__device__ __forceinline__ void for_each_reader_once(Border border, int j, int n, int reach, Body body) {
  bool const only_itself = border == Border::circular || (j > reach && j < n - 1 - reach);
  for (int k = 0; k < (only_itself ? 1 : 2 * reach + 1); ++k) {
    int const i = k == 0 ? j : k <= reach ? -k : n - 1 + k - reach;
    if (k == 0 || border_index(border, i, n) == j) body(i);
  }
}
template <class Params, class Body>
__device__ __forceinline__ void for_each_reader_once(Params const& p, int y, int x, Body body) {
  for_each_reader_once(p.border, y, int(p.x.height), p.ky / 2, [&](int at_y) {
    for_each_reader_once(p.border, x, int(p.x.width), p.kx / 2, [&](int at_x) { body(at_y, at_x); });
  });
}

// The part of a position's window that has gradients: all of it for the pixel itself, and the part in bounds for a
// position out of bounds.
struct Window {
  int top, bottom, left, right;
  template <class Params>
  __device__ __forceinline__ Window(Params const& p, int y, int x, bool is_own)
      : top(y - p.ky / 2), bottom(y + p.ky / 2), left(x - p.kx / 2), right(x + p.kx / 2) {
    if (is_own) return;
    top = max(top, 0);
    left = max(left, 0);
    bottom = min(bottom, int(p.x.height) - 1);
    right = min(right, int(p.x.width) - 1);
  }
};

// --- tiles -----------------------------------------------------------------------------------------------------------

constexpr int kRun = 4;

// The positions out of bounds near a tile, R on each side of the image: those in rows of the tile, in columns from left
// to right, then those above and below the image.
template <int R>
struct Frame {
  static constexpr int kRows = rows_of(kRun), kWide = kColumns + 2 * R, kSides = 2 * R * kRows;
  static constexpr int kSlots = kSides + 2 * R * kWide;
  int y0, x0, height, width;

  __device__ __forceinline__ bool contains(int y, int x) const {
    return y >= y0 && y < y0 + kRows && x >= x0 && x < x0 + kColumns;
  }
  // Those that may have their border pixel in the tile are the first ones, or all of them, or none.
  __device__ __forceinline__ int count() const {
    if (y0 <= R || y0 + kRows + R >= height) return kSlots;
    return x0 <= R || x0 + kColumns + R >= width ? kSides : 0;
  }
  __device__ __forceinline__ static int coordinate(int k, int n) { return k < R ? k - R : n + k - R; }
  __device__ __forceinline__ static int index(int at, int n) { return at < 0 ? at + R : at - n + R; }
  // False for slots of rows and columns of the tile that are not in the image.
  __device__ __forceinline__ bool locate(int slot, int& y, int& x) const {
    if (slot < kSides) {
      y = y0 + slot % kRows, x = coordinate(slot / kRows, width);
      return y < height;
    }
    int const k = (slot - kSides) / kWide, i = (slot - kSides) % kWide;
    y = coordinate(k, height), x = i < kColumns ? x0 + i : coordinate(i - kColumns, width);
    return i >= kColumns || x < width;
  }
  __device__ __forceinline__ int slot(int y, int x) const {
    bool const outside_x = x < 0 || x >= width;
    if (y >= 0 && y < height) return index(x, width) * kRows + y - y0;
    return kSides + index(y, height) * kWide + (outside_x ? kColumns + index(x, width) : x - x0);
  }
};

// Adds what pixel q receives from pixel p; see bilateral.h. Values are scaled to unit falloff in color: b and the
// products with a have one factor of the scale, the derivative of the distance has the other one. With L1 `grad` lacks
// the number that is added to `excess`, the same for all channels: a sign is twice a number that is 0, 1/2 or 1,
// less 1.
template <int C, bool L1>
__device__ __forceinline__ void accumulate_gradient(float space, float const (&p)[C], float const (&p_ab)[C + 1],
                                                    float const (&q)[C], float const (&q_ab)[C + 1], bool is_own,
                                                    float (&grad)[C], float& excess) {
  float difference[C], distance;
#pragma unroll
  for (int c = 0; c < C; ++c) {
    difference[c] = q[c] - p[c];
    float const along = L1 ? fabsf(difference[c]) : difference[c] * difference[c];
    distance = c == 0 ? along : distance + along;
  }
  float const weight = fast_exp2(L1 ? space - distance * distance : space - distance);
  float weight_grad = -p_ab[C];
  if (is_own) weight_grad -= q_ab[C];
#pragma unroll
  for (int c = 0; c < C; ++c) {
    weight_grad += p_ab[c] * q[c];
    if (is_own) weight_grad += q_ab[c] * p[c];
  }
  weight_grad *= weight * (L1 ? -2.77258872223978123767f : -1.38629436111989061883f);  // -2 log 2; L1: twice that
  if (L1) weight_grad *= distance, excess += weight_grad;
#pragma unroll
  for (int c = 0; c < C; ++c) {
    grad[c] += weight * p_ab[c];
    if constexpr (!L1) {
      grad[c] += weight_grad * difference[c];
    } else {
      grad[c] += weight_grad * __saturatef(fmaf(difference[c], 1e38f, 0.5f));
    }
  }
}

// Three phases: load the tile's pixels and twice the window's radius around them; compute a and b of the tile and the
// window's radius around it; compute the gradients. `Kept`: the results of the forward pass give a and b, for which
// pixels are needed in the window's radius only.
template <class T, int C, bool L1, int R, bool Kept>
__global__ void __launch_bounds__(kThreads, 3) bilateral_backward_tile(BilateralBackward<T> p, Tiles<kRun> tiles) {
  extern __shared__ float memory[];
  int const ry = R > 0 ? R : p.ky / 2, rx = R > 0 ? R : p.kx / 2;
  int const height = int(p.x.height), width = int(p.x.width);
  int64_t b;
  int y0, x0;
  tiles.locate(b, y0, x0);
  int const reach_y = Kept ? ry : 2 * ry, reach_x = Kept ? rx : 2 * rx;
  SharedPlanes const s{memory, y0 - reach_y, x0 - reach_x, rows_of(kRun) + 2 * reach_y, kColumns + 2 * reach_x};
  SharedPlanes const ab{memory + C * s.size(), y0 - ry, x0 - rx, rows_of(kRun) + 2 * ry, kColumns + 2 * rx};
  Falloff<float> const falloff = p.sigma.at(b);
  float const scale = sqrtf(falloff.color);
  load_planes<C>(s, p.x, b, p.border, reach_x, scale);
  auto const is_in_bounds = [&](int y, int x) {
    return p.border == Border::circular || (y >= 0 && y < height && x >= 0 && x < width);
  };
  if constexpr (Kept) {
#pragma unroll 2
    for (int task = threadIdx.x; task < ab.size(); task += kThreads) {
      int const row = unsigned(task) / unsigned(ab.columns), y = ab.y + row, x = ab.x + task - row * ab.columns;
      float a[C] = {}, product = 0;
      if (is_in_bounds(y, x)) {
        bool const repeats = p.border == Border::circular;
        int const from_y = repeats ? pixel_at(p.border, y, height) : y;
        int const from_x = repeats ? pixel_at(p.border, x, width) : x;
        T const* const grad = p.grad.row(b, 0, from_y) + from_x * p.grad.step;
        T const* const mean = p.y.row(b, 0, from_y) + from_x * p.y.step;
        float const inverse = __fdividef(1.f, read(p.totals.row(b, 0, from_y)[from_x * p.totals.step]));
#pragma unroll
        for (int c = 0; c < C; ++c) {
          a[c] = read(grad[c * p.grad.channel_stride]) * inverse;
          product += a[c] * (read(mean[c * p.y.channel_stride]) * scale);
        }
      }
#pragma unroll
      for (int c = 0; c < C; ++c) ab.data[c * ab.size() + task] = a[c];
      ab.data[C * ab.size() + task] = product;
    }
  }
  __syncthreads();

  int const runs = (ab.rows + kRun - 1) / kRun;
  for (int task = threadIdx.x; !Kept && task < runs * ab.columns; task += kThreads) {
    int const run = unsigned(task) / unsigned(ab.columns), x = ab.x + task - run * ab.columns;
    int const y = ab.y + min(run * kRun, ab.rows - kRun);  // the last run overlaps the previous one
    float sum[kRun][C], total[kRun];
    sum_run<C, L1, R>(s, ry, rx, falloff, y, x, sum, total);
#pragma unroll
    for (int i = 0; i < kRun; ++i) {
      bool const in_bounds = is_in_bounds(y + i, x);
      float const inverse = __fdividef(1.f, total[i]);
      float* const to = ab.data + (y + i - ab.y) * ab.columns + x - ab.x;
      T const* const grad =
          p.grad.row(b, 0, pixel_at(p.border, y + i, height)) + pixel_at(p.border, x, width) * p.grad.step;
      float product = 0;
#pragma unroll
      for (int c = 0; c < C; ++c) {
        float const a = in_bounds ? read(grad[c * p.grad.channel_stride]) * inverse : 0.f;
        to[c * ab.size()] = a;
        product += a * (sum[i][c] * inverse);
      }
      to[C * ab.size()] = in_bounds ? product : 0.f;
    }
  }
  if constexpr (!Kept) __syncthreads();

  auto const load = [&](int row, int column, float(&pixel)[C], float(&pixel_ab)[C + 1]) {
#pragma unroll
    for (int c = 0; c < C; ++c) {
      pixel[c] = s.at(row, column)[c * s.size()];
      pixel_ab[c] = ab.at(row, column)[c * ab.size()];
    }
    pixel_ab[C] = ab.at(row, column)[C * ab.size()];
  };
  // Adds what a position out of bounds, whose border pixel is `center`, receives.
  auto const receive_out_of_bounds = [&](int at_y, int at_x, float const(&center)[C], float(&grad)[C], float& excess) {
    Window const window(p, at_y, at_x, false);
    for (int row = window.top; row <= window.bottom; ++row)
      for (int column = window.left; column <= window.right; ++column) {
        float pixel[C], pixel_ab[C + 1];
        load(row, column, pixel, pixel_ab);
        int const dy = row - at_y, dx = column - at_x;
        float const space = falloff.space_y * float(dy * dy) + falloff.space_x * float(dx * dx);
        float const none[C + 1] = {};  // a position out of bounds has no gradients
        accumulate_gradient<C, L1>(space, pixel, pixel_ab, center, none, false, grad, excess);
      }
  };
  // In windows known at compile time a thread for each position out of bounds computes what its border pixel adds,
  // which is read after the barrier behind the sums of the tile.
  Frame<(R > 0 ? R : 1)> const frame{y0, x0, height, width};
  float* const received_from_border = ab.data + (C + 1) * ab.size();
  bool const has_frame = R > 0 && p.border != Border::circular && p.border != Border::constant && frame.count() > 0;
  if constexpr (R > 0) {
    if (has_frame) {
      for (int task = threadIdx.x; task < frame.count(); task += kThreads) {
        int at_y, at_x;
        if (!frame.locate(task, at_y, at_x)) continue;
        int const from_y = border_index(p.border, at_y, height), from_x = border_index(p.border, at_x, width);
        if (!frame.contains(from_y, from_x)) continue;
        float center[C], received[C] = {}, excess = 0;
#pragma unroll
        for (int c = 0; c < C; ++c) center[c] = s.at(from_y, from_x)[c * s.size()];
        receive_out_of_bounds(at_y, at_x, center, received, excess);
#pragma unroll
        for (int c = 0; c < C; ++c) received_from_border[C * task + c] = received[c] - 0.5f * excess;
      }
    }
  }

  int const x = x0 + threadIdx.x % kColumns, y = y0 + threadIdx.x / kColumns * kRun;
  bool const is_in_image = x < width && y < height;
  float center[kRun][C], center_ab[kRun][C + 1], grad[kRun][C], excess[kRun] = {};
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
#pragma unroll
    for (int c = 0; c < C; ++c) {
      center[i][c] = s.at(y + i, x)[c * s.size()];
      center_ab[i][c] = ab.at(y + i, x)[c * ab.size()];
      grad[i][c] = 0;
    }
    center_ab[i][C] = ab.at(y + i, x)[C * ab.size()];
  }
  auto const column = [&](int dx, [[maybe_unused]] auto is_center) {
    auto const pixel_row = [&](int row) {
      float pixel[C], pixel_ab[C + 1];
      load(y + row, x + dx, pixel, pixel_ab);
#pragma unroll
      for (int i = 0; i < kRun; ++i) {
        int const dy = row - i;
        if (dy < -ry || dy > ry) continue;
        if (is_center && dy == 0) {  // the pixel itself, of weight 1
#pragma unroll
          for (int c = 0; c < C; ++c) grad[i][c] += pixel_ab[c];
          continue;
        }
        float const space = falloff.space_y * float(dy * dy) + falloff.space_x * float(dx * dx);
        accumulate_gradient<C, L1>(space, pixel, pixel_ab, center[i], center_ab[i], true, grad[i], excess[i]);
      }
    };
    if constexpr (R > 0) {
#pragma unroll
      for (int row = -R; row < kRun + R; ++row) pixel_row(row);
    } else {
      for (int row = -ry; row < kRun + ry; ++row) pixel_row(row);
    }
  };
  if (R == 0 && !is_in_image) return;
  if constexpr (R > 0) {
    if (is_in_image) {
      column(0, std::true_type{});
#pragma unroll 1
      for (int dx = 1; dx <= R; ++dx) {
#pragma unroll 1
        for (int side = -1; side <= 1; side += 2) column(side * dx, std::false_type{});
      }
    }
    if (has_frame) __syncthreads();
    if (!is_in_image) return;
  } else {
    for (int dx = -rx; dx <= rx; ++dx) column(dx, std::false_type{});
  }
#pragma unroll
  for (int i = 0; i < kRun; ++i) {
    if (y + i >= height) return;
    if constexpr (R > 0) {
      if (has_frame)
        for_each_reader(p.border, y + i, height, R, R, [&](int at_y) {
          for_each_reader(p.border, x, width, R, R, [&](int at_x) {
            if (at_y == y + i && at_x == x) return;
            float const* const from = received_from_border + C * frame.slot(at_y, at_x);
#pragma unroll
            for (int c = 0; c < C; ++c) grad[i][c] += from[c];
          });
        });
    } else {
      for_each_reader_once(p, y + i, x, [&](int at_y, int at_x) {
        if (at_y != y + i || at_x != x) receive_out_of_bounds(at_y, at_x, center[i], grad[i], excess[i]);
      });
    }
    T* const out = p.grad_x.row(b, 0, y + i) + x * p.grad_x.step;
#pragma unroll
    for (int c = 0; c < C; ++c) out[c * p.grad_x.channel_stride] = round_to<T>(grad[i][c] - 0.5f * excess[i]);
  }
}

// --- plain kernels ---------------------------------------------------------------------------------------------------

constexpr int kSide = 16;  // a block computes a square of pixels

// One thread for each pixel. Shared memory holds 1 / n and b of the square and the window's radius around it.
template <class T, bool Joint>
__global__ void __launch_bounds__(kThreads)
    bilateral_backward_any(BilateralBackward<T> p, unsigned across, unsigned down) {
  using F = Compute<T>;
  extern __shared__ char bytes[];
  auto const& guide = guide_of<Joint>(p);
  int const ry = p.ky / 2, rx = p.kx / 2, height = int(p.x.height), width = int(p.x.width);
  int const rows = kSide + 2 * ry, columns = kSide + 2 * rx;
  unsigned const tile_row = blockIdx.x / across;
  int64_t const b = tile_row / down;
  int const y0 = int(tile_row % down) * kSide - ry, x0 = int(blockIdx.x % across) * kSide - rx;
  F* const inverses = reinterpret_cast<F*>(bytes);
  F* const products = inverses + rows * columns;
  Falloff<F> const falloff = p.sigma.at(b);
  auto const grad_at = [&](int y, int x) {  // null where it is 0
    bool const in_bounds = p.border == Border::circular || (y >= 0 && y < height && x >= 0 && x < width);
    return in_bounds ? pixel(p.grad, b, p.border, y, x) : nullptr;
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
  bool const needs_guide = !Joint || p.needs_guide;
  for (int c = 0; c < max(p.x.channels, guide.channels); c += kChunk) {
    F image_grads[kChunk] = {}, guide_grads[kChunk] = {};
    for_each_reader_once(p, y, x, [&](int at_y, int at_x) {
      bool const is_own = at_y == y && at_x == x;
      Window const window(p, at_y, at_x, is_own);
      for (int row = window.top; row <= window.bottom; ++row)
        for (int column = window.left; column <= window.right; ++column) {
          int const dy = row - at_y, dx = column - at_x, neighbor = (row - y0) * columns + column - x0;
          auto const* const from = pixel(p.x, b, p.border, row, column);
          auto const* const from_guide = pixel(guide, b, p.border, row, column);
          T const* const from_grad = grad_at(row, column);
          F const d = distance(guide, p.l1, q_guide, from_guide);
          F const space = falloff.space_y * F(dy * dy) + falloff.space_x * F(dx * dx);
          F const weight = fast_exp2(space - (p.l1 ? d * d : d) * falloff.color);
          F weight_grad = 0;
          if (needs_guide) {
            weight_grad = -products[neighbor] - (is_own ? products[here] : F(0));
            for (int k = 0; k < p.x.channels; ++k) {
              weight_grad += value(p.grad, from_grad, k) * inverses[neighbor] * value(p.x, q, k);
              if (is_own) weight_grad += value(p.grad, q_grad, k) * inverses[here] * value(p.x, from, k);
            }
            weight_grad *= weight * rate * (p.l1 ? d : F(1));
          }
          for (int k = 0; k < kChunk; ++k) {
            if (c + k < p.x.channels) image_grads[k] += weight * value(p.grad, from_grad, c + k) * inverses[neighbor];
            if (c + k < guide.channels) {
              F const difference = value(guide, q_guide, c + k) - value(guide, from_guide, c + k);
              guide_grads[k] += !p.l1            ? weight_grad * difference
                                : difference > 0 ? weight_grad
                                : difference < 0 ? -weight_grad
                                                 : F(0);
            }
          }
        }
    });
    for (int k = 0; k < kChunk; ++k) {
      F const value = Joint ? image_grads[k] : image_grads[k] + guide_grads[k];
      if (c + k < p.grad_x.channels) p.grad_x.row(b, c + k, y)[x * p.grad_x.step] = round_to<T>(value);
      if (c + k < p.grad_guide.channels)
        p.grad_guide.row(b, c + k, y)[x * p.grad_guide.step] = round_to<T>(guide_grads[k]);
    }
  }
}

// False where the tile does not fit into shared memory.
template <int C, bool L1, int R, bool Kept, class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  auto const kernel = bilateral_backward_tile<T, C, L1, R, Kept>;
  int64_t const ry = p.ky / 2, rx = p.kx / 2, reach_y = Kept ? ry : 2 * ry, reach_x = Kept ? rx : 2 * rx;
  int64_t const bytes = sizeof(float) * (C * (rows_of(kRun) + 2 * reach_y) * (kColumns + 2 * reach_x) +
                                         (C + 1) * (rows_of(kRun) + 2 * ry) * (kColumns + 2 * rx) +
                                         (R > 0 ? C * Frame<(R > 0 ? R : 1)>::kSlots : 0));
  if (!fits(kernel, bytes)) return false;
  Tiles<kRun> const tiles(p.x.batch, p.x.height, p.x.width);
  kernel<<<tiles.count, kThreads, bytes, stream>>>(p, tiles);
  return true;
}
template <int C, bool L1, int R, class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  if constexpr (sizeof(T) == 4)
    if (p.totals.data) return launch_tile<C, L1, R, true>(p, stream);
  return launch_tile<C, L1, R, false>(p, stream);
}
template <int C, bool L1, class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  // Special case, H200: 1.51 (bilateral5 backward) to 2.2 (bilateral5gray backward) times as fast as any window in
  // tiles.
  return p.ky == 5 && p.kx == 5 ? launch_tile<C, L1, 2>(p, stream) : launch_tile<C, L1, 0>(p, stream);
}
template <class T>
bool launch_tile(BilateralBackward<T> const& p, CUstream_st* stream) {
  // Special case, H200: 13 (bilateral7 backward) to 25 (bilateral5gray backward) times as fast as any channels.
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

}  // namespace kv::filters::cuda
