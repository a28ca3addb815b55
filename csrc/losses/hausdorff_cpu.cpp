// Hausdorff loss on the CPU: planes [begin, end), each in a few copies padded with zeros. Compiled once per instruction
// set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "hausdorff.h"

namespace kv::losses::KV_ISA {
namespace {

// Copies of a plane, padded with zeros.
template <class F>
struct Padded {
  Extent const extent;
  int64_t const pitch, slab, size;
  Scratch<F> memory;

  KV_HD Padded(Extent const& e, int64_t count)
      : extent(e),
        pitch(e.width + 2),
        slab(pitch * (e.height + 2)),
        size(slab * (e.depth > 0 ? e.depth + 2 : 1)),
        memory(size * count) {
    for (int64_t i = 0; i < size * count; ++i) memory.data[i] = 0;
  }
  KV_HD F* plane(int64_t i) const { return memory.data + i * size; }

  // Calls f(first element of a row in a copy, first element in the plane).
  template <class Call>
  KV_HD void for_each_row(Call f) const {
    int64_t const rows = extent.size() / extent.width;
    for (int64_t row = 0; row < rows; ++row) {
      int64_t const z = row / extent.height, y = row % extent.height;
      f((extent.depth > 0 ? z + 1 : 0) * slab + (y + 1) * pitch + 1, row * extent.width);
    }
  }
  // Calls f(width, element of a copy, element of the plane) for vectors, which do not overlap.
  template <class Call>
  KV_HD void for_each(Call f) const {
    constexpr int N = kLanes<F>;
    for_each_row([&](int64_t at, int64_t i) {
      int64_t x = 0;
      for (; x + N <= extent.width; x += N) f(Width<N>{}, at + x, i + x);
      for (; x < extent.width; ++x) f(Width<1>{}, at + x, i + x);
    });
  }
  // The mean of an element and its direct neighbors.
  template <int N>
  KV_HD Lanes<F, N> mean(F const* at) const {
    using V = Lanes<F, N>;
    V sum = load<N>(at) + load<N>(at - 1) + load<N>(at + 1) + load<N>(at - pitch) + load<N>(at + pitch);
    if (extent.depth > 0) sum += load<N>(at - slab) + load<N>(at + slab);
    return sum / F(extent.taps());
  }
};

// Sums in vectors, and of the remaining elements.
template <class F>
struct Sum {
  static constexpr int N = kLanes<F>;
  Lanes<F, N> lanes{};
  F single = 0;

  template <int M>
  KV_HD void add(Lanes<F, M> x) {
    if constexpr (M == 1)
      single += x;
    else
      lanes += x;
  }
  KV_HD F total() const {
    double sum = single;
    for (int i = 0; i < N; ++i) sum += lanes[i];
    return F(sum);
  }
};

template <class F>
KV_HD void load_differences(Padded<F> const& r, Differences<F> const& d, int64_t plane, F* to) {
  r.for_each_row([&](int64_t at, int64_t i) {
    for (int64_t x = 0; x < r.extent.width; ++x) {
      F const difference = d.at(plane, i + x);
      to[at + x] = difference * difference;
    }
  });
}

// One erosion, b_(i-1) to b_i.
template <class F>
KV_HD ValueRange<F> erode(Padded<F> const& r, F const* from, F* to) {
  constexpr int N = kLanes<F>;
  F const infinite = F(__builtin_inf());
  Lanes<F, N> low = broadcast<N>(infinite), high = -low, nan_or_zero{};
  ValueRange<F> span{infinite, -infinite};
  F nan = 0;
  r.for_each([&](auto width, int64_t at, int64_t) {
    constexpr int M = decltype(width)::value;
    using V = Lanes<F, M>;
    V const zero{}, eroded = r.template mean<M>(from + at) - F(0.5), c = eroded < zero ? zero : eroded;
    store<M>(to + at, c);
    if constexpr (M == 1)
      span.low = min(span.low, c), span.high = max(span.high, c), nan = c == c ? nan : c;
    else
      low = min(low, c), high = max(high, c), nan_or_zero = c == c ? nan_or_zero : c;
  });
  for (int i = 0; i < N; ++i) {
    if (r.extent.width >= N) span = {min(span.low, low[i]), max(span.high, high[i])};
    nan = nan_or_zero[i] == nan_or_zero[i] ? nan : nan_or_zero[i];
  }
  if (nan != nan) span = {nan, nan};
  F const first = span.from(), range = span.width();
  r.for_each([&](auto width, int64_t at, int64_t) {
    constexpr int M = decltype(width)::value;
    store<M>(to + at, Lanes<F, M>((load<M>(to + at) - first) / range));
  });
  return span;
}

KV_HD double weight_of(int64_t i, double alpha) { return __builtin_pow(double(i), alpha); }

}  // namespace

template <class F>
void hausdorff(Hausdorff<F> const& p, int64_t begin, int64_t end) {
  Padded<F> const r(p.differences.extent, 2);
  for (int64_t plane = begin; plane < end; ++plane) {
    F* const map = p.map ? p.map + plane * r.extent.size() : nullptr;
    double loss = 0;
    load_differences(r, p.differences, plane, r.plane(0));
    for (int64_t i = 1; i <= p.k; ++i) {
      F const* const b = r.plane(i % 2);
      F const weight = F(weight_of(i, p.alpha));
      erode(r, r.plane((i - 1) % 2), r.plane(i % 2));
      Sum<F> sum;
      r.for_each([&](auto width, int64_t at, int64_t to) {
        constexpr int M = decltype(width)::value;
        using V = Lanes<F, M>;
        V const x = load<M>(b + at) * weight;
        if (map)
          store<M>(map + to, V(i > 1 ? V(load<M>(map + to) + x) : x));
        else
          sum.template add<M>(x);
      });
      loss += sum.total();
    }
    if (!map) p.sums[plane] = F(loss);
  }
}

template <class F>
void hausdorff_backward(HausdorffBackward<F> const& p, int64_t begin, int64_t end) {
  Padded<F> const r(p.differences.extent, p.k + 2);  // b_i, and g in the memory of b_0
  int64_t const size = r.extent.size();
  Scratch<ValueRange<F>> spans(p.k + 1);
  for (int64_t plane = begin; plane < end; ++plane) {
    F *const g = r.plane(0), *const h = r.plane(p.k + 1), *const out = p.grad_pred + plane * size;
    load_differences(r, p.differences, plane, g);
    for (int64_t i = 1; i <= p.k; ++i) spans.data[i] = erode(r, r.plane(i - 1), r.plane(i));
    for (int64_t i = p.k; i >= 0; --i) {
      F const weight = i > 0 ? F(weight_of(i, p.alpha)) : F(0);
      F const *const grad = p.of_sums ? nullptr : p.grad + plane * size, of_sum = p.of_sums ? p.grad[plane] : F(0);
      F const* const b = r.plane(i);
      Sum<F> sum, product, lowest, highest;
      r.for_each([&](auto width, int64_t at, int64_t e) {
        constexpr int M = decltype(width)::value;
        using V = Lanes<F, M>;
        V const zero{}, one = zero + F(1), own = (grad ? load<M>(grad + e) : zero + of_sum) * weight;
        V const derivative = i < p.k ? V(own + r.template mean<M>(h + at)) : own;
        if (i == 0) {
          store<M>(out + e, derivative);
          return;
        }
        V const x = load<M>(b + at);
        store<M>(g + at, derivative);
        sum.template add<M>(derivative), product.template add<M>(V(derivative * x));
        lowest.template add<M>(V(x == zero ? one : zero)), highest.template add<M>(V(x == one ? one : zero));
      });
      if (i == 0) break;
      auto const gradients =
          NormalizeVjp<F>::of(spans.data[i], sum.total(), product.total(), lowest.total(), highest.total());
      r.for_each([&](auto width, int64_t at, int64_t) {
        constexpr int M = decltype(width)::value;
        using V = Lanes<F, M>;
        store<M>(h + at, gradients(V(load<M>(g + at)), V(load<M>(b + at))));
      });
    }
    for (int64_t i = 0; i < size; ++i) out[i] *= 2 * p.differences.at(plane, i);
  }
}

KV_INSTANTIATE_COMPUTED(hausdorff, Hausdorff)
KV_INSTANTIATE_COMPUTED(hausdorff_backward, HausdorffBackward)

}  // namespace kv::losses::KV_ISA
