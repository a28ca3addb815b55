// Mutual information: schemas and entries, for CPU and CUDA.
#include <limits>

#include "glue/batch.h"
#include "mutual_information.h"

namespace kv::losses {
namespace {

constexpr int64_t kMaxBins = 1 << 14;
// CUDA: as many chunks as the GPU can run blocks, each with enough samples.
constexpr int64_t kBlocks = 512, kSamplesPerChunk = 1 << 10;

// Two signals (rows, samples), float32 or float64, and their masks.
struct TwoSignals {
  Tensor x, y;
  std::optional<Tensor> x_mask, y_mask;
  int64_t rows, samples;

  TwoSignals(char const* op, Tensor const& first, Tensor const& second, std::optional<Tensor> const& of_first,
             std::optional<Tensor> const& of_second)
      : x(dense(first)), y(dense(second)), rows(first.dim() == 2 ? first.size(0) : 0) {
    KV_CHECK(first.dim() == 2 && first.size(1) > 0 && first.scalar_type() == compute_dtype(first), op,
             ": expected input (rows, samples) of float32 or float64");
    samples = first.size(1);
    check_sizes(op, "other", second, first, {rows, samples});
    auto const checked = [&](std::optional<Tensor> const& mask) -> std::optional<Tensor> {
      if (!mask) return {};
      bool const fits = mask->dim() == 2 && (mask->size(0) == rows || mask->size(0) == 1) && mask->size(1) == samples;
      KV_CHECK(fits && mask->scalar_type() == ScalarType::Bool && mask->device() == first.device(), op,
               ": expected masks (rows or 1, samples) of bool on the device of input");
      return dense(*mask);
    };
    x_mask = checked(of_first), y_mask = checked(of_second);
  }

  template <class F>
  Signal<F> signal(Tensor const& of, std::optional<Tensor> const& mask) const {
    auto const stride = [&](Tensor const& t) { return t.size(0) == 1 ? 0 : samples; };
    return {data_ptr<F const>(of), mask ? data_ptr<uint8_t const>(*mask) : nullptr, stride(of),
            mask ? stride(*mask) : 0};
  }
  int64_t chunks() const {
    return min((kBlocks + rows - 1) / max(rows, int64_t(1)), ceil_div(samples, kSamplesPerChunk));
  }
  template <class Call>
  void for_type(Call f) const {
    x.scalar_type() == ScalarType::Double ? f(Type<double>{}) : f(Type<float>{});
  }
};

template <class F>
Binning<F> binning_of(char const* op, int64_t kernel, int64_t bins, double radius) {
  KV_CHECK(bins >= 2 && bins <= kMaxBins && radius > 0, op, ": expected 2 to ", kMaxBins, " bins and a radius above 0");
  KV_CHECK(kernel >= 0 && kernel <= 2, op,
           ": kernel must be one of 0 (xu), 1 (rectangular), 2 (truncated_gaussian); got ", kernel);
  bool const gaussian = BinKernel(kernel) == BinKernel::truncated_gaussian;
  return {int(bins),
          BinKernel(kernel),
          F(radius),
          F(1 / radius),
          F(gaussian ? 0.39894228040143268 / radius : 1.0),  // 1 / sqrt(2 pi)
          std::numeric_limits<F>::epsilon()};
}

// The losses (rows), their gradients (rows, bins, bins) and the ranges (rows, 4).
std::tuple<Tensor, Tensor, Tensor> mutual_information(Tensor const& input, Tensor const& other,
                                                      std::optional<Tensor> const& input_mask,
                                                      std::optional<Tensor> const& other_mask, int64_t kernel,
                                                      int64_t bins, double radius, bool normalized) {
  constexpr char const* op = "mutual_information";
  TwoSignals const x(op, input, other, input_mask, other_mask);
  binning_of<double>(op, kernel, bins, radius);  // checked before memory is allocated
  Tensor const loss = empty({x.rows}, x.x), gradients = empty({x.rows, bins, bins}, x.x),
               ranges = empty({x.rows, 4}, x.x);
  x.for_type([&](auto type) {
    using F = typename decltype(type)::type;
    MutualInformation<F> params{x.signal<F>(x.x, x.x_mask),
                                x.signal<F>(x.y, x.y_mask),
                                x.rows,
                                x.samples,
                                binning_of<F>(op, kernel, bins, radius),
                                std::numeric_limits<F>::epsilon(),
                                normalized,
                                data_ptr<F>(loss),
                                data_ptr<F>(gradients),
                                data_ptr<F>(ranges),
                                x.chunks(),
                                nullptr,
                                nullptr,
                                0,
                                nullptr};
#if defined(KV_CUDA)
    Tensor const partial = empty({x.rows, params.chunks, 4}, x.x), sums = empty({x.rows, 2, bins}, x.x);
    Tensor const counts = empty({x.rows, bins, bins}, x.x, Layout::planar, ScalarType::Long);
    params.partial = data_ptr<F>(partial), params.sums = data_ptr<F>(sums);
    params.counts = data_ptr<unsigned long long>(counts);
    int of_samples = 1;
    while (x.samples >> of_samples) ++of_samples;
    params.bits = min(sizeof(F) == 4 ? 30 : 52, 62 - of_samples);
#endif
    KV_RUN(mutual_information, x.x, params, x.rows, 64 * x.samples + 16 * bins * bins);
  });
  return {loss, gradients, ranges};
}

// The gradient with respect to `input`, or to `other`.
Tensor mutual_information_backward(Tensor const& grad, Tensor const& gradients, Tensor const& ranges,
                                   Tensor const& input, Tensor const& other, std::optional<Tensor> const& input_mask,
                                   std::optional<Tensor> const& other_mask, int64_t kernel, int64_t bins, double radius,
                                   bool normalized, bool by_other) {
  constexpr char const* op = "mutual_information_backward";
  (void)normalized;  // already part of the gradients
  KV_CHECK(grad.dim() == 1, op, ": expected grad (rows)");
  int64_t const rows = grad.size(0);
  check_sizes(op, "input", input, grad, {rows, input.dim() == 2 ? input.size(1) : 0});
  TwoSignals const x(op, expand_batch(input, rows), other, input_mask, other_mask);
  check_sizes(op, "gradients", gradients, grad, {rows, bins, bins});
  check_sizes(op, "ranges", ranges, grad, {rows, 4});
  Tensor const g = dense(grad), s = expand_batch(gradients, rows), r = expand_batch(ranges, rows),
               out = empty({rows, x.samples}, x.x);
  x.for_type([&](auto type) {
    using F = typename decltype(type)::type;
    MutualInformationBackward<F> params{x.signal<F>(x.x, x.x_mask),
                                        x.signal<F>(x.y, x.y_mask),
                                        rows,
                                        x.samples,
                                        binning_of<F>(op, kernel, bins, radius),
                                        by_other,
                                        data_ptr<F const>(g),
                                        data_ptr<F const>(s),
                                        data_ptr<F const>(r),
                                        data_ptr<F>(out),
                                        x.chunks(),
                                        nullptr};
#if defined(KV_CUDA)
    Tensor const partial = empty({rows, params.chunks, 4}, x.x);
    params.partial = data_ptr<F>(partial);
#endif
    KV_RUN(mutual_information_backward, x.x, params, rows, 64 * x.samples);
  });
  return out;
}

}  // namespace

KV_OPERATOR(mutual_information,
            "(Tensor input, Tensor other, Tensor? input_mask, Tensor? other_mask, int kernel, int bins, float radius, "
            "bool normalized) -> (Tensor, Tensor, Tensor)")
KV_OPERATOR(mutual_information_backward,
            "(Tensor grad, Tensor count_gradients, Tensor ranges, Tensor input, Tensor other, Tensor? input_mask, "
            "Tensor? other_mask, int kernel, int bins, float radius, bool normalized, bool by_other) -> Tensor")

}  // namespace kv::losses
