// Images behind a layer: schemas and entries, for CPU and CUDA.
#include "augmentation/corruption/layer.h"
#include "augmentation/lists/listed_images.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), or what stands for a list; layer (B or 1, C or 1, H, W), or layers of any number and size with
// windows (B, 3) int64, or the packed layers (N,) of a list; factors (B or 1, C or 1, 4). Layers and factors are of the
// type that is computed in.
struct LayerArguments {
  char const* op;
  Tensor const &images, &layer;
  OptionalTensor windows;
  Tensor factors;
  bool is_packed;

  LayerArguments(char const* op, Tensor const& images, Tensor const& layer, OptionalTensor const& windows,
                 Tensor const& factors)
      : op(op), images(images), layer(layer), windows(windows), factors(factors), is_packed(layer.dim() == 1) {
    check_images(op, "images", images);
    int64_t const batch = images.size(0), channels = images.size(1);
    auto const is_one_or = [](int64_t size, int64_t all) { return size == all || size == 1; };
    auto const is_like_images = [&](Tensor const& t) {
      return t.scalar_type() == compute_dtype(images) && t.device() == images.device();
    };
    auto const fits = [&](Tensor const& t) {
      return is_like_images(t) && is_one_or(t.size(1), channels) && (windows || is_one_or(t.size(0), batch));
    };
    KV_CHECK(factors.dim() == 3 && fits(factors) && is_one_or(factors.size(0), batch) && factors.size(2) == 4, op,
             ": expected factors of shape (B, C, 4), of the type that is computed in, on the device of images");
    bool const is_layer = is_packed ? is_like_images(layer) && layer.stride(0) == 1 && !windows
                                    : layer.dim() == 4 && fits(layer) && layer.numel() > 0;
    KV_CHECK(images.numel() == 0 || is_layer, op,
             ": expected a layer of the type that is computed in, on the device of images");
    if (windows)
      KV_CHECK(windows->dim() == 2 && windows->size(0) == batch && windows->size(1) == 3 &&
                   windows->scalar_type() == ScalarType::Long && windows->device() == images.device(),
               op, ": expected int64 windows of shape (B, 3) on the device of images");
    KV_CHECK(images.is_cpu() || (batch <= 65535 && images.size(2) * images.size(3) <= INT32_MAX / 2), op,
             ": expected at most 65535 images, and 2^30 pixels in each");
    this->factors = dense(factors);
    if (windows) this->windows = dense(*windows);
  }
  // Where the packed layers of images (C, H, W) begin, in units; nothing of others, whose sizes are checked.
  std::vector<int64_t> begins(Tensors const& list) const {
    std::vector<int64_t> begins;
    if (!is_packed) {
      for (Tensor const& x : list) check_size(x.size(1), x.size(2), false);
      return begins;
    }
    begins.push_back(0);
    for (Tensor const& x : list)
      begins.push_back(begins.back() + PackedLayers<kMaxListed>::units(x.size(1), x.size(2)));
    KV_CHECK(begins.back() <= UINT32_MAX && layer.numel() == kLayerUnit * begins.back(), op,
             ": expected packed layers of the sizes of images");
    return begins;
  }
  void check_size(int64_t height, int64_t width, bool is_equal) const {
    int64_t const tall = layer.size(2), wide = layer.size(3);
    KV_CHECK(is_equal ? tall == height && wide == width : tall >= height && wide >= width, op,
             ": expected a layer of the size of images");
  }

  // All but the images.
  template <class T>
  AddLayer<T> params() const {
    using F = Compute<T>;
    AddLayer<T> p{};
    p.channels = images.size(1);
    p.layer = data_ptr<F const>(layer), p.factors = data_ptr<F const>(factors);
    p.windows = windows ? data_ptr<int64_t const>(*windows) : nullptr;
    if (is_packed) {
      p.layer_strides[3] = 1;
    } else {
      p.layers = layer.size(0), p.layer_height = layer.size(2), p.layer_width = layer.size(3);
      for (int i = 0; i < 4; ++i) p.layer_strides[i] = layer.stride(i);
      if (layer.size(1) == 1) p.layer_strides[1] = 0;
    }
    p.factor_strides[0] = factors.size(0) > 1 ? 4 * factors.size(1) : 0;
    p.factor_strides[1] = factors.size(1) > 1 ? 4 : 0;
    p.full_range = sizeof(T) == 1 ? 255 : 1;
    return p;
  }
};

// Fills the begins of `count` layers from `first` on.
template <int Count>
void set_packed(PackedLayers<Count>& packed, std::vector<int64_t> const& begins, int64_t first, int count) {
  packed.are_packed = !begins.empty();
  for (int b = 0; packed.are_packed && b < count; b += 2) packed.begin[b / 2] = uint32_t(begins[size_t(first + b)]);
}

Tensor add_layer(Tensor const& images, Tensor const& layer, OptionalTensor const& windows, Tensor const& factors) {
  LayerArguments const arguments("add_layer", images, layer, windows, factors);
  Layout const layout = layout_of(images);
  Tensor const x = as_layout(images, layout), y = empty_like(x, layout);
  if (images.numel() == 0) return y;
  KV_CHECK(!arguments.is_packed, arguments.op, ": expected a layer of shape (B, C, H, W)");
  arguments.check_size(images.size(2), images.size(3), !windows);
  dispatch_floating_and_uint8(arguments.op, images, [&]<class T>(Type<T>) {
    AddLayer<T> params = arguments.params<T>();
    params.x = planes<T const>(x, layout), params.y = planes<T>(y, layout);
    KV_RUN(add_layer, images, params, params.x.rows(), 4 * params.x.row_size());
  });
  return y;
}

Tensors behind_layer(char const* op, Tensors const& images, OptionalTensor const& chosen, Tensor const& layer,
                     OptionalTensor const& windows, Tensor const& factors) {
  ListedImages const list(op, images, chosen);
  LayerArguments const arguments(list.kept.op, list.like(), layer, windows, factors);
  std::vector<int64_t> const begins = arguments.begins(images);
  int64_t first = 0;
  dispatch_floating_and_uint8(arguments.op, list.like(), [&]<class T>(Type<T>) {
    list.filter<AddLayerList<T>>(arguments.params<T>(), 4, [&](AddLayerList<T>& p, [[maybe_unused]] int64_t cost) {
      set_packed(p.packed, begins, first, p.list.count);
      first += p.list.count;
      KV_RUN(add_layer_list, list.like(), p, p.list.items, cost);
    });
  });
  return list.kept.results;
}

Tensors add_layer_list(Tensors const& images, OptionalTensor const& chosen, Tensor const& layer,
                       OptionalTensor const& windows, Tensor const& factors) {
  return behind_layer("add_layer_list", images, chosen, layer, windows, factors);
}

// The gradients of the images. The list has the images, and behind them the gradients of the results.
Tensors add_layer_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen, Tensor const& layer,
                                OptionalTensor const& windows, Tensor const& factors) {
  constexpr char const* op = "add_layer_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen);
  LayerArguments const arguments(op, list.like(), layer, windows, factors);
  std::vector<int64_t> const begins = arguments.begins(images);
  Tensors const grads = list.in_layout_of_images(given);
  dispatch_floating(op, list.like(), [&]<class T>(Type<T>) {
    AddLayerBackward<T> const all{arguments.params<T>(), {}, {}};
    list.gradients<AddLayerBackwardList<T>>(all, grads, 6, [&](auto& p, size_t first, [[maybe_unused]] int64_t cost) {
      set_packed(p.packed, begins, int64_t(first), p.count);
      KV_RUN(add_layer_list_backward, list.like(), p, p.items, cost);
    });
  });
  return list.kept.results;
}

// The largest values of images, and the factors of fog that follow from these, with their slopes.
struct FogOfImages {
  Tensor brightest, factors, slopes;

  FogOfImages(char const* op, Tensors const& images, Tensor const& numbers) : brightest(steps::brightest(images)) {
    int64_t const count = int64_t(images.size());
    Tensor const& x = images[0];
    KV_CHECK(numbers.dim() == 2 && (numbers.size(0) == count || numbers.size(0) == 1) && numbers.size(1) == 3 &&
                 numbers.scalar_type() == brightest.scalar_type() && numbers.device() == x.device(),
             op, ": expected numbers of shape (B, 3), of the type that is computed in, on the device of images");
    Tensor const own = dense(numbers);
    factors = empty({count, 1, 4}, brightest), slopes = empty({count, 1, 4}, brightest);
    dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
      using F = Compute<T>;
      FogFactors<T> const p{
          data_ptr<F const>(brightest), data_ptr<F const>(own),     data_ptr<F>(factors), data_ptr<F>(slopes), count,
          own.size(0) > 1 ? 3 : 0,      F(sizeof(T) == 1 ? 255 : 1)};
      KV_RUN(fog_factors, x, p, count, 16);
    });
  }
};

Tensors fog_list(Tensors const& images, OptionalTensor const& chosen, Tensor const& layer, Tensor const& numbers) {
  FogOfImages const fog("fog_list", images, numbers);
  return behind_layer("fog_list", images, chosen, layer, {}, fog.factors);
}

Tensors fog_list_backward(Tensors const& images_and_grads, OptionalTensor const& chosen, Tensor const& layer,
                          Tensor const& numbers) {
  constexpr char const* op = "fog_list_backward";
  auto const [images, given] = halves(op, images_and_grads);
  ListedImages const list(op, images, chosen);
  FogOfImages const fog(op, images, numbers);
  LayerArguments const arguments(op, list.like(), layer, {}, fog.factors);
  std::vector<int64_t> const begins = arguments.begins(images);
  Tensors const grads = list.in_layout_of_images(given);
  auto const items_of = []([[maybe_unused]] Tensor const& x) {
#if defined(KV_CUDA)
    return ceil_div(x.size(1) * x.size(2), int64_t(kFogPixels));
#else
    return int64_t(1);
#endif
  };
  dispatch_floating(op, list.like(), [&]<class T>(Type<T>) {
    using F = Compute<T>;
    FogBackward<T> const all{
        {arguments.params<T>(), {}, {}}, data_ptr<F const>(fog.slopes), data_ptr<F const>(fog.brightest)};
    list.for_each_gradient_table<FogBackwardList<T>>(all, grads, items_of, [&](FogBackwardList<T>& p, size_t first) {
      set_packed(p.packed, begins, int64_t(first), p.count);
      Tensor const sums = empty({p.items, 2}, list.like(), Layout::planar, ScalarType::Double);
      p.sums = data_ptr<double>(sums);
      KV_RUN(fog_list_backward, list.like(), p, p.items, 12 * list.like().numel() / list.like().size(0));
    });
  });
  return list.kept.results;
}

}  // namespace

KV_OPERATOR(add_layer, "(Tensor images, Tensor layer, Tensor? windows, Tensor factors) -> Tensor")
// The same of images (C, H, W) of different sizes, as a list. `chosen` (B,) float32: images whose value is 0 stay as
// they are.
KV_OPERATOR(add_layer_list,
            "(Tensor[] images, Tensor? chosen, Tensor layer, Tensor? windows, Tensor factors) -> Tensor[]")
KV_OPERATOR(add_layer_list_backward,
            "(Tensor[] images_and_grads, Tensor? chosen, Tensor layer, Tensor? windows, Tensor factors) -> Tensor[]")

// The same of images behind fog; numbers (B or 1, 3).
KV_OPERATOR(fog_list, "(Tensor[] images, Tensor? chosen, Tensor layer, Tensor numbers) -> Tensor[]")
KV_OPERATOR(fog_list_backward, "(Tensor[] images_and_grads, Tensor? chosen, Tensor layer, Tensor numbers) -> Tensor[]")

}  // namespace kv::augmentation
