"""What runs at every step, and would take torch many passes over memory."""
