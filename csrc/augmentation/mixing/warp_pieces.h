// A bilinear warp of images that are made of pieces, and a program of color steps, in one pass over memory on CUDA:
// pixels are read where the images of the pieces are. On the CPU the images are pasted first.
#pragma once

#include "augmentation/mixing/pieces.h"
#include "augmentation/warp_and_color.h"

namespace kv::augmentation {

constexpr int kMaxReadPieces = 31;  // of a sample, of which a block keeps a set in the bits of a word

// Images have three channels, the size of those that are made, and types that compute in float. All pieces are copies,
// the padding is a fill, and the program has no mean.
template <class T>
struct WarpPieces : WarpAndColor<T> {
  float const* pieces;  // (B, count, kPieceNumbers)
  int count;
  int64_t piece_stride;  // 0 where all samples have the same

  KV_HD Piece piece(int64_t sample, int n) const { return Piece(pieces + sample * piece_stride + n * kPieceNumbers); }
};

KV_KERNEL(warp_pieces, WarpPieces)

}  // namespace kv::augmentation
