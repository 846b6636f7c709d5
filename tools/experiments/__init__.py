"""The experiments of chapters 4 and 5 of the thesis, and what they leave open."""
