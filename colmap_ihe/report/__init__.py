"""Draw pages, pictures and tables from records."""
