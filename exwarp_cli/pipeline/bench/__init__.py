"""What ``exwarp bench`` measures: key intervals of sequences, by every system."""
