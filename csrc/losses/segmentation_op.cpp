// Losses of segmentations: schemas and entries, for CPU and CUDA alike.
#include "glue/glue.h"
#include "segmentation.h"

namespace kv {
namespace {

constexpr int64_t kMostClasses = 1024;  // whose sums a block's shared memory holds

void check_labels(char const* op, Tensor const& pred, Tensor const& target) {
  KV_CHECK(pred.dim() == 4 && pred.size(1) > 0, op, ": expected pred of shape (B, C, H, W) with a class");
  KV_CHECK(target.dim() == 3 && (target.size(0) == pred.size(0) || target.size(0) == 1) &&
               target.size(1) == pred.size(2) && target.size(2) == pred.size(3) &&
               target.scalar_type() == ScalarType::Long && target.device() == pred.device(),
           op, ": expected target of int64 labels (B or 1, H, W) on the device of pred");
}

ScalarType computed(Tensor const& x) {
  return x.scalar_type() == ScalarType::Double ? ScalarType::Double : ScalarType::Float;
}

// Of contiguous tensors.
template <class T>
Logits<T> logits_of(Tensor const& pred, Tensor const& target, int64_t ignored, bool ignores) {
  return {static_cast<T const*>(pred.const_data_ptr()),
          static_cast<int64_t const*>(target.const_data_ptr()),
          target.size(0) > 1 ? pred.size(2) * pred.size(3) : 0,
          pred.size(0),
          pred.size(1),
          pred.size(2) * pred.size(3),
          ignored,
          ignores};
}

template <class T>
T* data(Tensor const& x) {
  return static_cast<T*>(const_cast<void*>(x.const_data_ptr()));
}

Tensor class_sums(Tensor const& pred, Tensor const& target, int64_t ignored, bool ignores) {
  check_labels("class_sums", pred, target);
  KV_CHECK(pred.size(1) <= kMostClasses, "class_sums: expected at most ", kMostClasses, " classes");
  Tensor const x = dense(pred), labels = dense(target);
  int64_t const batch = x.size(0), classes = x.size(1);
  int64_t const pieces = max((x.size(2) * x.size(3) + kPiece - 1) / kPiece, int64_t(1));
  Tensor const sums = empty({batch, 3, classes}, x, Layout::planar, computed(x));
  Tensor const partial = empty({batch, pieces, 3, classes}, x, Layout::planar, computed(x));
  for_floats("class_sums", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    ClassSums<T> const params{logits_of<T>(x, labels, ignored, ignores), pieces, data<F>(partial), data<F>(sums)};
    KV_RUN(class_sums, x, params, batch * pieces, 4 * min(params.logits.pixels, int64_t(kPiece)) * classes);
#if !defined(KV_CUDA)
    for (int64_t i = 0; i < batch * 3 * classes; ++i) {
      int64_t const sample = i / (3 * classes), k = i % (3 * classes);
      double sum = 0;
      for (int64_t piece = 0; piece < pieces; ++piece)
        sum += params.partial[(sample * pieces + piece) * 3 * classes + k];
      params.sums[i] = F(sum);
    }
#endif
  });
  return sums;
}

Tensor class_sums_backward(Tensor const& grad, Tensor const& pred, Tensor const& target, int64_t ignored,
                           bool ignores) {
  constexpr char const* op = "class_sums_backward";
  check_labels(op, pred, target);
  KV_CHECK(grad.dim() == 3 && grad.size(0) == pred.size(0) && grad.size(1) == 3 && grad.size(2) == pred.size(1) &&
               grad.scalar_type() == computed(pred) && grad.device() == pred.device(),
           op, ": expected grad to be that of the sums");
  Tensor const x = dense(pred), labels = dense(target), g = dense(grad), grad_x = empty_like(x, Layout::planar);
  for_floats(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    ClassSumsBackward<T> const params{logits_of<T>(x, labels, ignored, ignores), data<Compute<T>>(g), data<T>(grad_x)};
    KV_RUN(class_sums_backward, x, params, params.logits.batch * params.logits.pixels, 4 * x.size(1));
  });
  return grad_x;
}

template <class F>
FocalTerms<F> terms_of(std::optional<Tensor> const& weight, double first, double other, double gamma) {
  return {weight ? data<F>(*weight) : nullptr, F(first), F(other), F(gamma)};
}

std::optional<Tensor> checked_weight(char const* op, std::optional<Tensor> const& weight, Tensor const& pred) {
  if (!weight) return weight;
  KV_CHECK(weight->dim() == 2 && weight->size(0) == 1 && weight->size(1) == pred.size(1) &&
               weight->scalar_type() == computed(pred) && weight->device() == pred.device(),
           op, ": expected weight of shape (1, C) in the type that pred is computed in");
  return dense(*weight);
}

Tensor focal(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight, double first, double other,
             double gamma, int64_t ignored, bool ignores) {
  check_labels("focal", pred, target);
  std::optional<Tensor> const w = checked_weight("focal", weight, pred);
  Tensor const x = dense(pred), labels = dense(target);
  Tensor const loss = empty({x.size(0), x.size(2), x.size(3)}, x, Layout::planar, computed(x));
  for_floats("focal", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Focal<T> const params{logits_of<T>(x, labels, ignored, ignores), terms_of<F>(w, first, other, gamma),
                          data<F>(loss)};
    KV_RUN(focal, x, params, params.logits.batch * params.logits.pixels, 4 * x.size(1));
  });
  return loss;
}

Tensor focal_backward(Tensor const& grad, Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight,
                      double first, double other, double gamma, int64_t ignored, bool ignores) {
  constexpr char const* op = "focal_backward";
  check_labels(op, pred, target);
  std::optional<Tensor> const w = checked_weight(op, weight, pred);
  KV_CHECK(grad.dim() == 3 && grad.size(0) == pred.size(0) && grad.size(1) == pred.size(2) &&
               grad.size(2) == pred.size(3) && grad.scalar_type() == computed(pred) && grad.device() == pred.device(),
           op, ": expected grad to be that of the loss");
  Tensor const x = dense(pred), labels = dense(target), g = dense(grad), grad_x = empty_like(x, Layout::planar);
  for_floats(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    FocalBackward<T> const params{logits_of<T>(x, labels, ignored, ignores), terms_of<F>(w, first, other, gamma),
                                  data<F>(g), data<T>(grad_x)};
    KV_RUN(focal_backward, x, params, params.logits.batch * params.logits.pixels, 4 * x.size(1));
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(class_sums, "(Tensor pred, Tensor target, int ignored, bool ignores) -> Tensor")
KV_OPERATOR(class_sums_backward, "(Tensor grad, Tensor pred, Tensor target, int ignored, bool ignores) -> Tensor")
KV_OPERATOR(focal,
            "(Tensor pred, Tensor target, Tensor? weight, float first, float other, float gamma, int ignored, "
            "bool ignores) -> Tensor")
KV_OPERATOR(focal_backward,
            "(Tensor grad, Tensor pred, Tensor target, Tensor? weight, float first, float other, float gamma, "
            "int ignored, bool ignores) -> Tensor")

}  // namespace kv
