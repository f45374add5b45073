"""Claims on the linear chain and on the matrices of the paper's appendix."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from claim import Claim, Verdict, claim, rounds_to
from paper_data import ALPHA, GAMMA, SITES, Array, PaperData

from casadi_skin import Chain

ROUND_OFF = 1e-12


def linear_claims(data: PaperData) -> Iterator[Claim]:
    """Sec. II up to the multiple-scale solution, Fig. 2, and the appendix on matrices."""
    chain = data.chain(1.0)
    yield from _spectrum(chain)
    yield from _eigenvectors(chain)
    yield from _one_way()
    yield from _matrices(chain)


def _spectrum(chain: Chain) -> Iterator[Claim]:
    omega, (values, _) = chain.linear_frequencies(), chain.diagonalise()
    difference = float(np.max(np.abs(np.sqrt(values) - omega)))
    yield claim(
        "Sec. II, omega_j^2", "omega_j^2 = 2 + alpha - 2 sqrt(1 - gamma^2) cos(j pi/(N+1))", "formula",
        f"largest difference to diagonalisation {difference:.0e}", difference < ROUND_OFF, error=ROUND_OFF,
    )  # fmt: skip
    asymmetry = float(np.max(np.abs(omega**2 + omega[::-1] ** 2 - 2 * (2 + ALPHA))))
    yield claim(
        "Sec. II", "omega_j^2 is symmetric about omega_0^2 = 2 + alpha", "symmetric", f"asymmetry {asymmetry:.0e}",
        asymmetry < ROUND_OFF, error=ROUND_OFF,
    )  # fmt: skip
    gammas = np.linspace(0.0, 1.0, 101)
    bands = np.array([Chain(2, ALPHA, float(g), 0.0).band() for g in gammas])
    monotone = bool(np.all(np.diff(bands[:, 0]) > 0) and np.all(np.diff(bands[:, 1]) < 0))
    yield claim(
        "Sec. II", "omega_min^2 increases and omega_max^2 decreases with gamma", "monotone",
        "monotone on 101 values of gamma in [0, 1]" if monotone else "not monotone", monotone,
    )  # fmt: skip
    collapsed = Chain(SITES, ALPHA, 1.0, 0.0)
    spread = float(np.ptp(collapsed.linear_frequencies() ** 2))
    jordan = np.linalg.matrix_rank(collapsed.dynamical_matrix() - (2 + ALPHA) * np.eye(SITES))
    yield claim(
        "Sec. II", "all omega_j^2 collapse to omega_0^2 at gamma = 1", "2 + alpha", f"spread {spread:.0e}",
        spread == 0.0, f"D is then one Jordan block (D - omega_0^2 I has rank {jordan}): a single eigenvector is left",
        0.0,
    )  # fmt: skip
    cutoff = float(np.sqrt(chain.band()[0]))
    yield claim(
        "Sec. II", "omega_min = 1.04", "1.04", f"{cutoff:.6f} by the paper's formula; omega_1 = {omega[0]:.6f}",
        Verdict.MISPRINT if rounds_to(cutoff, "1.04") is Verdict.DISAGREES else Verdict.AGREES,
        "1.04 is omega_1 of the chain of 24 sites, not the cutoff of the infinite chain that the formula gives",
        ROUND_OFF,
    )  # fmt: skip
    spacing = float(np.mean(np.diff(omega)))
    yield claim(
        "Sec. II", "average spacing of the frequencies 0.05", "0.05", f"{spacing:.6f}", rounds_to(spacing, "0.05"),
        error=ROUND_OFF,
    )  # fmt: skip
    yield claim(
        "Sec. II", "the lower gap omega_min is much larger than the spacing", "much larger",
        f"{cutoff / spacing:.1f} times", cutoff > 10 * spacing, error=ROUND_OFF,
    )  # fmt: skip


def _residual(matrix: Array, vector: Array, value: float) -> float:
    """Residual of an eigenvector, relative to value and vector."""
    return float(np.linalg.norm(matrix @ vector - value * vector) / (value * np.linalg.norm(vector)))


def _eigenvectors(chain: Chain) -> Iterator[Claim]:
    D, omega = chain.dynamical_matrix(), chain.linear_frequencies()
    n, modes = np.arange(1, SITES + 1), np.arange(1, SITES + 1)
    r = (1 + GAMMA) / (1 - GAMMA)
    sines = np.sin(np.outer(n, modes) * np.pi / (SITES + 1))
    right, left = r ** (n[:, None] / 2) * sines, r ** (-n[:, None] / 2) * sines
    worst = max(_residual(D, right[:, j], omega[j] ** 2) for j in range(SITES))
    worst = max(worst, *(_residual(D.T, left[:, j], omega[j] ** 2) for j in range(SITES)))
    yield claim(
        "Sec. II, u and v", "right vectors r^(n/2) sin, left vectors r^(-n/2) sin, r = a_-/a_+", "formula",
        f"largest residual {worst:.0e}", worst < ROUND_OFF, error=ROUND_OFF,
    )  # fmt: skip
    wrong = _residual(D, left[:, 0], omega[0] ** 2)
    yield claim(
        "App. B, w = u", "right eigenvector r^(-n/2) sin(n j pi/(N+1))", "r^(-n/2)", f"residual {wrong:.2f} of omega^2",
        Verdict.MISPRINT if wrong > 0.01 else Verdict.AGREES, "r^(n/2) of the main text is the right eigenvector",
        ROUND_OFF,
    )  # fmt: skip
    centre = (n @ right**2) / np.sum(right**2, axis=0)
    mirror = (n @ left**2) / np.sum(left**2, axis=0)
    leaning = bool(np.all(centre > (SITES + 1) / 2) and np.all(mirror < (SITES + 1) / 2))
    yield claim(
        "Sec. II", "right (left) eigenvectors are localised at the right (left) end for gamma > 0", "all modes",
        f"mean sites {centre.min():.1f} to {centre.max():.1f} (right), {mirror.min():.1f} to {mirror.max():.1f} (left)",
        leaning, error=ROUND_OFF,
    )  # fmt: skip
    products = np.sum(left * right, axis=0)
    deviation = float(np.max(np.abs(products - (SITES + 1) / 2)))
    yield claim(
        "App. B", "sum_n v_n u_n = (N+1)/2", "12.5", f"12.5, largest deviation {deviation:.0e}", deviation < ROUND_OFF,
        error=ROUND_OFF,
    )  # fmt: skip
    asymmetry = float(np.max(np.abs(D - D.T)))
    yield claim(
        "App. A", "D is not Hermitian for gamma > 0", "D^T != D", f"largest entry of D - D^T: {asymmetry:g} = 2 gamma",
        asymmetry > 0, error=ROUND_OFF,
    )  # fmt: skip


def _one_way() -> Iterator[Claim]:
    """Skin modes at the end of the range of gamma that the paper gives."""
    D = Chain(SITES, ALPHA, 1.0, 1.0).dynamical_matrix()
    rank = int(np.linalg.matrix_rank(D - (2.0 + ALPHA) * np.eye(SITES)))
    yield claim(
        "Sec. II", "skin modes r^(n/2) sin(n j pi/(N+1)) for gamma in (0, 1]", "also at gamma = 1",
        f"at gamma = 1 D has {SITES - rank} eigenvector, at one end site", Verdict.IN_RANGE if rank == SITES - 1
        else Verdict.AGREES,
        "they hold for 0 < gamma < 1; at 1 r is infinite and D a single Jordan block", ROUND_OFF,
    )  # fmt: skip


def _matrices(chain: Chain) -> Iterator[Claim]:
    y = np.random.default_rng(0).normal(size=SITES)
    J = np.block([[np.zeros((SITES, SITES)), -np.eye(SITES)], [np.eye(SITES), np.zeros((SITES, SITES))]])
    Z = np.array(chain.variational_matrix("physical")(y, 1.0).full())
    W = np.array(chain.variational_matrix("gauge")(y / chain.rho, 1.0).full())
    for name, matrix in (("Z", Z), ("W", W)):
        defect = float(np.max(np.abs(matrix.T @ J @ matrix - J)))
        hamiltonian = float(np.max(np.abs(matrix.T @ J + J @ matrix)))
        reason = (
            "neither condition holds for Z in physical coordinates"
            if name == "Z"
            else (
                "the matrix of coefficients is Hamiltonian (W^T J + J W = 0); the flow that it generates is symplectic"
            )
        )
        yield claim(
            "Sec. III, App. A", f"{name} is symplectic: {name}^T J {name} = J",
            "yes" if name == "W" else "not for gamma > 0",
            f"largest entry of {name}^T J {name} - J: {defect:.2f}; of {name}^T J + J {name}: {hamiltonian:.0e}",
            Verdict.MISPRINT if name == "W" and defect > 1e-6 else defect > 1e-6, reason, ROUND_OFF,
        )  # fmt: skip
    asymmetry = float(np.max(np.abs(W - W.T)))
    lower = W[SITES:, :SITES]
    symmetric = float(np.max(np.abs(lower - lower.T)))
    yield claim(
        "Sec. III", "W is Hermitian", "W^T = W",
        f"largest entry of W - W^T: {asymmetry:.2f}; of its block W_21: {symmetric:.0e}",
        Verdict.MISPRINT if asymmetry > 1e-6 else Verdict.AGREES,
        "its block W_21 and V = J^-1 W are symmetric, W is not", ROUND_OFF,
    )  # fmt: skip
    V = -J @ W  # W = J V
    defect = float(np.max(np.abs(V.T @ J @ V - J)))
    yield claim(
        "App. A", "V, of W = J V, is Hermitian and symplectic", "both",
        f"largest entry of V - V^T: {np.max(np.abs(V - V.T)):.0e}; of V^T J V - J: {defect:.2f}",
        Verdict.MISPRINT if defect > 1e-6 else Verdict.AGREES, "V is symmetric, which is all that is needed", ROUND_OFF,
    )  # fmt: skip
    reciprocal = np.array(Chain(SITES, ALPHA, 0.0, 1.0).variational_matrix("physical")(y, 1.0).full())
    U, defect = -J @ reciprocal, float(np.max(np.abs(reciprocal.T @ J @ reciprocal - J)))
    yield claim(
        "App. A", "Z^T J Z = J holds whenever U^T = U, Z = J U", "holds",
        f"at gamma = 0: largest entry of U - U^T {np.max(np.abs(U - U.T)):.0e}, of Z^T J Z - J {defect:.2f}",
        Verdict.MISPRINT if defect > 1e-6 else Verdict.AGREES,
        "Z^T J + J Z = 0 holds: Z is Hamiltonian, and the flow that it generates symplectic", ROUND_OFF,
    )  # fmt: skip
    spectra = [np.sort_complex(np.linalg.eigvals(m)) for m in (Z, W)]
    difference = float(np.max(np.abs(np.sort(np.abs(spectra[0])) - np.sort(np.abs(spectra[1])))))
    yield claim(
        "Sec. III", "W and Z have the same eigenvalues", "equal", f"largest difference {difference:.0e}",
        difference < 1e-7, "one is the other in the gauge", 1e-8,
    )  # fmt: skip
