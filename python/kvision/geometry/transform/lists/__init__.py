"""Lists of images of different sizes: one launch for all of them, and a result by sample."""
