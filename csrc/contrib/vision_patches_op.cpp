// Model inputs: schema and entry, for CPU and CUDA.
#include "contrib/vision_patches.h"
#include "glue/glue.h"

namespace kv::contrib {
namespace {

constexpr int64_t kLongestSide = 1 << 24;

// Images (C, H, W), or one batch (B, C, H, W) of them, and the grid of patches, rows and columns, of each tensor.
std::vector<Tensor> vision_patches(std::vector<Tensor> const& images, std::vector<int64_t> const& grids, int64_t filter,
                                   int64_t patch, int64_t merge, int64_t repeats, int64_t padded,
                                   std::vector<double> const& scale, std::vector<double> const& offset, bool bfloat16) {
  constexpr char const* op = "vision_patches";
  KV_CHECK(!images.empty() && grids.size() == 2 * images.size(), op, ": expected images and a grid of each");
  Tensor const& first = images[0];
  int64_t const channels = first.size(first.dim() == 4 ? 1 : 0);
  KV_CHECK(filter == int64_t(geometry::ResizeFilter::bilinear) || filter == int64_t(geometry::ResizeFilter::bicubic),
           op, ": filter must be 3 (bilinear) or 4 (bicubic), got ", filter);
  KV_CHECK(channels > 0 && channels <= kMaxPatchChannels && int64_t(scale.size()) == channels &&
               int64_t(offset.size()) == channels,
           op, ": expected 1 to ", kMaxPatchChannels, " channels with a scale and an offset of each");
  KV_CHECK(patch > 0 && patch <= 64 && merge > 0 && repeats >= 0 && (repeats > 0 || (padded > 0 && merge == 1)), op,
           ": wrong sizes of patches");

  std::vector<PatchImage> table;
  int64_t patches = 0, units = 0, work = 0;
  for (size_t i = 0; i < images.size(); ++i) {
    Tensor const& image = images[i];
    bool const is_batch = image.dim() == 4 && images.size() == 1;
    KV_CHECK(is_batch || image.dim() == 3, op, ": expected images of three axes or one tensor of four");
    KV_CHECK(image.scalar_type() == first.scalar_type() && image.get_device_index() == first.get_device_index(), op,
             ": expected images of one type and device");
    int const c = is_batch ? 1 : 0;
    int64_t const height = image.size(c + 1), width = image.size(c + 2), rows = grids[2 * i],
                  columns = grids[2 * i + 1];
    KV_CHECK(image.size(c) == channels && height > 0 && width > 0 && height <= kLongestSide && width <= kLongestSide,
             op, ": expected images of ", channels, " channels and sides of 1 to ", kLongestSide);
    KV_CHECK(rows > 0 && columns > 0 && rows % merge == 0 && columns % merge == 0 && rows * patch <= kLongestSide &&
                 columns * patch <= kLongestSide && (repeats > 0 || rows * columns <= padded),
             op, ": wrong grid of patches");
    for (int64_t b = 0; b < (is_batch ? image.size(0) : 1); ++b) {
      int64_t const size = image.scalar_type() == ScalarType::Byte ? 1 : 4;
      table.push_back({static_cast<char const*>(image.const_data_ptr()) + (is_batch ? b * image.stride(0) * size : 0),
                       image.stride(c), image.stride(c + 1), image.stride(c + 2), patches, int(height), int(width),
                       int(rows), int(columns), int(units)});
      patches += repeats > 0 ? rows * columns : padded;
      units += rows;
      work = max(work, columns * patch * patch * channels);
    }
  }
  KV_CHECK(units <= INT32_MAX / 2, op, ": too many patches");
  int64_t const elements = channels * max(repeats, int64_t(1)) * patch * patch;
  ScalarType const type = bfloat16 ? ScalarType::BFloat16 : ScalarType::Float;
  int64_t const samples = int64_t(table.size());
  Tensor const result = repeats > 0 ? empty({patches, elements}, first, Layout::planar, type)
                                    : empty({samples, padded, elements}, first, Layout::planar, type);
  Tensor const mask = empty({repeats > 0 ? 0 : samples, padded}, first, Layout::planar, ScalarType::Bool);
  auto const run = [&](auto storage) {
    using T = typename decltype(storage)::type;
    VisionPatches<T> params{table.data(),
                            int(samples),
                            int(channels),
                            int(patch),
                            int(merge),
                            int(repeats),
                            int(padded),
                            geometry::ResizeFilter(filter),
                            bfloat16 ? DType::bfloat16 : DType::float32,
                            const_cast<void*>(result.const_data_ptr()),
                            repeats > 0 ? nullptr : data_ptr<bool>(mask),
                            {},
                            {}};
    for (int64_t c = 0; c < channels; ++c) params.scale[c] = float(scale[c]), params.offset[c] = float(offset[c]);
    KV_RUN(vision_patches, first, params, units, 8 * work);
  };
  if (first.scalar_type() == ScalarType::Byte) {
    run(Type<uint8_t>{});
  } else {
    KV_CHECK(first.scalar_type() == ScalarType::Float, op, ": no kernel for this dtype");
    run(Type<float>{});
  }
  return {result, mask};
}

}  // namespace

KV_OPERATOR(vision_patches,
            "(Tensor[] images, int[] grids, int filter, int patch, int merge, int repeats, int padded, float[] scale, "
            "float[] offset, bool bfloat16) -> Tensor[]")

}  // namespace kv::contrib
