// Confusion matrices on the CPU: samples [begin, end). Compiled once per instruction set.
#include "confusion_matrix.h"
#include "core/scratch.h"

namespace kv::metrics::KV_ISA {

template <class T>
void confusion_matrix(ConfusionMatrix<T> const& p, int64_t begin, int64_t end) {
  int64_t const n = p.classes;
  Scratch<uint32_t> const memory(n * n);
  uint32_t* const counts = memory.data;
  for (int64_t sample = begin; sample < end; ++sample) {
    for (int64_t i = 0; i < n * n; ++i) counts[i] = 0;
    T const *const pred = p.pred + sample * p.pixels, *const target = p.target + sample * p.pixels;
    for (int64_t i = 0; i < p.pixels; ++i) {
      int64_t const cell = p.cell(pred[i], target[i]);
      if (cell >= 0) ++counts[cell];
    }
    for (int64_t row = 0; row < n; ++row) {
      uint32_t labelled = 0, predicted = 0;
      for (int64_t k = 0; k < n; ++k) labelled += counts[row * n + k], predicted += counts[k * n + row];
      if (p.statistic == ConfusionStatistic::iou) {
        p.result[sample * n + row] = p.overlap(float(counts[row * n + row]), float(labelled), float(predicted));
        continue;
      }
      float* const to = p.result + (sample * n + row) * n;
      for (int64_t k = 0; k < n; ++k) {
        float const count = float(counts[row * n + k]);
        to[k] = p.statistic == ConfusionStatistic::counts ? count : p.rate(count, float(labelled));
      }
    }
  }
}

KV_INSTANTIATE_ONE(confusion_matrix, ConfusionMatrix, int64_t)
KV_INSTANTIATE_ONE(confusion_matrix, ConfusionMatrix, uint8_t)

}  // namespace kv::metrics::KV_ISA
