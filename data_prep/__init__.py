"""From any video of a speaker to a dataset of clips, and the phantom speaker."""
