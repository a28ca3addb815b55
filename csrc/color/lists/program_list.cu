// Color programs on lists of images on CUDA, in one launch, or two around a mean of samples that no cluster keeps: a
// block finds its image in the table and works as blocks of batches do.
#include "color/lists/program_list.h"
#include "color/program_bytes.cuh"
#include "color/program_clusters.cuh"
#include "color/program_forward.cuh"

namespace kv::color::cuda {
namespace {

static_assert(sizeof(ProgramList<float>) <= 32764, "more than a kernel's parameters");

// The image that a block takes, and which of its blocks it is. A second run takes them in reverse, as that of a batch.
struct ListBlock {
  int item, entry;
  ListedPixels const& own;
  Pixels x, y;
  int64_t pixels;
  int block, blocks;
  float* parts;
  MeanParts<float> mean;

  __device__ __forceinline__ explicit ListBlock(ProgramList<float> const& p)
      : item(p.all.contrast >= 0 && !p.all.measures_mean ? p.items - 1 - int(blockIdx.x) : int(blockIdx.x)),
        entry(p.entry_of(item)),
        own(p.listed[entry]),
        x(p.pixels_of(p.all.x, const_cast<void*>(own.x), own)),
        y(p.pixels_of(p.all.y, own.y, own)),
        pixels(own.as_values ? own.pixels * int64_t(p.all.x.channels) : own.pixels),
        block(item - own.first),
        blocks(p.end_of(entry) - own.first),
        parts(p.all.parts + own.part),
        mean{parts, mean_parts_of<float>(p.samples, pixels), pixels} {}
};

template <int C>
__global__ void __launch_bounds__(kThreads, 4) run_list(__grid_constant__ ProgramList<float> const p) {
  __shared__ Sample<float> sample;
  ListBlock const b(p);
  auto const run = [&](auto elements) {
    run_block<float, C, elements.value>(p.all, sample, b.x, b.y, b.own.sample, 0, 0, b.pixels, b.block, b.blocks,
                                        b.parts + b.block, b.mean);
  };
  b.own.by_vectors ? run(std::false_type{}) : run(std::true_type{});
}

// T: of the results, or void.
template <int C, class T>
__global__ void __launch_bounds__(kThreads) run_list_of_bytes(__grid_constant__ ProgramList<float> const p) {
  __shared__ Sample<float> sample;
  ListBlock const b(p);
  run_block_of_bytes<C, T, true>(p.all, sample,
                                 {b.x, b.y, static_cast<uint8_t const*>(b.x.data), b.y.data, b.own.sample, b.pixels,
                                  b.block, b.blocks, b.parts + b.block, b.mean});
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
  Pixels const &x = p.all.x, &y = p.all.y;
  bool const values = x.channels == 1 || p.listed[0].as_values, measures = p.all.measures_mean;
  bool const bytes = x.type == DType::uint8 && x.step == 1, to_planes = bytes && y.step == 1;
  auto* const kernel = bytes && measures ? (values ? run_list_of_bytes<1, void> : run_list_of_bytes<3, void>)
                       : to_planes && y.type == DType::uint8
                           ? (values ? run_list_of_bytes<1, uint8_t> : run_list_of_bytes<3, uint8_t>)
                       : to_planes && y.type == DType::float32 && !values ? run_list_of_bytes<3, float>
                       : values                                           ? run_list<1>
                                                                          : run_list<3>;
  kernel<<<unsigned(p.items), kThreads, 0, stream>>>(p);
  return cudaGetLastError();
}

bool takes_clusters(ProgramList<float> const& p, int i) {
  // Most images are too large, which is known without a copy of the program of each.
  return int64_t(bytes_of(p.listed[i].pixels)) <= kMaxShared && takes_clusters(program_at(p, i));
}

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
