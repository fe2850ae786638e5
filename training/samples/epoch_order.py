"""The order of training samples: random in every epoch, and optionally balanced between classes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Items = NDArray[np.int64]


@dataclass(frozen=True)
class EpochOrder:
    """Maps the numbers 0, 1, 2, ... to items: each epoch has another random order. A number always gives the same item.

    seed: the seed of the order.
    num_items: number of items. Without `class_items`, every epoch has each of them once.
    class_items: the items of each class, for class-balanced sampling (CBGS, Zhu et al., 2019). An item may belong to
        several classes. Every epoch then has an equal number of items per class, sampled with replacement: the mean
        number of items of a class. Items of no class are in every epoch once. Classes without items are left out.
    """

    seed: int
    num_items: int
    class_items: tuple[tuple[int, ...], ...] | None = None

    @cached_property
    def items_per_epoch(self) -> int:
        """The number of items in every epoch."""
        return self._items_per_class * len(self._classes) + len(self._others)

    def item(self, number: int) -> int:
        """The item with this number."""
        epoch, position = divmod(number, self.items_per_epoch)
        return int(self.items(epoch)[position])

    def items(self, epoch: int) -> Items:
        """All items of an epoch, in order."""
        if epoch not in self._kept:
            if len(self._kept) == 2:  # loading and counting steps are at most one epoch apart
                del self._kept[min(self._kept)]
            self._kept[epoch] = self._sample_epoch(epoch)
        return self._kept[epoch]

    def _sample_epoch(self, epoch: int) -> Items:
        rng = np.random.default_rng([self.seed, epoch])
        balanced = [rng.choice(items, self._items_per_class) for items in self._classes]
        return rng.permutation(np.concatenate([*balanced, self._others]))

    @cached_property
    def _items_per_class(self) -> int:
        """The mean number of items of a class, rounded down."""
        return sum(map(len, self._classes)) // max(1, len(self._classes))

    @cached_property
    def _classes(self) -> list[Items]:
        """The items of each class that has items."""
        return [np.array(items, np.int64) for items in self.class_items or () if items]

    @cached_property
    def _others(self) -> Items:
        """The items of no class."""
        return np.setdiff1d(np.arange(self.num_items), np.concatenate([*self._classes, np.zeros(0, np.int64)]))

    @cached_property
    def _kept(self) -> dict[int, Items]:
        """The newest epochs, so that an epoch is not sampled again for each of its items."""
        return {}


def group_by_class(classes_of_items: Sequence[frozenset[str]], classes: Sequence[str]) -> tuple[tuple[int, ...], ...]:
    """The items of each class, for `EpochOrder.class_items`.

    classes_of_items: the classes that each item contains.
    classes: the names of the classes.
    """
    return tuple(tuple(item for item, names in enumerate(classes_of_items) if name in names) for name in classes)
