"""The one door to searches: orbits of a chain, or of any model."""

from __future__ import annotations

from typing import Any, overload

from casadi_skin.arguments import short_repr
from casadi_skin.lattice.chain import Chain
from casadi_skin.models.ode import OdeModel
from casadi_skin.optimise.model_result import ModelSearchResult
from casadi_skin.optimise.model_search import search_model
from casadi_skin.optimise.result import SearchResult
from casadi_skin.optimise.search import search_chain


@overload
def search_orbit(chain_or_model: Chain, **asked: Any) -> SearchResult: ...


@overload
def search_orbit(chain_or_model: OdeModel, **asked: Any) -> ModelSearchResult: ...


def search_orbit(chain_or_model: Chain | OdeModel, **asked: Any) -> SearchResult | ModelSearchResult:
    """Find the orbits that optimise an objective over free parameters within bounds, from many starts.

    Of a chain, orbits of one mode's family (see `search_chain` for what can be asked); of any other model, periodic
    orbits near a guess (see `search_model`). Raises TypeError for what is neither.
    """
    if isinstance(chain_or_model, Chain):
        return search_chain(chain_or_model, **asked)
    if isinstance(chain_or_model, OdeModel):
        return search_model(chain_or_model, **asked)
    raise TypeError(f"chain_or_model: given {short_repr(chain_or_model)}; accepted: a Chain or an OdeModel")
