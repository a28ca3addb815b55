// Histograms with compact kernels on the CPU. Compiled once per instruction set.
#include "core/lanes.h"
#include "core/scratch.h"
#include "image_histogram2d.h"

namespace kv::enhance::KV_ISA {
namespace {

constexpr int kChunk = 512;

// Calls f(i, bin + 1, t) for the samples that count. `bin`, at least -1, is the last bin whose center is not above
// sample i; t is the distance from that center in bins.
template <class T, class F>
KV_HD void for_each_sample(ImageHistogram2d<T> const& p, T const* x, F f) {
  int32_t bin[kChunk];
  T t[kChunk];
  for (int64_t begin = 0; begin < p.samples; begin += kChunk) {
    int64_t const n = min(int64_t(kChunk), p.samples - begin);
    for_each_vector<T>(0, n, [&](auto width, int64_t i) {
      constexpr int N = decltype(width)::value;
      using V = Lanes<T, N>;
      V const position = (load<N>(x + begin + i) - p.low) * p.inverse + T(0.5), whole = vfloor(position);
      V const inside = (whole >= 0) & (whole <= T(p.bins + 1)) ? whole : broadcast<N>(T(-1));
      store<N>(t + i, V(position - whole));
      if constexpr (N == 1)
        bin[i] = int32_t(inside);
      else
        write_lanes<N>(bin + i, __builtin_convertvector(inside, Lanes<int32_t, N>));
    });
    for (int64_t i = 0; i < n; ++i) f(begin + i, bin[i], t[i]);
  }
}

}  // namespace

template <class T>
void image_histogram2d(ImageHistogram2d<T> const& p, int64_t begin, int64_t end) {
  Scratch<double> const sums(p.bins + 4);  // two additional bins at either end
  double* const count = sums.data + 1;
  for (int64_t row = begin; row < end; ++row) {
    for (int64_t k = 0; k < p.bins + 4; ++k) sums.data[k] = 0;
    for_each_sample(p, p.x + row * p.samples, [&](int64_t, int32_t bin, T t) {
      if (bin < 0) return;
      Between<T> const b(t, p.kernel);
      count[bin] += b.first_weight;
      count[bin + 1] += b.next_weight;
      if (t == 0 && p.kernel == HistogramKernel::uniform) count[bin - 1] += 1;
    });
    for (int64_t k = 0; k < p.bins; ++k) p.counts[row * p.bins + k] = T(count[k + 1]);
  }
}

template <class T>
void image_histogram2d_backward(ImageHistogram2dBackward<T> const& b, int64_t begin, int64_t end) {
  ImageHistogram2d<T> const& p = b.forward;
  Scratch<T> const grads(p.bins + 4);
  T* const grad = grads.data + 1;
  for (int64_t row = begin; row < end; ++row) {
    grad[-1] = grad[0] = grad[p.bins + 1] = grad[p.bins + 2] = 0;
    for (int64_t k = 0; k < p.bins; ++k) grad[k + 1] = b.grad[row * p.bins + k];
    T* const grad_x = b.grad_x + row * p.samples;
    for_each_sample(p, p.x + row * p.samples, [&](int64_t i, int32_t bin, T t) {
      grad_x[i] = bin < 0 ? T(0) : p.inverse * between_backward(t, p.kernel, grad[bin - 1], grad[bin], grad[bin + 1]);
    });
  }
}

KV_INSTANTIATE_COMPUTED(image_histogram2d, ImageHistogram2d)
KV_INSTANTIATE_COMPUTED(image_histogram2d_backward, ImageHistogram2dBackward)

}  // namespace kv::enhance::KV_ISA
