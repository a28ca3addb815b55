// Chains of matrices and maps as one warp: schemas and entries, for CPU and CUDA.
#include "geometry/transform/composed/composed_warp.h"
#include "geometry/transform/sampling_glue.h"

namespace kv::geometry {
namespace {

using OptionalTensor = std::optional<Tensor>;

// The links in a schema, in the order of the chain. The arguments after the last link are None.
#define KV_LINKS "Tensor a, Tensor? b, Tensor? c, Tensor? d, Tensor? e, Tensor? f, Tensor? g, Tensor? h, "
#define KV_LINK_ARGUMENTS                                                                                              \
  Tensor const &a, OptionalTensor const &b, OptionalTensor const &c, OptionalTensor const &d, OptionalTensor const &e, \
      OptionalTensor const &f, OptionalTensor const &g, OptionalTensor const &h

struct Links {
  char const* op;
  std::vector<Tensor> links;  // dense
  int64_t batch = 1;

  Links(char const* op, Tensor const& first, std::initializer_list<OptionalTensor const*> others) : op(op) {
    add(first);
    for (OptionalTensor const* link : others)
      if (*link) add(**link);
  }
  void add(Tensor const& link) {
    Tensor const& first = links.empty() ? link : links[0];
    bool const is_matrix = link.dim() == 3 && link.size(1) == 3 && link.size(2) == 3;
    KV_CHECK(is_matrix || (link.dim() == 4 && link.size(1) == 2), op,
             ": expected links of shape (B, 3, 3) or (B, 2, H, W)");
    KV_CHECK(link.scalar_type() == first.scalar_type() && link.device() == first.device(), op,
             ": expected links of one type and device");
    if (!is_matrix) map_size(op, {link.size(2), link.size(3)});
    if (link.size(0) != 1) {
      KV_CHECK(batch == 1 || batch == link.size(0), op, ": expected links of 1 or ", batch, " samples, got ",
               link.size(0));
      batch = link.size(0);
    }
    links.push_back(dense(link));
  }
  // Checks that the links fit a batch of images.
  void check_images(Tensor const& image) {
    KV_CHECK(batch == 1 || batch == image.size(0), op, ": expected links of 1 or ", image.size(0), " samples, got ",
             batch);
    KV_CHECK(links[0].scalar_type() == compute_dtype(image) && links[0].device() == image.device(), op,
             ": expected links of the type that computes, on the device of the images");
    batch = image.size(0);
  }
  template <class F>
  Chain<F> chain() const {
    Chain<F> p{int(links.size()), {}};
    for (int k = 0; k < p.count; ++k) {
      Tensor const& link = links[size_t(p.count - 1 - k)];
      bool const is_map = link.dim() == 4;
      p.links[k] = {data_ptr<F const>(link), link.size(0) == 1 ? 0 : link.stride(0), is_map ? int(link.size(2)) : 0,
                    is_map ? int(link.size(3)) : 0};
    }
    return p;
  }
  Tensor coords(Size const& size) const {
    Tensor const result = empty({batch, 2, size.height, size.width}, links[0]);
    dispatch_compute_dtype(op, result, [&](auto type) {
      using F = typename decltype(type)::type;
      ComposedCoords<F> const params{chain<F>(), images<F>(result, batch)};
      KV_RUN(composed_coords, result, params, batch * size.height, 8 * params.chain.count * size.width);
    });
    return result;
  }
};

Tensor composed_coords(KV_LINK_ARGUMENTS, std::vector<int64_t> size) {
  constexpr char const* op = "composed_coords";
  return Links(op, a, {&b, &c, &d, &e, &f, &g, &h}).coords(map_size(op, size));
}

// The gradients of the links, in the order of the arguments. Those of None and those that are not needs_grad are empty.
using Gradients = std::tuple<Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor>;

Gradients composed_coords_backward(Tensor const& grad, KV_LINK_ARGUMENTS, std::vector<int64_t> needs_grad) {
  constexpr char const* op = "composed_coords_backward";
  Links const links(op, a, {&b, &c, &d, &e, &f, &g, &h});
  int64_t const batch = links.batch, count = int64_t(links.links.size());
  KV_CHECK(grad.dim() == 4 && grad.size(0) == batch && grad.size(1) == 2 &&
               grad.scalar_type() == links.links[0].scalar_type() && grad.device() == links.links[0].device(),
           op, ": expected grad of shape (B, 2, h, w), of the type and device of the links");
  KV_CHECK(int64_t(needs_grad.size()) == kMaxLinks, op, ": expected ", kMaxLinks, " flags");
  Size const size = map_size(op, {grad.size(2), grad.size(3)});
  Tensor grads[kMaxLinks];
  for (int i = 0; i < kMaxLinks; ++i) {
    if (i >= count || !needs_grad[size_t(i)]) {
      grads[i] = empty({batch, 0}, grad);
      continue;
    }
    Tensor const& link = links.links[size_t(i)];
    std::vector<int64_t> sizes{batch};
    for (int64_t axis = 1; axis < link.dim(); ++axis) sizes.push_back(link.size(axis));
    grads[i] = empty(sizes, grad);
    torch::stable::zero_(grads[i]);
  }
  dispatch_compute_dtype(op, grad, [&](auto type) {
    using F = typename decltype(type)::type;
    ComposedCoordsBackward<F> params{links.chain<F>(), images<F const>(grad, batch), {}, nullptr, 1};
    for (int64_t k = 0; k < count; ++k) {
      int64_t const i = count - 1 - k;
      params.grads[k] = needs_grad[size_t(i)] ? data_ptr<F>(grads[i]) : nullptr;
    }
#if defined(KV_CUDA)
    KV_CHECK(batch <= 65535, op, ": expected at most 65535 samples");
    params.parts = ceil_div(size.height * size.width, kBackwardPixels);
    Tensor const sums = empty({batch, params.parts, count, 9}, grad, Layout::planar, ScalarType::Double);
    params.sums = data_ptr<double>(sums);
#endif
    KV_RUN(composed_coords_backward, grad, params, batch, 32 * count * size.height * size.width);
  });
  return {grads[0], grads[1], grads[2], grads[3], grads[4], grads[5], grads[6], grads[7]};
}

Tensor composed_warp(Tensor const& image, KV_LINK_ARGUMENTS, OptionalTensor const& fill, std::vector<int64_t> sides,
                     int64_t interpolation, int64_t padding, bool align_corners) {
  constexpr char const* op = "composed_warp";
  kv::check_images(op, "image", image);
  Size const source = checked_size(op, image), size = map_size(op, sides);
  Links links(op, a, {&b, &c, &d, &e, &f, &g, &h});
  links.check_images(image);
  SamplingOptions const options(op, interpolation, padding, align_corners, image, fill);
  int64_t const batch = image.size(0), channels = image.size(1);
  Tensor const y = empty({batch, channels, size.height, size.width}, image, layout_of(image));
  if (y.numel() == 0) return y;
  dispatch_floating_and_uint8(op, image, [&]<class T>(Type<T>) {
    using F = Compute<T>;
    ComposedWarp<T> params{{options.of<T>(source, {}), images<T const>(image, batch), images<T>(y, batch)},
                           links.chain<F>()};
    check_planes(op, params.x);
    check_planes(op, params.y);
#if defined(KV_CUDA)
    // There is no fused kernel for float64 and bicubic: the coordinates are stored.
    if (sizeof(T) == 8 || options.interpolation == Interpolation::bicubic) {
      Tensor const coords = links.coords(size);
      Images<F const> const map = images<F const>(coords, batch);
      params.coords.x = params.coords.y = map;
      params.coords.y.data += map.channel_stride;
      params.coords.scale[0] = params.coords.scale[1] = 1;
      Sample<T> const& sampling = params;
      KV_RUN(sample, image, sampling, 1, 0);
      return;
    }
    if constexpr (sizeof(T) < 8) KV_RUN(composed_warp, image, params, 1, 0);
#else
    KV_RUN(composed_warp, image, params, batch * bands_of(size.height, size.width), 8 * channels * kBandPixels);
#endif
  });
  return y;
}

}  // namespace

// Where the pixels of a result of that size read after a chain of links, matrices (B, 3, 3) and displacements
// (B, 2, H, W), the first one first: (B, 2, h, w). composed_warp.py explains them.
KV_OPERATOR(composed_coords, "(" KV_LINKS "SymInt[] size) -> Tensor")
KV_OPERATOR(composed_coords_backward,
            "(Tensor grad, " KV_LINKS
            "int[] needs_grad) -> (Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor, Tensor)")
KV_OPERATOR(composed_warp, "(Tensor image, " KV_LINKS
                           "Tensor? fill, SymInt[] size, int interpolation, int padding, bool align_corners) -> Tensor")

#undef KV_LINKS
#undef KV_LINK_ARGUMENTS

}  // namespace kv::geometry
