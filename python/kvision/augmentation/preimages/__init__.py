"""Where the results of geometric augmentations read images, which labels follow through maps."""
