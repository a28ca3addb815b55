// Antialiased resizing that shrinks whole images of lists on CUDA, in one launch: a block finds its image in the table,
// and resizes as blocks of batches do.
#include "geometry/transform/lists/resize_windows_list.h"
#include "geometry/transform/resize/resize_strips.cuh"

namespace kv::geometry::cuda {
namespace {

// The warps of a block whose image has three planes: none has no plane. As many as there is shared memory for.
// Special case, types of one and two bytes. H200: 1.01 to 1.14 times as fast as six; float32 .94 to 1.15.
constexpr int kColorWarps = 6, kManyColorWarps = 12;

// The sample that a block takes, and its strips, in shared memory.
template <class T>
struct StripBlock {
  Resize<T> sample;
  ResizeStrips strips;
  bool aligned;
  unsigned block;  // among those of the sample

  // By two threads of different warps, one for what is along x. `all`: the rows and the warps that all samples have in
  // common.
  template <class S>
  __device__ __forceinline__ void init(ResizeWindowsList<T> const& p, ResizeStrips const& all, bool along_x) {
    int const b = p.list.sample_of(int(blockIdx.x));
    Resize<T> const own = resize_at(p, b);
    ResizeStrips divided = all;
    if (along_x) {
      aligned = strips_are_aligned<S>(own.x);
      divide_columns<S>(own, aligned, divided);
      sample.x = own.x, sample.columns = own.columns;
      strips.across = divided.across, strips.elements = divided.elements, strips.lines = divided.lines;
      block = blockIdx.x - unsigned(p.list.first[b]);
    } else {
      divide_rows(own, all.rows, divided);
      sample.y = own.y, sample.rows = own.rows, sample.minuend = nullptr;
      strips.rows = all.rows, strips.warps_down = all.warps_down;
      strips.down = divided.down, strips.span_y = divided.span_y;
    }
  }
};

template <class T, int M, int W>
__global__ void __launch_bounds__(StripOf<T, M, true, W>::kThreads, StripOf<T, M, true, W>::kBlocks)
    resize_list_strips(__grid_constant__ ResizeWindowsList<T> const p, ResizeStrips const strips) {
  __shared__ __align__(16) unsigned char memory[sizeof(StripBlock<T>)];
  auto& own = *reinterpret_cast<StripBlock<T>*>(memory);
  if (threadIdx.x == 0) own.template init<StripOf<T, M, true, W>>(p, strips, true);
  if (threadIdx.x == 32) own.template init<StripOf<T, M, true, W>>(p, strips, false);
  __syncthreads();
  resize_block<T, M, true, W>(own.sample, own.strips, own.aligned, own.block);
}

template <class T, int M, int W>
int launch(ResizeWindowsList<T>& p, int64_t planes, CUstream_st* stream) {
  using S = StripOf<T, M, true, W>;
  // With few planes of each image, warps that have none cost less than tables of more rows.
  int const warps_down = W % 3 == 0 ? W / 3 : warps_down_of(planes, 0.35);
  int64_t const groups = ceil_div(planes, int64_t(W / warps_down));
  // A sample that needs as much shared memory as any, and how many strips of columns each one has.
  Resize<T> largest = resize_at(p, 0);
  ResizeStrips strips{};
  strips.warps_down = warps_down;
  unsigned across[kMaxListed];
  int64_t columns = 0, height = 0;
  for (int b = 0; b < p.list.count; ++b) {
    Resize<T> const one = resize_at(p, b);
    if (one.rows.max_readers > min(M, one.rows.max_taps) || one.x.row_stride * int64_t(sizeof(T)) > INT32_MAX)
      return kUnsupported;
    ResizeStrips own;
    if (!divide_columns<S>(one, strips_are_aligned<S>(one.x), own)) return kUnsupported;
    across[b] = own.across;
    columns += groups * own.across;
    height = max(height, one.y.height);
    strips.elements = max(strips.elements, own.elements), strips.lines = max(strips.lines, own.lines);
    largest.x.height = max(largest.x.height, one.x.height);
    largest.columns.max_taps = max(largest.columns.max_taps, one.columns.max_taps);
    largest.rows.max_taps = max(largest.rows.max_taps, one.rows.max_taps);
    if (one.rows.num * largest.rows.den > largest.rows.num * one.rows.den)
      largest.rows.num = one.rows.num, largest.rows.den = one.rows.den;
  }
  auto const bytes_of = [&](int64_t rows) { return strip_bytes<S, true>(largest, strips, rows); };
  constexpr bool kMany = W == kManyColorWarps;
  int64_t const most = most_rows(bytes_of, kMany ? 112 << 10 : 100 << 10),
                resident = resident_blocks<S>(bytes_of(most));
  if (most < (kMany ? 8 : 1)) return kUnsupported;
  // Blocks take as long as their images are large: there are some more than run at once.
  height = ceil_div(height, int64_t(warps_down));
  int64_t const rows = min(most, int64_t(32));
  strips.rows = min(int(rows), strip_height(columns, height, 6, resident, resident, min(height, int64_t(8)), rows));
  int64_t blocks = 0;
  for (int b = 0; b < p.list.count; ++b) {
    p.list.first[b] = int(blocks);
    blocks += groups * across[b] * ceil_div(int64_t(p.list.results[b].height), int64_t(strips.rows) * warps_down);
  }
  if (blocks > INT32_MAX) return kUnsupported;
  int64_t const bytes = bytes_of(strips.rows);
  auto* const kernel = resize_list_strips<T, M, W>;
  if (int const error = cudaFuncSetAttribute(kernel, cudaFuncAttributeMaxDynamicSharedMemorySize, int(bytes)))
    return error;
  kernel<<<unsigned(blocks), S::kThreads, unsigned(bytes), stream>>>(p, strips);
  return cudaGetLastError();
}

template <class T, int M>
int launch(ResizeWindowsList<T>& p, CUstream_st* stream) {
  int64_t const planes = p.list.interleaved ? 1 : p.channels;
  if (planes % 3 != 0) return launch<T, M, 8>(p, planes, stream);
  if constexpr (sizeof(T) < 4)
    if (int const error = launch<T, M, kManyColorWarps>(p, planes, stream); error != kUnsupported) return error;
  return launch<T, M, kColorWarps>(p, planes, stream);
}

}  // namespace

template <class T>
int resize_strips_list(ResizeWindowsList<T> p, CUstream_st* stream) {
  if (p.all.backward || p.all.matrices) return kUnsupported;
  return p.all.filter == ResizeFilter::bilinear  ? launch<T, 2>(p, stream)
         : p.all.filter == ResizeFilter::bicubic ? launch<T, 4>(p, stream)
                                                 : kUnsupported;
}

template int resize_strips_list(ResizeWindowsList<float>, CUstream_st*);
template int resize_strips_list(ResizeWindowsList<Half>, CUstream_st*);
template int resize_strips_list(ResizeWindowsList<BFloat16>, CUstream_st*);
template int resize_strips_list(ResizeWindowsList<uint8_t>, CUstream_st*);

}  // namespace kv::geometry::cuda
