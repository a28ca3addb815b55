// Fits of two views on the CPU: models [begin, end) of all pairs, correspondences in vectors. In double: the AVX-512
// build uses the AVX2 code.
#include "core/lanes.h"
// Included after core/lanes.h, whose vectors it uses.
#include "geometry/solvers/two_view_fits.h"

#if !defined(__AVX512F__)
namespace kv::geometry::KV_ISA {

namespace {

struct Vector {
  static constexpr int kCount = kLanes<double>;
  using V = Lanes<double, kCount>;
  static KV_HD V load(double const* x) { return kv::load<kCount>(x); }
  static KV_HD V root(V x) { return vsqrt(x); }
  static KV_HD V exp2(V x) { return vexp2<double, kCount>(x); }
  static KV_HD double sum(V x) {
    double sum = x[0];
    for (int i = 1; i < kCount; ++i) sum += x[i];
    return sum;
  }
};

}  // namespace

template <class T>
void two_view_fits(TwoViewFits<T> const& p, int64_t begin, int64_t end) {
  two_view::dispatch_kind(p.model, [&](auto kind) KV_INLINE {
    for (int64_t item = begin; item < end; ++item) two_view::fit_from<decltype(kind), Vector>(p, item, SingleThread{});
  });
}

KV_INSTANTIATE_ONE(two_view_fits, TwoViewFits, double)

}  // namespace kv::geometry::KV_ISA
#endif
