"""Tests of the order of training samples: random epochs, and balance between classes."""

from collections import Counter

import pytest

from duospacenet.training.samples.epoch_order import EpochOrder, group_by_class

# Items 0 to 8 have cars, 8 and 9 buses; 10 and 11 have neither.
GROUPS = (tuple(range(9)), (8, 9), ())


def test_every_epoch_has_every_item_once_in_another_order():
    order = EpochOrder(0, 20)
    epochs = [[order.item(20 * epoch + position) for position in range(20)] for epoch in range(3)]
    assert all(sorted(epoch) == list(range(20)) for epoch in epochs)
    assert epochs[0] != epochs[1] != epochs[2] != epochs[0]
    assert epochs[0] != [EpochOrder(1, 20).item(position) for position in range(20)]


@pytest.mark.parametrize("groups", [None, GROUPS])
def test_a_number_gives_the_same_item_in_any_order_of_calls(groups):
    """Resumed trainings, and the processes that load clips, do not ask for the numbers in order."""
    order = EpochOrder(3, 12, groups)
    numbers = range(4 * order.items_per_epoch)
    forward = [order.item(number) for number in numbers]
    assert forward == [EpochOrder(3, 12, groups).item(number) for number in numbers]
    backward = EpochOrder(3, 12, groups)
    assert forward == [backward.item(number) for number in reversed(numbers)][::-1]


def test_class_balanced_epochs_have_as_many_samples_of_each_class():
    """9 + 2 items of two classes: 5 samples per class, and both items without a class. The empty class has none."""
    order = EpochOrder(0, 12, GROUPS)
    assert order.items_per_epoch == 2 * 5 + 2
    counts: Counter[int] = Counter()
    for epoch in range(2000):
        items = order.items(epoch).tolist()
        assert items.count(10) == items.count(11) == 1
        counts.update(items)
    assert sum(counts.values()) == 2000 * 12
    # Each class is sampled 5 times per epoch. Item 9 is one of two buses: 5 x 1/2 times. Item 0 is one of nine cars:
    # 5 x 1/9 times. Item 8 is in both groups. The tolerance is five standard deviations.
    assert counts[9] / 2000 == pytest.approx(5 / 2, abs=5 * (5 / 4 / 2000) ** 0.5)
    assert counts[0] / 2000 == pytest.approx(5 / 9, abs=5 * (5 * 8 / 81 / 2000) ** 0.5)
    assert counts[8] / 2000 == pytest.approx(5 / 2 + 5 / 9, abs=5 * ((5 / 4 + 5 * 8 / 81) / 2000) ** 0.5)


def test_items_are_grouped_by_their_classes():
    of_items = [frozenset({"car", "bus"}), frozenset(), frozenset({"bus", "tram"})]
    assert group_by_class(of_items, ("car", "bus", "trailer")) == ((0,), (0, 2), ())
