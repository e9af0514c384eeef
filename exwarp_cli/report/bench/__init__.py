"""What ``exwarp bench`` writes: the paper's tables and figures, as JSON, CSV, Markdown and HTML."""
