"""Teaching a PointAdapter: recorded vehicles are painted out of their drives, and painted in again."""
