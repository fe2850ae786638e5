"""Box counts: how many ground-truth boxes are used, under which class, and why others are left out."""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from ..runtime.printable import printable

Reason = Literal["class", "range", "no_points", "bicycle_rack"]

_REASON_TEXTS: Mapping[Reason, str] = {
    "class": "of other classes",
    "range": "out of range",
    "no_points": "without lidar or radar points",
    "bicycle_rack": "in bicycle racks",
}


@dataclass(frozen=True)
class BoxCounts:
    """The numbers of ground-truth boxes.

    used: by class.
    mapped: of the used boxes whose annotated name is not their class, by name and class.
    left_out: by reason and annotated name.
    """

    used: Counter[str] = field(default_factory=Counter)
    mapped: Counter[tuple[str, str]] = field(default_factory=Counter)
    left_out: Counter[tuple[Reason, str]] = field(default_factory=Counter)

    @property
    def num_used(self) -> int:
        return self.used.total()

    @property
    def num_of_known_classes(self) -> int:
        """The used boxes, and those that are left out for another reason than their class."""
        return self.num_used + sum(count for (reason, _), count in self.left_out.items() if reason != "class")

    def __add__(self, other: "BoxCounts") -> "BoxCounts":
        return BoxCounts(self.used + other.used, self.mapped + other.mapped, self.left_out + other.left_out)

    def left_out_by_name(self) -> dict[Reason, dict[str, int]]:
        """Return the left-out boxes by reason, then by annotated name."""
        by_reason: dict[Reason, dict[str, int]] = {reason: {} for reason in _REASON_TEXTS}
        for (reason, name), count in self.left_out.items():
            by_reason[reason][name] = count
        return {reason: names for reason, names in by_reason.items() if names}

    def lines(self) -> Iterator[str]:
        """Yield a line with the mapped names, and a line for each reason why boxes are left out."""
        if self.mapped:
            listed = ", ".join(
                f"{printable(name)} -> {printable(class_name)} ({count})"
                for (name, class_name), count in self.mapped.items()
            )
            yield f"mapped {number_of_boxes(self.mapped.total())} to classes: {listed}"
        for reason, names in self.left_out_by_name().items():
            listed = ", ".join(f"{printable(name)} ({count})" for name, count in names.items())
            yield f"left out {number_of_boxes(sum(names.values()))} {_REASON_TEXTS[reason]}: {listed}"

    def to_dict(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        mapped: dict[str, dict[str, int]] = {}
        for (name, class_name), count in self.mapped.items():
            mapped.setdefault(name, {})[class_name] = count
        return {"boxes": self.num_used, "mapped": mapped, "left_out": self.left_out_by_name()}


def number_of_boxes(count: int) -> str:
    """Return the number in words, such as "1 box"."""
    return f"{count} box{'' if count == 1 else 'es'}"
