"""The family as an equations file of AUTO-07p: a two-point problem on a part of the period, with all derivatives.

    (q, v)' = tau (v, -L q - g S w q^3),  time scaled to [0, 1],  tau = part * 2 pi / Omega
    v(0) = 0,  sum_n w_n q_n(0)^2 = 1,  and q(1) = 0 on a quarter, v(1) = 0 on a whole period

PAR(1) = S, PAR(2) = tau, PAR(3) = largest |multiplier|. No unfolding parameter and no phase condition are needed:
v(0) = 0 fixes the phase, and with S free and the amplitude scaled out the problem is regular. In the gauge L is
symmetric; in physical coordinates it is not, and w = 1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from enum import Enum

import numpy as np
from family_case import FamilyCase

TEMPLATE = """
module family
  implicit none
  integer, parameter :: n = {n}
  double precision, parameter :: g = {g}, diagonal = {diagonal}
  double precision, parameter :: left = {left}, right = {right}
  double precision, parameter :: w(n) = [ &
{weights} ]
  double precision, parameter :: mode(n) = [ &
{mode} ]
end module family

subroutine func(ndim, u, icp, par, ijac, f, dfdu, dfdp)
  use family
  implicit none
  integer, intent(in) :: ndim, icp(*), ijac
  double precision, intent(in) :: u(ndim), par(*)
  double precision, intent(out) :: f(ndim)
  double precision, intent(inout) :: dfdu(ndim, ndim), dfdp(ndim, *)
  integer :: i
  double precision :: kappa, tau, force
  kappa = g*par(1)
  tau = par(2)
  do i = 1, n
    force = -diagonal*u(i) - kappa*w(i)*u(i)**3
    if (i > 1) force = force + left*u(i - 1)
    if (i < n) force = force + right*u(i + 1)
    f(i) = tau*u(n + i)
    f(n + i) = tau*force
  end do
  if (ijac == 0) return
  do i = 1, n
    dfdu(i, n + i) = tau
    dfdu(n + i, i) = tau*(-diagonal - 3*kappa*w(i)*u(i)**2)
    if (i > 1) dfdu(n + i, i - 1) = tau*left
    if (i < n) dfdu(n + i, i + 1) = tau*right
  end do
  if (ijac == 1) return
  do i = 1, n
    dfdp(n + i, 1) = -tau*g*w(i)*u(i)**3
  end do
  dfdp(:, 2) = f/tau
end subroutine func

subroutine stpnt(ndim, u, par, t)
  use family
  implicit none
  integer, intent(in) :: ndim
  double precision, intent(inout) :: u(ndim), par(*)
  double precision, intent(in) :: t
  double precision, parameter :: omega = {omega}, tau = {tau}
  par(1) = 0
  par(2) = tau
  par(3) = 1
  u(:n) = mode*cos(omega*tau*t)
  u(n + 1:) = -omega*mode*sin(omega*tau*t)
end subroutine stpnt

subroutine bcnd(ndim, par, icp, nbc, u0, u1, fb, ijac, dbc)
  use family
  implicit none
  integer, intent(in) :: ndim, icp(*), nbc, ijac
  double precision, intent(in) :: par(*), u0(ndim), u1(ndim)
  double precision, intent(out) :: fb(nbc)
  double precision, intent(inout) :: dbc(nbc, *)
  integer :: i
  fb(:n) = u0(n + 1:)
  fb(n + 1:2*n) = u1({end_first}:{end_last})
  fb(2*n + 1) = sum(w*u0(:n)**2) - 1
  if (ijac == 0) return
  do i = 1, n
    dbc(i, n + i) = 1
    dbc(n + i, ndim + {end_first} - 1 + i) = 1
    dbc(2*n + 1, i) = 2*w(i)*u0(i)
  end do
end subroutine bcnd

subroutine pvls(ndim, u, par)
  {using}
  implicit none
  integer, intent(in) :: ndim
  double precision, intent(in) :: u(ndim, *)
  double precision, intent(inout) :: par(*)
{after}
end subroutine pvls

subroutine icnd
end subroutine icnd

subroutine fopt
end subroutine fopt
"""

# The eigenvalues that AUTO finds of the flow over the whole period
OWN_MULTIPLIERS = """
  integer :: i
  double precision, external :: getp
  par(3) = 0
  do i = 1, ndim
    par(3) = max(par(3), hypot(getp('EIG', 2*i - 1, u), getp('EIG', 2*i, u)))
  end do
"""

# AUTO's reduced linear system P0 u(0) + P1 u(1) = 0, from which the flow over the quarter follows
REDUCED_SYSTEM = """
  logical, save :: opened = .false.
  if (.not. opened) open(71, file='reduced.bin', access='stream', form='unformatted')
  opened = .true.
  if (allocated(p0v)) write(71) par(1), p0v, p1v
"""

# Interface alone of a module of AUTO's that bifpy installs without its .mod file; compiled, not linked
SUPPORT = """
module support
  implicit none
  double precision, allocatable, save :: p0v(:, :), p1v(:, :)
end module support
"""


class Formulation(Enum):
    """What AUTO solves, and whence multipliers come."""

    QUARTER = "quarter"
    REDUCED = "quarter, reduced system, multipliers"
    PERIOD = "whole period, multipliers"
    PHYSICAL = "whole period, physical, multipliers"

    @property
    def whole(self) -> bool:
        """Whether the interval is the period, of which AUTO computes multipliers itself; else it is a quarter."""
        return self in (Formulation.PERIOD, Formulation.PHYSICAL)

    @property
    def part(self) -> float:
        """Length of the interval in periods."""
        return 1.0 if self.whole else 0.25


def fortran_list(values: Iterable[float]) -> str:
    """Numbers of an array constructor, one a line."""
    return ", &\n".join(f"    {number(value)}" for value in values)


def number(value: float) -> str:
    """A double precision literal with all digits."""
    return f"{value:.17e}".replace("e", "d")


def equations(case: FamilyCase, formulation: Formulation) -> str:
    """Fortran source of the equations."""
    chain, whole, reduced = case.chain, formulation.whole, formulation is Formulation.REDUCED
    left, right, weights, mode = chain.coupling, chain.coupling, chain.weights, case.start
    if formulation is Formulation.PHYSICAL:
        left, right = 1.0 + chain.gamma, 1.0 - chain.gamma
        weights, mode = np.ones(case.sites), chain.rho * case.start
    return TEMPLATE.format(
        n=case.sites,
        g=number(chain.g),
        diagonal=number(2.0 + chain.alpha),
        left=number(left),
        right=number(right),
        weights=fortran_list(weights),
        mode=fortran_list(mode),
        omega=number(case.omega),
        tau=number(formulation.part * 2.0 * math.pi / case.omega),
        end_first="n + 1" if whole else "1",
        end_last="2*n" if whole else "n",
        using="use support, only: p0v, p1v" if reduced else "",
        after=OWN_MULTIPLIERS if whole else REDUCED_SYSTEM if reduced else "",
    )
