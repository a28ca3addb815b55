// The photometric distance: schema and entry, for CPU and CUDA alike.
#include "photometric.h"
#include "photometric_glue.h"

namespace kv {
namespace {

std::tuple<Tensor, Tensor> photometric(Tensor const& source, Tensor const& target, Tensor const& matrix,
                                       std::string const& distance, double eps, bool align_corners, bool normalized) {
  char const* const op = "photometric";
  check_images(op, "source", source);
  check_images(op, "target", target);
  KV_CHECK((target.size(0) == 1 || source.size(0) == target.size(0)) && source.size(1) == target.size(1) &&
               source.scalar_type() == target.scalar_type() && source.device() == target.device(),
           op, ": target does not fit source");
  Size const from = size_of(op, source), to = size_of(op, target);
  SamplingArguments const a(op, "bilinear", "fill", align_corners, source, {});
  Matrix const m(op, matrix, source, false, normalized, align_corners, from, to);
  KV_CHECK(m.use.rows == 3, op, ": expected matrix of shape (B, 3, 3)");
  int64_t const batch = source.size(0), channels = source.size(1), parts = slope_parts(to, 1);
  Tensor const sums = empty({batch, parts, kPhotometricSums}, source, Layout::planar, ScalarType::Double);
  Tensor const loss = empty({batch}, m.matrix), grad = empty({batch, 3, 3}, m.matrix);
  for_floats(op, source, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Places<F> const places = m.places<F>();
    Photometric<T> const params{a.of<T>(from, places),
                                images<T const>(source, batch),
                                images<T const>(target, batch),
                                distance_of(op, distance),
                                F(eps),
                                data_of<double>(sums),
                                parts};
    KV_RUN(photometric, source, params, batch * to.height, 8 * channels * to.width);
    PhotometricTotal<F> const total{
        places, data_of<double const>(sums), parts, batch, channels, data_of<F>(loss), data_of<F>(grad)};
    KV_RUN(photometric_total, source, total, batch, kPhotometricSums * parts);
  });
  return {loss, grad};
}

}  // namespace

KV_OPERATOR(photometric,
            "(Tensor source, Tensor target, Tensor matrix, str distance, float eps, bool align_corners, "
            "bool normalized) -> (Tensor, Tensor)")

}  // namespace kv
