// Images that are made of pieces of the images of a batch, as mixing augmentations make them: rectangles of the result
// that read from a sample at a distance, one over the other.
#pragma once

#include "core/isa.h"
#include "core/view.h"

namespace kv::augmentation {

// Columns [left, right) and rows [top, bottom) of the result become v + weight (s - v), s from the sample `source`
// behind this one, at a distance of (dx, dy); 0 outside of its image. `user` is where the sample is whose piece of the
// same number reads from this one, of which there is one.
constexpr int kPieceNumbers = 9;
constexpr int kMaxPieces = 512;        // of a sample, on CUDA
constexpr int kMaxPieceRow = 1 << 29;  // elements of a row, and rows
struct Piece {
  int64_t left, top, right, bottom, source, user, dx, dy;
  float weight;

  KV_HD explicit Piece(float const* n)
      : left(int64_t(n[0])),
        top(int64_t(n[1])),
        right(int64_t(n[2])),
        bottom(int64_t(n[3])),
        source(int64_t(n[4])),
        user(int64_t(n[5])),
        dx(int64_t(n[6])),
        dy(int64_t(n[7])),
        weight(n[8]) {}
  KV_HD bool has_row(int64_t y) const { return top <= y && y < bottom; }
};

// `x` are images and `y` results; in the backward pass gradients to results and to images.
template <class T>
struct PastePieces {
  Planes<T const> x;
  Planes<T> y;
  float const* pieces;  // (B, count, kPieceNumbers)
  int count;
  int64_t batch, planes_per_sample,
      piece_stride;  // 1 where a plane has all channels; 0 where all samples have the same

  KV_HD Piece piece(int64_t sample, int n) const { return Piece(pieces + sample * piece_stride + n * kPieceNumbers); }
  // The row of the same channel of another sample; null where there is none.
  KV_HD T const* row_of(int64_t plane, int64_t sample, int64_t offset, int64_t y) const {
    bool const is_there = sample + offset >= 0 && sample + offset < batch && y >= 0 && y < x.height;
    return is_there ? x.row(plane + offset * planes_per_sample, y) : nullptr;
  }
};

KV_KERNEL(paste_pieces, PastePieces)
KV_KERNEL(paste_pieces_backward, PastePieces)

// The pieces of mixing augmentations from what was drawn.
enum class MixKind : int { mixup, cutmix, patch_mix, jigsaw, mosaic };
constexpr int kMixKinds = 5;

template <class T>
struct MixPieces {
  T const* columns;  // (B, P); the draws begin at `first`, and `chosen` says which samples are mixed, or is -1 for all
  T* result;         // (B, count, kPieceNumbers)
  int64_t batch, columns_stride;
  int first, chosen, count;
  MixKind kind;
  int64_t rows, columns_of_grid;  // of grids; height and width of a patch
  int64_t height, width, out_height, out_width;
  T low, high;  // of the side of a window; for jigsaws `low` is not 0 where the identity is replaced

  KV_HD T drawn(int64_t b, int i) const { return columns[b * columns_stride + first + i]; }
  KV_HD T* piece(int64_t b, int n) const { return result + (b * count + n) * kPieceNumbers; }
};

KV_KERNEL(mix_pieces, MixPieces)

template <class T>
KV_HD void set_window(T* piece, int64_t left, int64_t top, int64_t right, int64_t bottom, int64_t dx, int64_t dy,
                      T weight) {
  piece[0] = T(left), piece[1] = T(top), piece[2] = T(right), piece[3] = T(bottom);
  piece[6] = T(dx), piece[7] = T(dy), piece[8] = weight;
}

// Whether number k, x, comes before number b among those that are not negative.
template <class T>
KV_HD bool precedes(T x, int64_t k, T own, int64_t b) {
  return x >= 0 && (x < own || (x == own && k < b));
}

// Draw i orders the samples that are not negative there: the k-th of them reads from the k-th in order, others from
// themselves. Of samples of numbers that are not in order, as NaN, each reads from itself. This is the sample that
// reads from b.
template <class T>
KV_HD int64_t find_reader(MixPieces<T> const& p, int64_t b, int i) {
  T const own = p.drawn(b, i);
  if (!(own >= 0)) return b;
  int64_t rank = 0, reader = 0;
  for (int64_t k = 0; k < p.batch; ++k) rank += precedes(p.drawn(k, i), k, own, b);
  for (; reader < p.batch; ++reader)
    if (p.drawn(reader, i) >= 0 && rank-- == 0) return reader;
  return b;
}
// Tells both; `reader_of(b, i)` is find_reader.
template <class T, class ReaderOf>
KV_HD void pair_up(MixPieces<T> const& p, int64_t b, int i, int n, ReaderOf reader_of) {
  int64_t const reader = reader_of(b, i);
  p.piece(reader, n)[4] = T(b - reader);
  p.piece(b, n)[5] = T(reader - b);
}

KV_HD int64_t to_whole(float x, int64_t highest) { return x > 0 ? (x < float(highest) ? int64_t(x) : highest) : 0; }

template <class T, class ReaderOf>
KV_HD void mix_sample(MixPieces<T> const& p, int64_t b, ReaderOf reader_of) {
  bool const chosen = p.chosen < 0 || p.columns[b * p.columns_stride + p.chosen] > T(.5);
  int64_t const w = p.width, h = p.height;
  switch (p.kind) {
    case MixKind::mixup:
      pair_up(p, b, 0, 0, reader_of);
      set_window(p.piece(b, 0), 0, 0, w, h, 0, 0, p.drawn(b, 1));
      break;
    case MixKind::cutmix:
      for (int n = 0; n < p.count; ++n) {
        pair_up(p, b, 4 * n, n, reader_of);
        T const side = min(max(T(sqrt(1 - p.drawn(b, 4 * n + 1))), p.low), p.high);
        int64_t const across = to_whole(side * T(w), w), down = to_whole(side * T(h), h),
                      x = to_whole(p.drawn(b, 4 * n + 2) * T(w - across + 1), w),
                      y = to_whole(p.drawn(b, 4 * n + 3) * T(h - down + 1), h);
        set_window(p.piece(b, n), x, y, x + across, y + down, 0, 0, T(1));
      }
      break;
    case MixKind::patch_mix: {
      pair_up(p, b, 0, 0, reader_of);
      int64_t const x = to_whole(p.drawn(b, 1), w), y = to_whole(p.drawn(b, 2), h);
      set_window(p.piece(b, 0), x, y, x + p.columns_of_grid, y + p.rows, 0, 0, T(1));
      break;
    }
    case MixKind::jigsaw: {
      int64_t const across = w / p.columns_of_grid, down = h / p.rows;
      bool is_identity = p.count > 1;  // which becomes a rotation of the cells
      for (int n = 0; n < p.count; ++n) is_identity = is_identity && to_whole(p.drawn(b, n), p.count) == n;
      for (int n = 0; n < p.count; ++n) {
        int const k = is_identity && p.low != 0 ? (n + p.count - 1) % p.count : n;
        int64_t const cell = to_whole(p.drawn(b, k), p.count), column = n % p.columns_of_grid,
                      row = n / p.columns_of_grid;
        int64_t const x = column * across, y = row * down;
        p.piece(b, n)[4] = p.piece(b, n)[5] = 0;
        set_window(p.piece(b, n), x, y, chosen ? x + across : x, y + down, (cell % p.columns_of_grid - column) * across,
                   (cell / p.columns_of_grid - row) * down, T(1));
      }
      break;
    }
    case MixKind::mosaic: {
      int64_t const last_x = max(p.columns_of_grid * w - p.out_width, int64_t(0)),
                    last_y = max(p.rows * h - p.out_height, int64_t(0)), x = to_whole(p.drawn(b, 0) * T(w), last_x),
                    y = to_whole(p.drawn(b, 1) * T(h), last_y);
      // The first one reads out of the image: 0 is where there is no cell.
      p.piece(b, 0)[4] = p.piece(b, 0)[5] = 0;
      set_window(p.piece(b, 0), 0, 0, chosen ? p.out_width : 0, p.out_height, w, h, T(1));
      for (int n = 1; n < p.count; ++n) {
        int64_t const left = (n - 1) % p.columns_of_grid * w - x, top = (n - 1) / p.columns_of_grid * h - y;
        if (n == 1)
          p.piece(b, n)[4] = p.piece(b, n)[5] = 0;
        else
          pair_up(p, b, n, n, reader_of);
        set_window(p.piece(b, n), left, top, chosen ? left + w : left, top + h, -left, -top, T(1));
      }
      break;
    }
  }
}

}  // namespace kv::augmentation
