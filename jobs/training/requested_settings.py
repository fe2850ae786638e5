"""The settings of a training, from its recipe and its options."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ...runtime.errors import UsageError
from ...runtime.extras import needs_extra

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training import Settings


def training_settings(options: Mapping[str, Any], recipe: str = "cpu", assignments: Sequence[str] = ()) -> "Settings":
    """The settings of a recipe with other values.

    options: values by the name of the setting; None keeps the recipe's value.
    recipe: "cpu", "paper" or a `.toml` file.
    assignments: further values as `NAME=VALUE`.

    Raises UsageError that names the option of an invalid value, and InputError for a recipe file with a mistake.
    """
    with needs_extra("train"):
        from ...training.recipe import override, read_recipe
    return override(read_recipe(recipe), options, assignments)


def settings_for(settings: "Settings", config: "DuoSpaceNetConfig", num_samples: int | None) -> "Settings":
    """The settings with the number of steps of their epochs.

    num_samples: samples in one pass over the sources; None for synthetic scenes, which have no end.

    Raises UsageError for epochs of synthetic scenes, for a class that neither the model nor nuScenes has, for a frozen
    part that the model does not have, and if no part is trained.
    """
    from ...data.class_names import DETECTION_CLASSES

    _check_frozen_parts(settings, config)

    if unknown := [name for name in settings.yaw_free_classes if name not in {*config.classes, *DETECTION_CLASSES}]:
        expected = ", ".join(config.classes)
        raise UsageError(f"yaw_free_classes: expected some of the classes {expected}; got {unknown[0]!r}.")
    if settings.epochs is None:
        return settings
    if num_samples is None:
        raise UsageError(
            f"recipe {settings.recipe}: expected --source for a training of {settings.epochs} epochs; got none. "
            "Synthetic scenes have no end: give --source or --steps."
        )
    return replace(settings, steps=settings.epochs * -(-num_samples // settings.batch_size))


def _check_frozen_parts(settings: "Settings", config: "DuoSpaceNetConfig") -> None:
    from ...training.tasks import parts_without_loss
    from ...weights.trained_parts import model_parts

    parts = model_parts(config)
    if unknown := [name for name in settings.frozen_parts if name not in parts]:
        raise UsageError(
            f"frozen_parts: expected parts of {config.preset}, which are {', '.join(parts)}; got {unknown[0]!r}."
        )
    has_loss = [name for name in parts if name not in parts_without_loss(settings, config)]
    if set(has_loss) <= set(settings.frozen_parts):
        raise UsageError(
            f"frozen_parts: expected one of the parts that the tasks train to be left ({', '.join(has_loss)}); got all "
            "of them."
        )
