// Contrast of channels: schemas and entries, for CPU and CUDA. Lists are in augmentation/lists.
#include "channel_contrast.h"
#include "enhance/plane_views.h"

namespace kv::enhance {
namespace {

Tensor channel_contrast(Tensor const& input, double factor) {
  check_planes("channel_contrast", input);
  Layout const layout = layout_of(input);
  Tensor const x = dense_planes(input, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8("channel_contrast", x, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    ChannelContrast<T> p{};
    p.x = flat_planes<T const>(x, layout), p.y = flat_planes<T>(y, layout);
    Tensor const memory = working_memory<F>(x, p.x.count() * contrast_chunks<T>(p.x.width));
    p.factor = F(factor), p.most = sizeof(T) == 1 ? 255 : 1;
    p.partial = static_cast<F*>(memory.mutable_data_ptr());
    KV_RUN(channel_contrast, x, p, p.x.count(), 2 * p.x.width);
  });
  return y;
}

Tensor channel_contrast_backward(Tensor const& grad, Tensor const& input, double factor) {
  constexpr char const* op = "channel_contrast_backward";
  check_planes(op, input);
  check_like(op, "grad", grad, input);
  Layout const layout = layout_of(input);
  Tensor const x = dense_planes(input, layout), g = dense_planes(as_layout(grad, layout), layout),
               grad_x = empty_like(x, layout);
  dispatch_floating(op, x, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    ChannelContrastBackward<T> p{};
    p.grad = flat_planes<T const>(g, layout), p.x = flat_planes<T const>(x, layout);
    p.grad_x = flat_planes<T>(grad_x, layout);
    int64_t const chunks = p.x.count() * contrast_chunks<T>(p.x.width);
    Tensor const memory = working_memory<F>(x, 2 * chunks);
    p.factor = F(factor);
    p.partial = static_cast<F*>(memory.mutable_data_ptr());
    p.partial_grads = p.partial + chunks;
    KV_RUN(channel_contrast_backward, x, p, p.x.count(), 3 * p.x.width);
  });
  return grad_x;
}

}  // namespace

KV_OPERATOR(channel_contrast, "(Tensor input, float factor) -> Tensor")
KV_OPERATOR(channel_contrast_backward, "(Tensor grad, Tensor input, float factor) -> Tensor")

}  // namespace kv::enhance
