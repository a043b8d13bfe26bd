"""From any videos of a speaker to a dataset."""
