"""What measures a society, beside the bare mesh."""
