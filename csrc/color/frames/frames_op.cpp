// Frames of video: schema and entry, for CPU and CUDA.
#include <algorithm>
#include <optional>

#include "frames.h"
#include "glue/glue.h"

namespace kv::color {
namespace {

constexpr char const* kPlanesToRgb = "planes_to_rgb";

int64_t rows_of(Tensor const& x, int64_t frames) { return x.size(0) == frames || x.size(0) == 1 ? x.size(0) : -1; }

FrameAxis frame_axis(int64_t size, int64_t chroma_size, ChromaSite site) {
  KV_CHECK(chroma_size == size || chroma_size == (size + 1) / 2, kPlanesToRgb, ": expected chroma of ", size, " or ",
           (size + 1) / 2, " samples along an axis of ", size, " pixels, got ", chroma_size);
  return {int(size), int(chroma_size), site};
}

// A number as results have it.
template <class T>
Compute<T> as_stored(Compute<T> x) {
  if constexpr (std::is_same_v<T, Half>) return to_float(to_half(x));
  if constexpr (std::is_same_v<T, BFloat16>) return to_float(to_bfloat16(x));
  return x;
}

// The arguments of a call, checked.
struct FrameCall {
  char const* const op;
  Tensor const &y, &u, &v;
  std::vector<int64_t> const& plan;
  std::vector<double> const& numbers;
  int64_t height, width, frames;  // of the result
  ScalarType type, codes;
  FrameMap kind = FrameMap::whole;
  FrameAxis x_axis, y_axis;
  std::optional<Tensor> maps;

  FrameCall(char const* op, Tensor const& y, Tensor const& u, Tensor const& v, std::optional<Tensor> const& map,
            std::vector<int64_t> const& plan, std::vector<double> const& numbers)
      : op(op), y(y), u(u), v(v), plan(plan), numbers(numbers) {
    KV_CHECK(plan.size() == 9 && numbers.size() == 21, op, ": expected a plan of 9 and 21 numbers");
    KV_CHECK(y.dim() == 3 && u.dim() == 3 && v.dim() == 3 && y.numel() > 0 && u.numel() > 0 && v.numel() > 0, op,
             ": expected planes of three axes with at least one pixel");
    bool const is_whole = plan[0] == 0 && plan[1] == 0;
    height = is_whole ? y.size(1) : plan[0], width = is_whole ? y.size(2) : plan[1];
    constexpr int64_t kLargest = int64_t(1) << 24;
    KV_CHECK(height > 0 && width > 0 && height < kLargest && width < kLargest, op, ": there is no result of ", height,
             " x ", width, " pixels");
    KV_CHECK(plan[2] >= 0 && plan[2] <= int64_t(DType::float64), op, ": there is no dtype ", plan[2]);
    for (int i = 3; i < 5; ++i)
      KV_CHECK(plan[i] >= 0 && plan[i] <= int64_t(ChromaSite::between), op, ": there is no site of chroma ", plan[i]);
    KV_CHECK(y.size(1) < kLargest && y.size(2) < kLargest, op, ": expected frames of fewer than 2^24 rows and columns");
    KV_CHECK(u.size(1) == v.size(1) && u.size(2) == v.size(2), op, ": expected u and v of one size");
    for (Tensor const* x : {&u, &v})
      KV_CHECK(x->scalar_type() == y.scalar_type() && x->device() == y.device(), op,
               ": expected planes of one dtype and device");
    char const* const maps_are = ": expected boxes (B, 4) or matrices (B, 2, 3) or (B, 3, 3)";
    KV_CHECK(!map || map->dim() == 2 || map->dim() == 3, op, maps_are);
    frames = max(y.size(0), max(u.size(0), v.size(0)));
    if (map) frames = max(frames, map->size(0));
    KV_CHECK(rows_of(y, frames) > 0 && rows_of(u, frames) > 0 && rows_of(v, frames) > 0, op,
             ": expected planes of one batch");
    type = scalar_type_of(DType(plan[2])), codes = y.scalar_type();
    KV_CHECK(is_integer() || codes == type, op, ": expected planes of bytes, of uint16 or of the dtype of the result");
    if (map) {
      bool const is_box = map->dim() == 2 && map->size(1) == 4;
      KV_CHECK(is_box || (map->dim() == 3 && (map->size(1) == 2 || map->size(1) == 3) && map->size(2) == 3), op,
               maps_are);
      KV_CHECK(rows_of(*map, frames) > 0 && map->device() == y.device() &&
                   map->scalar_type() == (type == ScalarType::Double ? ScalarType::Double : ScalarType::Float),
               op, ": expected a box or a matrix for each frame, in the type that computes");
      kind = is_box ? FrameMap::boxes : plan[5] != 0 ? FrameMap::windows : FrameMap::matrices;
      Tensor all = *map;
      maps = dense(all.stride(0) == 0 ? torch::stable::narrow(all, 0, 0, 1) : all);  // one for all is not copied
    } else if (height != y.size(1) || width != y.size(2)) {
      kind = FrameMap::boxes;
    }
    x_axis = frame_axis(y.size(2), u.size(2), ChromaSite(plan[3]));
    y_axis = frame_axis(y.size(1), u.size(1), ChromaSite(plan[4]));
  }

  bool is_integer() const { return codes == ScalarType::Byte || codes == ScalarType::UInt16; }

  template <class T>
  PlanesToRgb<T> parameters(Tensor const& rgb) const {
    using F = Compute<T>;
    PlanesToRgb<T> p{};
    Tensor const* const planes_of[] = {&y, &u, &v};
    for (int k = 0; k < 3; ++k) {
      Tensor const& x = *planes_of[k];
      p.planes[k] = {x.const_data_ptr(), x.size(0) == 1 ? 0 : x.stride(0), x.stride(1), x.stride(2)};
    }
    p.code_bytes = codes == ScalarType::Byte ? 1 : is_integer() ? 2 : 0;
    p.x = x_axis, p.y = y_axis;
    p.rgb = planes<T>(rgb, Layout::planar);
    p.kind = kind;
    if (maps) {
      p.map = data_ptr<F const>(*maps);
      p.map_stride = maps->size(0) == 1 ? 0 : maps->stride(0);
      p.is_affine = maps->size(1) == 2;
    }
    p.antialias = plan[5] != 0;
    p.align_corners = plan[5] == 2;
    p.from_result = plan[6] != 0;
    p.nearest = plan[7] != 0;
    p.border = plan[8] != 0;
    auto number = numbers.begin();
    for (F* part : {p.colors.matrix, p.colors.matrix + 3, p.colors.matrix + 6, p.colors.offset, p.colors.bias,
                    p.colors.lowest, p.colors.highest})
      for (int k = 0; k < 3; ++k) part[k] = F(*number++);
    return p;
  }
};

Tensor planes_to_rgb(Tensor const& y, Tensor const& u, Tensor const& v, std::optional<Tensor> const& map,
                     std::vector<int64_t> plan, std::vector<double> numbers) {
  FrameCall const call(kPlanesToRgb, y, u, v, map, plan, numbers);
  Tensor const rgb = empty({call.frames, 3, call.height, call.width}, y, Layout::planar, call.type);
  dispatch_floating_and_uint8(call.op, rgb, [&](auto stored) {
    auto const p = call.parameters<typename decltype(stored)::type>(rgb);
    KV_RUN(planes_to_rgb, y, p, call.frames * call.height, 6 * call.width);
  });
  return rgb;
}

std::tuple<Tensor, Tensor, Tensor> planes_to_rgb_backward(Tensor const& grad, Tensor const& result, Tensor const& y,
                                                          Tensor const& u, Tensor const& v,
                                                          std::optional<Tensor> const& map, std::vector<int64_t> plan,
                                                          std::vector<double> numbers) {
  FrameCall const call("planes_to_rgb_backward", y, u, v, map, plan, numbers);
  for (Tensor const* x : {&grad, &result}) {
    check_images(call.op, "grad and result", *x);
    KV_CHECK(x->size(0) == call.frames && x->size(1) == 3 && x->size(2) == call.height && x->size(3) == call.width &&
                 x->scalar_type() == y.scalar_type() && x->device() == y.device(),
             call.op, ": expected gradients and results of the call");
  }
  KV_CHECK(!call.is_integer(), call.op, ": expected floating-point planes");
  Tensor const own_grad = as_layout(grad, Layout::planar), own_result = as_layout(result, Layout::planar);
  auto const like = [&](Tensor const& x) {
    return empty({call.frames, x.size(1), x.size(2)}, x, Layout::planar, x.scalar_type());
  };
  Tensor const grads[] = {like(y), like(u), like(v)};
  dispatch_floating(call.op, own_grad, [&](auto stored) {
    using T = typename decltype(stored)::type;
    PlanesToRgbBackward<T> p{};
    p.forward = call.parameters<T>(own_result);
    for (auto* bounds : {p.forward.colors.lowest, p.forward.colors.highest})
      for (int k = 0; k < 3; ++k) bounds[k] = as_stored<T>(bounds[k]);
    p.grad = planes<T const>(own_grad, Layout::planar);
    for (int k = 0; k < 3; ++k) p.planes[k] = data_ptr<T>(grads[k]);
    int64_t const rows = call.kind == FrameMap::matrices ? 3 : p.rows_of_frame();
    KV_RUN(planes_to_rgb_backward, y, p, call.frames * rows, 6 * (call.width + p.width(0)));
  });
  return {grads[0], grads[1], grads[2]};
}

}  // namespace

KV_OPERATOR(planes_to_rgb, "(Tensor y, Tensor u, Tensor v, Tensor? map, int[] plan, float[] numbers) -> Tensor")
KV_OPERATOR(planes_to_rgb_backward,
            "(Tensor grad, Tensor result, Tensor y, Tensor u, Tensor v, Tensor? map, int[] plan, float[] numbers) -> "
            "(Tensor, Tensor, Tensor)")

}  // namespace kv::color
