// Validation of a frame before the graphs run: a graph turns a calibration with NaN into plausible boxes.

import { SceneError, shown } from './errors.js';
import { determinant, multiply, rotationOf, transpose } from './geometry.js';

const ORTHONORMAL_TOLERANCE = 2e-3;
const LARGEST = 1e9;
const LATEST_S = 1e11;
const [SHORTEST_FOCAL, LONGEST_FOCAL] = [0.1, 60]; // image sizes
const FARTHEST_CENTRE = 2; // image sizes from the image's centre

/**
 * Check a frame of a scene.
 * @param {object} frame see `scene.js`
 * @param {number} numCameras the largest number of cameras that the bundle accepts
 */
export function checkFrame(frame, numCameras) {
  if (frame.cameras.size < 1 || frame.cameras.size > numCameras) {
    const remedy = 'Use a bundle for more cameras, or leave cameras out.';
    throw new SceneError(
      `${frame.where}, cameras`,
      `1 to ${numCameras}, as in the bundle`,
      `${frame.cameras.size}`,
      remedy,
    );
  }
  if (!(Math.abs(frame.timestamp_s) <= LATEST_S)) {
    const remedy = 'If the times are in milliseconds or microseconds, convert them.';
    throw new SceneError(
      `${frame.where}, timestamp_s`,
      `seconds, at most ${LATEST_S}`,
      shown(frame.timestamp_s),
      remedy,
    );
  }
  checkRigid(`${frame.where}, global_T_ego`, frame.global_T_ego);
  for (const [name, camera] of frame.cameras) checkCamera(`${frame.where}, camera ${name}`, camera);
}

function checkCamera(where, camera) {
  for (const size of [camera.width_px, camera.height_px]) {
    if (!Number.isInteger(size) || size < 1) {
      throw new SceneError(where, 'width_px and height_px of at least 1', shown(size));
    }
  }
  const field = `${where}, intrinsics_px`;
  const K = camera.intrinsics_px;
  checkFinite(field, K);
  const isUpper = K[1][0] === 0 && K[2][0] === 0 && K[2][1] === 0 && K[2][2] === 1;
  if (!isUpper || !(K[0][0] > 0) || !(K[1][1] > 0)) {
    const remedy = 'Is the matrix transposed?';
    throw new SceneError(field, '[[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy above 0', shown(K), remedy);
  }
  checkProportions(field, 'x', K[0][0], K[0][2], camera.width_px);
  checkProportions(field, 'y', K[1][1], K[1][2], camera.height_px);
  checkRigid(`${where}, camera_T_ego`, camera.camera_T_ego);
}

function checkProportions(field, axis, focal, centre, size) {
  const isPossible = focal / size >= SHORTEST_FOCAL && focal / size <= LONGEST_FOCAL;
  if (isPossible && Math.abs(centre / size - 0.5) <= FARTHEST_CENTRE) return;
  const expected =
    `f${axis} of ${SHORTEST_FOCAL} to ${LONGEST_FOCAL} times the ${size} px of the image, ` +
    `and c${axis} at most ${FARTHEST_CENTRE} image sizes from its centre`;
  throw new SceneError(field, expected, `${focal} and ${centre}`, 'Are they in pixels of this image?');
}

function checkRigid(field, a_T_b) {
  checkFinite(field, a_T_b);
  const rotation = rotationOf(a_T_b);
  const product = multiply(rotation, transpose(rotation));
  const deviations = product.flatMap((row, i) => row.map((value, j) => Math.abs(value - (i === j ? 1 : 0))));
  const deviation = Math.max(...deviations);
  if (deviation > ORTHONORMAL_TOLERANCE || !(determinant(rotation) > 0)) {
    const found = `a matrix that is off by ${deviation.toPrecision(3)}, determinant ${determinant(rotation).toPrecision(3)}`;
    throw new SceneError(field, 'a rotation with determinant 1', found, 'Is it scaled or mirrored?');
  }
  if (a_T_b[3].some((value, index) => value !== (index === 3 ? 1 : 0))) {
    throw new SceneError(field, 'the last row 0 0 0 1', shown(a_T_b[3]), 'Is the matrix transposed?');
  }
}

function checkFinite(field, matrix) {
  if (!matrix.flat().every((value) => Math.abs(value) <= LARGEST)) {
    throw new SceneError(field, `finite numbers, at most ${LARGEST}`, shown(matrix), 'Use metres and pixels.');
  }
}
