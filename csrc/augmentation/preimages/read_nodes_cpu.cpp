// Nodes of maps on the CPU: items, which are some rows of a map. Compiled once per instruction set.
#include "augmentation/preimages/read_nodes.h"
#include "core/image_list.h"

namespace kv::augmentation::KV_ISA {

template <class F>
void read_nodes_list(ReadNodes<F> const& p, int64_t begin, int64_t end) {
  for_each_sample(p, begin, end, [&](int b, int64_t first, int64_t last) {
    int64_t const rows = rows_of_item(p.columns[b]), from = first * rows, to = min(last * rows, int64_t(p.rows[b]));
    for (int64_t i = from; i < to; ++i)
      for (int64_t j = 0; j < p.columns[b]; ++j) p.run(b, i, j);
  });
}

KV_INSTANTIATE_COMPUTED(read_nodes_list, ReadNodes)

}  // namespace kv::augmentation::KV_ISA
