// Maps of lenses, vortices and grids on CUDA: a thread has pixels of a column.
#include "augmentation/distortion/displacement_map.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kMapWarps = 8, kMapRows = 4;  // warps of a block, above each other, and rows of a thread

template <class Map, class T>
__global__ void __launch_bounds__(32 * kMapWarps) fill_map(__grid_constant__ DisplacementMap<T> const p) {
  int const x = int(blockIdx.x) * 32 + int(threadIdx.x), height = int(p.height), width = int(p.width);
  int64_t const b = blockIdx.z, plane = p.height * p.width;
  if (x >= width) return;
  Map const map(p, p.rows + b * p.columns);
#pragma unroll
  for (int i = 0; i < kMapRows; ++i) {
    int const row = (int(blockIdx.y) * kMapRows + i) * kMapWarps + int(threadIdx.y);
    if (row >= height) return;
    Displacement<T> const moved = map.at(x, row);
    T* const y = p.y + 2 * b * plane + int64_t(row) * width + x;
    y[0] = moved.x, y[plane] = moved.y;
  }
}

template <class Map, class T>
int launch_map(DisplacementMap<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.width, 32)), unsigned(ceil_div(p.height, kMapWarps * kMapRows)),
                    unsigned(p.batch));
  fill_map<Map><<<blocks, dim3(32, kMapWarps), 0, stream>>>(p);
  return cudaGetLastError();
}

}  // namespace

template <class T>
int displacement_map(DisplacementMap<T> const& p, CUstream_st* stream) {
  switch (p.kind) {
    case MapKind::lens:
      return launch_map<LensMap<T>>(p, stream);
    case MapKind::swirl:
      return launch_map<SwirlMap<T>>(p, stream);
    case MapKind::cells:
      return launch_map<CellsMap<T>>(p, stream);
    default:
      return launch_map<TrianglesMap<T>>(p, stream);
  }
}

KV_INSTANTIATE_COMPUTED(displacement_map, DisplacementMap)

}  // namespace kv::augmentation::cuda
