"""What several methods share: windows of correlations, and the noise that a fit leaves."""
