// Drops: schemas and entries, for CPU and CUDA.
#include "augmentation/corruption/drops.h"
#include "augmentation/lists/list_steps.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// Calls run(Drops<T>) with the parameters (B or 1, 3) of `batch` layers (B, 1, H, W), float32 or float64, or of a list
// of such.
template <class Run>
void run_drops(char const* op, Tensor const& layers, int64_t batch, Tensor const& parameters, Run run) {
  KV_CHECK(layers.scalar_type() == compute_dtype(layers), op, ": expected float32 or float64 layers");
  KV_CHECK(parameters.dim() == 2 && (parameters.size(0) == batch || parameters.size(0) == 1) &&
               parameters.size(1) == 3 && parameters.scalar_type() == layers.scalar_type() &&
               parameters.device() == layers.device(),
           op, ": expected parameters of shape (B, 3), of the type and device of layers");
  Tensor const own = dense(parameters);
  auto const with = [&]<class T>(Type<T>) {
    run(Drops<T>{nullptr, data_ptr<T const>(own), batch, 0, 0, own.size(0) > 1 ? 3 : 0});
  };
  layers.scalar_type() == ScalarType::Double ? with(Type<double>{}) : with(Type<float>{});
}
// The same with layers (B, 1, H, W).
template <class Run>
void run_drops_of_batch(char const* op, Tensor const& layers, Tensor const& parameters, Run run) {
  int64_t const batch = layers.size(0), height = layers.size(2), width = layers.size(3);
  KV_CHECK(layers.size(1) == 1, op, ": expected layers of shape (B, 1, H, W)");
  KV_CHECK(height * width <= INT32_MAX / 2 && (layers.is_cpu() || (batch <= 65535 && height <= 32 * 65535)), op,
           ": expected at most 2^30 pixels, and on CUDA 65535 layers");
  Tensor const x = dense(layers);
  run_drops(op, layers, batch, parameters, [&]<class T>(Drops<T> drops) {
    drops.layer = data_ptr<T const>(x), drops.height = height, drops.width = width;
    run(drops);
  });
}
bool has_shape_of(Tensor const& depths, Tensor const& layers) {
  bool fits =
      depths.dim() == layers.dim() && depths.scalar_type() == ScalarType::Byte && depths.device() == layers.device();
  for (int i = 0; fits && i < layers.dim(); ++i) fits = depths.size(i) == layers.size(i);
  return fits;
}

int64_t drop_bands(Tensor const& layers) {
  return layers.numel() ? layers.size(0) * ceil_div(layers.size(2), kDropBand) : 0;
}

Tensor drop_depths(Tensor const& layers, Tensor const& parameters) {
  check_images("drop_depths", "layers", layers);
  Tensor const y = empty({layers.size(0), 1, layers.size(2), layers.size(3)}, layers, Layout::planar, ScalarType::Byte);
  run_drops_of_batch("drop_depths", layers, parameters, [&]<class T>(Drops<T> const& drops) {
    DropDepths<T> const params{drops, data_ptr<uint8_t>(y)};
    KV_RUN(drop_depths, layers, params, drop_bands(layers), 2000 * drops.width);
  });
  return y;
}

// Depths (B, 1, H, W) of bytes.
Tensor drop_reliefs(Tensor const& layers, Tensor const& parameters, Tensor const& depths) {
  constexpr char const* op = "drop_reliefs";
  check_images(op, "layers", layers);
  KV_CHECK(has_shape_of(depths, layers), op, ": expected uint8 depths of the shape and device of layers");
  Tensor const own = dense(depths), y = empty({layers.size(0), 1, layers.size(2), layers.size(3)}, layers);
  run_drops_of_batch(op, layers, parameters, [&]<class T>(Drops<T> const& drops) {
    DropReliefs<T> const params{drops, data_ptr<uint8_t const>(own), data_ptr<T>(y)};
    KV_RUN(drop_reliefs, layers, params, drop_bands(layers), 500 * drops.width);
  });
  return y;
}

Tensor mark_stains(Tensor const& layers, Tensor const& parameters) {
  check_images("mark_stains", "layers", layers);
  Tensor const y = empty({layers.size(0), 1, layers.size(2), layers.size(3)}, layers);
  run_drops_of_batch("mark_stains", layers, parameters, [&]<class T>(Drops<T> const& drops) {
    MarkStains<T> const params{drops, data_ptr<T>(y)};
    KV_RUN(mark_stains, layers, params, drop_bands(layers), 32 * drops.width);
  });
  return y;
}

// Layers (1, H, W) of a list, or depths of such; the results have their sizes.
struct ListedLayers {
  char const* op;
  Tensor like;     // of the first layer, as a batch
  Tensors layers;  // dense
  Tensors depths;  // or none
  Tensors results;

  ListedLayers(char const* op, Tensors const& given, Tensors const& given_depths, std::optional<ScalarType> type,
               bool in_block)
      : op(op) {
    check_image_list(op, "layers", given);
    KV_CHECK(given[0].size(0) == 1, op, ": expected layers of shape (1, H, W)");
    KV_CHECK(given_depths.empty() || given_depths.size() == given.size(), op, ": expected depths of all layers");
    like = as_batch(given[0]);
    std::vector<int64_t> sides;
    sides.reserve(2 * given.size()), layers.reserve(given.size()), depths.reserve(given_depths.size());
    for (size_t b = 0; b < given.size(); ++b) {
      Tensor const& x = given[b];
      sides.push_back(x.size(1)), sides.push_back(x.size(2));
      KV_CHECK(x.size(1) <= INT32_MAX / 2 / x.size(2), op, ": expected at most 2^30 pixels");
      layers.push_back(dense(x));
      if (given_depths.empty()) continue;
      KV_CHECK(has_shape_of(given_depths[b], x), op, ": expected uint8 depths of the shape and device of layers");
      depths.push_back(dense(given_depths[b]));
    }
    geometry::ListSizes const sizes(op, sides, given.size());
    results = in_block ? geometry::list_in_block(like, 1, sizes, given.size(), type)
                       : geometry::empty_list(like, 1, sizes, given.size(), Layout::planar, type);
  }
  // Fills tables of at most kMaxListed layers and calls run(table).
  template <class List, class T, class Run>
  void for_each_table(Drops<T> const& drops, Run run) const {
    List p{};
    p.all.drops = drops;
    for (size_t begin = 0; begin < layers.size(); begin += kMaxListed) {
      p.count = int(std::min(layers.size() - begin, size_t(kMaxListed)));
      p.all.drops.parameters = drops.parameters + int64_t(begin) * drops.parameter_stride;
      int64_t items = 0;
      for (int i = 0; i < p.count; ++i) {
        size_t const b = begin + size_t(i);
        Tensor const& x = layers[b];
        p.listed[i] = {x.const_data_ptr(),
                       depths.empty() ? nullptr : depths[b].const_data_ptr(),
                       results[b].mutable_data_ptr(),
                       int(x.size(1)),
                       int(x.size(2)),
                       int(items)};
        items += ceil_div(x.size(1), kDropBand);
        KV_CHECK(items <= INT32_MAX, op, ": expected fewer layers");
      }
      p.items = int(items);
      run(p);
    }
  }
};

Tensors depths_of(Tensors const& layers, Tensor const& parameters, bool in_block) {
  ListedLayers const list("drop_depths_list", layers, {}, ScalarType::Byte, in_block);
  run_drops(list.op, list.like, int64_t(layers.size()), parameters, [&]<class T>(Drops<T> const& drops) {
    list.for_each_table<DropDepthsList<T>>(
        drops, [&](auto const& p) { KV_RUN(drop_depths_list, list.like, p, p.items, 2000 * list.like.size(3)); });
  });
  return list.results;
}

Tensors reliefs_of(Tensors const& layers, Tensor const& parameters, Tensors const& depths, bool in_block) {
  ListedLayers const list("drop_reliefs_list", layers, depths, {}, in_block);
  KV_CHECK(!depths.empty(), list.op, ": expected depths of all layers");
  run_drops(list.op, list.like, int64_t(layers.size()), parameters, [&]<class T>(Drops<T> const& drops) {
    list.for_each_table<DropReliefsList<T>>(
        drops, [&](auto const& p) { KV_RUN(drop_reliefs_list, list.like, p, p.items, 500 * list.like.size(3)); });
  });
  return list.results;
}

Tensors stains_of(Tensors const& layers, Tensor const& parameters, bool in_block) {
  ListedLayers const list("mark_stains_list", layers, {}, {}, in_block);
  run_drops(list.op, list.like, int64_t(layers.size()), parameters, [&]<class T>(Drops<T> const& drops) {
    list.for_each_table<MarkStainsList<T>>(
        drops, [&](auto const& p) { KV_RUN(mark_stains_list, list.like, p, p.items, 32 * list.like.size(3)); });
  });
  return list.results;
}

Tensors drop_depths_list(Tensors const& layers, Tensor const& parameters) {
  return depths_of(layers, parameters, false);
}
Tensors drop_reliefs_list(Tensors const& layers, Tensor const& parameters, Tensors const& depths) {
  return reliefs_of(layers, parameters, depths, false);
}
Tensors mark_stains_list(Tensors const& layers, Tensor const& parameters) {
  return stains_of(layers, parameters, false);
}

}  // namespace

Tensors steps::drop_depths(Tensors const& layers, Tensor const& parameters) {
  return depths_of(layers, parameters, true);
}
Tensors steps::drop_reliefs(Tensors const& layers, Tensor const& parameters, Tensors const& depths) {
  return reliefs_of(layers, parameters, depths, true);
}
Tensors steps::mark_stains(Tensors const& layers, Tensor const& parameters) {
  return stains_of(layers, parameters, true);
}

KV_OPERATOR(drop_depths, "(Tensor layers, Tensor parameters) -> Tensor")
KV_OPERATOR(drop_reliefs, "(Tensor layers, Tensor parameters, Tensor depths) -> Tensor")
KV_OPERATOR(mark_stains, "(Tensor layers, Tensor parameters) -> Tensor")
// The same of layers (1, H, W) of different sizes.
KV_OPERATOR(drop_depths_list, "(Tensor[] layers, Tensor parameters) -> Tensor[]")
KV_OPERATOR(drop_reliefs_list, "(Tensor[] layers, Tensor parameters, Tensor[] depths) -> Tensor[]")
KV_OPERATOR(mark_stains_list, "(Tensor[] layers, Tensor parameters) -> Tensor[]")

}  // namespace kv::augmentation
