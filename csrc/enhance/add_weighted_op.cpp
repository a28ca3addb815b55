// add_weighted: schema and entry, for CPU and CUDA.
#include "add_weighted.h"
#include "glue/glue.h"

namespace kv::enhance {
namespace {

using OptionalTensor = std::optional<Tensor>;

// `x`, copied only if it is not dense.
Tensor whole(Tensor const& x, Layout layout) {
  if (layout == Layout::planar) return dense(x);
  Tensor const y = as_layout(x, layout);
  return y.size(0) == 1 || y.stride(0) == y.size(2) * y.stride(2) ? y : as_layout(dense(y), layout);
}

Tensor add_weighted(Tensor const& input, Tensor const& other, OptionalTensor const& alpha, OptionalTensor const& beta,
                    OptionalTensor const& gamma, double a, double b, double c) {
  check_images("add_weighted", "input", input);
  bool const one = other.dim() == 4 && other.size(0) == 1 && input.size(0) > 1;  // one image broadcast to the batch
  bool same = other.dim() == 4 && (one || other.size(0) == input.size(0)) && other.device() == input.device() &&
              other.scalar_type() == input.scalar_type();
  for (int64_t axis = 1; axis < 4; ++axis) same = same && other.size(axis) == input.size(axis);
  KV_CHECK(same, "add_weighted: other differs in shape, dtype or device from input");
  Layout const layout = layout_of(input);
  bool const last = layout == Layout::channels_last;
  Tensor const x = whole(input, layout), y = whole(other, layout), result = empty_like(x, layout);
  bool by_image = one, by_channel = false;
  for (OptionalTensor const* weight : {&alpha, &beta, &gamma}) {
    if (!*weight) continue;
    Tensor const& w = **weight;
    KV_CHECK(w.dim() == 3 && (w.size(0) == 1 || w.size(0) == x.size(0)) && (w.size(1) == 1 || w.size(1) == x.size(1)) &&
                 w.size(2) == 1,
             "add_weighted: expected weights of shape (B, C, 1) or with axes of size 1");
    KV_CHECK(w.scalar_type() == (x.scalar_type() == ScalarType::Double ? ScalarType::Double : ScalarType::Float) &&
                 w.device() == x.device(),
             "add_weighted: expected weights of the type that is computed in, on the device of input");
    by_image = by_image || w.size(0) > 1;
    by_channel = by_channel || w.size(1) > 1;
  }
  int64_t const images = x.size(0), channels = x.size(1), pixels = x.size(2) * x.size(3), of_image = channels * pixels;
  dispatch_floating("add_weighted", x, [&](auto type) {
    using T = typename decltype(type)::type;
    // Rows as long as possible: the whole tensor, an image, or a channel.
    auto const rows = [&]<class U>(Type<U>, Tensor const& t) -> Planes<U> {
      int64_t const image = t.size(0) == images ? of_image : 0;
      auto* const data = static_cast<U*>(const_cast<void*>(t.const_data_ptr()));
      if (by_channel) return {data, images, channels, image, last ? 1 : pixels, 0, 1, pixels, last ? channels : 1};
      if (by_image) return {data, images, 1, image, 0, 0, 1, of_image, 1};
      return {data, 1, 1, 0, 0, 0, 1, images * of_image, 1};
    };
    auto const weight = [&](OptionalTensor const& w, double number) -> typename AddWeighted<T>::Weight {
      if (!w) return {nullptr, 0, 0, Compute<T>(number)};
      return {static_cast<Compute<T> const*>(w->const_data_ptr()), w->size(0) > 1 ? w->stride(0) : 0,
              w->size(1) > 1 ? w->stride(1) : 0, 0};
    };
    AddWeighted<T> const p{rows(Type<T const>{}, x), rows(Type<T const>{}, y), rows(Type<T>{}, result),
                           weight(alpha, a),         weight(beta, b),          weight(gamma, c)};
    KV_RUN(add_weighted, x, p, p.x.count() * ceil_div(p.x.width, kAddWeightedChunk), kAddWeightedChunk);
  });
  return result;
}

}  // namespace

// alpha input + beta other + gamma, by weights (B, C, 1) or by the numbers a, b and c instead.
KV_OPERATOR(add_weighted,
            "(Tensor input, Tensor other, Tensor? alpha, Tensor? beta, Tensor? gamma, float a, float b, float c)"
            " -> Tensor")

}  // namespace kv::enhance
