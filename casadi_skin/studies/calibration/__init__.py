"""Estimated errors compared with true ones."""
