"""Proofs about decimals: the numbers in formulas are the decimals that are written, whatever doubles make of them."""

import random
import re
from fractions import Fraction

import casadi as ca
import mpmath as mp
import pytest

from casadi_skin import Bond, Chain, Lattice, OdeModel, Site, follow_family
from casadi_skin.runs.program import main

pytest.importorskip("flint")

DIGITS = 45
NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
ONE_SITE = """[lattice]
cells = [1]
[[lattice.site]]
name = "a"
onsite = "{onsite}"
[family]
mode = 1
amplitude_max = 1.0
at = [0.25]
[accuracy]
certify = true
"""
MODEL = """import casadi as ca
from casadi_skin import OdeModel
y, v = ca.SX.sym("y"), ca.SX.sym("v")
model = OdeModel("well", y, -{stiffness} * y - y**3, order=2, velocity=v, reversal=(1, -1), half_period=(-1, -1))
"""


def frequency(coefficients, S):
    """Omega of y'' = -sum of c_k y^k, k odd, from y(0) = sqrt(S) at rest, by quadrature of its period."""
    a = mp.sqrt(S)

    def rate(u):
        s = mp.sin(u)  # the energy left at y = a s, over a^2 cos(u)^2
        powers = {k: sum(s ** (2 * j) for j in range((k + 1) // 2)) for k in coefficients}
        return mp.sqrt(sum(2 * c / (k + 1) * a ** (k - 1) * powers[k] for k, c in coefficients.items()))

    return mp.pi / 2 / mp.quad(lambda u: 1 / rate(u), mp.linspace(0, mp.pi / 2, 5))


def value(text, decimals):
    """What a formula of numbers is, in fractions: Python reads it, not the parser of formulas."""
    number = "Fraction('{}')" if decimals else "Fraction(float('{}'))"
    return eval(NUMBER.sub(lambda found: number.format(found[0]), text), {"Fraction": Fraction})


def multiple(fraction):
    return mp.mpf(fraction.numerator) / fraction.denominator


def enclosed(certificate, truth):
    """Whether a frequency is inside all of a certificate's digits."""
    middle, radius = (mp.mpf(x) for x in certificate.Omega_digits.strip("[]").split("+/-"))
    return abs(middle - truth) <= radius and certificate.Omega[0] <= truth <= certificate.Omega[1]


def written(generator, depth=0):
    """A random formula of numbers."""
    if depth > 2 or generator.random() < 0.4:
        digits = generator.choice((1, 2, 3))
        return generator.choice((f"{generator.uniform(0.1, 3.0):.{digits}f}", "3", "1e-1", "0.1234567890123456789"))
    left, right = written(generator, depth + 1), written(generator, depth + 1)
    return f"({left} {generator.choice('+-*/')} {right})"


def formulas(generator):
    """Endless forces c_1 y + c_3 y^3 + c_5 y^5 with a well about 0: the text of each coefficient."""
    while True:
        texts = {k: written(generator) for k in (1, 3, 5)}
        try:
            values = {k: value(text, True) for k, text in texts.items()}
        except ZeroDivisionError:
            continue
        if 0.05 < values[1] < 20 and abs(values[3]) < min(3, values[1] / 3) and 0 <= values[5] < 3:
            yield texts


def certificate_of(model, S, decimals, harmonics=None):
    return (
        follow_family(model, mode=1, amplitude_max=S, tolerance=1e-9)
        .at(S=S)
        .certify(harmonics=harmonics, decimals=decimals)
    )


@pytest.mark.parametrize(("seed", "count"), [(0, 12), pytest.param(1, 150, marks=pytest.mark.slow)])
def test_periods_by_quadrature_of_random_formulas_are_inside(seed, count):
    generator = random.Random(seed)
    for texts, _ in zip(formulas(generator), range(count), strict=False):
        onsite = " + ".join(f"{text}*y^{k}" for k, text in texts.items())
        S = round(generator.uniform(0.05, 1.0), 2)
        orbit = follow_family(Lattice(1, [Site("a", onsite)]), mode=1, amplitude_max=1.0, tolerance=1e-9).at(S=S)
        for decimals in (True, False):
            certificate = orbit.certify(decimals=decimals)
            assert certificate.proved, onsite
            with mp.workdps(DIGITS):
                coefficients = {k: multiple(value(text, decimals)) for k, text in texts.items()}
                square = multiple(Fraction(repr(S)) if decimals else Fraction(S))
                energy = sum(c * square ** ((k + 1) // 2) / (k + 1) for k, c in coefficients.items())
                assert enclosed(certificate, frequency(coefficients, square)), (onsite, decimals)
                assert certificate.energy[0] <= energy <= certificate.energy[1], (onsite, decimals)


def test_difference_of_two_decimals_is_a_tenth():
    """(100.1 - 100) y in doubles is 0.0999999999999943 y."""
    model = Lattice(1, [Site("a", "(100.1 - 100)*y + 0.1*y^3")])
    certificate = certificate_of(model, 0.25, True)
    with mp.workdps(DIGITS):
        tenth = mp.mpf(1) / 10
        assert enclosed(certificate, frequency({1: tenth, 3: tenth}, mp.mpf("0.25")))


LATTICES = {
    "of numbers": ("0.6*y/2 - (0.8 - 0.1)*y^3", ("0.9", "0.3 + 0.8"), {}),
    "of parameters": ("k*y - g*y^3", ("1 - c", "1 + c"), {"k": 0.3, "g": 0.7, "c": 0.1}),
    "by cell": ("k*y - (1.4 - 0.7*q)*y^3", ("0.9", "1.1"), {"k": [0.3] * 5, "q": "(n + n)/(2*n)"}),
}


@pytest.mark.parametrize("name", LATTICES)
def test_chain_with_numbers_in_its_formulas_is_the_chain_of_decimals(name):
    """alpha = 0.3, gamma = 0.1, g = -0.7 written in three ways, each in other coordinates or doubles."""
    onsite, gain, parameters = LATTICES[name]
    lattice = Lattice(5, [Site("a", onsite)], [Bond("a", "a", 1, "d", gain)], parameters=parameters)
    orbit = follow_family(lattice, mode=1, amplitude_max=0.4, tolerance=1e-9).at(S=0.4)
    one, other = orbit.certify(decimals=True), certificate_of(Chain(5, 0.3, 0.1, -0.7), 0.4, True)
    with mp.workdps(DIGITS):
        (a, r), (b, s) = ([mp.mpf(x) for x in c.Omega_digits.strip("[]").split("+/-")] for c in (one, other))
        assert abs(a - b) <= r + s < 1e-17
    assert max(one.energy[0], other.energy[0]) <= min(one.energy[1], other.energy[1]) * (1 + 1e-15)


def test_long_chain_with_numbers_in_its_formulas_is_the_chain_of_decimals():
    """The tail takes the exact gains and stiffness too: 1 - c and 0.7*2 for gamma = 0.4, 3*0.3 for alpha."""
    site, bond = Site("a", "3*0.3*y - 1.3*y^3/1.3"), Bond("a", "a", 1, "d", ("1 - c", "0.7*2"))
    lattice, chain = Lattice(900, [site], [bond], parameters={"c": 0.4}), Chain(900, 0.9, 0.4, -1.0)
    one, other = (certificate_of(model, 1.5, True, 25) for model in (lattice, chain))
    assert one.proved
    with mp.workdps(DIGITS):
        (a, r), (b, s) = ([mp.mpf(x) for x in c.Omega_digits.strip("[]").split("+/-")] for c in (one, other))
        assert abs(a - b) <= r + s < 1e-20


@pytest.mark.parametrize(
    ("onsite", "words"),
    [("sqrt(2)*y + y^3", "sqrt is in the expression"), ("pi*y + y^3", "pi is in the expression, which is no fraction")],
)
@pytest.mark.parametrize("decimals", [True, False])
def test_numbers_that_are_no_fractions_are_refused(onsite, words, decimals):
    orbit = follow_family(Lattice(1, [Site("a", onsite)]), mode=1, amplitude_max=0.25, tolerance=1e-9).at(S=0.25)
    with pytest.raises(ValueError, match=words):
        orbit.certify(decimals=decimals)


def well(stiffness):
    y, v = ca.SX.sym("y"), ca.SX.sym("v")
    signs = {"reversal": (1, -1), "half_period": (-1, -1)}
    return OdeModel("well", y, -stiffness * y - y**3, order=2, velocity=v, **signs)


def test_doubles_of_python_are_no_decimals():
    """A half is a half; 0.1 and 100.1 - 100 of Python are doubles, and proofs without decimals are about these."""
    for stiffness in (0.1, 100.1 - 100):
        orbit = follow_family(well(stiffness), mode=1, amplitude_max=0.25, tolerance=1e-9).at(S=0.25)
        with pytest.raises(ValueError, match=f"given the double -{stiffness!r} in the equations of well"):
            orbit.certify(decimals=True)
        with mp.workdps(DIGITS):
            assert enclosed(orbit.certify(), frequency({1: mp.mpf(stiffness), 3: mp.mpf(1)}, mp.mpf("0.25")))
    certificate = certificate_of(well(0.5), 0.1, True)
    with mp.workdps(DIGITS):
        assert enclosed(certificate, frequency({1: mp.mpf("0.5"), 3: mp.mpf(1)}, mp.mpf("0.1")))


def test_scene_of_a_lattice_is_proved_for_its_decimals_and_one_of_a_model_with_doubles_is_refused(tmp_path, capsys):
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(ONE_SITE.format(onsite="(100.1 - 100)*y + 0.1*y^3"))
    assert main(["run", str(scene), "--out", str(out)]) == 0
    assert "1 of 1 orbits proved to exist" in capsys.readouterr().out
    header, *rows = ((out / "family.csv").read_text()).splitlines()
    row = next(r for r in (dict(zip(header.split(","), row.split(","), strict=True)) for row in rows) if r["proved"])
    with mp.workdps(DIGITS):
        truth = frequency({1: mp.mpf(1) / 10, 3: mp.mpf(1) / 10}, mp.mpf("0.25"))
        assert mp.mpf(row["Omega_lower"]) <= truth <= mp.mpf(row["Omega_upper"])
    (tmp_path / "well.py").write_text(MODEL.format(stiffness=0.1))
    table = '[model]\nfile = "well.py"\nname = "model"\n' + ONE_SITE[ONE_SITE.index("[family]") :]
    scene.write_text(table)
    assert main(["run", str(scene), "--out", str(tmp_path / "other")]) == 2
    message = capsys.readouterr().err
    assert "given the double -0.1 in the equations of well" in message
    assert message.count("\n") == 1
    assert not (tmp_path / "other").exists()
