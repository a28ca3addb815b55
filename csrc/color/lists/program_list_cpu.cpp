// Color programs on lists of images on the CPU, by the kernel of batches: items [begin, end) of all samples, chunks of
// pixels or partial sums of means. Compiled once per instruction set.
#include "color/lists/program_list.h"

namespace kv::color::KV_ISA {

// Calls run(entry, its first item, the one behind its last) for those of a table with items from begin to end.
template <class Run>
void for_each_entry(ProgramTable const& p, int64_t begin, int64_t end, Run run) {
  for (int i = 0; i < p.count && begin < end; ++i) {
    int64_t const first = p.listed[i].first, last = min(end, int64_t(p.end_of(i)));
    if (last <= begin) continue;
    run(i, begin - first, last - first);
    begin = last;
  }
}

template <class F>
void program_list(ProgramList<F> const& p, int64_t begin, int64_t end) {
  for_each_entry(p, begin, end,
                 [&](int i, int64_t first, int64_t last) { KV_ISA::program(program_at(p, i), first, last); });
}
template <class F>
void program_list_backward(ProgramBackwardList<F> const& p, int64_t begin, int64_t end) {
  for_each_entry(p, begin, end,
                 [&](int i, int64_t first, int64_t last) { KV_ISA::program_backward(program_at(p, i), first, last); });
}

KV_INSTANTIATE_COMPUTED(program_list, ProgramList)
KV_INSTANTIATE_COMPUTED(program_list_backward, ProgramBackwardList)

}  // namespace kv::color::KV_ISA
