// Losses of logits (B, C, pixels) with labels (B, pixels): what Dice and Tversky losses are made of, and the focal loss
// of every pixel. No softmax and no one-hot target is kept. Included by segmentation_cpu.cpp, segmentation.cu and
// segmentation_op.cpp.
//
// A label counts 1, an ignored one 0, and one that is no class NaN, which spoils what it is in.
#pragma once

#include "core/hd.h"
#include "core/isa.h"

namespace kv {

template <class T>
struct Logits {
  T const* data;
  int64_t const* target;
  int64_t target_stride;  // 0 when one image of labels serves all samples
  int64_t batch, classes, pixels, ignored;
  bool ignores;

  KV_HD int64_t const* labels(int64_t sample) const { return target + sample * target_stride; }
  KV_HD Compute<T> counts(int64_t label) const {
    using F = Compute<T>;
    return ignores && label == ignored ? F(0) : label >= 0 && label < classes ? F(1) : F(__builtin_nanf(""));
  }
};

constexpr int kPiece = 4096;  // pixels that are summed together

// For every class of a sample the sums of its probability where it is the label, of that everywhere, and of its pixels:
// (B, 3, C), first for each piece.
template <class T>
struct ClassSums {
  Logits<T> logits;
  int64_t pieces;
  Compute<T>* partial;
  Compute<T>* sums;
};

// With p the probabilities and G_c = grad(1, c) + [c is the label] grad(0, c), logit c gets p_c (G_c - sum_k p_k G_k).
template <class T>
struct ClassSumsBackward {
  Logits<T> logits;
  Compute<T> const* grad;
  T* grad_logits;
};

// -f (1 - p)^gamma log p of the label's p, where f is `first` for class 0 and `other` for the others, times its weight.
template <class F>
struct FocalTerms {
  F const* weight;  // of the classes, or null
  F first, other, gamma;
};

template <class T>
struct Focal {
  Logits<T> logits;
  FocalTerms<Compute<T>> terms;
  Compute<T>* loss;
};

template <class T>
struct FocalBackward {
  Logits<T> logits;
  FocalTerms<Compute<T>> terms;
  Compute<T> const* grad;
  T* grad_logits;
};

KV_KERNEL(class_sums, ClassSums)
KV_KERNEL(class_sums_backward, ClassSumsBackward)
KV_KERNEL(focal, Focal)
KV_KERNEL(focal_backward, FocalBackward)

template <class F>
constexpr F kLog2E = F(1.44269504088896340736);
template <class F>
constexpr F kTiny = sizeof(F) == 4 ? F(1.17549435e-38) : F(2.2250738585072014e-308);

// The focal loss of pixels and its slope by log p. `label` is the label's logit, `most` the largest one and `rest` the
// sum of exp(logit - most) over the other classes; Math has exp and log of V. 1 - p and log p keep their digits where p
// is nearly 1.
template <class V, class F, class Math>
KV_HD void focal_of_pixels(V factor, F gamma, V label, V most, V rest, Math math, V& loss, V& slope, V& scale) {
  V const one = V{} + F(1), tiny = V{} + kTiny<F>;
  V const own = math.exp(V(label - most)), sum = own + rest, log_sum = math.log(sum);
  scale = one / sum;
  V const wrong = rest * scale, small = sum == one ? rest : V(log_sum * rest / (sum - one));
  V const log_p = (label - most) - (own == one ? small : log_sum);
  V power = one;
  if (gamma != 0) power = math.exp(V(math.log(wrong > tiny ? wrong : tiny) * gamma));
  loss = -factor * power * log_p;
  V const falling = power - gamma * power / wrong * own * scale * log_p;
  slope = -factor * (wrong > tiny ? falling : power);
}

}  // namespace kv
