"""The base of every settings class: what is not understood is refused, never repaired."""

from pydantic import BaseModel, ConfigDict


class Settings(BaseModel):
    """Typed, immutable settings; an unknown key, a wrong type or an impossible value is an error.

    Every room derives its settings from this, and `scenarios.schema` composes them into the
    scenario file, so a key is defined in exactly one place: beside the code that reads it.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )
