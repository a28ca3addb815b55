"""Images as tensors: conversion from and to NumPy, grids, drawing, showing, printing."""

from kvision import _torch_compat
from kvision.image.adapter import to_numpy, to_pil, to_tensor
from kvision.image.convert import ImageToTensor, image_list_to_tensor, image_to_tensor, tensor_to_image
from kvision.image.display import show
from kvision.image.draw import draw_convex_polygon, draw_line, draw_point2d, draw_rectangle
from kvision.image.grid import make_grid
from kvision.image.image import ChannelsOrder, ColorSpace, Image, ImageLayout, ImageSize, PixelFormat
from kvision.image.shape import perform_keep_shape_image, perform_keep_shape_video
from kvision.image.terminal import image_to_string, print_image

__all__ = [
    "ChannelsOrder",
    "ColorSpace",
    "Image",
    "ImageLayout",
    "ImageSize",
    "ImageToTensor",
    "PixelFormat",
    "draw_convex_polygon",
    "draw_line",
    "draw_point2d",
    "draw_rectangle",
    "image_list_to_tensor",
    "image_to_string",
    "image_to_tensor",
    "make_grid",
    "perform_keep_shape_image",
    "perform_keep_shape_video",
    "print_image",
    "show",
    "tensor_to_image",
    "to_numpy",
    "to_pil",
    "to_tensor",
]

_torch_compat.refuse_script(globals())
