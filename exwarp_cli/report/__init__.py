"""Report files: report.json and frames.csv."""
