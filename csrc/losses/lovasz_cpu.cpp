// Lovász losses on the CPU: blocks [begin, end) of pixels for errors and for gradients of the logits, segments [begin,
// end) for the sorted errors. Compiled once per instruction set.
#include "core/ceil_div.h"
#include "core/lanes.h"
#include "core/scratch.h"
#include "lovasz.h"

namespace kv::losses::KV_ISA {
namespace {

constexpr int kDigitBits = 11, kDigits = 1 << kDigitBits;

template <class F, int N>
struct LovaszMath {
  KV_HD static Lanes<F, N> one() { return broadcast<N>(F(1)); }
  KV_HD static Lanes<F, N> exp(Lanes<F, N> x) { return vexp2<F, N>(x * F(1.44269504088896340736)); }
};

// Calls f(image, pixel, labels) for vectors of the pixels of blocks [begin, end).
template <class T, class Call>
KV_HD void for_each_pixel(LovaszLabels const& labels, int64_t begin, int64_t end, Call f) {
  using F = Compute<T>;
  int64_t const blocks = ceil_div(labels.pixels, kLovaszBlock);
  for (int64_t block = begin; block < end; ++block) {
    int64_t const b = block / blocks, first = block % blocks * kLovaszBlock;
    for_each_vector<T>(first, min(first + kLovaszBlock, labels.pixels), [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      F label[N];
      for (int k = 0; k < N; ++k) label[k] = labels.number<F>(b, i + k);
      f(width, b, i, Lanes<F, N>(load<N>(label)));
    });
  }
}

// A stable radix sort by ascending key; returns the buffer with the result, one of both.
template <class F>
KV_HD Ranked<F>* sorted(Ranked<F>* from, Ranked<F>* to, uint32_t* counts, int64_t n) {
  constexpr int kPasses = (8 * sizeof(F) + kDigitBits - 1) / kDigitBits;
  for (int i = 0; i < kPasses * kDigits; ++i) counts[i] = 0;
  for (int64_t i = 0; i < n; ++i)
    for (int pass = 0; pass < kPasses; ++pass) ++counts[pass * kDigits + (from[i].key >> pass * kDigitBits) % kDigits];
  for (int pass = 0; pass < kPasses; ++pass) {
    uint32_t* const at = counts + pass * kDigits;
    int const shift = pass * kDigitBits;
    if (at[(from[0].key >> shift) % kDigits] == n) continue;  // all elements have the same digit
    uint32_t sum = 0;
    for (int i = 0; i < kDigits; ++i) {
      uint32_t const count = at[i];
      at[i] = sum, sum += count;
    }
    for (int64_t i = 0; i < n; ++i) to[at[(from[i].key >> shift) % kDigits]++] = from[i];
    Ranked<F>* const other = from;
    from = to, to = other;
  }
  return from;
}

}  // namespace

template <class T>
void lovasz_errors(LovaszErrors<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  LovaszLabels const& labels = p.labels;
  for_each_pixel<T>(labels, begin, end, [&](auto width, int64_t b, int64_t i, auto label) {
    constexpr int N = decltype(width)::value;
    using V = Lanes<F, N>;
    T const* const x = p.logits + b * labels.classes * labels.pixels + i;
    F* const to = p.errors + b * labels.classes * labels.pixels + i;
    errors_of_pixels<F, LovaszMath<F, N>>(
        labels.hinge, labels.classes, label, [&](int64_t c) { return V(load<N>(x + c * labels.pixels)); },
        [&](int64_t c, V e) { store<N>(to + c * labels.pixels, e); });
  });
}

template <class F>
void lovasz_gradients(LovaszGradients<F> const& p, int64_t begin, int64_t end) {
  LovaszLabels const& labels = p.labels;
  int64_t const n = labels.pixels;
  Scratch<Ranked<F>> memory(2 * n);
  Scratch<uint32_t> counts(kDigits * int(sizeof(F)));
  for (int64_t segment = begin; segment < end; ++segment) {
    int64_t const b = segment / labels.classes, c = segment % labels.classes;
    F* const gradients = p.gradients + segment * n;
    uint32_t all = 0, inside = 0;
    for (int64_t i = 0; i < n; ++i) {
      bool const own = labels.is_inside(b, c, i);
      all += own, memory.data[i] = Ranked<F>::of(gradients[i], i, own);
    }
    Ranked<F> const* const ranked = sorted(memory.data, memory.data + n, counts.data, n);
    double loss = 0;
    for (int64_t i = 0; i < n; ++i) {
      Ranked<F> const r = ranked[i];
      inside += r.inside();
      F const derivative = jaccard_derivative<F>(r.inside(), all, inside, uint32_t(i + 1) - inside);
      loss += double(r.error()) * derivative;
      gradients[r.pixel()] = derivative;
    }
    p.losses[segment] = F(loss);
  }
}

template <class T>
void lovasz_backward(LovaszBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  LovaszLabels const& labels = p.labels;
  for_each_pixel<T>(labels, begin, end, [&](auto width, int64_t b, int64_t i, auto label) {
    constexpr int N = decltype(width)::value;
    using V = Lanes<F, N>;
    int64_t const at = b * labels.classes * labels.pixels + i;
    F const* const grad = p.grad + b * labels.classes;
    gradients_of_pixels<F, LovaszMath<F, N>>(
        labels.hinge, labels.classes, label, [&](int64_t c) { return V(load<N>(p.logits + at + c * labels.pixels)); },
        [&](int64_t c) { return V(load<N>(p.gradients + at + c * labels.pixels) * grad[c]); },
        [&](int64_t c, V d) { store<N>(p.grad_logits + at + c * labels.pixels, d); });
  });
}

KV_INSTANTIATE(lovasz_errors, LovaszErrors)
KV_INSTANTIATE_COMPUTED(lovasz_gradients, LovaszGradients)
KV_INSTANTIATE(lovasz_backward, LovaszBackward)

}  // namespace kv::losses::KV_ISA
