// The operations of policies: schemas and entries, for CPU and CUDA.
#include "augmentation/auto/operations.h"
#include "augmentation/warp_and_color_glue.h"
#include "color/lists/program_list_glue.h"
#include "enhance/plane_views.h"
#include "geometry/transform/lists/warp_list_glue.h"

namespace kv::augmentation {
namespace {

// A tensor whose planes are dense.
template <class T>
Images<T> dense_images(Tensor const& x, Layout layout) {
  int64_t const channels = x.size(1), step = layout == Layout::channels_last ? channels : 1;
  return {data_ptr<T>(x), x.stride(0),  step > 1 ? 1 : x.stride(1), x.size(3) * step, step, x.size(0), x.size(2),
          x.size(3),      int(channels)};
}

// Images of a layout whose planes are dense; without colors, all values of an image are one row.
Tensor dense_in(Tensor const& x, Layout layout) {
  bool const is_row = layout == Layout::channels_last || x.size(1) == 1 || x.stride(1) == x.size(2) * x.size(3);
  return x.size(1) == kColors || is_row ? enhance::dense_planes(x, layout) : dense(x);
}

// Operations of several steps are (B, S), those of one step (B,).
void check_arguments(char const* op, Tensor const& images, Tensor const& operation, Tensor const& value,
                     bool several_steps) {
  enhance::check_planes(op, images);
  auto const fits = [&](Tensor const& t, ScalarType type) {
    bool const same = t.dim() == 1 + several_steps && t.size(0) == images.size(0) &&
                      (!several_steps || (t.size(1) > 0 && t.size(1) == operation.size(1)));
    return same && t.scalar_type() == type && t.device() == images.device();
  };
  KV_CHECK(images.size(1) > 0, op, ": expected images with channels");
  KV_CHECK(images.size(0) * images.size(1) <= INT32_MAX / 64, op, ": expected fewer than 2^25 planes, got ",
           images.size(0) * images.size(1));
  KV_CHECK(fits(operation, ScalarType::Long), op, ": expected operations of shape ", several_steps ? "(B, S)" : "(B,)",
           ", int64, on the device of images");
  KV_CHECK(fits(value, ScalarType::Float), op, ": expected a float32 value of each operation");
}

// How operations that move pixels read images of a size, by matrices (B, 3, 3).
template <class T>
void set_warp(geometry::Sampling<T>& p, int64_t batch, geometry::Size const& size, float const* matrices) {
  p.interpolation = geometry::Interpolation::bilinear;
  p.x_axis = {int(size.width), geometry::Padding::fill, true};
  p.y_axis = {int(size.height), geometry::Padding::fill, true};
  p.images = batch;
  p.coords.matrices = matrices;
  p.coords.matrix_stride = 9;
  p.coords.use = {3, true, false, true, size, size};
}

// The operations of a step and their values, from sample b on; they are (B,) of one step, or (B, S).
template <class T>
void set_operations(ApplyOperations<T>& p, Tensor const& operation, Tensor const& value, int64_t step, int64_t b) {
  p.operation_stride = operation.stride(0);
  p.operation =
      data_ptr<int64_t const>(operation) + (step > 0 ? step * operation.stride(1) : 0) + b * p.operation_stride;
  p.value_stride = value.stride(0);
  p.value = data_ptr<float const>(value) + (step > 0 ? step * value.stride(1) : 0) + b * p.value_stride;
}

// A step on dense images; operation and value are (B,) of one step, or (B, S).
template <class T>
ApplyOperations<T> operations_on(char const* op, Tensor const& x, Layout layout, Tensor const& operation,
                                 Tensor const& value, int64_t step, float* matrices,
                                 [[maybe_unused]] Tensor const& measured) {
  ApplyOperations<T> p{};
  p.warp.x = dense_images<T const>(x, layout);
  geometry::check_planes(op, p.warp.x);
  set_warp<T>(p.warp, x.size(0), {x.size(2), x.size(3)}, matrices);
  p.matrices = matrices;
  set_operations(p, operation, value, step, 0);
#if defined(KV_CUDA)
  p.measured = data_ptr<float>(measured);
#endif
  return p;
}

// Calls run(Type<T>{}) with the type of images that get gradients: on the CPU float32.
template <class Run>
void dispatch_differentiable(char const* op, Tensor const& x, Run run) {
#if defined(KV_CUDA)
  if (x.scalar_type() == ScalarType::Half) return run(Type<Half>{});
  if (x.scalar_type() == ScalarType::BFloat16) return run(Type<BFloat16>{});
#endif
  KV_CHECK(x.scalar_type() == ScalarType::Float, op, ": no kernel for this dtype");
  run(Type<float>{});
}

// What CUDA measures of the planes of images, and nothing on the CPU.
Tensor measured_of([[maybe_unused]] Tensor const& images, [[maybe_unused]] int64_t numbers) {
#if defined(KV_CUDA)
  return empty({images.size(0) * images.size(1), numbers}, images, Layout::planar, ScalarType::Float);
#else
  return {};
#endif
}

// Runs all steps of a policy, by turns into two buffers. Images (B, C, H, W); operation and value (B, S). Returns the
// results and the matrices (S, B, 3, 3) of the steps.
std::tuple<Tensor, Tensor> apply_operations(Tensor const& images, Tensor const& operation, Tensor const& value) {
  constexpr char const* op = "apply_operations";
  check_arguments(op, images, operation, value, true);
  geometry::checked_size(op, images);
  int64_t const batch = images.size(0), steps = operation.size(1);
  Layout const layout = layout_of(images);
  Tensor const matrices = empty({steps, batch, 3, 3}, images, Layout::planar, ScalarType::Float);
  Tensor const measured = measured_of(images, kMeasured);
  Tensor x = dense_in(images, layout), others;
  for (int64_t step = 0; step < steps; ++step) {
    Tensor const y = step < 2 ? empty_like(x, layout) : others;
    dispatch_joined(op, x, [&]<class T>(Type<T>) {
      float* const own = data_ptr<float>(matrices) + step * batch * 9;
      auto p = operations_on<T>(op, x, layout, operation, value, step, own, measured);
      p.warp.y = dense_images<T>(y, layout);
      KV_RUN(apply_operations, x, p, batch, 6 * x.size(1) * x.size(2) * x.size(3));
    });
    others = step > 0 ? x : Tensor();
    x = y;
  }
  return {x, matrices};
}

using Listed = std::vector<ListedImage>;

// Memory for images of a list, dense, whole items of mixtures for each, and without tensors of their own, which cost
// the host more than a launch.
struct ImageBlock {
  Tensor memory;
  Listed images;

  // As large as the results, which are listed.
  ImageBlock(geometry::KeptSizes const& kept, Listed const& results) {
    int64_t const channels = kept.largest.size(1);
    auto const values_of = [&](ListedImage const& x) { return items_of(channels, x.height, x.width) * kMixedValues; };
    int64_t values = 0;
    for (ListedImage const& x : results) values += values_of(x);
    memory = empty({values}, kept.largest);
    char* data = static_cast<char*>(memory.mutable_data_ptr());
    images = results;
    for (ListedImage& x : images) {
      x.data = data;
      data += values_of(x) * memory.element_size();
    }
  }
  // Of kMixedValues.
  static int64_t items_of(int64_t channels, int64_t height, int64_t width) {
    return ceil_div(channels * height * width, int64_t(kMixedValues));
  }
};

// Images (C, h, w) of a list in dense rows, and what runs steps of a policy on them.
struct ListedSteps {
  geometry::KeptSizes const& kept;
  Tensor const &operation, &value, matrices, measured;
  Tensors dense;  // keeps the memory
  Listed images, results;
  int tiles;

  ListedSteps(geometry::KeptSizes const& kept, Tensors const& given, Tensor const& operation, Tensor const& value)
      : kept(kept),
        operation(operation),
        value(value),
        matrices(
            empty({operation.size(1), int64_t(given.size()), 3, 3}, kept.largest, Layout::planar, ScalarType::Float)),
        measured(measured_of(kept.largest, kMeasured)),
        dense(color::in_pixel_rows(given, kept.layout)),
        tiles(geometry::tiles_per_block_of(sizes(), given.size())) {
    for (Tensor const& x : dense) images.push_back(geometry::checked_planes(kept.op, listed(x)));
    for (Tensor const& y : kept.results) results.push_back(listed(y));
  }
  geometry::ListSizes sizes() const { return {kept.op, kept.sides, kept.results.size()}; }

  // Steps [begin, end) from the images to `to`; those between are in `to` and `others` by turns.
  void run(int64_t begin, int64_t end, Listed const& to, Listed const& others) const {
    geometry::ListSizes const all = sizes();
    Tensor const& like = kept.largest;
    Listed const* from = &images;
    for (int64_t step = begin; step < end; ++step) {
      Listed const& next = (end - step) % 2 == 1 ? to : others;
      dispatch_joined(kept.op, like, [&]<class T>(Type<T>) {
        ApplyOperationsList<T> p;
        p.list.interleaved = kept.interleaved();
        p.tiles_per_block = tiles;
        auto const items_of = [&](size_t b) { return geometry::kOnCuda ? geometry::blocks_of(all[b], tiles) : 1; };
        auto const run = [&](size_t first) {
          int64_t const b = int64_t(first);
          float* const own = data_ptr<float>(matrices) + (step * int64_t(images.size()) + b) * 9;
          p.all = {};
          p.all.warp.x.channels = int(like.size(1));
          set_warp<T>(p.all.warp, 1, {1, 1}, own);
          set_operations(p.all, operation, value, step, b);
          p.all.matrices = own;
#if defined(KV_CUDA)
          p.all.measured = data_ptr<float>(measured) + b * like.size(1) * kMeasured;
#endif
          KV_RUN(apply_operations_list, like, p, p.list.items, 6 * like.size(1) * like.size(2) * like.size(3));
        };
        geometry::for_each_table(
            p.list, images.size(), [&](size_t b) { return (*from)[b]; }, [&](size_t b) { return next[b]; }, items_of,
            run);
      });
      from = &next;
    }
  }
};

// All steps of a policy on a list of images (C, h, w). The matrices (S, B, 3, 3) follow the results.
Tensors apply_operations_list(Tensors const& images, Tensor const& operation, Tensor const& value) {
  constexpr char const* op = "apply_operations_list";
  geometry::KeptSizes const kept(op, images);
  check_arguments(op, kept.largest, operation, value, true);
  ListedSteps const steps(kept, images, operation, value);
  std::optional<ImageBlock> between;
  if (operation.size(1) > 1) between.emplace(kept, steps.results);
  steps.run(0, operation.size(1), steps.results, between ? between->images : Listed{});
  Tensors results = kept.results;
  results.push_back(steps.matrices);
  return results;
}

// Mixtures of images (C, h, w) of a list with chains of as many operations each. The weights (B, 1 + chains) are those
// of the image and of its chains.
Tensors mix_operations_list(Tensors const& images, Tensor const& operation, Tensor const& value,
                            Tensor const& weights) {
  constexpr char const* op = "mix_operations_list";
  geometry::KeptSizes const kept(op, images);
  Tensor const& like = kept.largest;
  check_arguments(op, like, operation, value, true);
  size_t const count = images.size();
  KV_CHECK(weights.dim() == 2 && weights.size(0) == int64_t(count) && weights.size(1) > 1 &&
               weights.scalar_type() == ScalarType::Float && weights.device() == like.device(),
           op, ": expected float32 weights of shape (B, 1 + chains)");
  int64_t const chains = weights.size(1) - 1, depth = operation.size(1) / chains;
  KV_CHECK(depth * chains == operation.size(1), op, ": expected chains of as many operations each");
  ListedSteps const steps(kept, images, operation, value);
  geometry::ListSizes const sizes = steps.sizes();
  ImageBlock const of_chain(kept, steps.results), between(kept, steps.results);
  Tensor const sums = empty({of_chain.memory.size(0)}, like, Layout::planar, ScalarType::Float);
  for (int64_t chain = 0; chain < chains; ++chain) {
    steps.run(chain * depth, (chain + 1) * depth, of_chain.images, between.images);
    dispatch_joined(op, like, [&]<class T>(Type<T>) {
      MixOperations<T> p;
      p.list.interleaved = kept.interleaved();
      p.channels = int(like.size(1));
      p.weight_stride = weights.stride(0);
      p.is_first = chain == 0, p.is_last = chain + 1 == chains;
      auto const items_of = [&](size_t b) { return ImageBlock::items_of(p.channels, sizes[b].height, sizes[b].width); };
      auto const run = [&](size_t first) {
        p.chains = static_cast<T const*>(of_chain.images[first].data);
        p.sums = data_ptr<float>(sums) + (p.chains - data_ptr<T const>(of_chain.memory));
        p.image_weights = data_ptr<float const>(weights) + int64_t(first) * p.weight_stride;
        p.weights = p.image_weights + (1 + chain) * weights.stride(1);
        KV_RUN(mix_operations_list, like, p, p.list.items, kMixedValues);
      };
      geometry::for_each_table(
          p.list, count, [&](size_t b) { return steps.images[b]; }, [&](size_t b) { return steps.results[b]; },
          items_of, run);
    });
  }
  return kept.results;
}

// One step, whose results have gradients; operation and value are (B,). Returns the results and the matrices (B, 3, 3).
std::tuple<Tensor, Tensor> apply_operation(Tensor const& images, Tensor const& operation, Tensor const& value) {
  constexpr char const* op = "apply_operation";
  check_arguments(op, images, operation, value, false);
  geometry::checked_size(op, images);
  Layout const layout = layout_of(images);
  Tensor const x = dense_in(images, layout), y = empty_like(x, layout);
  Tensor const matrices = empty({x.size(0), 3, 3}, x, Layout::planar, ScalarType::Float);
  Tensor const measured = measured_of(x, kMeasured);
  dispatch_joined(op, x, [&]<class T>(Type<T>) {
    auto p = operations_on<T>(op, x, layout, operation, value, 0, data_ptr<float>(matrices), measured);
    p.warp.y = dense_images<T>(y, layout);
    KV_RUN(apply_operations, x, p, x.size(0), 6 * x.size(1) * x.size(2) * x.size(3));
  });
  return {y, matrices};
}

// The gradient of the images of apply_operation, in planes.
Tensor apply_operation_backward(Tensor const& grad, Tensor const& images, Tensor const& operation,
                                Tensor const& value) {
  constexpr char const* op = "apply_operation_backward";
  check_arguments(op, images, operation, value, false);
  bool same = grad.dim() == 4 && grad.scalar_type() == images.scalar_type() && grad.device() == images.device();
  for (int64_t i = 0; i < 4; ++i) same = same && grad.size(i) == images.size(i);
  KV_CHECK(same, op, ": grad differs in shape, type or device from images");
  geometry::checked_size(op, images);
  Tensor const x = dense(images), g = dense(grad), grad_x = empty_like(x, Layout::planar);
  Tensor const matrices = empty({x.size(0), 3, 3}, x, Layout::planar, ScalarType::Float);
  Tensor const measured = measured_of(x, kMeasured), sums = measured_of(x, kGradientSums);
  dispatch_differentiable(op, x, [&]<class T>(Type<T>) {
    ApplyOperationsBackward<T> p{};
    float* const own = data_ptr<float>(matrices);
    p.forward = operations_on<T>(op, x, Layout::planar, operation, value, 0, own, measured);
    set_warp<T>(p.warp, x.size(0), {x.size(2), x.size(3)}, own);
    p.warp.grad = dense_images<T const>(g, Layout::planar);
    p.warp.grad_x = dense_images<T>(grad_x, Layout::planar);
#if defined(KV_CUDA)
    p.sums = data_ptr<float>(sums);
#endif
    KV_RUN(apply_operations_backward, x, p, x.size(0), 12 * x.size(1) * x.size(2) * x.size(3));
  });
  return grad_x;
}

std::tuple<Tensor, Tensor> choose_operations(Tensor const& columns, Tensor const& table, int64_t count,
                                             double top_level) {
  constexpr char const* op = "choose_operations";
  KV_CHECK(table.dim() == 3 && table.size(0) > 0 && table.size(1) > 0 && table.size(2) == 5 &&
               table.scalar_type() == ScalarType::Float && table.device() == columns.device(),
           op, ": expected a table of shape (N, L, 5), float32, on the device of columns");
  int64_t const length = table.size(1);
  KV_CHECK(count > 0 && count <= INT16_MAX && length <= INT16_MAX && columns.dim() == 2 &&
               columns.size(1) == count * (1 + 3 * length) && columns.scalar_type() == ScalarType::Float,
           op, ": expected float32 columns of shape (B, ", count * (1 + 3 * length), ")");
  int64_t const batch = columns.size(0);
  Tensor const entries = dense(table), value = empty({batch, count * length}, columns);
  Tensor const operation = empty({batch, count * length}, columns, Layout::planar, ScalarType::Long);
  ChooseOperations<float> const p{data_ptr<float const>(columns),
                                  columns.stride(0),
                                  columns.stride(1),
                                  batch,
                                  data_ptr<float const>(entries),
                                  table.size(0),
                                  int(count),
                                  int(length),
                                  float(top_level),
                                  data_ptr<int64_t>(operation),
                                  data_ptr<float>(value)};
  KV_RUN(choose_operations, columns, p, operation.numel(), 16);
  return {operation, value};
}

}  // namespace

KV_OPERATOR(apply_operations, "(Tensor images, Tensor operation, Tensor value) -> (Tensor, Tensor)")
// The same of images (C, h, w) of different sizes. The matrices follow the images.
KV_OPERATOR(apply_operations_list, "(Tensor[] images, Tensor operation, Tensor value) -> Tensor[]")
KV_OPERATOR(mix_operations_list, "(Tensor[] images, Tensor operation, Tensor value, Tensor weights) -> Tensor[]")
// A step of a policy: each image (B, C, H, W) gets the operation of its number, with its value; -1 is none. Returns the
// images and the matrices (B, 3, 3) of operations that move pixels. operation_table.py has the numbers and the values.
KV_OPERATOR(apply_operation, "(Tensor images, Tensor operation, Tensor value) -> (Tensor, Tensor)")
KV_OPERATOR(apply_operation_backward, "(Tensor grad, Tensor images, Tensor operation, Tensor value) -> Tensor")
KV_OPERATOR(choose_operations,
            "(Tensor columns, Tensor table, int count, float top_level) -> (Tensor operation, Tensor value)")

}  // namespace kv::augmentation
