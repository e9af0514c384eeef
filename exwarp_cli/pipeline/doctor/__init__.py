"""The work behind ``exwarp doctor``: one module for each kind of check."""
