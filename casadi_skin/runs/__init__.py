"""What a scene asks for, planned, computed and written: runs of chain scenes and of scenes of any model."""
