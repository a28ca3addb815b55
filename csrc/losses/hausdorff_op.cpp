// Hausdorff loss: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "hausdorff.h"

namespace kv::losses {
namespace {

constexpr int64_t kMaxErosions = 1000;

// Predictions (B, C, H, W) or (B, C, D, H, W) in float32 or float64, and labels (B or 1, ...), contiguous.
struct LabelledPlanes {
  Tensor pred, target;
  Extent extent;
  int64_t k;

  LabelledPlanes(char const* op, Tensor const& predicted, Tensor const& labels, int64_t k)
      : pred(dense(predicted)), target(dense(labels)), k(k) {
    int64_t const axes = pred.dim();
    KV_CHECK((axes == 4 || axes == 5) && pred.numel() > 0 && pred.scalar_type() == compute_dtype(pred), op,
             ": expected pred of shape (B, C, H, W) or (B, C, D, H, W) in float32 or float64");
    bool fits = labels.dim() == axes - 1 && (labels.size(0) == pred.size(0) || labels.size(0) == 1);
    for (int64_t axis = 2; fits && axis < axes; ++axis) fits = labels.size(axis - 1) == pred.size(axis);
    KV_CHECK(fits && labels.scalar_type() == ScalarType::Long && labels.device() == pred.device(), op,
             ": expected target of int64 labels (B or 1, ...) on the device of pred");
    KV_CHECK(k >= 1 && k <= kMaxErosions, op, ": expected k from 1 to ", kMaxErosions);
    extent = {axes == 5 ? pred.size(2) : 0, pred.size(axes - 2), pred.size(axes - 1)};
    KV_CHECK(extent.size() < int64_t(1) << 31, op, ": expected less than 2^31 pixels in a plane");
  }

  template <class F>
  Differences<F> of() const {
    return {data_ptr<F const>(pred),
            data_ptr<int64_t const>(target),
            target.size(0) == 1,
            pred.size(0),
            pred.size(1),
            extent};
  }
  int64_t planes() const { return pred.size(0) * pred.size(1); }
  template <class Call>
  void for_type(Call f) const {
    pred.scalar_type() == ScalarType::Double ? f(Type<double>{}) : f(Type<float>{});
  }
};

#if defined(KV_CUDA)
// Working memory for a group of planes: as large as a map of the batch, but at least enough to occupy the GPU.
template <class Params>
std::pair<Tensor, Tensor> make_room(LabelledPlanes const& x, Params& params, int64_t maps, int64_t numbers) {
  constexpr int64_t kElementsAtOnce = 1 << 20;
  int64_t const n = x.extent.size(), chunks = ceil_div(n, kErosionChunk);
  params.at_once = clamp(std::max(kElementsAtOnce / n, x.planes() / maps), int64_t(1), x.planes());
  std::pair const room(empty({maps, params.at_once, n}, x.pred), empty({numbers, params.at_once, chunks}, x.pred));
  params.maps = static_cast<decltype(params.maps)>(const_cast<void*>(room.first.const_data_ptr()));
  params.numbers = static_cast<decltype(params.numbers)>(const_cast<void*>(room.second.const_data_ptr()));
  return room;
}
#endif

// The loss of every pixel, or the sums (B, C) over planes.
Tensor hausdorff(Tensor const& pred, Tensor const& target, double alpha, int64_t k, bool summed) {
  LabelledPlanes const x("hausdorff", pred, target, k);
  Tensor const loss = summed ? empty({pred.size(0), pred.size(1)}, x.pred) : empty(x.pred.sizes(), x.pred);
  x.for_type([&](auto type) {
    using F = typename decltype(type)::type;
    F* const to = data_ptr<F>(loss);
    Hausdorff<F> params{x.of<F>(), alpha, k, summed ? nullptr : to, summed ? to : nullptr, nullptr, nullptr, 0};
#if defined(KV_CUDA)
    auto const room = make_room(x, params, kErosionMaps, kErosionNumbers);
#endif
    KV_RUN(hausdorff, x.pred, params, x.planes(), 4 * x.extent.size() * k);
  });
  return loss;
}

Tensor hausdorff_backward(Tensor const& grad, Tensor const& pred, Tensor const& target, double alpha, int64_t k,
                          bool summed) {
  constexpr char const* op = "hausdorff_backward";
  LabelledPlanes const x(op, pred, target, k);
  bool fits = grad.dim() == (summed ? 2 : pred.dim()) && grad.scalar_type() == pred.scalar_type() &&
              grad.device() == pred.device();
  for (int64_t axis = 0; fits && axis < grad.dim(); ++axis) fits = grad.size(axis) == pred.size(axis);
  KV_CHECK(fits, op, ": expected grad to be that of the loss");
  Tensor const g = dense(grad), grad_x = empty(x.pred.sizes(), x.pred);
  x.for_type([&](auto type) {
    using F = typename decltype(type)::type;
    HausdorffBackward<F> params{x.of<F>(), alpha,   k, data_ptr<F const>(g), summed, data_ptr<F>(grad_x),
                                nullptr,   nullptr, 0};
#if defined(KV_CUDA)
    auto const room = make_room(x, params, erosion_maps_backward(k), erosion_numbers_backward(k));
#endif
    KV_RUN(hausdorff_backward, x.pred, params, x.planes(), 8 * x.extent.size() * k);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(hausdorff, "(Tensor pred, Tensor target, float alpha, int k, bool summed) -> Tensor")
KV_OPERATOR(hausdorff_backward, "(Tensor grad, Tensor pred, Tensor target, float alpha, int k, bool summed) -> Tensor")

}  // namespace kv::losses
