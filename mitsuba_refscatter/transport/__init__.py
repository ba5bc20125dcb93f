"""What camera and light share: segments, and what happens on the way."""
