"""Zero problems: rest, boundary-value problems on collocation meshes, cosines; augmented problems and normal forms."""
