"""The outputs in a bundle's manifest: which detections are selected, and how boxes and map masks are laid out."""

from typing import Literal

from ..json_record import JsonRecord


class DetectionSelection(JsonRecord):
    """How detections follow from `class_logits` (Q, classes). A detection is a pair of a query and a class.

    score: 1 / (1 + exp(-logit)), computed and compared in float32.
    order: of the detections. Pairs of equal score keep the order of queries, and of classes within a query.
    largest_count: number of detections that are kept, at most.
    smallest_score: None: there is no threshold.
    suppression: "none": overlapping boxes are kept.
    not_finite: "drop query": a query with a logit or box number that is not finite has no detections.
    """

    score: Literal["sigmoid"] = "sigmoid"
    score_dtype: Literal["float32"] = "float32"
    order: Literal["score descending"] = "score descending"
    ties: Literal["query, class"] = "query, class"
    largest_count: Literal[500] = 500
    smallest_score: None = None
    suppression: Literal["none"] = "none"
    not_finite: Literal["drop query"] = "drop query"


class BoxLayout(JsonRecord):
    """The numbers of a row of `boxes` (Q, 9).

    columns: names with units. w, l, h are width, length and height.
    frame: "ego": of the current frame.
    position: "centre": x, y and z are the centre of the box, not its bottom.
    length: "along heading".
    yaw: 0 along the x axis, counter-clockwise about the z axis.
    velocity: "over ground": not relative to the ego vehicle.
    """

    columns: tuple[
        Literal["x_m"],
        Literal["y_m"],
        Literal["z_m"],
        Literal["w_m"],
        Literal["l_m"],
        Literal["h_m"],
        Literal["yaw_rad"],
        Literal["vx_m_s"],
        Literal["vy_m_s"],
    ] = ("x_m", "y_m", "z_m", "w_m", "l_m", "h_m", "yaw_rad", "vx_m_s", "vy_m_s")
    frame: Literal["ego"] = "ego"
    position: Literal["centre"] = "centre"
    length: Literal["along heading"] = "along heading"
    yaw: Literal["from x, counter-clockwise about z"] = "from x, counter-clockwise about z"
    velocity: Literal["over ground"] = "over ground"


class MapLayout(JsonRecord):
    """The cells of a map class, `mask[0, 0, i, j]`.

    axes: the row i counts cells along x, the column j along y. Both increase with the index.
    cell_centre: coordinate of the centre of the cell with an index, from the `perception` range of its axis.
    probability: 1 / (1 + exp(-logit)).
    not_finite: the probability of a cell whose logit is not finite.
    """

    axes: tuple[Literal["x"], Literal["y"]] = ("x", "y")
    cell_centre: Literal["lower + (index + 0.5) * (upper - lower) / size"] = (
        "lower + (index + 0.5) * (upper - lower) / size"
    )
    probability: Literal["sigmoid"] = "sigmoid"
    not_finite: Literal[0] = 0


class Axes(JsonRecord):
    """The directions of the axes of each coordinate frame. The ego and camera frames are in metres."""

    ego: tuple[Literal["forward"], Literal["left"], Literal["up"]] = ("forward", "left", "up")
    camera: tuple[Literal["right"], Literal["down"], Literal["forward"]] = ("right", "down", "forward")
    image: tuple[Literal["right"], Literal["down"]] = ("right", "down")
