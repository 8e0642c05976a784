"""`python -m colmap_ihe`: the command line."""

from colmap_ihe.cli import entry_point

if __name__ == "__main__":
    entry_point()
