"""What runs a society: as processes of this machine, or on the virtual mesh."""
