// A step of the approximate distance transform on the CPU, rows [begin, end). Compiled once per instruction set.
#include "core/lanes.h"
#include "distance_step.h"

namespace kv::contrib::KV_ISA {
namespace {

template <class T>
struct Row {
  DistanceStep<T> const& p;
  T const* plane;
  int64_t z, y;

  // The weighted sums of the windows around N pixels of the row; `inside`: all of them have `radius` pixels on both
  // sides.
  template <int N, bool inside>
  KV_HD Lanes<T, N> near(int64_t x) const {
    Lanes<T, N> sum{};
    T const* weight = p.kernel;
    for (int64_t dz = -p.radius_z; dz <= p.radius_z; ++dz)
      for (int64_t dy = -p.radius; dy <= p.radius; ++dy) {
        int64_t const at_z = clamp(z + dz, int64_t(0), p.depth - 1), at_y = clamp(y + dy, int64_t(0), p.height - 1);
        T const* const row = plane + (at_z * p.height + at_y) * p.width;
        for (int64_t dx = -p.radius; dx <= p.radius; ++dx, ++weight)
          if constexpr (inside)
            sum += *weight * load<N>(row + x + dx);
          else
            sum += *weight * row[clamp(x + dx, int64_t(0), p.width - 1)];
      }
    return sum;
  }
};

}  // namespace

template <class T>
void distance_step(DistanceStep<T> const& p, int64_t begin, int64_t end) {
  constexpr T kLog2 = T(0.693147180559945309417);
  for (int64_t i = begin; i < end; ++i) {
    int64_t const in_plane = i % (p.depth * p.height);
    Row<T> const row{p, p.grown + i / (p.depth * p.height) * p.pixels(), in_plane / p.height, in_plane % p.height};
    auto const finish = [&](auto width, int64_t x, auto near) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<T, N>;
      int64_t const at = i * p.width + x;
      auto const reached = is_reached(near);
      V const half = broadcast<N>(T(0.5)), one = broadcast<N>(T(1)), none = broadcast<N>(T(0));
      V const within = p.scale * kLog2 * vlog2<T, N>(reached ? near : half);
      store<N>(p.next + at, V(reached ? one : load<N>(p.grown + at)));
      store<N>(p.next_total + at, V(load<N>(p.total + at) + (reached ? V(p.distance + within) : none)));
    };
    int64_t const left = min(int64_t(p.radius), p.width), right = max(left, p.width - p.radius);
    for (int64_t x = 0; x < left; ++x) finish(Width<1>{}, x, row.template near<1, false>(x));
    for_each_vector<T>(left, right, [&](auto width, int64_t x) {
      finish(width, x, row.template near<decltype(width)::value, true>(x));
    });
    for (int64_t x = right; x < p.width; ++x) finish(Width<1>{}, x, row.template near<1, false>(x));
  }
}

KV_INSTANTIATE_COMPUTED(distance_step, DistanceStep)

}  // namespace kv::contrib::KV_ISA
