"""Sound, pictures and video files, read and written."""
