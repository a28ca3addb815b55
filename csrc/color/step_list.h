// The steps of color programs, in one table. Included by program.h, which makes the enum Step and its properties of it;
// tests compare it with python/kvision/color/steps.py and include/kvision/color.h.
//
//   X(name, number, parameters, domain, arguments, channels, affine)
//
//   number      Stands for the step in programs. Exported graphs contain it, so it never changes and is never used
//               again. A new step takes the next number, in a new line at the end.
//   parameters  How many numbers the step takes. steps.h explains them next to the formula.
//   domain      rgb: the step needs three channels. any: it computes every value alone, in the same way for all
//               channels.
//   arguments   numbers: parameters are the same for all samples. tensors: each may be a tensor, with a gradient.
//   channels    same: as many channels as before. one: the result has one channel, so the step comes last.
//   affine      always: the Jacobian is the same for all pixels. unless_clipped: it is if the last parameter, which
//               says whether the result is clipped to [0, 1], is 0. never: it depends on the pixel.
#pragma once

#define KV_COLOR_STEPS(X)                                                                                        \
  X(affine, 0, 13, rgb, numbers, same, unless_clipped) /* 3 x 3 matrix by rows, offsets, clip */                 \
  X(rgb_to_hsv, 1, 1, rgb, numbers, same, never)       /* eps */                                                 \
  X(hsv_to_rgb, 2, 0, rgb, numbers, same, never)                                                                 \
  X(rgb_to_hls, 3, 1, rgb, numbers, same, never) /* eps */                                                       \
  X(hls_to_rgb, 4, 0, rgb, numbers, same, never)                                                                 \
  X(rgb_to_linear_rgb, 5, 0, rgb, numbers, same, never)                                                          \
  X(linear_rgb_to_rgb, 6, 0, rgb, numbers, same, never)                                                          \
  X(rgb_to_lab, 7, 0, rgb, numbers, same, never)                                                                 \
  X(lab_to_rgb, 8, 1, rgb, numbers, same, never)          /* clip */                                             \
  X(rgb_to_luv, 9, 1, rgb, numbers, same, never)          /* eps */                                              \
  X(luv_to_rgb, 10, 1, rgb, numbers, same, never)         /* eps */                                              \
  X(luma_u8_fixed_point, 11, 3, rgb, numbers, one, never) /* weights in 32768ths */                              \
  X(hsv_u8, 12, 0, rgb, numbers, same, never)                                                                    \
  X(weighted_sum, 13, 3, rgb, tensors, one, always)             /* weights */                                    \
  X(luma_u8, 14, 3, rgb, tensors, one, never)                   /* weights; rounded half to even */              \
  X(scale_shift_rgb, 15, 7, rgb, tensors, same, unless_clipped) /* factors, offsets, clip */                     \
  X(standardize_rgb, 16, 6, rgb, tensors, same, always)         /* means, standard deviations */                 \
  X(saturation, 17, 1, rgb, tensors, same, never)               /* factor of the saturation in HSV */            \
  X(saturation_raw, 18, 1, rgb, tensors, same, never)           /* factor of the saturation of HSV images */     \
  X(saturation_gray, 19, 1, rgb, tensors, same, never)          /* factor of the distance from the luma */       \
  X(hue, 20, 1, rgb, tensors, same, never)                      /* angle in radians */                           \
  X(hue_raw, 21, 1, rgb, tensors, same, never)                  /* angle in radians, of HSV images */            \
  X(contrast, 22, 2, any, tensors, same, never)                 /* factor of the distance from the mean, mean */ \
  X(scale_shift, 23, 3, any, tensors, same, unless_clipped)     /* factor, offset, clip */                       \
  X(standardize, 24, 2, any, tensors, same, always)             /* mean, standard deviation */                   \
  X(gamma, 25, 2, any, tensors, same, never)                    /* exponent, gain */                             \
  X(log, 26, 3, any, tensors, same, never)                      /* gain, inverse, clip */                        \
  X(sigmoid, 27, 3, any, tensors, same, never)                  /* cutoff, gain, falling */                      \
  X(solarize, 28, 3, any, tensors, same, never)                 /* threshold, addition, whether to add */        \
  X(posterize, 29, 2, any, tensors, same, never)                /* bits, how to round to the stored type */      \
  X(threshold, 30, 5, any, tensors, same, never)                /* threshold, above, below, keep above, below */ \
  X(lightness_raw, 31, 2, rgb, tensors, same, never)            /* limit, factor of lightness below it, of HLS images */
