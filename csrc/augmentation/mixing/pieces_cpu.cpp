// Images made of pieces on the CPU: rows [begin, end) of all planes of the result, or samples. Compiled once per
// instruction set.
#include <cstddef>

#include "augmentation/mixing/pieces.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {
namespace {

constexpr int kPieceChunk = 512;  // elements

// The part of the elements [begin, end) that lies within [low, high).
struct PieceRange {
  int64_t begin, end;
  KV_HD PieceRange(int64_t begin, int64_t end, int64_t low, int64_t high)
      : begin(clamp(low, begin, end)), end(clamp(high, this->begin, end)) {}
};

// Elements [begin, end) of a row become those at a distance of a row with `size` of them, 0 outside.
template <class T>
KV_HD void copy_shifted(T* to, T const* from, int64_t size, int64_t distance, int64_t begin, int64_t end) {
  PieceRange const inside(begin, end, -distance, from ? size - distance : -distance);
  for (int64_t i = begin; i < inside.begin; ++i) to[i] = T{};
  if (inside.begin < inside.end)
    __builtin_memcpy(to + inside.begin, from + inside.begin + distance, size_t(inside.end - inside.begin) * sizeof(T));
  for (int64_t i = inside.end; i < end; ++i) to[i] = T{};
}

// v[i - first] for i in [begin, end) becomes element i + distance of a row with `size` of them, 0 outside.
template <class T>
KV_HD void load_shifted(Compute<T>* v, T const* from, int64_t size, int64_t distance, int64_t begin, int64_t end) {
  PieceRange const inside(begin, end, -distance, from ? size - distance : -distance);
  for (int64_t i = begin; i < end; ++i)
    v[i - begin] = i >= inside.begin && i < inside.end ? Compute<T>(load<1>(from + i + distance)) : Compute<T>(0);
}

// Whether all pieces of the row are copies.
template <class T>
KV_HD bool has_copies_only(PastePieces<T> const& p, int64_t b, int64_t y) {
  for (int n = 0; n < p.count; ++n) {
    Piece const piece = p.piece(b, n);
    if (piece.has_row(y) && piece.weight != 1) return false;
  }
  return true;
}

}  // namespace

template <class T>
void paste_pieces(PastePieces<T> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.y.step, size = p.x.row_size(), width = p.y.row_size();
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.y.height, y = r % p.y.height, b = plane / p.planes_per_sample;
    T* const to = p.y.row(plane, y);
    T const* const own = p.row_of(plane, b, 0, y);
    if (has_copies_only(p, b, y)) {
      copy_shifted(to, own, size, 0, 0, width);
      for (int n = 0; n < p.count; ++n) {
        Piece const piece = p.piece(b, n);
        if (!piece.has_row(y)) continue;
        PieceRange const columns(0, width, piece.left * step, piece.right * step);
        copy_shifted(to, p.row_of(plane, b, piece.source, y + piece.dy), size, piece.dx * step, columns.begin,
                     columns.end);
      }
      continue;
    }
    Compute<T> v[kPieceChunk], read[kPieceChunk];
    for (int64_t first = 0; first < width; first += kPieceChunk) {
      int64_t const last = min(first + kPieceChunk, width);
      load_shifted(v, own, size, 0, first, last);
      for (int n = 0; n < p.count; ++n) {
        Piece const piece = p.piece(b, n);
        if (!piece.has_row(y)) continue;
        PieceRange const columns(first, last, piece.left * step, piece.right * step);
        Compute<T>* const at = v + (columns.begin - first);
        load_shifted(read, p.row_of(plane, b, piece.source, y + piece.dy), size, piece.dx * step, columns.begin,
                     columns.end);
        Compute<T> const weight = piece.weight, rest = 1 - weight;
        for (int64_t i = 0; i < columns.end - columns.begin; ++i)
          at[i] = weight == 1 ? read[i] : at[i] * rest + read[i] * weight;
      }
      for (int64_t i = first; i < last; ++i) store<1>(to + i, v[i - first]);
    }
  }
}

template <class T>
void paste_pieces_backward(PastePieces<T> const& p, int64_t begin, int64_t end) {
  int64_t const step = p.y.step, size = p.x.row_size(), width = p.y.row_size();
  Compute<T> sum[kPieceChunk], v[kPieceChunk];
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.y.height, y = r % p.y.height, b = plane / p.planes_per_sample;
    T* const to = p.y.row(plane, y);
    for (int64_t first = 0; first < width; first += kPieceChunk) {
      int64_t const last = min(first + kPieceChunk, width);
      // v has the gradients to elements [begin, end) of row `row` of the result of `sample`, which the pieces from n on
      // cover.
      auto const cover = [&](int64_t sample, int n, int64_t row, int64_t begin, int64_t end) KV_INLINE {
        for (; n < p.count; ++n) {
          Piece const above = p.piece(sample, n);
          if (!above.has_row(row)) continue;
          PieceRange const columns(begin, end, above.left * step, above.right * step);
          Compute<T> const rest = 1 - Compute<T>(above.weight);
          for (int64_t i = columns.begin; i < columns.end; ++i) v[i - begin] = rest == 0 ? 0 : v[i - begin] * rest;
        }
      };
      load_shifted(v, p.row_of(plane, b, 0, y), size, 0, first, last);
      cover(b, 0, y, first, last);
      for (int64_t i = 0; i < last - first; ++i) sum[i] = v[i];
      for (int n = 0; n < p.count; ++n) {
        int64_t const user = p.piece(b, n).user;
        if (b + user < 0 || b + user >= p.batch) continue;
        Piece const piece = p.piece(b + user, n);
        int64_t const row = y - piece.dy, distance = piece.dx * step;
        if (piece.source != -user || !piece.has_row(row)) continue;
        PieceRange const columns(first, last, max(piece.left * step, int64_t(0)) + distance,
                                 min(piece.right * step, size) + distance);
        load_shifted(v, p.row_of(plane, b, user, row), size, -distance, columns.begin, columns.end);
        cover(b + user, n + 1, row, columns.begin - distance, columns.end - distance);
        for (int64_t i = columns.begin; i < columns.end; ++i)
          sum[i - first] += Compute<T>(piece.weight) * v[i - columns.begin];
      }
      for (int64_t i = first; i < last; ++i) store<1>(to + i, sum[i - first]);
    }
  }
}

template <class T>
void mix_pieces(MixPieces<T> const& p, int64_t begin, int64_t end) {
  auto const reader_of = [&](int64_t b, int i) KV_INLINE { return find_reader(p, b, i); };
  for (int64_t b = begin; b < end; ++b) mix_sample(p, b, reader_of);
}

KV_INSTANTIATE_WITH_BYTES(paste_pieces, PastePieces)
KV_INSTANTIATE(paste_pieces_backward, PastePieces)
KV_INSTANTIATE_ONE(mix_pieces, MixPieces, float)

}  // namespace kv::augmentation::KV_ISA
