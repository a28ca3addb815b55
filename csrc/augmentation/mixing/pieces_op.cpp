// Images made of pieces: schemas and entries, for CPU and CUDA.
#include <algorithm>

#include "augmentation/mixing/pieces_glue.h"

namespace kv::augmentation {
namespace {

template <class T>
PastePieces<T> paste_parameters(Tensor const& x, Tensor const& y, Tensor const& pieces, Layout layout) {
  return {planes<T const>(x, layout),
          planes<T>(y, layout),
          data_ptr<float const>(pieces),
          int(pieces.size(1)),
          x.size(0),
          layout == Layout::channels_last ? 1 : x.size(1),
          stride_of_pieces(pieces)};
}

// Images (B, C, H, W), pieces (B, N, 9); run(x, y, pieces, layout) writes y (B, C, h, w).
template <class Run>
Tensor paste(char const* op, Tensor const& images, Tensor const& pieces, std::vector<int64_t> const& size, Run run) {
  check_images(op, "images", images);
  check_pieces(op, images, pieces);
  KV_CHECK(size.size() == 2 && size[0] >= 0 && size[1] >= 0, op, ": expected a size of two numbers");
#if defined(KV_CUDA)
  KV_CHECK(pieces.size(1) <= kMaxPieces, op, ": expected at most ", kMaxPieces, " pieces, got ", pieces.size(1));
#endif
  int64_t const row = std::max(images.size(3), size[1]) * images.size(1);
  KV_CHECK(std::max({images.size(2), size[0], row}) <= kMaxPieceRow, op, ": expected at most ", kMaxPieceRow,
           " rows, and elements of a row");
  Layout const layout = layout_of(images);
  int64_t const sizes[] = {images.size(0), images.size(1), size[0], size[1]};
  Tensor const x = as_layout(images, layout), y = empty(sizes, x, layout);
  if (y.numel()) run(x, y, dense(pieces), layout);
  return y;
}

}  // namespace

void check_pieces(char const* op, Tensor const& images, Tensor const& pieces) {
  KV_CHECK(pieces.dim() == 3 && pieces.size(2) == kPieceNumbers &&
               (pieces.size(0) == images.size(0) || pieces.size(0) == 1) && pieces.scalar_type() == ScalarType::Float &&
               pieces.device() == images.device() && pieces.size(1) <= INT32_MAX,
           op, ": expected float32 pieces of shape (B, N, ", kPieceNumbers, ") on the device of images");
}

Tensor pasted(Tensor const& images, Tensor const& pieces, std::vector<int64_t> const& size) {
  constexpr char const* op = "paste_pieces";
  return paste(op, images, pieces, size, [](Tensor const& x, Tensor const& y, Tensor const& pieces, Layout layout) {
    dispatch_floating_and_uint8(op, x, [&]<class T>(Type<T>) {
      PastePieces<T> const params = paste_parameters<T>(x, y, pieces, layout);
      KV_RUN(paste_pieces, x, params, params.y.rows(), params.y.row_size());
    });
  });
}

namespace {

Tensor paste_pieces(Tensor const& images, Tensor const& pieces, std::vector<int64_t> const& size) {
  return pasted(images, pieces, size);
}

Tensor paste_pieces_backward(Tensor const& grad, Tensor const& pieces, std::vector<int64_t> const& size) {
  constexpr char const* op = "paste_pieces_backward";
  return paste(op, grad, pieces, size, [](Tensor const& x, Tensor const& y, Tensor const& pieces, Layout layout) {
    dispatch_floating(op, x, [&]<class T>(Type<T>) {
      PastePieces<T> const params = paste_parameters<T>(x, y, pieces, layout);
      KV_RUN(paste_pieces_backward, x, params, params.y.rows(), 4 * params.y.row_size());
    });
  });
}

// Columns (B, P) of draws. The plan is the kind, the first draw, the column of the samples that are mixed or -1, the
// number of pieces, rows and columns of the grid, height and width of images and results; the numbers are bounds of the
// side of a window.
Tensor mix_pieces(Tensor const& columns, std::vector<int64_t> const& plan, std::vector<double> const& numbers) {
  constexpr char const* op = "mix_pieces";
  KV_CHECK(columns.dim() == 2 && columns.scalar_type() == ScalarType::Float, op,
           ": expected float32 columns of shape (B, P)");
  KV_CHECK(plan.size() == 10 && numbers.size() == 2, op, ": expected a plan of 10 numbers and 2 bounds");
  KV_CHECK(plan[0] >= 0 && plan[0] < kMixKinds, op, ": expected a kind below ", kMixKinds, ", got ", plan[0]);
  for (size_t i = 4; i < plan.size(); ++i)
    KV_CHECK(plan[i] >= 1 && plan[i] < (1 << 24), op, ": expected sizes from 1 to 2^24, got ", plan[i]);
  MixKind const kind = MixKind(plan[0]);
  int64_t const count = plan[3], cells = plan[4] * plan[5];
  bool const is_grid = kind == MixKind::jigsaw || kind == MixKind::mosaic;
  KV_CHECK(is_grid ? count == cells + (kind == MixKind::mosaic) : count >= 1 && (kind == MixKind::cutmix || count == 1),
           op, ": expected as many pieces as the kind has, got ", count);
  int64_t const draws[] = {2, 4 * count, 3, cells, cells + 1};
  KV_CHECK(plan[1] >= 0 && plan[1] + draws[plan[0]] <= columns.size(1) && plan[2] >= -1 && plan[2] < columns.size(1),
           op, ": expected the columns of its draws, got ", columns.size(1));
  int64_t const sizes[] = {columns.size(0), count, kPieceNumbers};
  Tensor const own = dense(columns), result = empty(sizes, columns);
  MixPieces<float> const params{data_ptr<float const>(own),
                                data_ptr<float>(result),
                                own.size(0),
                                own.size(1),
                                int(plan[1]),
                                int(plan[2]),
                                int(count),
                                kind,
                                plan[4],
                                plan[5],
                                plan[6],
                                plan[7],
                                plan[8],
                                plan[9],
                                float(numbers[0]),
                                float(numbers[1])};
  KV_RUN(mix_pieces, columns, params, params.batch, 64 * count);
  return result;
}

}  // namespace

KV_OPERATOR(paste_pieces, "(Tensor images, Tensor pieces, int[] size) -> Tensor")
KV_OPERATOR(paste_pieces_backward, "(Tensor grad, Tensor pieces, int[] size) -> Tensor")
KV_OPERATOR(mix_pieces, "(Tensor columns, int[] plan, float[] numbers) -> Tensor")

}  // namespace kv::augmentation
