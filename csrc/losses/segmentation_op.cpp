// Losses of segmentations: schemas and entries, for CPU and CUDA.
#include "core/row_sums.h"
#include "glue/glue.h"
#include "segmentation.h"

namespace kv::losses {
namespace {

constexpr int64_t kMaxClasses = 224;  // the most that fit a block's shared memory on CUDA; more take the reference

// Logits (losses, B, C, H, W), labels (losses or 1, B, H, W), and their parameters, contiguous.
struct Labelled {
  Tensor logits, target;
  std::optional<Tensor> weight;
  int64_t losses, batch, classes, pixels, ignored;
  bool ignores;
  int64_t chunk, chunks;

  Labelled(char const* op, Tensor const& pred, Tensor const& labels, std::optional<Tensor> const& of_classes,
           int64_t ignored, bool ignores, int chunk)
      : logits(dense(pred)), target(dense(labels)), ignored(ignored), ignores(ignores), chunk(chunk) {
    KV_CHECK(pred.dim() == 5 && pred.numel() > 0 && pred.size(2) <= kMaxClasses, op,
             ": expected pred of shape (losses, B, C, H, W) with 1 to ", kMaxClasses, " classes");
    losses = pred.size(0), batch = pred.size(1), classes = pred.size(2), pixels = pred.size(3) * pred.size(4);
    chunks = ceil_div(pixels, chunk);
    KV_CHECK(labels.dim() == 4 && (labels.size(0) == losses || labels.size(0) == 1) && labels.size(1) == batch &&
                 labels.size(2) == pred.size(3) && labels.size(3) == pred.size(4) &&
                 labels.scalar_type() == ScalarType::Long && labels.device() == pred.device(),
             op, ": expected target of int64 labels (losses or 1, B, H, W) on the device of pred");
    if (!of_classes) return;
    weight = dense(*of_classes);
    KV_CHECK(weight->dim() == 2 && (weight->size(0) == losses || weight->size(0) == 1) && weight->size(1) == classes &&
                 weight->scalar_type() == compute_dtype(pred) && weight->device() == pred.device(),
             op, ": expected weight of shape (losses or 1, C) in the type that pred is computed in");
  }

  int64_t num_chunks() const { return losses * batch * chunks; }
  int64_t cost() const { return 4 * min(pixels, chunk) * classes; }
  Tensor number(torch::headeronly::IntHeaderOnlyArrayRef sizes) const {
    return empty(sizes, logits, Layout::planar, compute_dtype(logits));
  }
  Tensor gradient() const { return empty({losses, batch, classes, logits.size(3), logits.size(4)}, logits); }

  template <class T>
  Logits<T> of() const {
    return {data_ptr<T const>(logits),
            data_ptr<int64_t const>(target),
            target.size(0) == 1,
            losses,
            batch,
            classes,
            pixels,
            ignored,
            ignores,
            chunk,
            chunks};
  }
  template <class F>
  OverlapTerms<F> overlap_terms(bool micro, double alpha, double beta, double eps) const {
    return {weight_data<F>(), weight_stride(), micro, F(alpha), F(beta), F(eps)};
  }
  template <class F>
  FocalTerms<F> focal_terms(double first, double other, double gamma) const {
    return {weight_data<F>(), weight_stride(), F(first), F(other), F(gamma)};
  }
  template <class F>
  F const* weight_data() const {
    return weight ? data_ptr<F const>(*weight) : nullptr;
  }
  int64_t weight_stride() const { return weight && weight->size(0) > 1 ? classes : 0; }
};

// Checks that x has the shape `sizes` and the type that the logits are computed in; returns it dense.
Tensor checked(char const* op, char const* name, Tensor const& x, Labelled const& like,
               std::initializer_list<int64_t> sizes) {
  bool fits = x.dim() == int64_t(sizes.size()) && x.scalar_type() == compute_dtype(like.logits) &&
              x.device() == like.logits.device();
  for (size_t i = 0; fits && i < sizes.size(); ++i) fits = x.size(int64_t(i)) == sizes.begin()[i];
  KV_CHECK(fits, op, ": expected ", name, " to be that of the loss");
  return dense(x);
}

// The losses (losses), and the sums (losses, B, 3, C) of every sample from which they are computed.
std::tuple<Tensor, Tensor> overlap(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight,
                                   bool micro, double alpha, double beta, double eps, int64_t ignored, bool ignores) {
  Labelled const x("overlap", pred, target, weight, ignored, ignores, kChunk);
  Tensor const loss = x.number({x.losses}), sums = x.number({x.losses, x.batch, 3, x.classes});
  int64_t const samples = x.losses * x.batch, chunks = x.chunks, bins = 3 * x.classes;
  Tensor const partial = x.number({samples, chunks, bins});
  dispatch_floating("overlap", pred, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Overlap<T> const params{x.of<T>(), x.overlap_terms<F>(micro, alpha, beta, eps), data_ptr<F>(partial),
                            data_ptr<F>(sums), data_ptr<F>(loss)};
    KV_RUN(overlap, pred, params, x.num_chunks(), x.cost());
#if !defined(KV_CUDA)
    for (int64_t i = 0; i < samples * bins; ++i) {
      double sum = 0;
      for (int64_t chunk = 0; chunk < chunks; ++chunk)
        sum += params.partial[(i / bins * chunks + chunk) * bins + i % bins];
      params.sums[i] = F(sum);
    }
    for (int64_t r = 0; r < x.losses; ++r) {
      double sum = 0;
      for (int64_t b = 0; b < x.batch; ++b) {
        F const* const of_sample = params.sums + (r * x.batch + b) * bins;
        sum += OverlapTotals<F>::of(params.terms, of_sample, x.classes, r).loss(params.terms);
      }
      params.loss[r] = F(sum / double(x.batch));
    }
#endif
  });
  return {loss, sums};
}

Tensor overlap_backward(Tensor const& grad, Tensor const& sums, Tensor const& pred, Tensor const& target,
                        std::optional<Tensor> const& weight, bool micro, double alpha, double beta, double eps,
                        int64_t ignored, bool ignores) {
  constexpr char const* op = "overlap_backward";
  Labelled const x(op, pred, target, weight, ignored, ignores, kShortChunk);
  Tensor const g = checked(op, "grad", grad, x, {x.losses}),
               of_samples = checked(op, "sums", sums, x, {x.losses, x.batch, 3, x.classes}), grad_x = x.gradient();
  dispatch_floating(op, pred, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    OverlapBackward<T> const params{x.of<T>(), x.overlap_terms<F>(micro, alpha, beta, eps), data_ptr<F const>(g),
                                    data_ptr<F const>(of_samples), data_ptr<T>(grad_x)};
    KV_RUN(overlap_backward, pred, params, x.num_chunks(), x.cost());
  });
  return grad_x;
}

// The losses (losses, B, H, W) of all pixels, or their sums.
Tensor focal(Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight, double first, double other,
             double gamma, int64_t ignored, bool ignores, bool summed) {
  Labelled const x("focal", pred, target, weight, ignored, ignores, kShortChunk);
  Tensor const loss = summed ? x.number({x.losses}) : x.number({x.losses, x.batch, pred.size(3), pred.size(4)});
  Tensor const partial = x.number({summed ? x.num_chunks() : 0});
  dispatch_floating("focal", pred, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Focal<T> const params{x.of<T>(), x.focal_terms<F>(first, other, gamma), summed ? nullptr : data_ptr<F>(loss),
                          data_ptr<F>(partial), summed ? data_ptr<F>(loss) : nullptr};
    KV_RUN(focal, pred, params, x.num_chunks(), x.cost());
#if !defined(KV_CUDA)
    if (summed) add_chunks(params.partial, x.losses, x.batch * x.chunks, FinalizeSum<F>{F(1), F(0)}, params.sums);
#endif
  });
  return loss;
}

Tensor focal_backward(Tensor const& grad, Tensor const& pred, Tensor const& target, std::optional<Tensor> const& weight,
                      double first, double other, double gamma, int64_t ignored, bool ignores, bool summed) {
  constexpr char const* op = "focal_backward";
  Labelled const x(op, pred, target, weight, ignored, ignores, kShortChunk);
  Tensor const g = summed ? checked(op, "grad", grad, x, {x.losses})
                          : checked(op, "grad", grad, x, {x.losses, x.batch, pred.size(3), pred.size(4)});
  Tensor const grad_x = x.gradient();
  dispatch_floating(op, pred, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    FocalBackward<T> const params{x.of<T>(), x.focal_terms<F>(first, other, gamma), data_ptr<F const>(g), summed,
                                  data_ptr<T>(grad_x)};
    KV_RUN(focal_backward, pred, params, x.num_chunks(), x.cost());
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(overlap,
            "(Tensor pred, Tensor target, Tensor? weight, bool micro, float alpha, float beta, float eps, "
            "int ignored, bool ignores) -> (Tensor, Tensor)")
KV_OPERATOR(overlap_backward,
            "(Tensor grad, Tensor sums, Tensor pred, Tensor target, Tensor? weight, bool micro, float alpha, "
            "float beta, float eps, int ignored, bool ignores) -> Tensor")
KV_OPERATOR(focal,
            "(Tensor pred, Tensor target, Tensor? weight, float first, float other, float gamma, int ignored, "
            "bool ignores, bool summed) -> Tensor")
KV_OPERATOR(focal_backward,
            "(Tensor grad, Tensor pred, Tensor target, Tensor? weight, float first, float other, float gamma, "
            "int ignored, bool ignores, bool summed) -> Tensor")

}  // namespace kv::losses
