// Warps of lists of images of different sizes with a program of color steps, on the CPU: parts [begin, end) of the
// samples in the table. Compiled once per instruction set.
#include "augmentation/lists/warp_and_color_list.h"
#include "augmentation/warp_blocks/warp_bands.h"

namespace kv::augmentation::KV_ISA {
template <class T>
void warp_and_color_list(WarpAndColorList<T> const& p, int64_t begin, int64_t end) {
  int64_t const before = p.first * bands_of(p.warp.y.height, p.warp.y.width);  // those of the samples before the table
  warp_bands(p, before + begin, before + end, [&](int64_t b) {
    ListedImage const& image = p.image(b);
    geometry::Sample<T> warp = p.warp;
    warp.x = images_of<T>(image, p.warp.x.channels);
    warp.x_axis.size = image.width;
    warp.y_axis.size = image.height;
    warp.coords.use.source = {image.height, image.width};
    warp.images = 1;
    return warp;
  });
}

KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, float)
KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, uint8_t)
#if !defined(__AVX512F__)
KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, ::kv::Half)
KV_INSTANTIATE_ONE(warp_and_color_list, WarpAndColorList, ::kv::BFloat16)
#endif

}  // namespace kv::augmentation::KV_ISA
