"""Measuring: methods side by side, clocks, and results as files."""
