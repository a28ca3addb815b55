// Confusion matrices: for every sample the counts of pairs of a true and a predicted class, and the statistics derived
// from them. A pixel is left out if either label is not a class.
#pragma once

#include "core/isa.h"

namespace kv::metrics {

// The counts; the counts divided by the sum of their row; or the intersection over union of each class. Exported graphs
// contain these numbers.
enum class ConfusionStatistic : int { counts, rates, iou };

template <class T>
struct ConfusionMatrix {
  T const *pred, *target;  // (samples, pixels)
  int64_t samples, pixels;
  int classes;
  ConfusionStatistic statistic;
  float eps;
  float* result;     // (samples, classes, classes); iou: (samples, classes)
  uint32_t* counts;  // CUDA: (samples, classes, classes)

  // The index of the count of a pair of labels, or -1.
  KV_HD int64_t cell(T predicted, T labelled) const {
    bool const counts =
        uint64_t(int64_t(predicted)) < uint64_t(classes) && uint64_t(int64_t(labelled)) < uint64_t(classes);
    return counts ? int64_t(labelled) * classes + int64_t(predicted) : -1;
  }
  KV_HD float rate(float count, float of_row) const { return count / (of_row + eps); }
  KV_HD float overlap(float both, float labelled, float predicted) const {
    return (both + eps) / (labelled + predicted - both + eps);
  }
};

KV_KERNEL(confusion_matrix, ConfusionMatrix)

}  // namespace kv::metrics
