// Losses of segmentations on the CPU, in blocks of pixels: a block's logits are read class by class, and its
// exponentials stay in the cache. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "segmentation.h"

namespace kv::losses::KV_ISA {
namespace {

constexpr int kBlock = 256;  // pixels; divides the chunk sizes

// A block of pixels: for every class the exponentials of the logits relative to the maximum, their sums, labels and
// counts. Ignored pixels have logits of 0.
template <class T>
struct Block {
  using F = Compute<T>;
  Logits<T> const& logits;
  Scratch<F> exponentials;
  F maximum[kBlock], sum[kBlock], rest[kBlock];  // rest: the sum over all classes but the label
  F counts[kBlock], label[kBlock];
  int size = 0;

  explicit Block(Logits<T> const& logits) : logits(logits), exponentials(logits.classes * kBlock) {
    for (int i = 0; i < kBlock; ++i) maximum[i] = sum[i] = rest[i] = counts[i] = label[i] = 0;
    for (int64_t i = 0; i < logits.classes * kBlock; ++i) exponentials.data[i] = 0;
  }
  KV_HD F* of_class(int64_t c) { return exponentials.data + c * kBlock; }

  // Calls f(width, pixel) for all pixels of the block, in vectors that may extend past its end.
  template <class Call>
  KV_HD void for_each(Call f) const {
    for (int i = 0; i < size; i += kLanes<T>) f(Width<kLanes<T>>{}, i);
  }

  void read(int64_t sample, int64_t first, int64_t count) {
    size = int(count);
    int64_t const* const target = logits.labels(sample) + first;
    for (int i = 0; i < size; ++i) counts[i] = logits.counts(target[i]), label[i] = F(logits.class_of(target[i]));
    for (int i = size; i < kBlock; ++i) counts[i] = 0;  // vectors extend up to here
    for (int64_t c = 0; c < logits.classes; ++c) {
      T const* const from = logits.sample(sample) + c * logits.pixels + first;
      F* const to = of_class(c);
      for_each_vector<T>(0, size, [&](auto width, int64_t i) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        V const x = load<N>(counts + i) == 0 ? V{} : load<N>(from + i);
        store<N>(to + i, x);
      });
      for_each([&](auto width, int i) {
        constexpr int N = decltype(width)::value;
        Lanes<F, N> const x = load<N>(to + i), before = load<N>(maximum + i);
        store<N>(maximum + i, Lanes<F, N>(c == 0 ? x : x > before ? x : before));
      });
    }
  }

  // Replaces logits by exponentials.
  void exponentiate() {
    for (int i = 0; i < kBlock; ++i) sum[i] = rest[i] = 0;
    for (int64_t c = 0; c < logits.classes; ++c) {
      F* const row = of_class(c);
      for_each([&](auto width, int i) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        V const e = vexp2<F, N>(V((load<N>(row + i) - load<N>(maximum + i)) * kLog2E<F>));
        store<N>(row + i, e);
        store<N>(sum + i, V(load<N>(sum + i) + e));
        store<N>(rest + i, V(load<N>(rest + i) + (load<N>(label + i) == F(c) ? V{} : e)));
      });
    }
  }
};

// Calls f(sample, first pixel, count) for the blocks of a chunk in order.
template <class T, class Call>
KV_HD void for_each_block(Logits<T> const& logits, int64_t chunk, Call f) {
  int64_t const sample = chunk / logits.chunks;
  int64_t const first = chunk % logits.chunks * logits.chunk, last = min(first + logits.chunk, logits.pixels);
  for (int64_t at = first; at < last; at += kBlock) f(sample, at, min(int64_t(kBlock), last - at));
}

template <class F, int N>
struct Math {
  KV_HD static Lanes<F, N> exp(Lanes<F, N> x) { return vexp2<F, N>(x * kLog2E<F>); }
  KV_HD static Lanes<F, N> log(Lanes<F, N> x) { return vlog2<F, N>(x) / kLog2E<F>; }
};

// The focal losses of a block.
template <class T>
struct FocalPixels {
  using F = Compute<T>;
  FocalTerms<F> const& terms;
  F label[kBlock], factor[kBlock], loss[kBlock], derivative[kBlock], scale[kBlock];

  explicit FocalPixels(FocalTerms<F> const& terms) : terms(terms) {
    for (int i = 0; i < kBlock; ++i) label[i] = factor[i] = 0;
  }
  void evaluate(Block<T>& block, int64_t loss_of) {
    for (int i = 0; i < block.size; ++i) {
      int const c = int(block.label[i]);
      label[i] = block.of_class(c)[i];
      factor[i] = block.counts[i] * terms.factor(loss_of, c);
    }
    block.exponentiate();
    block.for_each([&](auto width, int i) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      V result, by_log, inverse;
      focal_of_pixels(load<N>(factor + i), terms.gamma, load<N>(label + i), load<N>(block.maximum + i),
                      load<N>(block.rest + i), Math<F, N>{}, result, by_log, inverse);
      V const counts = load<N>(block.counts + i);
      store<N>(loss + i, V(counts == 0 ? V{} : result));
      store<N>(derivative + i, V(counts == 0 ? V{} : by_log));
      store<N>(scale + i, inverse);
    });
  }
};

}  // namespace

template <class T>
void overlap(Overlap<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  constexpr int N = kLanes<T>;
  int64_t const classes = p.logits.classes;
  Block<T> block(p.logits);
  Scratch<F> sums(3 * classes * N);
  for (int64_t chunk = begin; chunk < end; ++chunk) {
    for (int64_t i = 0; i < 3 * classes * N; ++i) sums.data[i] = 0;
    for_each_block(p.logits, chunk, [&](int64_t sample, int64_t first, int64_t count) {
      block.read(sample, first, count);
      block.exponentiate();
      block.for_each([&](auto, int i) {
        using V = Lanes<F, N>;
        V const counts = load<N>(block.counts + i), label = load<N>(block.label + i);
        V const scale = counts == 0 ? V{} : V(counts / load<N>(block.sum + i));
        for (int64_t c = 0; c < classes; ++c) {
          V const x = load<N>(block.of_class(c) + i) * scale;
          V const e = counts == 0 ? V{} : x;
          F* const to = sums.data + 3 * c * N;
          store<N>(to, V(load<N>(to) + (label == F(c) ? e : V{})));
          store<N>(to + N, V(load<N>(to + N) + e));
          store<N>(to + 2 * N, V(load<N>(to + 2 * N) + (label == F(c) ? counts : V{})));
        }
      });
    });
    F* const partial = p.partial + chunk * 3 * classes;
    for (int64_t c = 0; c < classes; ++c)
      for (int k = 0; k < 3; ++k) {
        F sum = 0;
        for (int l = 0; l < N; ++l) sum += sums.data[(3 * c + k) * N + l];
        partial[k * classes + c] = sum;
      }
  }
}

template <class T>
void overlap_backward(OverlapBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  int64_t const classes = p.logits.classes;
  Block<T> block(p.logits);
  Scratch<F> of_both(classes), of_all(classes);
  F dot[kBlock];
  int64_t known = -1;  // the sample whose derivatives are current
  auto const compute_gradients = [&](int64_t sample) {
    int64_t const loss = sample / p.logits.batch;
    F const* const sums = p.sums + sample * 3 * classes;
    OverlapTotals<F> const totals = OverlapTotals<F>::of(p.terms, sums, classes, loss);
    for (int64_t c = 0; c < classes; ++c) {
      Region<F> const r = Region<F>::of(sums, classes, c);
      totals.gradients(p.terms, p.grad[loss] / F(p.logits.batch), p.terms.weight_of(loss, c, r), r, of_both.data[c],
                       of_all.data[c]);
    }
    known = sample;
  };
  auto const work = [&](int64_t sample, int64_t first, int64_t count) {
    if (sample != known) compute_gradients(sample);
    block.read(sample, first, count);
    block.exponentiate();
    auto const gradient = [&](auto width, int64_t c, int64_t i) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      return V((load<N>(block.label + i) == F(c) ? broadcast<N>(of_both.data[c]) : V{}) + of_all.data[c]);
    };
    for (int i = 0; i < kBlock; ++i) dot[i] = 0;
    for (int64_t c = 0; c < classes; ++c)
      block.for_each([&](auto width, int i) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        store<N>(dot + i, V(load<N>(dot + i) + load<N>(block.of_class(c) + i) * gradient(width, c, i)));
      });
    block.for_each([&](auto width, int i) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<F, N>;
      V const inverse = broadcast<N>(F(1)) / load<N>(block.sum + i);
      store<N>(block.sum + i, inverse);  // replaces the sum, which is no longer needed
      store<N>(dot + i, V(load<N>(dot + i) * inverse));
    });
    for (int64_t c = 0; c < classes; ++c) {
      F const* const e = block.of_class(c);
      T* const to = p.grad_logits + (sample * classes + c) * p.logits.pixels + first;
      for_each_vector<T>(0, count, [&](auto width, int64_t i) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        V const counts = load<N>(block.counts + i), probability = load<N>(e + i) * load<N>(block.sum + i);
        V const d = counts * probability * (gradient(width, c, i) - load<N>(dot + i));
        store<N>(to + i, V(counts == 0 ? V{} : d));
      });
    }
  };
  for (int64_t chunk = begin; chunk < end; ++chunk) for_each_block(p.logits, chunk, work);
}

template <class T>
void focal(Focal<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Block<T> block(p.logits);
  FocalPixels<T> pixels(p.terms);
  for (int64_t chunk = begin; chunk < end; ++chunk) {
    double sum = 0;
    for_each_block(p.logits, chunk, [&](int64_t sample, int64_t first, int64_t count) {
      block.read(sample, first, count);
      pixels.evaluate(block, sample / p.logits.batch);
      F* const out = p.map + sample * p.logits.pixels + first;
      for (int i = 0; i < block.size; ++i)
        if (p.map)
          out[i] = pixels.loss[i];
        else
          sum += pixels.loss[i];
    });
    if (!p.map) p.partial[chunk] = F(sum);
  }
}

template <class T>
void focal_backward(FocalBackward<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  Block<T> block(p.logits);
  FocalPixels<T> pixels(p.terms);
  auto const work = [&](int64_t sample, int64_t first, int64_t count) {
    int64_t const loss = sample / p.logits.batch;
    block.read(sample, first, count);
    pixels.evaluate(block, loss);
    F const* const g = p.of_sums ? p.grad + loss : p.grad + sample * p.logits.pixels + first;
    for (int i = 0; i < block.size; ++i) pixels.derivative[i] *= block.counts[i] == 0 ? F(0) : g[p.of_sums ? 0 : i];
    for (int64_t c = 0; c < p.logits.classes; ++c) {
      F const* const e = block.of_class(c);
      T* const to = p.grad_logits + (sample * p.logits.classes + c) * p.logits.pixels + first;
      for_each_vector<T>(0, count, [&](auto width, int64_t i) {
        constexpr int N = decltype(width)::value;
        using V = Lanes<F, N>;
        V const own = load<N>(block.label + i) == F(c) ? broadcast<N>(F(1)) : V{};
        V const d = load<N>(pixels.derivative + i) * (own - load<N>(e + i) * load<N>(pixels.scale + i));
        store<N>(to + i, V(load<N>(block.counts + i) == 0 ? V{} : d));
      });
    }
  };
  for (int64_t chunk = begin; chunk < end; ++chunk) for_each_block(p.logits, chunk, work);
}

KV_INSTANTIATE(overlap, Overlap)
KV_INSTANTIATE(overlap_backward, OverlapBackward)
KV_INSTANTIATE(focal, Focal)
KV_INSTANTIATE(focal_backward, FocalBackward)

}  // namespace kv::losses::KV_ISA
