// Gaussian blurs of lists of images of different sizes whose windows grow with the image: schema and entry, for CPU and
// CUDA.
#include "augmentation/lists/listed_images.h"
#include "filters/separable_glue.h"

namespace kv::filters {
namespace {

template <class T>
void run_with_sides([[maybe_unused]] Tensor const& like, SeparableList<T> const& p, [[maybe_unused]] int64_t cost) {
  KV_RUN(separable_list, like, p, p.list.items, cost);
}

}  // namespace
}  // namespace kv::filters

namespace kv::augmentation {
namespace {

constexpr char const* op = "gaussian_blur2d_of_sides_list";

// Sigmas are `sigma` heights and widths of each image, windows three of them to each side. The results are one block.
Tensors gaussian_blur2d_of_sides_list(Tensors const& images, double sigma, int64_t border) {
  KV_CHECK(sigma > 0 && sigma <= 0.1, op, ": expected sigma above 0 and at most 0.1 sides, got ", sigma);
  return {steps::gaussian_blur_of_sides(images, {{sigma}, {sigma}}, to_border(op, border))};
}

}  // namespace

Tensor steps::gaussian_blur_of_sides(Tensors const& images, filters::SideBlur const& blur, Border border) {
  OptionalTensor const all_images;
  ListedImages const list(op, images, all_images, false, true);
  Tensor const& like = list.like();
  int64_t height = 1, width = 1;
  for (Tensor const& x : images) height = std::max(height, x.size(1)), width = std::max(width, x.size(2));
  dispatch_floating(op, like, [&]<class T>(Type<T>) {
    filters::AxisWeights const weights{nullptr, 1, true, 0, 1};
    auto all = filters::separable_of<T>(weights, weights, border, true, false, list.planes());
    all.by_sides = blur;
    all.by_sides.is_used = true;
    blur.x.set(all.kx, width), blur.y.set(all.ky, height);
#if defined(KV_CUDA)
    filters::check_taps(op, all.ky.size, all.kx.size);
#endif
    list.filter<filters::SeparableList<T>>(all, (all.kx.size + all.ky.size) / 4, [&](auto const& p, int64_t cost) {
      filters::run_with_sides(like, p, cost);
    });
  });
  return list.kept.block;
}

KV_OPERATOR(gaussian_blur2d_of_sides_list, "(Tensor[] images, float sigma, int border) -> Tensor[]")

}  // namespace kv::augmentation
