// Resizing: schemas and entries, for CPU and CUDA.
#include "geometry/transform/resize/resize.h"
#include "glue/batch.h"
#include "glue/glue.h"

namespace kv::geometry {
namespace {

constexpr int64_t kLongestSide = 1 << 30;  // coordinates are 64-bit fractions of pixels

ResizeFilter parse_filter(char const* op, int64_t number) {
  KV_CHECK(number >= int64_t(ResizeFilter::nearest) && number <= int64_t(ResizeFilter::pyrup), op,
           ": filter must be 0 (nearest), 1 (nearest-exact), 2 (area), 3 (bilinear), 4 (bicubic), 5 (lanczos), "
           "6 (pyrdown) or 7 (pyrup), got ",
           number);
  return ResizeFilter(number);
}

// From images to images of `size`, or the gradient to images of `size`; `minuend` minus that where there is one.
Tensor resized(char const* op, Tensor const& input, std::vector<int64_t> const& size, int64_t filter_number,
               bool align_corners, bool antialias, int64_t border_number, bool backward,
               Tensor const* minuend = nullptr) {
  check_images(op, backward ? "grad" : "input", input);
  KV_CHECK(size.size() == 2, op, ": expected a size of height and width, got ", size.size(), " numbers");
  ResizeFilter const filter = parse_filter(op, filter_number);
  Border const border = to_border(op, border_number);
  auto const axis = [&](int64_t from, int64_t to) {
    KV_CHECK(from <= kLongestSide && to > 0 && to <= kLongestSide, op, ": expected sides of 1 to ", kLongestSide,
             " pixels, got ", from, " and ", to);
    int64_t const source = backward ? to : from, result = backward ? from : to;
    if (filter == ResizeFilter::pyrdown || filter == ResizeFilter::pyrup) {
      // A circular border reads the opposite side, which is out of reach.
      KV_CHECK(border != Border::circular, op, ": a pyramid's border must be constant, reflect or replicate");
      check_border(op, border, 2, filter == ResizeFilter::pyrdown ? source : result);
      KV_CHECK(filter == ResizeFilter::pyrdown || result == 2 * source, op, ": pyrup doubles sides, got ", source,
               " and ", result);
    }
    return ResizeAxis(filter, source, result, align_corners, antialias, backward, border);
  };
  ResizeAxis const rows = axis(input.size(2), size[0]), columns = axis(input.size(3), size[1]);
  Layout const layout = layout_of(input);
  Tensor const x = as_layout(input, layout);
  Tensor const y = empty({x.size(0), x.size(1), size[0], size[1]}, x, layout);
  if (minuend) check_like(op, "image", *minuend, y);
  // With the layout of y.
  Tensor const image = !minuend ? y
                       : layout == Layout::channels_last
                           ? torch::stable::contiguous(*minuend, torch::headeronly::MemoryFormat::ChannelsLast)
                           : dense(*minuend);
  auto const run = [&](auto type) {
    using T = typename decltype(type)::type;
    Resize<T> const params{planes<T const>(x, layout), planes<T>(y, layout), rows, columns,
                           minuend ? data_ptr<T const>(image) : nullptr};
    KV_RUN(resize, x, params, params.y.row_size() ? params.y.rows() : 0,
           rows.max_taps * params.x.row_size() + columns.max_taps * params.y.row_size());
  };
  if (backward || minuend)
    dispatch_floating(op, x, run);
  else
    dispatch_floating_and_uint8(op, x, run);
  return y;
}

Tensor resize(Tensor const& input, std::vector<int64_t> size, int64_t filter, bool align_corners, bool antialias,
              int64_t border) {
  return resized("resize", input, size, filter, align_corners, antialias, border, false);
}

Tensor resize_backward(Tensor const& grad, std::vector<int64_t> size, int64_t filter, bool align_corners,
                       bool antialias, int64_t border) {
  return resized("resize_backward", grad, size, filter, align_corners, antialias, border, true);
}

// A level of a Laplacian pyramid: the image minus the pyrup of the next smaller one.
Tensor pyramid_detail(Tensor const& smaller, Tensor const& image, bool align_corners, int64_t border) {
  check_images("pyramid_detail", "smaller", smaller);
  return resized("pyramid_detail", smaller, {2 * smaller.size(2), 2 * smaller.size(3)}, int64_t(ResizeFilter::pyrup),
                 align_corners, false, border, false, &image);
}

}  // namespace

#define KV_RESIZE_OPTIONS "SymInt[] size, int filter, bool align_corners, bool antialias, int border"
KV_OPERATOR(resize, "(Tensor input, " KV_RESIZE_OPTIONS ") -> Tensor")
KV_OPERATOR(resize_backward, "(Tensor grad, " KV_RESIZE_OPTIONS ") -> Tensor")
KV_OPERATOR(pyramid_detail, "(Tensor smaller, Tensor image, bool align_corners, int border) -> Tensor")
#undef KV_RESIZE_OPTIONS

}  // namespace kv::geometry
