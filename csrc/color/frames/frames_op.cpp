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

Tensor planes_to_rgb(Tensor const& y, Tensor const& u, Tensor const& v, std::optional<Tensor> const& map,
                     std::vector<int64_t> plan, std::vector<double> numbers) {
  char const* const op = kPlanesToRgb;
  KV_CHECK(plan.size() == 8 && numbers.size() == 21, op, ": expected a plan of 8 and 21 numbers");
  KV_CHECK(y.dim() == 3 && u.dim() == 3 && v.dim() == 3 && y.numel() > 0 && u.numel() > 0 && v.numel() > 0, op,
           ": expected planes of three axes with at least one pixel");
  bool const is_whole = plan[0] == 0 && plan[1] == 0;
  int64_t const height = is_whole ? y.size(1) : plan[0], width = is_whole ? y.size(2) : plan[1], siting = plan[3];
  constexpr int64_t kLargest = int64_t(1) << 24;
  KV_CHECK(height > 0 && width > 0 && height < kLargest && width < kLargest, op, ": there is no result of ", height,
           " x ", width, " pixels");
  KV_CHECK(plan[2] >= 0 && plan[2] <= int64_t(DType::float64), op, ": there is no dtype ", plan[2]);
  KV_CHECK(siting >= 0 && siting <= 3, op, ": there is no siting ", siting);
  KV_CHECK(y.size(1) < kLargest && y.size(2) < kLargest, op, ": expected frames of fewer than 2^24 rows and columns");
  KV_CHECK(u.size(1) == v.size(1) && u.size(2) == v.size(2), op, ": expected u and v of one size");
  for (Tensor const* x : {&u, &v})
    KV_CHECK(x->scalar_type() == y.scalar_type() && x->device() == y.device(), op,
             ": expected planes of one dtype and device");
  KV_CHECK(!map || map->dim() == 2 || map->dim() == 3, op, ": expected boxes (B, 4) or matrices (B, 3, 3)");
  int64_t frames = max(y.size(0), max(u.size(0), v.size(0)));
  if (map) frames = max(frames, map->size(0));
  KV_CHECK(rows_of(y, frames) > 0 && rows_of(u, frames) > 0 && rows_of(v, frames) > 0, op,
           ": expected planes of one batch");
  ScalarType const type = scalar_type_of(DType(plan[2])), codes = y.scalar_type();
  bool const is_integer = codes == ScalarType::Byte || codes == ScalarType::UInt16;
  KV_CHECK(is_integer || codes == type, op, ": expected planes of bytes, of uint16 or of the dtype of the result");

  FrameMap kind = FrameMap::whole;
  if (map) {
    bool const is_box = map->dim() == 2 && map->size(1) == 4;
    KV_CHECK(is_box || (map->dim() == 3 && map->size(1) == 3 && map->size(2) == 3), op,
             ": expected boxes (B, 4) or matrices (B, 3, 3)");
    KV_CHECK(rows_of(*map, frames) > 0 && map->device() == y.device() &&
                 map->scalar_type() == (type == ScalarType::Double ? ScalarType::Double : ScalarType::Float),
             op, ": expected a box or a matrix for each frame, in the type that computes");
    kind = is_box ? FrameMap::boxes : plan[4] != 0 ? FrameMap::windows : FrameMap::matrices;
  } else if (height != y.size(1) || width != y.size(2)) {
    kind = FrameMap::boxes;
  }

  FrameAxis const x_axis = frame_axis(y.size(2), u.size(2), chroma_sites(siting)[0]),
                  y_axis = frame_axis(y.size(1), u.size(1), chroma_sites(siting)[1]);
  Tensor const rgb = empty({frames, 3, height, width}, y, Layout::planar, type);
  std::optional<Tensor> const maps = map ? std::optional(dense(*map)) : std::nullopt;

  auto const run = [&](auto stored) {
    using T = typename decltype(stored)::type;
    using F = Compute<T>;
    PlanesToRgb<T> p{};
    Tensor const* const planes_of[] = {&y, &u, &v};
    for (int k = 0; k < 3; ++k) {
      Tensor const& x = *planes_of[k];
      p.planes[k] = {x.const_data_ptr(), x.size(0) == 1 ? 0 : x.stride(0), x.stride(1), x.stride(2)};
    }
    p.code_bytes = codes == ScalarType::Byte ? 1 : is_integer ? 2 : 0;
    p.x = x_axis, p.y = y_axis;
    p.rgb = planes<T>(rgb, Layout::planar);
    p.kind = kind;
    if (maps) p.map = data_ptr<F const>(*maps), p.map_stride = maps->size(0) == 1 ? 0 : kind == FrameMap::boxes ? 4 : 9;
    p.antialias = plan[4] != 0;
    p.align_corners = plan[4] == 2;
    p.from_result = plan[5] != 0;
    p.nearest = plan[6] != 0;
    p.border = plan[7] != 0;
    auto number = numbers.begin();
    for (F* part : {p.colors.matrix, p.colors.matrix + 3, p.colors.matrix + 6, p.colors.offset, p.colors.bias,
                    p.colors.lowest, p.colors.highest})
      for (int k = 0; k < 3; ++k) part[k] = F(*number++);
    KV_RUN(planes_to_rgb, y, p, frames * height, 6 * width);
  };
  dispatch_floating_and_uint8(op, rgb, run);
  return rgb;
}

}  // namespace

KV_OPERATOR(planes_to_rgb, "(Tensor y, Tensor u, Tensor v, Tensor? map, int[] plan, float[] numbers) -> Tensor")

}  // namespace kv::color
