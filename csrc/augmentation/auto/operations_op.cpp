// The operations of policies: schemas and entries, for CPU and CUDA.
#include "augmentation/auto/operations.h"
#include "augmentation/warp_and_color_glue.h"
#include "enhance/plane_views.h"
#include "geometry/transform/sampling_glue.h"

namespace kv::augmentation {
namespace {

// A tensor whose planes are dense.
template <class T>
Images<T> dense_images(Tensor const& x, Layout layout) {
  int64_t const channels = x.size(1), step = layout == Layout::channels_last ? channels : 1;
  return {data_ptr<T>(x), x.stride(0),  step > 1 ? 1 : x.stride(1), x.size(3) * step, step, x.size(0), x.size(2),
          x.size(3),      int(channels)};
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
  KV_CHECK(images.size(1) == kImageChannels, op, ": expected images of three channels, got ", images.size(1));
  KV_CHECK(images.size(0) <= INT32_MAX / 64, op, ": expected fewer than 2^25 images, got ", images.size(0));
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
  p.operation = data_ptr<int64_t const>(operation) + (step > 0 ? step * operation.stride(1) : 0);
  p.operation_stride = operation.stride(0);
  p.value = data_ptr<float const>(value) + (step > 0 ? step * value.stride(1) : 0);
  p.value_stride = value.stride(0);
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
  return empty({images.size(0) * kImageChannels, numbers}, images, Layout::planar, ScalarType::Float);
#else
  return {};
#endif
}

// Runs all steps of a policy, by turns into two buffers. Images (B, 3, H, W); operation and value (B, S). Returns the
// results and the matrices (S, B, 3, 3) of the steps.
std::tuple<Tensor, Tensor> apply_operations(Tensor const& images, Tensor const& operation, Tensor const& value) {
  constexpr char const* op = "apply_operations";
  check_arguments(op, images, operation, value, true);
  geometry::checked_size(op, images);
  int64_t const batch = images.size(0), steps = operation.size(1);
  Layout const layout = layout_of(images);
  Tensor const matrices = empty({steps, batch, 3, 3}, images, Layout::planar, ScalarType::Float);
  Tensor const measured = measured_of(images, kMeasured);
  Tensor x = enhance::dense_planes(images, layout), others;
  for (int64_t step = 0; step < steps; ++step) {
    Tensor const y = step < 2 ? empty_like(x, layout) : others;
    dispatch_joined(op, x, [&]<class T>(Type<T>) {
      float* const own = data_ptr<float>(matrices) + step * batch * 9;
      auto p = operations_on<T>(op, x, layout, operation, value, step, own, measured);
      p.warp.y = dense_images<T>(y, layout);
      KV_RUN(apply_operations, x, p, batch, 6 * kImageChannels * x.size(2) * x.size(3));
    });
    others = step > 0 ? x : Tensor();
    x = y;
  }
  return {x, matrices};
}

// One step, whose results have gradients; operation and value are (B,). Returns the results and the matrices (B, 3, 3).
std::tuple<Tensor, Tensor> apply_operation(Tensor const& images, Tensor const& operation, Tensor const& value) {
  constexpr char const* op = "apply_operation";
  check_arguments(op, images, operation, value, false);
  geometry::checked_size(op, images);
  Layout const layout = layout_of(images);
  Tensor const x = enhance::dense_planes(images, layout), y = empty_like(x, layout);
  Tensor const matrices = empty({x.size(0), 3, 3}, x, Layout::planar, ScalarType::Float);
  Tensor const measured = measured_of(x, kMeasured);
  dispatch_joined(op, x, [&]<class T>(Type<T>) {
    auto p = operations_on<T>(op, x, layout, operation, value, 0, data_ptr<float>(matrices), measured);
    p.warp.y = dense_images<T>(y, layout);
    KV_RUN(apply_operations, x, p, x.size(0), 6 * kImageChannels * x.size(2) * x.size(3));
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
    KV_RUN(apply_operations_backward, x, p, x.size(0), 12 * kImageChannels * x.size(2) * x.size(3));
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
// A step of a policy: each image (B, 3, H, W) gets the operation of its number, with its value; -1 is none. Returns the
// images and the matrices (B, 3, 3) of operations that move pixels. operation_table.py has the numbers and the values.
KV_OPERATOR(apply_operation, "(Tensor images, Tensor operation, Tensor value) -> (Tensor, Tensor)")
KV_OPERATOR(apply_operation_backward, "(Tensor grad, Tensor images, Tensor operation, Tensor value) -> Tensor")
KV_OPERATOR(choose_operations,
            "(Tensor columns, Tensor table, int count, float top_level) -> (Tensor operation, Tensor value)")

}  // namespace kv::augmentation
