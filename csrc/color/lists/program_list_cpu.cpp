// Color programs on lists of images on the CPU, by the kernel of batches: items [begin, end) of all samples, chunks of
// pixels or partial sums of means. Compiled once per instruction set.
#include "color/lists/program_list.h"

namespace kv::color::KV_ISA {

template <class F>
void program_list(ProgramList<F> const& p, int64_t begin, int64_t end) {
  for (int i = 0; i < p.count && begin < end; ++i) {
    int64_t const first = p.listed[i].first, last = min(end, int64_t(p.end_of(i)));
    if (last <= begin) continue;
    KV_ISA::program(program_at(p, i), begin - first, last - first);
    begin = last;
  }
}

KV_INSTANTIATE_COMPUTED(program_list, ProgramList)

}  // namespace kv::color::KV_ISA
