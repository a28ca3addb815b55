// Images that are made of pieces, for the entries of operators.
#pragma once

#include "augmentation/mixing/pieces.h"
#include "glue/glue.h"

namespace kv::augmentation {

// Pieces (B or 1, N, kPieceNumbers) of images (B, C, H, W).
void check_pieces(char const* op, Tensor const& images, Tensor const& pieces);
inline int64_t stride_of_pieces(Tensor const& pieces) {
  return pieces.size(0) > 1 ? pieces.size(1) * kPieceNumbers : 0;
}

// Results (B, C, h, w).
Tensor pasted(Tensor const& images, Tensor const& pieces, std::vector<int64_t> const& size);

}  // namespace kv::augmentation
