"""Operators of augmentations on lists of images of different sizes."""
