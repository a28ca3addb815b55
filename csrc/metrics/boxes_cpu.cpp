// Intersection over union of boxes on the CPU: boxes [begin, end) of the first set. Compiled once per instruction set.
#include "boxes.h"
#include "core/lanes.h"

namespace kv::metrics::KV_ISA {
namespace {

template <class T>
KV_HD Corners<Compute<T>> corners_of(T const* box, BoxFormat format) {
  using F = Compute<T>;
  F const four[] = {F(load<1>(box)), F(load<1>(box + 1)), F(load<1>(box + 2)), F(load<1>(box + 3))};
  return {four, format};
}

}  // namespace

template <class T>
void box_iou(BoxIou<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t row = begin; row < end; ++row) {
    Corners<F> const own = corners_of(p.a + 4 * row, p.format);
    T const* const others = p.b + row / p.n * p.m * 4;
    for (int64_t k = 0; k < p.m; ++k)
      store<1>(p.result + row * p.m + k, Lanes<F, 1>(own.overlap(corners_of(others + 4 * k, p.format))));
  }
}

template <class T>
void box_iou_backward(BoxIouBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  for (int64_t row = begin; row < end; ++row) {
    Corners<F> const own = corners_of(p.a + 4 * row, p.format);
    T const *const others = p.b + row / p.n * p.m * 4, *const grad = p.grad_of(row);
    F sum[4] = {};
    for (int64_t k = 0; k < p.m; ++k)
      own.overlap_vjp(corners_of(others + 4 * k, p.format), F(load<1>(grad + k * p.grad_stride)), sum);
    Corners<F>::vjp(p.format, sum);
    for (int k = 0; k < 4; ++k) store<1>(p.result + 4 * row + k, Lanes<F, 1>(sum[k]));
  }
}

KV_INSTANTIATE(box_iou, BoxIou)
KV_INSTANTIATE(box_iou_backward, BoxIouBackward)

}  // namespace kv::metrics::KV_ISA
