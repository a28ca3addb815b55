// Non-maximum suppression and hysteresis of Canny on the CPU. Compiled once per instruction set.
#include "canny.h"
#include "core/stream.h"
#include "neighborhoods_cpu.h"

namespace kv::filters::KV_ISA {

// Streams down the rows. Rings hold the squared magnitudes of three rows, with one more pixel at either end, and the
// gradients of two rows.
template <class T>
void canny_suppress(CannySuppress<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const step = p.x.step, size = p.x.row_size(), height = p.x.height, padded = size + 2 * step;
  Scratch<F> scratch(3 * padded + 4 * size);
  auto const squared = [&](int64_t y) { return scratch.data + (y + 3) % 3 * padded + step; };
  auto const gradient = [&](int64_t y, int which) {
    return scratch.data + 3 * padded + ((y + 2) % 2 * 2 + which) * size;
  };
  F const eps = p.eps;
  Neighborhoods<kSobelBorder, T> const x(p.x);

  auto const fill = [&](int64_t plane, int64_t y) {  // row y, which may be one row out of bounds
    F* const q = squared(y);
    if (y < 0 || y >= height) {
      for (int64_t e = -step; e < size + step; ++e) q[e] = eps;
      return;
    }
    for (int64_t e = 0; e < step; ++e) q[e - step] = q[size + e] = eps;
    x.for_each(plane, y, [&](auto width, int64_t e, auto left, auto middle, auto right) KV_INLINE {
      constexpr int N = decltype(width)::value;
      auto const column = [](auto const& c) { return sobel_column(c.above, c.middle, c.below); };
      Lanes<F, N> gx, gy;
      sobel_gradients(column(left), column(middle), column(right), F(1), gx, gy);
      store<N>(gradient(y, 0) + e, gx);
      store<N>(gradient(y, 1) + e, gy);
      store<N>(q + e, gx * gx + gy * gy + eps);
    });
  };

  stream_rows(begin, end, height, fill, [&](int64_t plane, int64_t y, int64_t) {
    F const *const a = squared(y - 1), *const b = squared(y), *const c = squared(y + 1);
    T* const magnitudes = p.magnitude.row(plane, y);
    T* const edges = p.edges.row(plane, y);
    for_each_vector<T>(0, size, [&](auto width, int64_t e) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      V const q = load<N>(b + e), gx = load<N>(gradient(y, 0) + e), gy = load<N>(gradient(y, 1) + e);
      auto const ridge =
          is_ridge(gx, gy, load<N>(a + e - step), load<N>(a + e), load<N>(a + e + step), load<N>(b + e - step), q,
                   load<N>(b + e + step), load<N>(c + e - step), load<N>(c + e), load<N>(c + e + step), eps);
      V const magnitude = ridge ? V(vsqrt(q)) : V{};
      V const half = broadcast<N>(F(0.5));
      store<N>(magnitudes + e, magnitude);
      store<N>(edges + e, V((magnitude > p.low ? half : V{}) + (magnitude > p.high ? half : V{})));
    });
  });
}

// Planes [begin, end): a flood fill from the strong pixels that visits each weak pixel once. It runs on one byte for
// each pixel, twice the edge: 0, 1 weak, 2 strong or kept. A border of zeros makes all neighbors readable, and words of
// eight bytes are searched for strong pixels.
template <class T>
constexpr int kBytesAtOnce = __is_same(Compute<T>, float) ? kLanes<T> : 1;  // bytes are loaded as floats
template <class T>
void canny_hysteresis(CannyHysteresis<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const height = p.edges.height, width = p.edges.width, stride = width + 8;
  Scratch<uint8_t> bytes((height + 2) * stride + 8);
  Scratch<uint8_t*> stack(height * width);  // kept pixels whose neighbors are not visited yet
  uint8_t* const pixels = bytes.data + stride + 1;
  for (int64_t i = 0; i < (height + 2) * stride + 8; ++i) bytes.data[i] = 0;

  int64_t top = 0;
  auto const keep_neighbors = [&](uint8_t* pixel) {
    for (uint8_t* at = pixel - stride - 1; at <= pixel + stride; at += stride) {
      uint32_t three;
      __builtin_memcpy(&three, at, 4);
      if ((three & 0x010101) == 0) continue;
      for (int i = 0; i < 3; ++i)
        if (at[i] == 1) {
          at[i] = 2;
          stack.data[top++] = at + i;
        }
    }
  };
  for (int64_t plane = begin; plane < end; ++plane) {
    for (int64_t y = 0; y < height; ++y) {
      T const* const row = p.edges.row(plane, y);
      uint8_t* const to = pixels + y * stride;
      for_each_vector<T, kBytesAtOnce<T>>(0, width, [&](auto vector, int64_t x) {
        constexpr int N = decltype(vector)::value;
        store<N>(to + x, load<N>(row + x) * F(2));
      });
    }
    for (int64_t y = 0; y < height; ++y)
      for (int64_t x = 0; x < width; x += 8) {
        uint8_t* const eight = pixels + y * stride + x;
        uint64_t strong;
        __builtin_memcpy(&strong, eight, 8);
        for (strong &= 0x0202020202020202; strong; strong &= strong - 1) {
          keep_neighbors(eight + __builtin_ctzll(strong) / 8);
          while (top > 0) keep_neighbors(stack.data[--top]);
        }
      }
    for (int64_t y = 0; y < height; ++y) {
      T* const row = p.result.row(plane, y);
      uint8_t const* const from = pixels + y * stride;
      for_each_vector<T, kBytesAtOnce<T>>(0, width, [&](auto vector, int64_t x) {
        constexpr int N = decltype(vector)::value;
        store<N>(row + x, load<N>(from + x) > 1 ? broadcast<N>(F(1)) : Lanes<F, N>{});
      });
    }
  }
}

KV_INSTANTIATE(canny_suppress, CannySuppress)
KV_INSTANTIATE(canny_hysteresis, CannyHysteresis)

}  // namespace kv::filters::KV_ISA
