"""Pages, pictures and tables from records; computes nothing."""
