// Sizes of the maps of a list, for the entries of operators.
#pragma once

#include "glue/glue.h"

namespace kv::augmentation {

// Height and width of each result, and the margins of their maps.
struct ResultSizes {
  std::vector<int64_t> const &sides, &margins;
  std::vector<int64_t> nodes;  // where those of each map begin; the last entry is their number

  ResultSizes(char const* op, std::vector<int64_t> const& sides, std::vector<int64_t> const& margins)
      : sides(sides), margins(margins), nodes{0} {
    KV_CHECK(sides.size() == 2 * margins.size(), op, ": expected height and width of ", margins.size(), " results");
    for (size_t b = 0; b < margins.size(); ++b) {
      KV_CHECK(margins[b] >= 0 && margins[b] <= 62, op, ": expected margins of 0 to 62, got ", margins[b]);
      KV_CHECK(sides[2 * b] >= 0 && sides[2 * b + 1] >= 0 && rows(b) <= INT32_MAX / columns(b), op,
               ": expected fewer than 2^31 nodes a sample");
      nodes.push_back(nodes.back() + rows(b) * columns(b));
    }
  }
  int64_t count() const { return int64_t(margins.size()); }
  int64_t rows(size_t b) const { return sides[2 * b] + 2 * margins[b] + 2; }
  int64_t columns(size_t b) const { return sides[2 * b + 1] + 2 * margins[b] + 2; }
};

inline void check_nodes(char const* op, Tensor const& coordinates, Tensor const& kinds, int64_t count, ScalarType type,
                        Tensor const& like) {
  KV_CHECK(coordinates.dim() == 2 && coordinates.size(0) == count && coordinates.size(1) == 2 &&
               coordinates.scalar_type() == type && coordinates.device() == like.device(),
           op, ": expected coordinates of shape (", count, ", 2) of the type and the device of the first argument");
  KV_CHECK(kinds.dim() == 1 && kinds.size(0) == count && kinds.scalar_type() == ScalarType::Byte &&
               kinds.device() == like.device(),
           op, ": expected uint8 kinds of shape (", count, ",)");
}

}  // namespace kv::augmentation
