"""Exponential moving average (EMA) of the weights, with `torch.optim.swa_utils`."""

from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from ..model import DuoSpaceNet


class WeightAverage:
    """The exponential moving average of a model's weights and BatchNorm statistics.

    After step t, counted from 0, the average is d · average + (1 - d) · weights,
    with d = min(decay, (1 + t) / (10 + t)).

    The smaller decay of the first steps lets the average forget the initial weights, as in TensorFlow's
    ExponentialMovingAverage with `num_updates`. The first update copies the weights.

    model: the model in training. decay: 0 to 1.
    """

    def __init__(self, model: DuoSpaceNet, decay: float) -> None:
        self.decay = decay
        # `use_buffers`: the statistics of BatchNorm belong to the weights of their step, so both have one average.
        # No `device`: the counter stays on the CPU, where reading it does not wait for the GPU.
        self._average = AveragedModel(model, multi_avg_fn=get_ema_multi_avg_fn(decay), use_buffers=True)
        self._average.requires_grad_(False)
        self._average.eval()

    @property
    def model(self) -> DuoSpaceNet:
        """The model with the averaged weights, in evaluation mode."""
        assert isinstance(self._average.module, DuoSpaceNet)
        return self._average.module

    def update(self, model: DuoSpaceNet, step: int) -> None:
        """Add the weights of `model` after step `step`, counted from 0."""
        self._average.multi_avg_fn = get_ema_multi_avg_fn(min(self.decay, (1 + step) / (10 + step)))
        self._average.update_parameters(model)
        for average, buffer in zip(self.model.buffers(), model.buffers(), strict=True):
            if not buffer.is_floating_point():  # BatchNorm's counters: an average would be rounded
                average.copy_(buffer)

    def state_dict(self) -> dict[str, object]:
        """The averaged weights and the number of updates."""
        return self._average.state_dict()

    def load_state_dict(self, state: dict) -> None:
        """Restore the state that `state_dict` returned."""
        self._average.load_state_dict(state)
