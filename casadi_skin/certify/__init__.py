"""Proofs that orbits exist: a Newton-Kantorovich theorem in ball arithmetic (see the page "Orbits that are proved")."""
