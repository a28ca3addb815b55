// Erased rectangles, grids and marked pixels: schemas and entries, for CPU and CUDA.
#include "augmentation/erase.h"
#include "augmentation/lists/list_steps.h"
#include "geometry/transform/lists/list_glue.h"

namespace kv::augmentation {
namespace {

// Images (B, C, H, W), or what stands for a list; parts (B or 1, ...) float32; values (B, C), or (B, 1) for all
// channels, of the type that is computed in; none where the results hold them.
struct EraseArguments {
  char const* op;
  Tensor const &images, &parts;
  Tensor const* values;

  void check(bool are_parts, char const* expected, ScalarType type = ScalarType::Float) const {
    check_images(op, "images", images);
    int64_t const batch = images.size(0), channels = images.size(1);
    auto const fits = [&](Tensor const& t, ScalarType type) {
      return (t.size(0) == batch || t.size(0) == 1) && t.scalar_type() == type && t.device() == images.device();
    };
    KV_CHECK(are_parts && fits(parts, type), op, ": expected ", type == ScalarType::Float ? "float32 " : "uint8 ",
             expected, " on the device of images");
    if (!values) return;
    KV_CHECK(values->dim() == 2 && fits(*values, compute_dtype(images)) &&
                 (values->size(1) == channels || values->size(1) == 1),
             op,
             ": expected values of shape (B, C) or (B, 1), of the type that is computed in, on the device of images");
  }
  void check_boxes() const { check(parts.dim() == 3 && parts.size(2) == 4, "boxes of shape (B, N, 4)"); }
  void check_grids() const { check(parts.dim() == 2 && parts.size(1) == kGridNumbers, "grids of shape (B, 5)"); }
  void check_side(int64_t side) const { KV_CHECK(side <= INT32_MAX / 4, op, ": expected smaller images"); }

  // All but the images and the parts.
  template <class T>
  Erase<T> params(Layout layout) const {
    Erase<T> p{};
    p.samples = images.size(0);
    p.planes_per_sample = layout == Layout::channels_last ? 1 : images.size(1);
    if (!values) return p;
    p.values = data_ptr<Compute<T> const>(*values);
    p.value_stride = values->size(0) > 1 ? values->stride(0) : 0;
    p.channel_stride = values->size(1) > 1 ? values->stride(1) : 0;
    return p;
  }
  template <class T>
  EraseRectangles<T> rectangles(Layout layout, Tensor const& boxes) const {
    return {params<T>(layout), data_ptr<float const>(boxes), boxes.size(1), boxes.size(0) > 1 ? boxes.stride(0) : 0};
  }
  template <class T>
  EraseGrid<T> grids(Layout layout, Tensor const& own) const {
    return {params<T>(layout), data_ptr<float const>(own), own.size(0) > 1 ? own.stride(0) : 0};
  }
  template <class T>
  EraseMarked<T> marked(Layout layout, Tensor const& own) const {
    return {params<T>(layout), data_ptr<uint8_t const>(own), own.size(0) > 1 ? own.stride(0) : 0, own.stride(2)};
  }
};

// Boxes (B, N, 4). Columns of drawn parameters are read where they are.
Tensor readable_boxes(Tensor const& boxes) {
  return boxes.stride(1) == 4 && boxes.stride(2) == 1 ? boxes : dense(boxes);
}

// run(type, layout, x, y) calls the kernel.
template <class Run>
Tensor erase(EraseArguments const& a, Run run) {
  Layout const layout = layout_of(a.images);
  Tensor const x = as_layout(a.images, layout), y = empty_like(x, layout);
  dispatch_floating_and_uint8(a.op, x, [&](auto type) { run(type, layout, x, y); });
  return y;
}
template <class T>
void set_images(Erase<T>& p, Tensor const& x, Tensor const& y, Layout layout) {
  p.x = planes<T const>(x, layout), p.y = planes<T>(y, layout);
}

Tensor erase_rectangles(Tensor const& images, Tensor const& boxes, Tensor const& values) {
  EraseArguments const a{"erase_rectangles", images, boxes, &values};
  a.check_boxes();
  Tensor const own = readable_boxes(boxes);
  return erase(a, [&]<class T>(Type<T>, Layout layout, Tensor const& x, Tensor const& y) {
    EraseRectangles<T> params = a.rectangles<T>(layout, own);
    set_images(params, x, y, layout);
    KV_RUN(erase_rectangles, x, params, x.numel() ? params.x.rows() : 0, params.x.row_size());
  });
}

// Grids (B, 5): the width of lines, the angle, offsets along x and y, the number of cells.
Tensor erase_grid(Tensor const& images, Tensor const& grids, Tensor const& values) {
  EraseArguments const a{"erase_grid", images, grids, &values};
  a.check_grids();
  a.check_side(images.size(2)), a.check_side(images.size(3));
  Tensor const own = dense(grids);
  return erase(a, [&]<class T>(Type<T>, Layout layout, Tensor const& x, Tensor const& y) {
    EraseGrid<T> params = a.grids<T>(layout, own);
    set_images(params, x, y, layout);
    KV_RUN(erase_grid, x, params, x.numel() ? params.x.rows() : 0, 8 * params.x.row_size());
  });
}

// Images (C, H, W) of different sizes, to results of these. params_of(type, layout) is what all samples have in common,
// but for the images; run(list, cost) calls the kernel for those of a table.
template <template <class> class List, class ParamsOf, class Run>
Tensors erase_list(geometry::KeptSizes const& kept, EraseArguments const& a, Tensors const& images, ParamsOf params_of,
                   Run run) {
  Tensors const rows = geometry::in_layout(images, kept.layout);
  int64_t const channels = a.images.size(1), planes = kept.interleaved() ? 1 : channels;
  auto const items_of = [&](geometry::Size size) {
#if defined(KV_CUDA)
    return ceil_div(size.height, kEraseRows) * ceil_div(size.width, kEraseColumns);
#else
    return ceil_div(planes * size.height, kEraseRows);
#endif
  };
  dispatch_floating_and_uint8(a.op, a.images, [&]<class T>(Type<T> type) {
    List<T> p;
    auto const all = params_of(type, kept.layout);
    p.channels = int(channels);
    kept.for_each_table(p.list, rows, items_of, [&](size_t first) {
      p.all = all;
      p.all.skip(int64_t(first));
      run(p, kEraseRows * a.images.size(3) * channels / planes);
    });
  });
  return kept.results;
}

Tensors rectangles_of_list(geometry::KeptSizes const& kept, Tensors const& images, Tensor const& boxes,
                           Tensor const* values) {
  EraseArguments const a{kept.op, kept.largest, boxes, values};
  a.check_boxes();
  Tensor const own = readable_boxes(boxes);
  return erase_list<EraseRectanglesList>(
      kept, a, images, [&]<class T>(Type<T>, Layout layout) { return a.rectangles<T>(layout, own); },
      [&](auto const& p, [[maybe_unused]] int64_t cost) {
        KV_RUN(erase_rectangles_list, a.images, p, p.list.items, cost);
      });
}

Tensors grids_of_list(geometry::KeptSizes const& kept, Tensors const& images, Tensor const& grids,
                      Tensor const* values) {
  EraseArguments const a{kept.op, kept.largest, grids, values};
  a.check_grids();
  for (int64_t const side : kept.sides) a.check_side(side);
  Tensor const own = dense(grids);
  return erase_list<EraseGridList>(
      kept, a, images, [&]<class T>(Type<T>, Layout layout) { return a.grids<T>(layout, own); },
      [&](auto const& p, [[maybe_unused]] int64_t cost) {
        KV_RUN(erase_grid_list, a.images, p, p.list.items, 8 * cost);
      });
}

// Marks (B or 1, 1, H, W) uint8 of the largest sides.
Tensors marked_of_list(geometry::KeptSizes const& kept, Tensors const& images, Tensor const& marks,
                       Tensor const* values) {
  EraseArguments const a{kept.op, kept.largest, marks, values};
  bool fit = marks.dim() == 4 && marks.size(1) == 1;
  for (Tensor const& x : images) fit = fit && x.size(1) <= marks.size(2) && x.size(2) <= marks.size(3);
  a.check(fit, "marks of shape (B, 1, H, W), at least as high and wide as the images,", ScalarType::Byte);
  Tensor const own = dense(marks);
  return erase_list<EraseMarkedList>(
      kept, a, images, [&]<class T>(Type<T>, Layout layout) { return a.marked<T>(layout, own); },
      [&](auto const& p, [[maybe_unused]] int64_t cost) {
        KV_RUN(erase_marked_list, a.images, p, p.list.items, 2 * cost);
      });
}

Tensors erase_rectangles_list(Tensors const& images, Tensor const& boxes, Tensor const& values) {
  return rectangles_of_list({"erase_rectangles_list", images}, images, boxes, &values);
}
Tensors erase_grid_list(Tensors const& images, Tensor const& grids, Tensor const& values) {
  return grids_of_list({"erase_grid_list", images}, images, grids, &values);
}
Tensors erase_marked_list(Tensors const& images, Tensor const& marks, Tensor const& values) {
  return marked_of_list({"erase_marked_list", images}, images, marks, &values);
}

// Sets parts, which are boxes, grids or marks, to uniform noise: the results are filled with it before.
Tensors fill_with_noise_list(Tensors const& images, Tensor const& parts, Tensor const& parameters, Tensor const& keys,
                             OptionalTensor const& seeds, std::vector<int64_t> const& plan) {
  geometry::KeptSizes const kept("fill_with_noise_list", images);
  steps::fill_with_noise(kept, parameters, keys, seeds, plan);
  auto* const of_list = parts.dim() == 3 ? rectangles_of_list : parts.dim() == 2 ? grids_of_list : marked_of_list;
  return of_list(kept, images, parts, nullptr);
}

}  // namespace

KV_OPERATOR(erase_rectangles, "(Tensor images, Tensor boxes, Tensor values) -> Tensor")
KV_OPERATOR(erase_grid, "(Tensor images, Tensor grids, Tensor values) -> Tensor")
// The same of images (C, H, W) of different sizes, as a list.
KV_OPERATOR(erase_rectangles_list, "(Tensor[] images, Tensor boxes, Tensor values) -> Tensor[]")
KV_OPERATOR(erase_grid_list, "(Tensor[] images, Tensor grids, Tensor values) -> Tensor[]")
KV_OPERATOR(erase_marked_list, "(Tensor[] images, Tensor marks, Tensor values) -> Tensor[]")
KV_OPERATOR(fill_with_noise_list,
            "(Tensor[] images, Tensor parts, Tensor parameters, Tensor keys, Tensor? seeds, int[] plan) -> Tensor[]")

}  // namespace kv::augmentation
