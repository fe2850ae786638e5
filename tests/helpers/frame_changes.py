"""Changes to one field of a frame. Each function takes a change of the value and returns a change of the frame."""

from dataclasses import replace

from tests.helpers.streams import with_camera

FRONT = "CAM_FRONT"


def image(change):
    return lambda frame: replace(frame, images={**frame.images, FRONT: change(frame.images[FRONT])})


def intrinsics(change):
    return lambda frame: with_camera(frame, FRONT, intrinsics_px=change(frame.cameras[FRONT].intrinsics_px))


def extrinsics(change):
    return lambda frame: with_camera(frame, FRONT, camera_T_ego=change(frame.cameras[FRONT].camera_T_ego))


def pose(change):
    return lambda frame: replace(frame, global_T_ego=change(frame.global_T_ego))


def timestamp(change):
    return lambda frame: replace(frame, timestamp_s=change(frame.timestamp_s))


def with_element(row, column, value):
    def change(matrix):
        matrix = matrix.copy()
        matrix[row, column] = value
        return matrix

    return change
