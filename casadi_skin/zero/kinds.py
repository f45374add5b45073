"""Names of the kinds of special points: of codimension one on branches, of codimension two on curves of these."""

FOLD, HOPF, BRANCH_POINT, DOUBLING, TORUS = "fold", "hopf", "branch point", "period doubling", "torus"
HOMOCLINIC, HETEROCLINIC = "homoclinic", "heteroclinic"
BOUND = "bound"  # on a state or a free parameter, which a branch comes to
EDGE = "edge of a tongue"  # of instability of a family
KREIN = "krein collision"

CUSP, TAKENS, ZERO_HOPF = "cusp", "bogdanov-takens", "zero-hopf"
BAUTIN, HOPF_HOPF = "generalized hopf", "hopf-hopf"
DEGENERATE_PITCHFORK, DEGENERATE_TRANSCRITICAL = "degenerate pitchfork", "degenerate transcritical"
DOUBLE = "double branch point"
