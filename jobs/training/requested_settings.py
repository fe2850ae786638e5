"""The settings of a training from the values of its options."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from ...runtime.errors import UsageError
from ...runtime.extras import needs_extra
from ...runtime.json_record import describe_first_error

if TYPE_CHECKING:
    from ...training import Settings


def training_settings(values: Mapping[str, Any]) -> "Settings":
    """The settings of a training from option values.

    values: fields of `Settings`; a `backbone_learning_rate` of None means the same rate as for the other parts.
    Raises UsageError that names the option of an invalid value.
    """
    with needs_extra("train"):
        from ...training import Settings
    backbone_rate = values["backbone_learning_rate"]
    rates = {"backbone_learning_rate": values["learning_rate"] if backbone_rate is None else backbone_rate}
    try:
        return Settings(**{**values, **rates})
    except ValidationError as error:
        # A default may repeat another option's wrong value, so that the number of errors would mislead.
        raise UsageError(f"--{describe_first_error(error, count=False).replace('_', '-')}.") from None
