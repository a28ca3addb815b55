// The work of a list on the CPU. Included by *_list_cpu.cpp, outside of namespaces.
#pragma once

#include "core/image_list.h"

namespace kv::geometry::KV_ISA {
namespace {

// Calls run(sample, first, last) for the items [begin, end) of each sample, counted from its first one.
template <class List, class Run>
void for_each_sample(List const& list, int64_t begin, int64_t end, Run run) {
  while (begin < end) {
    int const b = list.sample_of(int(begin));
    int64_t const first = list.first[b], next = b + 1 < list.count ? list.first[b + 1] : list.items;
    int64_t const last = min(end, next);
    run(b, begin - first, last - first);
    begin = last;
  }
}

}  // namespace
}  // namespace kv::geometry::KV_ISA
