"""Mapping with unknown poses (SLAM) from a laser and odometry."""
