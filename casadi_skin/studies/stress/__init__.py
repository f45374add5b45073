"""Hard cases: where results hold, and where they are refused."""
