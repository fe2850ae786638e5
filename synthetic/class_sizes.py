"""Typical sizes of the ten classes."""

Size = tuple[float, float, float]

CLASS_SIZES_M: dict[str, Size] = {  # width, length, height
    "car": (1.95, 4.62, 1.73),
    "truck": (2.51, 6.93, 2.84),
    "construction_vehicle": (2.75, 6.37, 3.19),
    "bus": (2.84, 10.5, 3.47),
    "trailer": (2.80, 11.5, 3.87),
    "barrier": (2.53, 0.50, 0.98),
    "motorcycle": (0.77, 2.11, 1.47),
    "bicycle": (0.60, 1.70, 1.28),
    "pedestrian": (0.67, 0.73, 1.77),
    "traffic_cone": (0.41, 0.41, 1.07),
}
WIDEST_M = 2.95  # the largest width of an object of the ten classes, which must fit into its lane
