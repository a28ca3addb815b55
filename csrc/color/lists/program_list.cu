// Color programs on lists of images on CUDA, in one launch, or two around a mean of samples that no cluster keeps: a
// block finds its image in the table and works as blocks of batches do.
#include "color/lists/program_list.h"
#include "color/program_clusters.cuh"
#include "color/program_forward.cuh"

namespace kv::color::cuda {
namespace {

static_assert(sizeof(ProgramList<float>) <= 32764, "more than a kernel's parameters");

template <int C>
__global__ void __launch_bounds__(kThreads, 4) run_list(__grid_constant__ ProgramList<float> const p) {
  __shared__ Sample<float> sample;
  int const i = entry_of_item(p.count, int(blockIdx.x), [&](int k) { return p.listed[k].first; });
  ListedPixels const& own = p.listed[i];
  Program<float> const& all = p.all;
  Pixels const x = p.pixels_of(all.x, const_cast<void*>(own.x), own), y = p.pixels_of(all.y, own.y, own);
  int64_t const pixels = own.as_values ? own.pixels * int64_t(all.x.channels) : own.pixels;
  int const block = int(blockIdx.x) - own.first, blocks = p.end_of(i) - own.first;
  float* const parts = all.parts + own.part;
  MeanParts<float> const mean{parts, mean_parts_of<float>(p.samples, pixels), pixels};
  if (own.by_vectors)
    run_block<float, C, false>(all, sample, x, y, own.sample, 0, 0, pixels, block, blocks, parts + block, mean);
  else
    run_block<float, C, true>(all, sample, x, y, own.sample, 0, 0, pixels, block, blocks, parts + block, mean);
}

template <bool Plain>
__global__ void __launch_bounds__(kClusterThreads, 2)
    run_list_by_clusters(__grid_constant__ ProgramList<float> const p) {
  __shared__ Sample<float> sample;
  extern __shared__ __align__(16) float kept[];
  ListedPixels const& own = p.listed[cluster_of_block()];
  Pixels const x = p.pixels_of(p.all.x, const_cast<void*>(own.x), own), y = p.pixels_of(p.all.y, own.y, own);
  run_cluster<Plain>(p.all, sample, kept, x, y, own.sample, 0, 0, own.pixels, int(part_pixels_of(own.pixels)));
}

// Sets how each image is accessed.
ProgramList<float> with_access(ProgramList<float> p) {
  for (int i = 0; i < p.count; ++i) {
    ListedPixels& own = p.listed[i];
    Pixels x = p.pixels_of(p.all.x, const_cast<void*>(own.x), own), y = p.pixels_of(p.all.y, own.y, own);
    set_access<float, kPixelsPerThread<float>>({&x, &y}, 1);
    own.by_vectors = x.access != Access::elements;
  }
  return p;
}
// Vectors of all images, or of those that are accessed by vectors.
void set_access_of_vectors(Pixels& x) {
  x.access = x.type == DType::float32 && x.step == 1 ? Access::plain_vectors : Access::vectors;
}

}  // namespace

template <>
int program_list<float>(ProgramList<float> const& params, CUstream_st* stream) {
  ProgramList<float> p = with_access(params);
  set_access_of_vectors(p.all.x), set_access_of_vectors(p.all.y);
  bool const values = p.all.x.channels == 1 || p.listed[0].as_values;
  values ? run_list<1><<<unsigned(p.items), kThreads, 0, stream>>>(p)
         : run_list<3><<<unsigned(p.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

bool takes_clusters(ProgramList<float> const& p, int i) { return takes_clusters(program_at(p, i)); }

int program_list_by_clusters(ProgramList<float> const& params, CUstream_st* stream) {
  ProgramList<float> p = params;
  p.all.measures_mean = true;  // no other kernel has
  invert_deviations(p.all);
  set_access_of_vectors(p.all.x), set_access_of_vectors(p.all.y);
  bool const plain = p.all.x.access == Access::plain_vectors && p.all.y.access == Access::plain_vectors;
  size_t bytes = 0;
  for (int i = 0; i < p.count; ++i) bytes = max(bytes, bytes_of(p.listed[i].pixels));
  auto* const kernel = plain ? run_list_by_clusters<true> : run_list_by_clusters<false>;
  if (cudaError_t const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  return launch_clusters(kernel, unsigned(p.count * kMaxClusterSize), kClusterThreads, bytes, kMaxClusterSize, stream,
                         p);
}

}  // namespace kv::color::cuda
