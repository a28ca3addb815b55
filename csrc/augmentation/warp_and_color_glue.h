// Runs a pass over images: a warp and a program of color steps.
#pragma once

#include "glue/image_list.h"

namespace kv::augmentation {

// The integers of a plan before its transforms: the dtype and the layout of the result; interpolation, padding,
// align_corners and antialias.
constexpr size_t kPassOptions = 6;

// Calls run(Type<T>{}) with the storage type of images that are computed in float.
template <class Run>
void dispatch_joined(char const* op, Tensor const& x, Run run) {
  switch (x.scalar_type()) {
    case ScalarType::Byte:
      return run(Type<uint8_t>{});
    case ScalarType::Float:
      return run(Type<float>{});
    case ScalarType::Half:
      return run(Type<Half>{});
    case ScalarType::BFloat16:
      return run(Type<BFloat16>{});
    default:
      KV_CHECK(false, op, ": no kernel for this dtype");
  }
}

// The result; the matrices of the warp (B, 3, 3), if there is one; the means of contrast (B, 1), if there is contrast.
struct PassResults {
  Tensor y;
  std::optional<Tensor> matrix, means;
};

// A batch; or pieces of it, copies of which it is made at first; or a list of images that the warp gives one size: then
// `like` is a batch of as many, of the first one's size and layout.
struct PassImages {
  Tensor like;
  Tensors const* list = nullptr;
  std::optional<Tensor> pieces;

  PassImages(Tensor const& batch, std::optional<Tensor> const& pieces = {}) : like(batch), pieces(pieces) {}
  PassImages(char const* op, Tensors const& list) : like((check_image_list(op, "images", list), list[0])), list(&list) {
    Tensor const& x = list[0];
    like =
        view_of(x, {int64_t(list.size()), x.size(0), x.size(1), x.size(2)}, {0, x.stride(0), x.stride(1), x.stride(2)});
  }
};

// `matrices` are those of the warp, if the caller has computed them from the columns already.
PassResults run_pass(PassImages const& images, std::optional<Tensor> const& columns, std::optional<Tensor> const& fill,
                     std::optional<Tensor> const& matrices, std::vector<int64_t> const& size,
                     std::vector<int64_t> const& plan, std::vector<double> const& numbers);

// A list of results, of which each has a size of its own: that of its image if `sizes` has none for it.
struct ListResults {
  Tensors images;
  std::optional<Tensor> matrix, means;
};
ListResults run_pass_to_list(PassImages const& images, std::optional<Tensor> const& columns,
                             std::optional<Tensor> const& fill, std::optional<Tensor> const& matrices, bool warps,
                             std::vector<int64_t> const& sizes, std::vector<int64_t> const& plan,
                             std::vector<double> const& numbers);

}  // namespace kv::augmentation
