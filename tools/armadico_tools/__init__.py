"""Things that watch, draw or measure; nothing that drives."""
