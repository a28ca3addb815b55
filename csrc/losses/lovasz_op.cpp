// Lovász losses: schemas and entries, for CPU and CUDA.
#include "glue/glue.h"
#include "lovasz.h"

namespace kv::losses {
namespace {

// Logits (B, C, H, W) and labels (B or 1, H, W), contiguous.
struct LovaszImages {
  Tensor logits, target;
  bool hinge;
  int64_t batch, classes, pixels;

  LovaszImages(char const* op, Tensor const& pred, Tensor const& labels, bool hinge)
      : logits(dense(pred)), target(dense(labels)), hinge(hinge) {
    KV_CHECK(pred.dim() == 4 && pred.numel() > 0 && (!hinge || pred.size(1) == 1), op,
             ": expected pred of shape (B, C, H, W), of one class where it is a hinge loss");
    batch = pred.size(0), classes = pred.size(1), pixels = pred.size(2) * pred.size(3);
    KV_CHECK(pixels < int64_t(1) << 31, op, ": expected less than 2^31 pixels in an image");
    auto const type = labels.scalar_type();
    KV_CHECK(labels.dim() == 3 && (labels.size(0) == batch || labels.size(0) == 1) && labels.size(1) == pred.size(2) &&
                 labels.size(2) == pred.size(3) && (type == ScalarType::Long || type == ScalarType::Byte) &&
                 labels.device() == pred.device(),
             op, ": expected target of int64 or uint8 labels (B or 1, H, W) on the device of pred");
  }

  LovaszLabels labels() const {
    bool const bytes = target.scalar_type() == ScalarType::Byte, one_target = target.size(0) == 1;
    return {target.const_data_ptr(), bytes, one_target, hinge, batch, classes, pixels};
  }
  int64_t blocks() const { return batch * ceil_div(pixels, kLovaszBlock); }
  int64_t cost() const { return 4 * min(pixels, kLovaszBlock) * classes; }
};

// The losses (B, C), and the derivatives (B, C, H, W) of each loss by its errors.
std::tuple<Tensor, Tensor> lovasz(Tensor const& pred, Tensor const& target, bool hinge) {
  LovaszImages const x("lovasz", pred, target, hinge);
  auto const type = compute_dtype(pred);
  Tensor const losses = empty({x.batch, x.classes}, pred, Layout::planar, type);
  Tensor const gradients = empty({x.batch, x.classes, pred.size(2), pred.size(3)}, pred, Layout::planar, type);
  dispatch_floating("lovasz", pred, [&](auto of_type) {
    using T = typename decltype(of_type)::type;
    using F = Compute<T>;
    LovaszErrors<T> const errors{x.labels(), data_ptr<T const>(x.logits), data_ptr<F>(gradients)};
    KV_RUN(lovasz_errors, pred, errors, x.blocks(), x.cost());
    LovaszGradients<F> params{x.labels(), data_ptr<F>(gradients), data_ptr<F>(losses), {}, nullptr, nullptr, 0};
#if defined(KV_CUDA)
    // A group of segments: its memory, four times that of its gradients, is as large as a map of the batch, but at
    // least enough to occupy the GPU.
    constexpr int64_t kElementsAtOnce = 1 << 20, kSize = 2 * sizeof(Ranked<F>);
    int64_t const segments = x.batch * x.classes, chunks = ceil_div(x.pixels, kRankedChunk<F>);
    params.at_once = clamp(std::max(kElementsAtOnce / x.pixels, segments / 4), int64_t(1), segments);
    Tensor const ranked = empty({2, params.at_once, x.pixels, kSize / 2}, pred, Layout::planar, ScalarType::Byte);
    Tensor const counts = empty({params.at_once, chunks + 1, kRankedDigits}, pred, Layout::planar, ScalarType::Int);
    Tensor const partial = empty({segments, chunks}, pred, Layout::planar, type);
    params.ranked[0] = reinterpret_cast<Ranked<F>*>(data_ptr<uint8_t>(ranked));
    params.ranked[1] = params.ranked[0] + params.at_once * x.pixels;
    params.counts = data_ptr<uint32_t>(counts), params.partial = data_ptr<F>(partial);
#endif
    KV_RUN(lovasz_gradients, pred, params, x.batch * x.classes, 32 * x.pixels);
  });
  return {losses, gradients};
}

Tensor lovasz_backward(Tensor const& grad, Tensor const& gradients, Tensor const& pred, Tensor const& target,
                       bool hinge) {
  constexpr char const* op = "lovasz_backward";
  LovaszImages const x(op, pred, target, hinge);
  auto const fits = [&](Tensor const& t) {
    return t.scalar_type() == compute_dtype(pred) && t.device() == pred.device();
  };
  KV_CHECK(grad.dim() == 2 && grad.size(0) == x.batch && grad.size(1) == x.classes && fits(grad), op,
           ": expected grad to be that of the losses");
  KV_CHECK(gradients.dim() == 4 && gradients.size(0) == x.batch && gradients.size(1) == x.classes &&
               gradients.size(2) == pred.size(2) && gradients.size(3) == pred.size(3) && fits(gradients),
           op, ": expected gradients to be those of the losses");
  Tensor const g = dense(grad), by_errors = dense(gradients);
  Tensor const grad_x = empty({x.batch, x.classes, pred.size(2), pred.size(3)}, pred);
  dispatch_floating(op, pred, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    LovaszBackward<T> const params{x.labels(), data_ptr<T const>(x.logits), data_ptr<F const>(g),
                                   data_ptr<F const>(by_errors), data_ptr<T>(grad_x)};
    KV_RUN(lovasz_backward, pred, params, x.blocks(), x.cost());
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(lovasz, "(Tensor pred, Tensor target, bool hinge) -> (Tensor, Tensor)")
KV_OPERATOR(lovasz_backward, "(Tensor grad, Tensor gradients, Tensor pred, Tensor target, bool hinge) -> Tensor")

}  // namespace kv::losses
