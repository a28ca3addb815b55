// Matrices of crops: schema and entry, for CPU and CUDA alike.
#include "crop_matrix.h"
#include "sample_glue.h"

namespace kv {
namespace {

Tensor crop_matrix(Tensor const& quads, std::vector<int64_t> size) {
  KV_CHECK(quads.dim() == 3 && quads.size(1) == 4 && quads.size(2) == 2,
           "crop_matrix: expected quads of shape (B, 4, 2)");
  Size const result = size_of("crop_matrix", size);
  Tensor const points = dense(quads);
  int64_t const batch = points.size(0);
  Tensor const matrices = empty({batch, 3, 3}, points);
  for_computed("crop_matrix", points, [&](auto type) {
    using F = typename decltype(type)::type;
    CropMatrix<F> const params{data_of<F const>(points), data_of<F>(matrices), batch,
                               double(max(result.width - 1, int64_t(1))), double(max(result.height - 1, int64_t(1)))};
    KV_RUN(crop_matrix, points, params, batch, 64);
  });
  return matrices;
}

}  // namespace

KV_OPERATOR(crop_matrix, "(Tensor quads, int[] size) -> Tensor")

}  // namespace kv
