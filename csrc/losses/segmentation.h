// Losses of logits (losses, B, C, pixels) with labels (losses, B, pixels): Dice and Tversky losses, and the focal loss
// of every pixel or its sum. Neither the softmax nor a one-hot target is stored.
//
// A valid label counts 1, an ignored one 0. A label that is not a class counts NaN, which makes its result NaN.
#pragma once

#include "core/hd.h"
#include "core/isa.h"

namespace kv::losses {

template <class T>
struct Logits {
  T const* data;
  int64_t const* target;
  bool one_target;  // one for all losses
  int64_t losses, batch, classes, pixels, ignored;
  bool ignores;
  int64_t chunk, chunks;  // pixels per task, and the number of chunks in a sample

  KV_HD int64_t samples() const { return losses * batch; }
  KV_HD T const* sample(int64_t i) const { return data + i * classes * pixels; }
  KV_HD int64_t const* labels(int64_t i) const { return target + (one_target ? i % batch : i) * pixels; }
  KV_HD Compute<T> counts(int64_t label) const {
    using F = Compute<T>;
    return ignores && label == ignored ? F(0) : label >= 0 && label < classes ? F(1) : F(__builtin_nanf(""));
  }
  KV_HD int class_of(int64_t label) const { return int(clamp(label, int64_t(0), classes - 1)); }
};

constexpr int kChunk = 4096, kShortChunk = 1024;  // the latter if a chunk has one sum or none

// --- overlap of regions ----------------------------------------------------------------------------------------------

// Sums of one class or of all classes: the probability on the pixels with this label, the probability on all pixels,
// and the number of pixels with this label.
template <class F>
struct Region {
  F both, predicted, labelled;

  // The sums of class c, from (3, C).
  KV_HD static Region of(F const* sums, int64_t classes, int64_t c) {
    return {sums[c], sums[classes + c], sums[2 * classes + c]};
  }
};

// The score of a region is both / (both + alpha (predicted - both) + beta (labelled - both) + eps), and 0 if the
// divisor is 0. With `micro` the loss of a sample is 1 - the score of the weighted sums over its classes. Otherwise
// it is 1 - the weighted mean of the scores of the classes that occur in its labels, or 1 if none does.
template <class F>
struct OverlapTerms {
  F const* weight;        // per class, or null
  int64_t weight_stride;  // from loss to loss
  bool micro;
  F alpha, beta, eps;

  KV_HD F weight_of(int64_t loss, int64_t c, Region<F> const& r) const {
    F const w = weight ? weight[loss * weight_stride + c] : F(1);
    return micro || r.labelled != 0 ? w : F(0);
  }
  KV_HD F divisor(Region<F> const& r) const {
    return r.both + alpha * (r.predicted - r.both) + beta * (r.labelled - r.both) + eps;
  }
  KV_HD F score(Region<F> const& r) const {
    F const d = divisor(r);
    return d == 0 ? F(0) : r.both / d;
  }
};

// Weighted sums over the classes of a sample.
template <class F>
struct OverlapTotals {
  Region<F> all;    // if `micro`
  F weight, score;  // otherwise

  // Sums every `step`-th class from `first` on.
  KV_HD static OverlapTotals of(OverlapTerms<F> const& terms, F const* sums, int64_t classes, int64_t loss,
                                int64_t first = 0, int64_t step = 1) {
    OverlapTotals totals{};
    for (int64_t c = first; c < classes; c += step) {
      Region<F> const r = Region<F>::of(sums, classes, c);
      totals.add(terms, terms.weight_of(loss, c, r), r);
    }
    return totals;
  }
  KV_HD void add(OverlapTerms<F> const& terms, F w, Region<F> const& r) {
    all.both += w * r.both, all.predicted += w * r.predicted, all.labelled += w * r.labelled;
    weight += w, score += terms.micro || w == 0 ? F(0) : w * terms.score(r);
  }
  KV_HD F loss(OverlapTerms<F> const& terms) const {
    return 1 - (terms.micro ? terms.score(all) : weight == 0 ? F(0) : score / weight);
  }
  // g times the derivatives of the loss by a class's `both` and `predicted`.
  KV_HD void gradients(OverlapTerms<F> const& terms, F g, F w, Region<F> const& r, F& by_both, F& by_predicted) const {
    Region<F> const& of = terms.micro ? all : r;
    F const d = terms.divisor(of), scale = terms.micro ? w : weight == 0 ? F(0) : w / weight;
    bool const flat = scale == 0 || d == 0;
    F const s = flat ? F(0) : -g * scale / d, ratio = flat ? F(0) : of.both / d;
    by_both = s * (1 - ratio * (1 - terms.alpha - terms.beta));
    by_predicted = -s * ratio * terms.alpha;
  }
};

template <class T>
struct Overlap {
  Logits<T> logits;
  OverlapTerms<Compute<T>> terms;
  Compute<T>* partial;  // (losses * B, chunks, 3, C)
  Compute<T>*sums,
      *loss;  // (losses * B, 3, C) and (losses), written by the CUDA kernel; on the CPU the operator computes them
};

// With p the probabilities, and G_c the derivative by `predicted` plus, if c is the label, the derivative by `both`:
// logit c receives p_c (G_c - sum_k p_k G_k).
template <class T>
struct OverlapBackward {
  Logits<T> logits;
  OverlapTerms<Compute<T>> terms;
  Compute<T> const *grad, *sums;
  T* grad_logits;
};

// --- the focal loss --------------------------------------------------------------------------------------------------

// The focal loss is -f (1 - p)^gamma log p with the probability p of the label. f is `first` for class 0 and `other`
// for the other classes, times the weight of the class.
template <class F>
struct FocalTerms {
  F const* weight;        // per class, or null
  int64_t weight_stride;  // from loss to loss
  F first, other, gamma;

  KV_HD F factor(int64_t loss, int c) const {
    return (c == 0 ? first : other) * (weight ? weight[loss * weight_stride + c] : F(1));
  }
};

template <class T>
struct Focal {
  Logits<T> logits;
  FocalTerms<Compute<T>> terms;
  Compute<T>* map;            // (losses, B, pixels); null: only sums
  Compute<T>*partial, *sums;  // (losses * B, chunks) and (losses), as in Overlap
};

template <class T>
struct FocalBackward {
  Logits<T> logits;
  FocalTerms<Compute<T>> terms;
  Compute<T> const* grad;  // (losses, B, pixels) or (losses)
  bool of_sums;
  T* grad_logits;
};

KV_KERNEL(overlap, Overlap)
KV_KERNEL(overlap_backward, OverlapBackward)
KV_KERNEL(focal, Focal)
KV_KERNEL(focal_backward, FocalBackward)

template <class F>
constexpr F kLog2E = F(1.44269504088896340736);
template <class F>
constexpr F kMinNormal = sizeof(F) == 4 ? F(1.17549435e-38) : F(2.2250738585072014e-308);

// The focal loss of pixels and its derivative by log p. `label` is the logit of the label, `maximum` the maximum logit,
// and `rest` the sum of exp(logit - most) over the other classes. Math has exp and log of V. 1 - p and log p stay
// accurate where p is nearly 1.
template <class V, class F, class Math>
KV_HD void focal_of_pixels(V factor, F gamma, V label, V maximum, V rest, Math math, V& loss, V& derivative, V& scale) {
  V const one = V{} + F(1), min_normal = V{} + kMinNormal<F>;
  V const own = math.exp(V(label - maximum)), sum = own + rest, log_sum = math.log(sum);
  scale = one / sum;
  V const wrong = rest * scale, small = sum == one ? rest : V(log_sum * rest / (sum - one));
  V const log_p = (label - maximum) - (own == one ? small : log_sum);
  V power = one;
  if (gamma != 0) power = math.exp(V(math.log(wrong > min_normal ? wrong : min_normal) * gamma));
  loss = -factor * power * log_p;
  V const falling = power - gamma * power / wrong * own * scale * log_p;
  derivative = -factor * (wrong > min_normal ? falling : power);
}

}  // namespace kv::losses
