"""What ``exwarp bench`` measures of key intervals by every system, and its tables and page."""
