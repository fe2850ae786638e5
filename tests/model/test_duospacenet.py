"""The whole model on a window of frames, unrolled and streamed."""

import pytest
import torch

from duospacenet.model import PRESETS, DuoSpaceNet
from duospacenet.model.decoder import FrameCache
from duospacenet.model.duospacenet import FrameFeatures
from duospacenet.model.window import Window
from tests.helpers.model_inputs import assert_close, random_images, random_window

TINY = PRESETS["tiny"]
FRAMES = 4

pytestmark = pytest.mark.usefixtures("no_gradients")


@pytest.fixture
def no_gradients():
    with torch.no_grad():
        yield


@pytest.fixture(scope="module")
def window():
    return random_window(TINY, FRAMES, seed=3)


@pytest.fixture(scope="module")
def images():
    return random_images(TINY, FRAMES)


@pytest.fixture(scope="module")
def caches(tiny_model, images, window):
    """The cached values of each frame, index 0 the newest."""
    with torch.no_grad():
        return [cached(tiny_model, images, window, t) for t in range(FRAMES)]


def cached(model, images, window, t):
    return model.cache_frame(model.encode(images[t], window.image_T_ego[t], window.camera_valid[t]))


def with_frames(window, *valid):
    return window._replace(frame_valid=torch.tensor(valid))


def assert_equal_bits(predictions, others):
    for prediction, other in zip(predictions, others, strict=True):
        assert torch.equal(prediction.class_logits, other.class_logits)
        assert torch.equal(prediction.pose, other.pose)
        assert prediction.pose.isfinite().all()


def assert_near(predictions, others, relative=1e-5):
    for prediction, other in zip(predictions, others, strict=True):
        assert_close(prediction.class_logits, other.class_logits, relative)
        assert_close(prediction.pose, other.pose, relative)


def differ(predictions, others):
    return not torch.allclose(predictions[-1].class_logits, others[-1].class_logits, rtol=1e-3, atol=1e-3)


# --- Shapes -------------------------------------------------------------------------------------------------------


def test_the_output_is_a_prediction_for_each_layer_and_a_mask_for_each_map_class(tiny_model, images, window):
    predictions, maps = tiny_model(images, *window)
    assert [(p.class_logits.shape, p.pose.shape) for p in predictions] == [((32, 10), (32, 10))] * 2
    assert {name: tuple(mask.shape) for name, mask in maps.items()} == {
        "drivable_area": (1, 1, 16, 16),
        "lane_boundary": (1, 1, 16, 16),
    }


@pytest.mark.parametrize("preset", PRESETS)
def test_the_model_can_be_built_on_the_meta_device(preset):
    with torch.device("meta"):
        model = DuoSpaceNet(PRESETS[preset])
    assert all(parameter.is_meta for parameter in model.parameters())
    names = [name for name, _ in model.named_parameters()]
    assert len(names) == len(set(names)) > 100


# --- Unrolled equals streamed -------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_frames", [1, 2, 3, 4])
def test_a_window_of_images_equals_a_stream_of_frames(tiny_model, images, window, num_frames):
    """Each frame is encoded once, as the current frame. The next frames use its cached values."""
    queue = []
    for t in reversed(range(num_frames)):
        queue.insert(0, cached(tiny_model, images, window, t))
    streamed = tiny_model.detect(queue, Window(*(field[:num_frames] for field in window)))

    unrolled = tiny_model(images[:num_frames], *(field[:num_frames] for field in window))
    assert_near(unrolled.predictions, streamed, 1e-6)

    # The first frames use the same graph. Their empty slots are masked.
    valid = [t < num_frames for t in range(FRAMES)]
    padded = tiny_model(images, *with_frames(window, *valid))
    assert_near(padded.predictions, streamed)


def test_every_frame_of_the_window_changes_the_result(tiny_model, caches, window):
    whole = tiny_model.detect(caches, window)
    for t in range(1, FRAMES):
        valid = [slot != t for slot in range(FRAMES)]
        assert differ(whole, tiny_model.detect(caches, with_frames(window, *valid)))


def test_the_maps_depend_on_the_current_frame_only(tiny_model, images, window):
    maps = tiny_model(images, *window).maps
    alone = tiny_model(images[:1], *(field[:1] for field in window)).maps
    for name, mask in maps.items():
        assert torch.equal(mask, alone[name])


# --- Masked slots -------------------------------------------------------------------------------------------------


def poisoned(frame, number):
    pv = [[torch.full_like(level, number) for level in layer] for layer in frame.pv]
    return FrameCache(pv, [torch.full_like(bev, number) for bev in frame.bev])


def tensors_of(frame):
    return [*(level for layer in frame.pv for level in layer), *frame.bev]


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e30, 0.0])
@pytest.mark.parametrize("masked", [(3,), (2,), (1, 3), (1, 2, 3)])
def test_the_values_of_a_masked_slot_have_no_effect(tiny_model, caches, window, masked, number):
    masked_window = with_frames(window, *(t not in masked for t in range(FRAMES)))
    expected = tiny_model.detect(caches, masked_window)

    slots = list(caches)
    fields = {name: field.clone() for name, field in masked_window._asdict().items()}
    for t in masked:
        slots[t] = poisoned(caches[t], number)
        for name in ("image_T_ego", "past_T_now", "time_delta_s"):
            fields[name][t] = number
        fields["camera_valid"][t] = number != 0.0

    assert_equal_bits(tiny_model.detect(slots, Window(**fields)), expected)


def test_the_images_of_a_masked_slot_have_no_effect(tiny_model, images, window):
    masked_window = with_frames(window, True, True, False, True)
    expected = tiny_model(images, *masked_window)
    images = images.clone()
    images[2] = 255 - images[2]
    actual = tiny_model(images, *masked_window)
    assert_equal_bits(actual.predictions, expected.predictions)


# --- Cameras ------------------------------------------------------------------------------------------------------


def test_the_order_of_the_cameras_does_not_matter(tiny_model, images, window):
    """Up to rounding: the samples of the cameras are added in another order."""
    order = torch.tensor([4, 2, 0, 5, 1, 3])
    window = window._replace(camera_valid=window.camera_valid.clone())
    window.camera_valid[0, 1] = window.camera_valid[2, 5] = False
    expected = tiny_model(images, *window)
    shuffled = window._replace(image_T_ego=window.image_T_ego[:, order], camera_valid=window.camera_valid[:, order])
    actual = tiny_model(images[:, order], *shuffled)
    assert_near(actual.predictions, expected.predictions, 1e-5)
    for name, mask in actual.maps.items():
        assert_close(mask, expected.maps[name], 1e-5)
    unmatched = tiny_model(images[:, order], *window)
    assert differ(unmatched.predictions, expected.predictions)


def test_the_images_of_a_lost_camera_have_no_effect(tiny_model, images, window):
    window = window._replace(image_T_ego=window.image_T_ego.clone(), camera_valid=window.camera_valid.clone())
    window.camera_valid[0, 2] = window.camera_valid[1, 4] = False
    expected = tiny_model(images, *window)
    images = images.clone()
    for frame, camera in ((0, 2), (1, 4)):
        images[frame, camera] = 255 - images[frame, camera]
        window.image_T_ego[frame, camera] = float("nan")
    actual = tiny_model(images, *window)
    assert_equal_bits(actual.predictions, expected.predictions)
    for name, mask in actual.maps.items():
        assert torch.equal(mask, expected.maps[name])


def test_a_frame_without_any_camera_gives_finite_numbers(tiny_model, images, window):
    window = window._replace(camera_valid=torch.zeros_like(window.camera_valid))
    predictions, maps = tiny_model(images, *window)
    assert all(p.pose.isfinite().all() and p.class_logits.isfinite().all() for p in predictions)
    assert all(mask.isfinite().all() for mask in maps.values())


# --- The model has no state ---------------------------------------------------------------------------------------


def test_a_call_changes_neither_the_model_nor_its_arguments(tiny_model, images, window):
    state = {name: tensor.clone() for name, tensor in tiny_model.state_dict().items()}
    fields = [field.clone() for field in window]
    first = tiny_model(images, *window)
    tiny_model(255 - images, *random_window(TINY, FRAMES, seed=8))
    again = tiny_model(images, *window)
    assert_equal_bits(again.predictions, first.predictions)
    assert all(torch.equal(tensor, state[name]) for name, tensor in tiny_model.state_dict().items())
    assert all(torch.equal(field, before) for field, before in zip(window, fields, strict=True))


def test_caching_and_detecting_do_not_change_features_and_cached_values(tiny_model, images, window, caches):
    features = tiny_model.encode(images[0], window.image_T_ego[0], window.camera_valid[0])
    before = FrameFeatures([level.clone() for level in features.pv], features.bev.clone())
    slots = [tiny_model.cache_frame(features), *caches[1:]]
    copies = [[tensor.clone() for tensor in tensors_of(frame)] for frame in slots]
    tiny_model.detect(slots, window)
    for tensor, other in zip([*features.pv, features.bev], [*before.pv, before.bev], strict=True):
        assert torch.equal(tensor, other)
    for frame, frame_before in zip(slots, copies, strict=True):
        assert all(torch.equal(a, b) for a, b in zip(tensors_of(frame), frame_before, strict=True))
