// Lovász losses of logits (B, C, pixels) with labels (B, pixels). The errors of every class in every image are sorted
// in descending order. The loss is their sum, each error times the amount by which its pixel increases the Jaccard loss
// of the pixels before it.
//
// Let the region have `all` pixels, and let the first pixels comprise `inside` of them and `outside` others. The
// Jaccard loss of the first pixels is 1 - (all - inside) / (all + outside). A pixel of the region adds 1 / (all +
// outside), and any other pixel (all - inside) / ((all + outside - 1) (all + outside)). Both are computed from integer
// counts, without differences of numbers near 1.
//
// Errors are the absolute differences of the one-hot labels and the softmax. With `hinge` there is one class, and the
// errors are relu(1 - x) inside the region and relu(1 + x) outside. A label that is not a class makes the error NaN,
// which sorts before all numbers.
#pragma once

#include <type_traits>

#include "core/isa.h"

namespace kv::losses {

struct LovaszLabels {
  void const* target;             // int64, or uint8 if `bytes`
  bool bytes, one_target, hinge;  // one_target: one for all images
  int64_t batch, classes, pixels;

  KV_HD int64_t segments() const { return batch * classes; }
  KV_HD int64_t at(int64_t b, int64_t i) const {
    int64_t const at = (one_target ? 0 : b) * pixels + i;
    return bytes ? int64_t(static_cast<uint8_t const*>(target)[at]) : static_cast<int64_t const*>(target)[at];
  }
  // The label as a floating-point number; NaN if it is not a class.
  template <class F>
  KV_HD F number(int64_t b, int64_t i) const {
    int64_t const label = at(b, i);
    return label >= 0 && label < (hinge ? 2 : classes) ? F(label) : F(__builtin_nanf(""));
  }
  KV_HD bool is_inside(int64_t b, int64_t c, int64_t i) const { return at(b, i) == (hinge ? 1 : c); }
};

template <class T>
struct LovaszErrors {
  LovaszLabels labels;
  T const* logits;
  Compute<T>* errors;  // (B, C, pixels)
};

// An element of a segment; a segment is the pixels of one class in one image. The key is ascending for descending
// errors. `code` is 2 pixel + [in the region].
template <class F>
struct Ranked {
  using Bits = std::conditional_t<sizeof(F) == 4, uint32_t, uint64_t>;
  Bits key;
  uint32_t code;

  KV_HD static Ranked of(F error, int64_t pixel, bool inside) {
    return {Bits(~(__builtin_bit_cast(Bits, error) & (Bits(-1) >> 1))), uint32_t(2 * pixel + inside)};
  }
  KV_HD F error() const { return __builtin_bit_cast(F, Bits(~key & (Bits(-1) >> 1))); }
  KV_HD bool inside() const { return code & 1; }
  KV_HD int64_t pixel() const { return code >> 1; }
};

template <class F>
struct LovaszGradients {
  LovaszLabels labels;
  F* gradients;  // (B, C, pixels): errors on entry, gradients on return
  F* losses;     // (B, C)
  // CUDA: two buffers for the elements of `at_once` segments, and counts of their chunks.
  Ranked<F>* ranked[2];
  uint32_t* counts;
  F* partial;  // (B C, chunks)
  int64_t at_once;
};

template <class T>
struct LovaszBackward {
  LovaszLabels labels;
  T const* logits;
  Compute<T> const *grad, *gradients;  // (B, C), (B, C, pixels)
  T* grad_logits;
};

KV_KERNEL(lovasz_errors, LovaszErrors)
KV_KERNEL(lovasz_gradients, LovaszGradients)
KV_KERNEL(lovasz_backward, LovaszBackward)

constexpr int64_t kLovaszBlock = 1024;  // pixels of an image per task

// CUDA: the threads that sort a chunk of a segment, and the values of a digit.
constexpr int kRankedThreads = 256, kRankedDigits = 256;
template <class F>
constexpr int kRankedChunk = kRankedThreads * (64 / int(sizeof(F)));

// The derivative of the loss by the error of a pixel; `inside` and `outside` count the pixels up to and including it.
template <class F>
KV_HD F jaccard_derivative(bool is_inside, uint32_t all, uint32_t inside, uint32_t outside) {
  if (is_inside) return F(1) / F(all + outside);
  uint32_t const before = all + outside - 1;
  return before == 0 ? F(1) : F(all - inside) / F(before) / F(before + 1);
}

// The softmax of pixels V; load(c) returns their logits of class c.
template <class Math, class V>
struct LovaszSoftmax {
  V maximum, scale;

  template <class Load>
  KV_HD LovaszSoftmax(int64_t classes, Load load) : maximum(load(0)) {
    for (int64_t c = 1; c < classes; ++c) {
      V const x = load(c);
      maximum = x > maximum ? x : maximum;
    }
    V sum{};
    for (int64_t c = 0; c < classes; ++c) sum += Math::exp(V(load(c) - maximum));
    scale = Math::one() / sum;
  }
  KV_HD V operator()(V x) const { return Math::exp(V(x - maximum)) * scale; }
};

// Passes the errors of pixels V to store(c, errors). `label` has their labels, or NaN.
template <class F, class Math, class V, class Load, class Store>
KV_HD void errors_of_pixels(bool hinge, int64_t classes, V label, Load load, Store store) {
  V const zero{}, one = zero + F(1), nan_or_zero = label - label;
  if (hinge) {
    V const x = load(0), e = one - (label == one ? x : V(-x));
    store(0, V((e < zero ? zero : e) + nan_or_zero));
    return;
  }
  LovaszSoftmax<Math, V> const p(classes, load);
  for (int64_t c = 0; c < classes; ++c) {
    V const d = p(load(c)) - (label == zero + F(c) ? one : zero);
    store(c, V((d < zero ? V(-d) : d) + nan_or_zero));
  }
}

// Stores the gradient of their logits; derivative(c) is the derivative of the loss by the errors of class c. With p the
// probabilities and G the gradients by them, logit c receives p_c (G_c - sum_k p_k G_k).
template <class F, class Math, class V, class Load, class Derivative, class Store>
KV_HD void gradients_of_pixels(bool hinge, int64_t classes, V label, Load load, Derivative derivative, Store store) {
  V const zero{}, one = zero + F(1), nan_or_zero = label - label;
  if (hinge) {
    V const x = load(0), g = derivative(0) + nan_or_zero, e = one - (label == one ? x : V(-x));
    V const d = label == one ? V(-g) : g;
    store(0, e > zero ? d : nan_or_zero);
    return;
  }
  LovaszSoftmax<Math, V> const softmax(classes, load);
  auto const by_p = [&](int64_t c, V p) {
    V const d = p - (label == zero + F(c) ? one : zero), g = derivative(c);
    return V(d > zero ? g : d < zero ? V(-g) : zero);
  };
  V dot = nan_or_zero;
  for (int64_t c = 0; c < classes; ++c) {
    V const p = softmax(load(c));
    dot += p * by_p(c, p);
  }
  for (int64_t c = 0; c < classes; ++c) {
    V const p = softmax(load(c));
    store(c, V(p * (by_p(c, p) - dot)));
  }
}

}  // namespace kv::losses
