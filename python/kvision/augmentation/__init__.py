"""Random augmentation of images with their masks, boxes, key points and labels."""
