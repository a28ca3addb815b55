"""Image files: reading, decoding, writing, and a few photographs to start with."""

from kvision.io.decoding import decode
from kvision.io.load import ImageLoadType, load_image
from kvision.io.sample import get_sample_images
from kvision.io.write import write_image

__all__ = ["ImageLoadType", "decode", "get_sample_images", "load_image", "write_image"]
