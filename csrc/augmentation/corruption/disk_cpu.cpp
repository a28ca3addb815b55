// Disks on the CPU: kernels of samples [begin, end). Compiled once per instruction set.
#include "augmentation/corruption/disk.h"
#include "core/lanes.h"

namespace kv::augmentation::KV_ISA {

template <class T>
void disk_kernels(DiskKernels<T> const& p, int64_t begin, int64_t end) {
  for (int64_t b = begin; b < end; ++b) {
    Disk<T> const disk(T(p.radii[b * p.radius_stride]), p.deviations[b * p.deviation_stride]);
    int64_t pixels = 0;
    for (int y = -p.reach; y <= p.reach; ++y)
      for (int x = -p.reach; x <= p.reach; ++x) pixels += disk.has(T(x), T(y));
    T* to = p.y + b * p.side() * p.side();
    for (int y = -p.reach; y <= p.reach; ++y)
      for (int x = -p.reach; x <= p.reach; ++x) *to++ = disk.at(x, y) / T(pixels);
  }
}

KV_INSTANTIATE_COMPUTED(disk_kernels, DiskKernels)

}  // namespace kv::augmentation::KV_ISA
