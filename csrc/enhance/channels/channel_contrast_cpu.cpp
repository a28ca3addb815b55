// Contrast of channels on the CPU: planes [begin, end). Compiled once per instruction set.
#include "channel_contrast.h"
#include "flat_plane_cpu.h"

namespace kv::enhance::KV_ISA {
namespace {

// The sum of n numbers that value(index constant N, element) gives: in vectors of some hundred, these in double.
template <class T, class Value>
KV_HD double sum_of_row(int64_t n, int64_t step, Value value) {
  constexpr int N = kLanes<T>;
  double sum = 0;
  Lanes<Compute<T>, N> some{};
  int pending = 0;
  auto const add_up = [&]() KV_INLINE {
    if constexpr (N > 1)
      for (int i = 0; i < N; ++i) sum += some[i];
    some = Lanes<Compute<T>, N>{};
    pending = 0;
  };
  for_each_pixel<T>(n, step, [&](auto width, int64_t i) KV_INLINE {
    constexpr int M = decltype(width)::value;
    if constexpr (M == N && N > 1) {
      some = some + value(width, i);
      if (++pending == 64) add_up();
    } else {
      sum += value(width, i);
    }
  });
  add_up();
  return sum;
}

template <class T>
KV_HD Compute<T> mean_of_row(T const* x, int64_t n, int64_t step) {
  auto const load_at = [&](auto width, int64_t i) KV_INLINE { return load<decltype(width)::value>(x + i); };
  return Compute<T>(sum_of_row<T>(n, step, load_at) / double(n));
}

}  // namespace

template <class T>
void channel_contrast(ChannelContrast<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const n = p.x.width, step = p.x.step;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const* const x = p.x.plane(plane);
    T* const y = p.y.plane(plane);
    F const mean = mean_of_row(x, n, step);
    for_each_pixel<T>(n, step, [&](auto width, int64_t i) KV_INLINE {
      constexpr int M = decltype(width)::value;
      store<M>(y + i, p.mapped(Lanes<F, M>(load<M>(x + i)), mean));
    });
  }
}

template <class T>
void channel_contrast_list(ChannelContrastList<T> const& p, int64_t begin, int64_t end) {
  channel_items(p, begin, end, [](ChannelContrast<T> const& one, int64_t first, int64_t last) {
    KV_ISA::channel_contrast(flat_sample(one), first, last);
  });
}

template <class T>
void channel_contrast_backward(ChannelContrastBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const n = p.x.width, step = p.x.step;
  for (int64_t plane = begin; plane < end; ++plane) {
    T const *const x = p.x.plane(plane), *const g = p.grad.plane(plane);
    T* const grad_x = p.grad_x.plane(plane);
    F const mean = mean_of_row(x, n, step);
    auto const before_clamp = [&](auto width, int64_t i) KV_INLINE {
      constexpr int M = decltype(width)::value;
      return p.before_clamp(Lanes<F, M>(load<M>(g + i)), Lanes<F, M>(load<M>(x + i)), mean);
    };
    F const of_mean = F(sum_of_row<T>(n, step, before_clamp) * double(1 - p.factor) / double(n));
    for_each_pixel<T>(n, step, [&](auto width, int64_t i) KV_INLINE {
      constexpr int M = decltype(width)::value;
      store<M>(grad_x + i, before_clamp(width, i) * p.factor + of_mean);
    });
  }
}

template <class T>
void channel_contrast_list_backward(ChannelContrastBackwardList<T> const& p, int64_t begin, int64_t end) {
  channel_gradient_items(p, begin, end, [](ChannelContrastBackward<T> const& one, int64_t first, int64_t last) {
    KV_ISA::channel_contrast_backward(one, first, last);
  });
}

KV_INSTANTIATE_WITH_BYTES(channel_contrast, ChannelContrast)
KV_INSTANTIATE_WITH_BYTES(channel_contrast_list, ChannelContrastList)
KV_INSTANTIATE(channel_contrast_backward, ChannelContrastBackward)
KV_INSTANTIATE(channel_contrast_list_backward, ChannelContrastBackwardList)

}  // namespace kv::enhance::KV_ISA
