// Canny: schemas and entries, for CPU and CUDA. Images are read plane by plane; they have one channel as a rule.
#include "canny.h"
#include "glue/glue.h"

namespace kv::filters {
namespace {

std::tuple<Tensor, Tensor> canny_suppress(Tensor const& input, double low, double high, double eps) {
  check_images("canny_suppress", "input", input);
  Layout const layout = Layout::planar;
  Tensor const x = as_layout(input, layout), magnitude = empty_like(x, layout), edges = empty_like(x, layout);
  dispatch_floating("canny_suppress", x, [&](auto type) {
    using T = typename decltype(type)::type;
    using F = Compute<T>;
    CannySuppress<T> const params{
        planes<T const>(x, layout), planes<T>(magnitude, layout), planes<T>(edges, layout), F(low), F(high), F(eps)};
    KV_RUN(canny_suppress, x, params, params.x.rows(), params.x.row_size());
  });
  return {magnitude, edges};
}

Tensor canny_hysteresis(Tensor const& edges) {
  check_images("canny_hysteresis", "edges", edges);
  KV_CHECK(edges.size(2) * edges.size(3) <= INT32_MAX, "canny_hysteresis: expected at most 2^31 pixels a plane");
  Layout const layout = Layout::planar;
  Tensor const e = as_layout(edges, layout), result = empty_like(e, layout);
#if defined(KV_CUDA)
  Tensor const labels = empty(e.sizes(), e, Layout::planar, ScalarType::Int);
  auto* const memory = static_cast<int32_t*>(labels.mutable_data_ptr());
#else
  int32_t* const memory = nullptr;
#endif
  dispatch_floating("canny_hysteresis", e, [&](auto type) {
    using T = typename decltype(type)::type;
    CannyHysteresis<T> const params{planes<T const>(e, layout), planes<T>(result, layout), memory};
    KV_RUN(canny_hysteresis, e, params, params.edges.count(), params.edges.height * params.edges.width);
  });
  return result;
}

}  // namespace

KV_OPERATOR(canny_suppress, "(Tensor input, float low, float high, float eps) -> (Tensor magnitude, Tensor edges)")
KV_OPERATOR(canny_hysteresis, "(Tensor edges) -> Tensor")

}  // namespace kv::filters
