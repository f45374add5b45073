"""Models: `OdeModel`, models in files, and models in FMUs."""

from casadi_skin.models import saved as _saved  # noqa: F401 - it registers how models are pickled
