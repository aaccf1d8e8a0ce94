"""Limits that bytes from a daemon are checked against before they cost anything.

Names and values are those of protocol/limits.h; a test compares them.
"""

frame_bytes_max = 64 << 20
control_bytes_max = 64 << 10
control_depth_max = 16
control_tables_max = 256
blocks_max = 64
chunk_rays_max = 16 << 10
window_bytes = 8 << 20
window_bytes_max = 32 << 20
rays_max = 1 << 36
hits_max = 256
all_hits_max = 65536
azimuths_max = 65536
list_items_max = 512
upload_files_max = 512
upload_bytes_max = 4 << 30
picture_side_max = 16384
picture_pixels_max = 64 << 20
samples_max = 65536
