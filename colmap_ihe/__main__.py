"""Run the command line, as `python -m colmap_ihe`."""

from colmap_ihe.cli import entry_point

if __name__ == "__main__":
    entry_point()
