// Sums of moved copies on the CPU: rows [begin, end) of all planes. Compiled once per instruction set.
#include "augmentation/corruption/moved.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

namespace {

constexpr int kChunk = 256;

// Rows [begin, end) of sums, by chunks, to which add(plane that is read, move, row, first column, columns, sums) adds
// what each move gives.
template <class T, class Add>
KV_HD void sum_rows(SumOfMoved<T> const& p, int64_t begin, int64_t end, Add const& add) {
  using F = Compute<T>;
  for (int64_t r = begin; r < end; ++r) {
    int64_t const plane = r / p.height, y = r % p.height, b = plane / p.channels, c = plane % p.channels;
    T const* const x = p.x + b * p.x_strides[0] + c * p.x_strides[1];
    T* const result = p.y + b * p.y_strides[0] + c * p.y_strides[1] + y * p.y_strides[2];
    for (int64_t left = 0; left < p.width; left += kChunk) {
      int const count = int(min(p.width - left, int64_t(kChunk)));
      F sum[kChunk] = {};
      for (int64_t k = 0; k < p.num_moves; ++k) {
        F const* const move = p.moves + b * p.move_stride + 4 * k;
        if (move[3] != 0) add(x, move, y, left, count, sum);
      }
      for (int i = 0; i < count; ++i) store<1>(result + (left + i) * p.y_strides[3], Lanes<F, 1>(sum[i]));
    }
  }
}

}  // namespace

template <class T>
void sum_of_moved(SumOfMoved<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  sum_rows(p, begin, end,
           [&](T const* x, F const* move, int64_t y, int64_t left, int count, F(&sum)[kChunk]) KV_INLINE {
             F const scale = move[0], weight = move[3];
             PairOfTaps<F> const down(scale * F(y) + move[2], int(p.height));
             T const *const upper = x + down.first * p.x_strides[2], *const lower = x + down.second * p.x_strides[2];
             for (int i = 0; i < count; ++i) {
               PairOfTaps<F> const across(scale * F(left + i) + move[1], int(p.width));
               int64_t const first = across.first * p.x_strides[3], second = across.second * p.x_strides[3];
               F const u = load<1>(upper + first), v = load<1>(upper + second);
               F value = across.t > 0 ? u + across.t * (v - u) : u;
               if (down.t > 0) {
                 F const s = load<1>(lower + first), t = load<1>(lower + second);
                 value += down.t * ((across.t > 0 ? s + across.t * (t - s) : s) - value);
               }
               sum[i] += weight * value;
             }
           });
}

template <class T>
void sum_of_moved_backward(SumOfMoved<T> const& p, int64_t begin, int64_t end) {
  using F = Compute<T>;
  sum_rows(p, begin, end,
           [&](T const* grad, F const* move, int64_t y, int64_t left, int count, F(&sum)[kChunk]) KV_INLINE {
             ReadersOfPixel<F> const down(move[0], move[2], int(y), int(p.height));
             for (int row = down.begin; row < down.end; ++row) {
               F const weight = move[3] * down.weight(row);
               if (weight == 0) continue;
               T const* const from = grad + row * p.x_strides[2];
               for (int i = 0; i < count; ++i) {
                 ReadersOfPixel<F> const across(move[0], move[1], int(left) + i, int(p.width));
                 for (int column = across.begin; column < across.end; ++column)
                   if (F const own = across.weight(column); own != 0)
                     sum[i] += weight * own * F(load<1>(from + column * p.x_strides[3]));
               }
             }
           });
}

template <class T>
void sum_of_moved_list(SumOfMovedList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    SumOfMoved<T> const one = p.sample(b);
    int64_t const rows = rows_of_item(one.width);
    sum_of_moved(one, first * rows, min(last * rows, one.channels * one.height));
  });
}

template <class T>
void sum_of_moved_backward_list(SumOfMovedList<T> const& p, int64_t begin, int64_t end) {
  for_each_sample(p.list, begin, end, [&](int b, int64_t first, int64_t last) {
    SumOfMoved<T> const one = p.sample(b);
    int64_t const rows = rows_of_item(one.width);
    KV_ISA::sum_of_moved_backward(one, first * rows, min(last * rows, one.channels * one.height));
  });
}

KV_INSTANTIATE_WITH_BYTES(sum_of_moved, SumOfMoved)
KV_INSTANTIATE_WITH_BYTES(sum_of_moved_list, SumOfMovedList)
KV_INSTANTIATE(sum_of_moved_backward, SumOfMoved)
KV_INSTANTIATE(sum_of_moved_backward_list, SumOfMovedList)

}  // namespace kv::augmentation::KV_ISA
