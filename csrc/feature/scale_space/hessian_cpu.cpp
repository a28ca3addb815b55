// Responses of blobs on the CPU: derivatives along y into padded rows, one for each channel, then along these rows.
// Rows [begin, end) of all planes in order; compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "feature/scale_space/hessian.h"

namespace kv::feature::KV_ISA {
namespace {

template <class Kernel, class T>
KV_HD void respond(LevelHessian<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int R = Kernel::reach;
  int64_t const width = p.x.width, height = p.x.height, padded = width + 2 * R;
  Scratch<F> scratch(3 * padded);
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / height, y = r % height;
    F const factor = p.factor(plane);
    T const* rows[2 * R + 1];
    for (int i = 0; i <= 2 * R; ++i) rows[i] = p.x.row(plane, clamp(y - R + i, int64_t(0), height - 1));
    filters::for_each_channel<Kernel>([&](auto c) KV_INLINE {
      F* const v = scratch.data + c.value * padded;
      for_each_vector<T>(0, width, [&](auto lanes, int64_t e) KV_INLINE {
        constexpr int N = decltype(lanes)::value;
        auto const sum = c.down().dot([&](int i) KV_INLINE { return load<N>(rows[i] + e); });
        store<N>(v + R + e, sum * c.template scale<F>(true));
      });
      for (int i = 0; i < R; ++i) v[i] = v[R], v[R + width + i] = v[R + width - 1];
    });
    for_each_vector<T>(0, width, [&](auto lanes, int64_t e) KV_INLINE {
      constexpr int N = decltype(lanes)::value;
      Lanes<F, N> d[3];
      filters::for_each_channel<Kernel>([&](auto c) KV_INLINE {
        F const* const v = scratch.data + c.value * padded + e;
        d[c.value] = c.along().dot([&](int i) KV_INLINE { return load<N>(v + i); });
      });
      store<N>(p.y.row(plane, y) + e, scaled_determinant(d, factor));
    });
  }
}

}  // namespace

template <class T>
void level_hessian(LevelHessian<T> const& p, int64_t begin, int64_t end) {
  p.kind == filters::DerivativeKind::sobel2 ? respond<filters::Sobel2>(p, begin, end)
                                            : respond<filters::Diff2>(p, begin, end);
}

KV_INSTANTIATE(level_hessian, LevelHessian)

}  // namespace kv::feature::KV_ISA
