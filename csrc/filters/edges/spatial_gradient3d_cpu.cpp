// Derivatives of a volume on the CPU: rows [begin, end) of all planes in order, from the nine rows around each.
// Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "spatial_gradient3d.h"

namespace kv::filters::KV_ISA {
namespace {

template <int Order, class T>
KV_HD void forward(SpatialGradient3d<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.x.width, height = p.x.height;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const y = r % height, plane = r / height, z = plane % p.depth, volume = plane / p.depth;
    T const* rows[3][3];
    for (int k = 0; k < 3; ++k)
      for (int j = 0; j < 3; ++j)
        rows[k][j] = p.x.row(volume * p.depth + clamp(z - 1 + k, int64_t(0), p.depth - 1),
                             clamp(y - 1 + j, int64_t(0), height - 1));
    auto const pixel = [&](auto lanes, int64_t left, int64_t e, int64_t right) {
      constexpr int N = decltype(lanes)::value;
      auto const at = [&](int k, int j, int i) { return load<N>(rows[k][j] + (i == 0 ? left : i == 1 ? e : right)); };
      for_each_channel3d<Order>([&](auto c) {
        T* const out = p.y.row((volume * 3 * Order + c.index) * p.depth + z, y);
        store<N>(out + e, c.template derivative<F>(at));
      });
    };
    pixel(Width<1>{}, 0, 0, min(int64_t(1), width - 1));
    for_each_vector<T>(1, width - 1, [&](auto lanes, int64_t e) { pixel(lanes, e - 1, e, e + 1); });
    if (width > 1) pixel(Width<1>{}, width - 2, width - 1, width - 1);
  }
}

template <int Order, class T>
KV_HD void backward(SpatialGradient3dBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const width = p.grad_x.width, height = p.grad_x.height;
  Scratch<T> zeros(width);
  for (int64_t e = 0; e < width; ++e) zeros.data[e] = T{};
  for (int64_t r = begin; r < end; ++r) {
    int64_t const y = r % height, plane = r / height, z = plane % p.depth, volume = plane / p.depth;
    T const* rows[3 * Order][3][3];
    for (int c = 0; c < 3 * Order; ++c)
      for (int k = 0; k < 3; ++k)
        for (int j = 0; j < 3; ++j) {
          int64_t const zz = z - 1 + k, yy = y - 1 + j;
          bool const in_bounds = zz >= 0 && zz < p.depth && yy >= 0 && yy < height;
          rows[c][k][j] = in_bounds ? p.grad.row((volume * 3 * Order + c) * p.depth + zz, yy) : zeros.data;
        }
    T* const out = p.grad_x.row(plane, y);
    auto const pixel = [&](auto lanes, int64_t e, bool first_x, bool last_x) {
      constexpr int N = decltype(lanes)::value;
      bool const first[3]{first_x, y == 0, z == 0}, last[3]{last_x, y == height - 1, z == p.depth - 1};
      Lanes<F, N> sum{};
      for_each_channel3d<Order>([&](auto c) {
        auto const at = [&](int k, int j, int i) -> Lanes<F, N> {
          if (N == 1 && (e - 1 + i < 0 || e - 1 + i >= width)) return Lanes<F, N>{};
          return load<N>(rows[c.index][k][j] + e - 1 + i);
        };
        sum += c.template derivative_vjp<F>(at, first, last);
      });
      store<N>(out + e, sum);
    };
    pixel(Width<1>{}, 0, true, width == 1);
    for_each_vector<T>(1, width - 1, [&](auto lanes, int64_t e) { pixel(lanes, e, false, false); });
    if (width > 1) pixel(Width<1>{}, width - 1, false, true);
  }
}

}  // namespace

template <class T>
void spatial_gradient3d(SpatialGradient3d<T> const& p, int64_t begin, int64_t end) {
  p.order == 1 ? forward<1>(p, begin, end) : forward<2>(p, begin, end);
}

template <class T>
void spatial_gradient3d_backward(SpatialGradient3dBackward<T> const& p, int64_t begin, int64_t end) {
  p.order == 1 ? backward<1>(p, begin, end) : backward<2>(p, begin, end);
}

KV_INSTANTIATE(spatial_gradient3d, SpatialGradient3d)
KV_INSTANTIATE(spatial_gradient3d_backward, SpatialGradient3dBackward)

}  // namespace kv::filters::KV_ISA
