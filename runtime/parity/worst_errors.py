"""The largest error of each output of each graph, relative to its tolerance."""

from collections.abc import Iterator

from .tensor_error import TensorError
from .tolerances import describe_error, size_of, tolerance_of


class WorstErrors:
    """Collects errors. by_graph: the largest error so far, by graph and output."""

    def __init__(self) -> None:
        self.by_graph: dict[str, dict[str, TensorError]] = {}

    def add(self, graph: str, output: str, error: TensorError) -> None:
        """Keep the error if it is the largest of this output, relative to its tolerance."""
        worst = self.by_graph.setdefault(graph, {})
        both = [worst[output], error] if output in worst else [error]
        worst[output] = max(both, key=lambda error: size_of(error) / tolerance_of(error))

    def failures(self) -> Iterator[str]:
        """Describe the outputs outside their tolerance, one line each."""
        for graph, outputs in self.by_graph.items():
            for name, error in outputs.items():
                # `not <=` instead of `>`, so that a NaN fails.
                if not size_of(error) <= tolerance_of(error):
                    yield f"{graph}.{name}, {error.case}: {describe_error(error)}"
