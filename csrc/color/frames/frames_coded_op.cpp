// RGB to the codes of video frames: schema and entry, for CPU and CUDA.
#include "frames_coded.h"
#include "glue/glue.h"

namespace kv::color {
namespace {

constexpr char const* kCodedFrames = "coded_frames";

// In the order of color/frames.py.
enum class FrameLayout : int { nv12, nv21, i420, yuy2, p010 };

Tensor coded_frames(Tensor const& input, std::vector<int64_t> plan, std::vector<double> numbers) {
  char const* const op = kCodedFrames;
  check_images(op, "input", input);
  KV_CHECK(input.size(1) == 3 && input.numel() > 0, op, ": expected input of 3 channels with a pixel");
  KV_CHECK(plan.size() == 4 && numbers.size() == 12, op, ": expected a plan of 4 and 12 numbers");
  KV_CHECK(plan[0] >= 0 && plan[0] <= int64_t(FrameLayout::p010), op, ": there is no layout ", plan[0]);
  KV_CHECK(plan[1] == 0 || plan[1] == 1, op, ": expected integers or not, got ", plan[1]);
  for (int i = 2; i < 4; ++i)
    KV_CHECK(plan[i] >= 0 && plan[i] <= int64_t(ChromaSite::between), op, ": there is no site of chroma ", plan[i]);
  auto const layout = FrameLayout(plan[0]);
  int64_t const frames = input.size(0), height = input.size(2), width = input.size(3);
  KV_CHECK(height < int64_t(1) << 24 && width < int64_t(1) << 24, op, ": expected fewer than 2^24 rows and columns");
  bool const is_packed = layout == FrameLayout::yuy2;
  KV_CHECK(!is_packed || width % 2 == 0, op, ": expected an even width");
  KV_CHECK(plan[1] == 1 || input.scalar_type() != ScalarType::Byte, op, ": expected integers of bytes");
  int64_t const chroma_height = is_packed ? height : (height + 1) / 2, chroma_width = (width + 1) / 2;
  Tensor const x = as_layout(input, Layout::planar);
  ScalarType const type = plan[1] == 0                  ? x.scalar_type()
                          : layout == FrameLayout::p010 ? ScalarType::UInt16
                                                        : ScalarType::Byte;
  int64_t const luma = height * width, chroma = chroma_height * chroma_width, size = luma + 2 * chroma;
  Tensor const codes = empty({frames, size}, x, Layout::planar, type);
  FrameAxis const x_axis{int(width), int(chroma_width), ChromaSite(plan[2])},
      y_axis{int(height), int(chroma_height), ChromaSite(plan[3])};
  dispatch_floating_and_uint8(op, x, [&](auto stored) {
    using T = typename decltype(stored)::type;
    CodedFrames<T> p{};
    int64_t const bytes = plan[1] == 0 ? int64_t(sizeof(T)) : type == ScalarType::Byte ? 1 : 2;
    auto* const data = static_cast<char*>(codes.mutable_data_ptr());
    auto const plane = [&](int64_t first, int64_t row_stride, int64_t column_stride) {
      return CodeTarget{data + first * bytes, size, row_stride, column_stride};
    };
    p.rgb = planes<T const>(x, Layout::planar);
    if (is_packed) {
      p.planes[0] = plane(0, 2 * width, 2), p.planes[1] = plane(1, 2 * width, 4), p.planes[2] = plane(3, 2 * width, 4);
    } else {
      bool const has_planes = layout == FrameLayout::i420, is_swapped = layout == FrameLayout::nv21;
      int64_t const step = has_planes ? 1 : 2, second = luma + (has_planes ? chroma : 1);
      p.planes[0] = plane(0, width, 1);
      p.planes[is_swapped ? 2 : 1] = plane(luma, step * chroma_width, step);
      p.planes[is_swapped ? 1 : 2] = plane(second, step * chroma_width, step);
    }
    p.code_bytes = plan[1] == 0 ? 0 : int(bytes);
    p.x = x_axis, p.y = y_axis;
    for (int k = 0; k < 12; ++k) (k < 9 ? p.matrix[k] : p.offset[k - 9]) = Compute<T>(numbers[k]);
    KV_RUN(coded_frames, x, p, frames * chroma_height, 8 * width);
  });
  return codes;
}

}  // namespace

KV_OPERATOR(coded_frames, "(Tensor input, int[] plan, float[] numbers) -> Tensor")

}  // namespace kv::color
