// The photometric error: schemas and entries, for CPU and CUDA.
#include "geometry/photometric_glue.h"
#include "geometry/transform/photometric.h"

namespace kv::geometry {
namespace {

// The checked arguments of both operators.
struct Arguments {
  Size from, to;
  SamplingOptions sampling;
  Matrix matrix;
  int64_t batch, channels, parts;

  Arguments(char const* op, Tensor const& source, Tensor const& target, Tensor const& matrix, bool align_corners,
            bool normalized)
      : from(checked(op, "source", source)),
        to(checked(op, "target", target)),
        sampling(op, Interpolation::bilinear, Padding::fill, align_corners, source, {}),
        matrix(op, matrix, source, source.size(0), false, normalized, align_corners, from, to),
        batch(source.size(0)),
        channels(source.size(1)),
        parts(coords_backward_parts(to, 1)) {
    KV_CHECK((target.size(0) == 1 || source.size(0) == target.size(0)) && source.size(1) == target.size(1) &&
                 source.scalar_type() == target.scalar_type() && source.device() == target.device(),
             op, ": target does not fit source");
    KV_CHECK(this->matrix.use.rows == 3, op, ": expected matrix of shape (B, 3, 3)");
  }
  static Size checked(char const* op, char const* name, Tensor const& x) {
    check_images(op, name, x);
    return checked_size(op, x);
  }
  template <class T>
  Photometric<T> of(Tensor const& source, Tensor const& target, int64_t distance, double eps,
                    Tensor const& sums) const {
    return {sampling.of<T>(from, matrix.coords<Compute<T>>()),
            images<T const>(source, batch),
            images<T const>(target, batch),
            parse_distance(sampling.op, distance),
            Compute<T>(eps),
            data_ptr<double>(sums),
            parts};
  }
};

std::tuple<Tensor, Tensor> photometric(Tensor const& source, Tensor const& target, Tensor const& matrix,
                                       int64_t distance, double eps, bool align_corners, bool normalized) {
  Arguments const a("photometric", source, target, matrix, align_corners, normalized);
  Tensor const sums = empty({a.batch, a.parts, kPhotometricSums}, source, Layout::planar, ScalarType::Double);
  Tensor const loss = empty({a.batch}, a.matrix.tensor), grad = empty({a.batch, 3, 3}, a.matrix.tensor);
  dispatch_floating("photometric", source, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    Photometric<T> const params = a.of<T>(source, target, distance, eps, sums);
    KV_RUN(photometric, source, params, a.batch * a.to.height, 8 * a.channels * a.to.width);
    PhotometricTotal<F> const total{params.coords, params.sums,       a.parts,          a.batch,
                                    a.channels,    data_ptr<F>(loss), data_ptr<F>(grad)};
    KV_RUN(photometric_total, source, total, a.batch, kPhotometricSums * a.parts);
  });
  return {loss, grad};
}

std::tuple<Tensor, Tensor, Tensor> photometric_normal_equations(Tensor const& source, Tensor const& target,
                                                                Tensor const& matrix, int64_t distance, double eps,
                                                                bool align_corners, bool normalized) {
  Arguments const a("photometric_normal_equations", source, target, matrix, align_corners, normalized);
  Tensor const sums = empty({a.batch, a.parts, kNormalSums}, source, Layout::planar, ScalarType::Double);
  Tensor const loss = empty({a.batch}, a.matrix.tensor), gradient = empty({a.batch, 8}, loss);
  Tensor const normal = empty({a.batch, 8, 8}, loss);
  dispatch_compute_dtype("photometric_normal_equations", source, [&](auto type) {
    using T = typename decltype(type)::type;
    PhotometricNormalEquations<T> params{a.of<T>(source, target, distance, eps, sums), 1, 0, 1, 0, 1, 0, 1, 0};
    if (normalized) {
      auto const to_unit = [&](int64_t size, T& scale, T& offset) {
        matrix::Unit const unit(size, align_corners);
        scale = T(unit.scale > 0 ? 1 / unit.scale : 0);
        offset = T(unit.scale > 0 ? -unit.offset / unit.scale : 0);
      };
      to_unit(a.to.width, params.x_scale, params.x_offset);
      to_unit(a.to.height, params.y_scale, params.y_offset);
      to_unit(a.from.width, params.u_scale, params.u_offset);
      to_unit(a.from.height, params.v_scale, params.v_offset);
    }
    KV_RUN(photometric_normal_equations, source, params, a.batch * a.to.height, 16 * a.channels * a.to.width);
    PhotometricNormalTotal<T> const total{
        params.sums, a.parts, a.batch, a.channels, data_ptr<T>(loss), data_ptr<T>(gradient), data_ptr<T>(normal)};
    KV_RUN(photometric_normal_total, source, total, a.batch, kNormalSums * a.parts);
  });
  return {normal, gradient, loss};
}

}  // namespace

#define KV_PHOTOMETRIC_ARGUMENTS \
  "(Tensor source, Tensor target, Tensor matrix, int distance, float eps, bool align_corners, bool normalized)"

KV_OPERATOR(photometric, KV_PHOTOMETRIC_ARGUMENTS " -> (Tensor, Tensor)")
KV_OPERATOR(photometric_normal_equations, KV_PHOTOMETRIC_ARGUMENTS " -> (Tensor, Tensor, Tensor)")

#undef KV_PHOTOMETRIC_ARGUMENTS

}  // namespace kv::geometry
