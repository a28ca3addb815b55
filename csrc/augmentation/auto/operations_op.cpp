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

// Runs all steps of a policy, by turns into two buffers. Images (B, 3, H, W); operation and value (B, S). Returns the
// results and the matrices (S, B, 3, 3) of the steps.
std::tuple<Tensor, Tensor> apply_operations(Tensor const& images, Tensor const& operation, Tensor const& value) {
  constexpr char const* op = "apply_operations";
  enhance::check_planes(op, images);
  int64_t const batch = images.size(0), steps = operation.dim() == 2 ? operation.size(1) : 0;
  auto const fits = [&](Tensor const& t, ScalarType type) {
    return t.dim() == 2 && t.size(0) == batch && t.size(1) == steps && t.scalar_type() == type &&
           t.device() == images.device();
  };
  KV_CHECK(images.size(1) == kImageChannels, op, ": expected images of three channels, got ", images.size(1));
  KV_CHECK(batch <= INT32_MAX / 64, op, ": expected fewer than 2^25 images, got ", batch);
  KV_CHECK(steps > 0 && fits(operation, ScalarType::Long), op,
           ": expected operations of shape (B, S), int64, on the device of images");
  KV_CHECK(fits(value, ScalarType::Float), op, ": expected a float32 value of each operation");
  geometry::Size const size = geometry::checked_size(op, images);
  Layout const layout = layout_of(images);
  Tensor const matrices = empty({steps, batch, 3, 3}, images, Layout::planar, ScalarType::Float);
#if defined(KV_CUDA)
  Tensor const measured = empty({batch * kImageChannels, kMeasured}, images, Layout::planar, ScalarType::Float);
#endif
  Tensor x = enhance::dense_planes(images, layout), others;
  for (int64_t step = 0; step < steps; ++step) {
    Tensor const y = step < 2 ? empty_like(x, layout) : others;
    dispatch_joined(op, x, [&]<class T>(Type<T>) {
      ApplyOperations<T> p{};
      p.warp.interpolation = geometry::Interpolation::bilinear;
      p.warp.x_axis = {int(size.width), geometry::Padding::fill, true};
      p.warp.y_axis = {int(size.height), geometry::Padding::fill, true};
      p.warp.images = batch;
      p.warp.x = dense_images<T const>(x, layout);
      p.warp.y = dense_images<T>(y, layout);
      p.matrices = data_ptr<float>(matrices) + step * batch * 9;
      p.warp.coords.matrices = p.matrices;
      p.warp.coords.matrix_stride = 9;
      p.warp.coords.use = {3, true, false, true, size, size};
      geometry::check_planes(op, p.warp.x);
      p.operation = data_ptr<int64_t const>(operation) + step * operation.stride(1);
      p.operation_stride = operation.stride(0);
      p.value = data_ptr<float const>(value) + step * value.stride(1);
      p.value_stride = value.stride(0);
#if defined(KV_CUDA)
      p.measured = data_ptr<float>(measured);
#endif
      KV_RUN(apply_operations, x, p, batch, 6 * kImageChannels * size.height * size.width);
    });
    others = step > 0 ? x : Tensor();
    x = y;
  }
  return {x, matrices};
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
KV_OPERATOR(choose_operations,
            "(Tensor columns, Tensor table, int count, float top_level) -> (Tensor operation, Tensor value)")

}  // namespace kv::augmentation
