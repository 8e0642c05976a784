"""Drive COLMAP through pycolmap."""
