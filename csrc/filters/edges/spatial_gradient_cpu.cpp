// Derivatives of an image on the CPU: first along y into padded rows, one for each channel, then along these rows. Rows
// [begin, end) of all planes in order; compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "spatial_gradient.h"

namespace kv::filters::KV_ISA {
namespace {

template <class Kernel, class T>
KV_HD void forward(SpatialGradient<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int R = Kernel::reach, channels = Kernel::order + 1;
  int64_t const width = p.x.width, height = p.x.height, padded = width + 2 * R;
  Scratch<F> scratch(channels * padded);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    T const* rows[2 * R + 1];
    for (int i = 0; i <= 2 * R; ++i) rows[i] = p.x.row(plane, clamp(y - R + i, int64_t(0), height - 1));

    for_each_vector<T>(0, width, [&](auto lanes, int64_t e) {
      constexpr int N = decltype(lanes)::value;
      for_each_channel<Kernel>([&](auto c) {
        auto const v = c.down().dot([&](int i) { return load<N>(rows[i] + e); });
        store<N>(scratch.data + c.value * padded + R + e, v * c.template scale<F>(p.normalized));
      });
    });
    for_each_channel<Kernel>([&](auto c) {
      F* const v = scratch.data + c.value * padded;
      for (int i = 0; i < R; ++i) {
        v[i] = v[R];
        v[R + width + i] = v[R + width - 1];
      }
      auto* const out = p.y.row(plane * channels + c.value, y);
      for_each_vector<T>(0, width, [&](auto lanes, int64_t e) {
        constexpr int N = decltype(lanes)::value;
        store<N>(out + e, c.along().dot([&](int i) { return load<N>(v + e + i); }));
      });
    });
  }
}

// The transpose, in the same order: along y into rows padded with zeros, then along these rows.
template <class Kernel, class T>
KV_HD void backward(SpatialGradientBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int R = Kernel::reach, channels = Kernel::order + 1;
  int64_t const width = p.grad_x.width, height = p.grad_x.height, padded = width + 2 * R;
  Scratch<F> scratch(channels * padded);
  Scratch<T> zeros(width);
  for (int64_t e = 0; e < channels * padded; ++e) scratch.data[e] = 0;
  for (int64_t e = 0; e < width; ++e) zeros.data[e] = T{};
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    bool const first = y == 0, last = y == height - 1;
    for_each_channel<Kernel>([&](auto c) {
      F* const v = scratch.data + c.value * padded + R;
      T const* rows[2 * R + 1];
      for (int i = 0; i <= 2 * R; ++i) {
        int64_t const at = y - R + i;
        rows[i] = at >= 0 && at < height ? p.grad.row(plane * channels + c.value, at) : zeros.data;
      }
      for_each_vector<T>(0, width, [&](auto lanes, int64_t e) {
        constexpr int N = decltype(lanes)::value;
        auto const u = c.down().dot_vjp([&](int i) { return load<N>(rows[i] + e); }, first, last);
        store<N>(v + e, u * c.template scale<F>(p.normalized));
      });
    });
    auto const pixel = [&](auto lanes, int64_t e, bool first, bool last) {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> sum{};
      for_each_channel<Kernel>([&](auto c) {
        F const* const v = scratch.data + c.value * padded + e;
        sum += c.along().dot_vjp([&](int i) { return load<N>(v + i); }, first, last);
      });
      store<N>(p.grad_x.row(plane, y) + e, sum);
    };
    pixel(Width<1>{}, 0, true, width == 1);
    for_each_vector<T>(1, width - 1, [&](auto lanes, int64_t e) { pixel(lanes, e, false, false); });
    if (width > 1) pixel(Width<1>{}, width - 1, false, true);
  }
}

}  // namespace

template <class T>
void spatial_gradient(SpatialGradient<T> const& p, int64_t begin, int64_t end) {
  dispatch_kernel(p.kind, [&](auto kernel) { forward<decltype(kernel)>(p, begin, end); });
}

template <class T>
void spatial_gradient_backward(SpatialGradientBackward<T> const& p, int64_t begin, int64_t end) {
  dispatch_kernel(p.kind, [&](auto kernel) { backward<decltype(kernel)>(p, begin, end); });
}

KV_INSTANTIATE_WITH_BYTES(spatial_gradient, SpatialGradient)
KV_INSTANTIATE(spatial_gradient_backward, SpatialGradientBackward)

}  // namespace kv::filters::KV_ISA
