// Maps of lenses, vortices, grids and splines on CUDA: a thread has pixels of a column.
#include "augmentation/distortion/displacement_map.h"
#include "core/launch.cuh"

namespace kv::augmentation::cuda {
namespace {

constexpr int kMapWarps = 8, kMapRows = 4;  // warps of a block, above each other, and rows of a thread
constexpr int kMapTile = 32;                // rows and columns of a block
static_assert(kMapWarps * kMapRows == kMapTile);

// The pixels of a tile of sample b, by its map, or 0.
template <class Map, class T>
__device__ __forceinline__ void fill_tile(DisplacementMap<T> const& p, int64_t b, int column, int row, bool is_chosen) {
  int const x = column * kMapTile + int(threadIdx.x), height = int(p.height), width = int(p.width);
  int64_t const plane = p.height * p.width;
  if (x >= width) return;
  Map const map(p, p.rows + b * p.columns);
#pragma unroll
  for (int i = 0; i < kMapRows; ++i) {
    int const at = (row * kMapRows + i) * kMapWarps + int(threadIdx.y);
    if (at >= height) return;
    Displacement<T> const moved = is_chosen ? map.at(x, at) : Displacement<T>{0, 0};
    T* const y = p.y + 2 * b * plane + int64_t(at) * width + x;
    y[0] = moved.x, y[plane] = moved.y;
  }
}

template <class Map, class T>
__global__ void __launch_bounds__(32 * kMapWarps) fill_map(__grid_constant__ DisplacementMap<T> const p) {
  fill_tile<Map>(p, blockIdx.z, int(blockIdx.x), int(blockIdx.y), true);
}

template <class Map, class T>
__global__ void __launch_bounds__(32 * kMapWarps) fill_listed(__grid_constant__ DisplacementMapList<T> const p) {
  int const b = p.list.sample_of(int(blockIdx.x)), tile = int(blockIdx.x) - p.list.first[b];
  int const across = int(ceil_div(p.list.width[b], kMapTile)), row = tile / across;
  fill_tile<Map>(p.sample(b), 0, tile - row * across, row, p.is_chosen(b));
}

}  // namespace

template <class T>
int displacement_map(DisplacementMap<T> const& p, CUstream_st* stream) {
  dim3 const blocks(unsigned(ceil_div(p.width, kMapTile)), unsigned(ceil_div(p.height, kMapTile)), unsigned(p.batch));
  with_map<T>(p.kind,
              [&](auto map) { fill_map<typename decltype(map)::type><<<blocks, dim3(32, kMapWarps), 0, stream>>>(p); });
  return cudaGetLastError();
}

template <class T>
int displacement_map_list(DisplacementMapList<T> const& given, CUstream_st* stream) {
  DisplacementMapList<T> p = given;
  int64_t blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += ceil_div(p.list.width[b], kMapTile) * ceil_div(p.list.height[b], kMapTile);
    if (blocks > INT32_MAX) return cudaErrorInvalidConfiguration;
  }
  with_map<T>(p.all.kind, [&](auto map) {
    fill_listed<typename decltype(map)::type><<<unsigned(blocks), dim3(32, kMapWarps), 0, stream>>>(p);
  });
  return cudaGetLastError();
}

KV_INSTANTIATE_COMPUTED(displacement_map, DisplacementMap)
KV_INSTANTIATE_COMPUTED(displacement_map_list, DisplacementMapList)

}  // namespace kv::augmentation::cuda
