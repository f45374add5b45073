"""What leaves special points, the ends of branches, edges of tongues, bifurcation diagrams."""
