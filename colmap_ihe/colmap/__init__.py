"""The stages that drive COLMAP through pycolmap."""
