"""Speech: features, words, transcripts, synchrony."""
