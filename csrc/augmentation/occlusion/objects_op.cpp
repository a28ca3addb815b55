// Dropped objects: schema and entry, for CPU and CUDA.
#include "augmentation/occlusion/objects.h"
#include "glue/glue.h"

namespace kv::augmentation {
namespace {

// Masks (B, N, H, W) int64, 0 where no object is; the numbers (B, 1, H, W) int64 of the regions of one mask a sample;
// words and counts (B,) float32, at most `most`; the widths (B,) int64 of images that are padded on the right.
// Bytes (B, 1, H, W), 1 where an object is dropped.
Tensor drop_objects(Tensor const& masks, std::optional<Tensor> const& components, Tensor const& words,
                    Tensor const& counts, std::optional<Tensor> const& widths, int64_t most) {
  constexpr char const* op = "drop_objects";
  KV_CHECK(masks.dim() == 4 && masks.scalar_type() == ScalarType::Long, op,
           ": expected int64 masks of shape (B, N, H, W)");
  int64_t const batch = masks.size(0), height = masks.size(2), width = masks.size(3);
  KV_CHECK(most >= 0 && most <= INT32_MAX / 2, op, ": expected most of at least 0");
  for (Tensor const* t : {&words, &counts})
    KV_CHECK(
        t->dim() == 1 && t->size(0) == batch && t->scalar_type() == ScalarType::Float && t->device() == masks.device(),
        op, ": expected float32 words and counts of shape (B,) on the device of masks");
  if (components)
    KV_CHECK(components->dim() == 4 && components->size(0) == batch && components->size(1) == 1 && masks.size(1) == 1 &&
                 components->size(2) == height && components->size(3) == width &&
                 components->scalar_type() == ScalarType::Long && components->device() == masks.device(),
             op, ": expected int64 components of shape (B, 1, H, W) on the device of masks");
  KV_CHECK(!widths || (widths->dim() == 1 && widths->size(0) == batch && widths->scalar_type() == ScalarType::Long &&
                       widths->device() == masks.device()),
           op, ": expected int64 widths of shape (B,) on the device of masks");
  KV_CHECK(!widths || height * width <= INT32_MAX, op, ": expected smaller masks with widths");
  Tensor const x = dense(masks), own_words = dense(words), own_counts = dense(counts),
               y = empty({batch, 1, height, width}, masks, Layout::planar, ScalarType::Byte);
  std::optional<Tensor> const regions = components ? std::optional<Tensor>(dense(*components)) : std::nullopt;
  std::optional<Tensor> const own_widths = widths ? std::optional<Tensor>(dense(*widths)) : std::nullopt;
  DropObjects<int64_t> const params{data_ptr<int64_t const>(x),
                                    regions ? data_ptr<int64_t const>(*regions) : nullptr,
                                    data_ptr<float const>(own_words),
                                    data_ptr<float const>(own_counts),
                                    own_widths ? data_ptr<int64_t const>(*own_widths) : nullptr,
                                    data_ptr<uint8_t>(y),
                                    batch,
                                    masks.size(1),
                                    height * width,
                                    width,
                                    int(most)};
  KV_RUN(drop_objects, masks, params, y.numel() ? batch : 0, 8 * x.numel() / max(batch, int64_t(1)));
  return y;
}

}  // namespace

KV_OPERATOR(drop_objects,
            "(Tensor masks, Tensor? components, Tensor words, Tensor counts, Tensor? widths, int most) -> Tensor")

}  // namespace kv::augmentation
