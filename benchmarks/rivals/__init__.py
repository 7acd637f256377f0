"""Other ways to the same image and gradients, to measure ours against."""
