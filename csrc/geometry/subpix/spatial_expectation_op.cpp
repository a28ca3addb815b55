// Mean coordinates: schemas and entries, for CPU and CUDA.
#include <math.h>

#include "geometry/subpix/spatial_expectation.h"
#include "glue/glue.h"

namespace kv::geometry {
namespace {

// The maps of images (B, C, H, W), contiguous.
template <class T>
HeatMaps<T> heat_maps(Tensor const& x, bool softmax, double scale, bool normalized) {
  using F = Compute<T>;
  int64_t const height = x.size(2), width = x.size(3);
  return {data_ptr<T const>(x),
          x.size(0) * x.size(1),
          height,
          width,
          clamp(kExpectationChunk / width, int64_t(1), height),
          CoordAxis<F>::of(width, normalized),
          CoordAxis<F>::of(height, normalized),
          softmax,
          F(scale)};
}

void check_maps(char const* op, Tensor const& x, bool softmax, double scale) {
  check_images(op, "input", x);
  KV_CHECK(x.size(2) * x.size(3) < int64_t(1) << 31, op, ": expected less than 2^31 pixels in a plane");
  KV_CHECK(!softmax || scale > 0, op, ": expected scale to be positive, got ", scale);
}

// The coordinates (B, C, 2), x before y. For a softmax also (B, C, 2): its largest value, and the sum of exponentials
// relative to that value.
std::tuple<Tensor, Tensor> spatial_expectation(Tensor const& input, bool softmax, double scale, bool normalized) {
  check_maps("spatial_expectation", input, softmax, scale);
  Tensor const x = dense(input);
  Tensor const coords = empty({x.size(0), x.size(1), 2}, x, Layout::planar, compute_dtype(x));
  Tensor const parts = empty({x.size(0), x.size(1), 2}, x, Layout::planar, compute_dtype(x));
  dispatch_floating("spatial_expectation", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    auto const maps = heat_maps<T>(x, softmax, scale, normalized);
    Tensor const partial = empty({maps.planes, maps.chunks(), 4}, x, Layout::planar, compute_dtype(x));
    SpatialExpectation<T> const params{maps, reinterpret_cast<ExpectationSums<F>*>(data_ptr<F>(partial)),
                                       data_ptr<F>(coords), data_ptr<F>(parts)};
    KV_RUN(spatial_expectation, x, params, maps.planes * maps.chunks(), 4 * maps.rows * maps.width);
#if !defined(KV_CUDA)
    for (int64_t plane = 0; plane < maps.planes; ++plane) {
      auto sums = ExpectationSums<F>::nothing(softmax);
      for (int64_t i = 0; i < maps.chunks(); ++i)
        sums.add(params.partial[plane * maps.chunks() + i], softmax, [&](F d) { return F(::exp(double(d) * scale)); });
      sums.store(params.coords + 2 * plane, params.parts + 2 * plane, softmax);
    }
#endif
  });
  return {coords, parts};
}

Tensor spatial_expectation_backward(Tensor const& grad, Tensor const& coords, Tensor const& parts, Tensor const& input,
                                    bool softmax, double scale, bool normalized) {
  constexpr char const* op = "spatial_expectation_backward";
  check_maps(op, input, softmax, scale);
  Tensor const x = dense(input);
  auto const checked = [&](char const* name, Tensor const& t) {
    KV_CHECK(t.dim() == 3 && t.size(0) == x.size(0) && t.size(1) == x.size(1) && t.size(2) == 2 &&
                 t.scalar_type() == compute_dtype(x) && t.device() == x.device(),
             op, ": expected ", name, " to be that of the coords");
    return dense(t);
  };
  Tensor const g = checked("grad", grad), means = checked("coords", coords), of_sum = checked("parts", parts);
  Tensor const grad_x = empty({x.size(0), x.size(1), x.size(2), x.size(3)}, x);
  dispatch_floating(op, x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    SpatialExpectationBackward<T> const params{heat_maps<T>(x, softmax, scale, normalized), data_ptr<F const>(g),
                                               data_ptr<F const>(means), data_ptr<F const>(of_sum),
                                               data_ptr<T>(grad_x)};
    KV_RUN(spatial_expectation_backward, x, params, params.maps.planes * params.maps.chunks(),
           2 * params.maps.rows * params.maps.width);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(spatial_expectation, "(Tensor input, bool softmax, float scale, bool normalized) -> (Tensor, Tensor)")
KV_OPERATOR(spatial_expectation_backward,
            "(Tensor grad, Tensor coords, Tensor parts, Tensor input, bool softmax, float scale, bool normalized) -> "
            "Tensor")

}  // namespace kv::geometry
