"""Homographies from correspondences, and their errors."""

from kvision.geometry.homography.dlt import (
    find_homography_dlt,
    find_homography_dlt_iterated,
    find_homography_lines_dlt,
    find_homography_lines_dlt_iterated,
)
from kvision.geometry.homography.errors import (
    line_segment_transfer_error_one_way,
    oneway_transfer_error,
    sample_is_valid_for_homography,
    sampson_homography_distance,
    symmetric_transfer_error,
)

__all__ = [
    "find_homography_dlt",
    "find_homography_dlt_iterated",
    "find_homography_lines_dlt",
    "find_homography_lines_dlt_iterated",
    "line_segment_transfer_error_one_way",
    "oneway_transfer_error",
    "sample_is_valid_for_homography",
    "sampson_homography_distance",
    "symmetric_transfer_error",
]
