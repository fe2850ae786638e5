// The past frames of a stream, and the decoder's inputs from them: see "Decoder inputs" and "Steps of a frame" in
// docs/frame-steps.md.

import { printable, SceneError } from './errors.js';
import { identity, inverse, multiply, nearestRigid, rotationAngle, rotationOf, transpose } from './geometry.js';

/**
 * @typedef {object} PastFrame
 * @property {string} scene
 * @property {number} timestamp_s
 * @property {number[][]} global_T_ego exactly rigid
 * @property {Float32Array} image_T_ego (N, 3, 4)
 * @property {Uint8Array} camera_valid (N)
 * @property {Map<string, object>} memory cached tensors by name
 */

/** What the history keeps of a frame. */
export function pastFrame(frame, inputs, memory) {
  return {
    scene: frame.scene,
    timestamp_s: frame.timestamp_s,
    global_T_ego: nearestRigid(frame.global_T_ego),
    image_T_ego: inputs?.image_T_ego,
    camera_valid: inputs?.camera_valid,
    memory,
  };
}

/**
 * Return why `frame` cannot continue a history whose newest frame is `last`, or null if it can. Throws a SceneError for
 * a time stamp that is not later.
 */
export function resetReason(last, frame, window) {
  if (last === undefined) return null;
  if (frame.scene !== last.scene) return `new scene '${printable(frame.scene)}' after '${printable(last.scene)}'`;
  const delta_s = frame.timestamp_s - last.timestamp_s;
  if (delta_s <= 0) {
    const remedy = 'Leave the frame out, or start again.';
    throw new SceneError(
      'timestamp_s',
      `later than ${last.timestamp_s} of the frame before`,
      `${frame.timestamp_s}`,
      remedy,
    );
  }
  if (delta_s > window.largest_time_delta_s) {
    return `gap of ${delta_s.toFixed(2)} s, above ${window.largest_time_delta_s} s`;
  }
  const global_T_now = nearestRigid(frame.global_T_ego);
  const jump_m = Math.hypot(...[0, 1, 2].map((axis) => global_T_now[axis][3] - last.global_T_ego[axis][3]));
  if (jump_m > window.largest_speed_m_s * delta_s)
    return `ego jump of ${jump_m.toFixed(1)} m in ${delta_s.toFixed(2)} s`;
  const turn = multiply(transpose(rotationOf(last.global_T_ego)), rotationOf(global_T_now));
  const turn_rad = rotationAngle(turn);
  if (turn_rad > (window.largest_turn_rad_s ?? Math.PI) * delta_s) {
    return `ego turn of ${Math.round((turn_rad * 180) / Math.PI)} degrees in ${delta_s.toFixed(2)} s`;
  }
  return null;
}

/**
 * The decoder's inputs besides the cached values.
 * @param {PastFrame[]} window the current frame, then past frames, newest first
 * @param {number} numFrames T
 * @param {number} numCameras N
 */
export function decoderInputs(window, numFrames, numCameras) {
  const inputs = {
    image_T_ego: new Float32Array(numFrames * numCameras * 12),
    past_T_now: new Float32Array(numFrames * 16),
    time_delta_s: new Float32Array(numFrames),
    frame_valid: new Uint8Array(numFrames),
    camera_valid: new Uint8Array(numFrames * numCameras),
  };
  for (let slot = 0; slot < numFrames; slot += 1) inputs.past_T_now.set(identity(4).flat(), slot * 16);
  window.forEach((past, slot) => {
    if (slot > 0) {
      inputs.past_T_now.set(multiply(inverse(past.global_T_ego), window[0].global_T_ego).flat(), slot * 16);
      inputs.time_delta_s[slot] = window[0].timestamp_s - past.timestamp_s;
    }
    inputs.image_T_ego.set(past.image_T_ego, slot * numCameras * 12);
    inputs.camera_valid.set(past.camera_valid, slot * numCameras);
    inputs.frame_valid[slot] = 1;
  });
  return inputs;
}

/** The history after the frame `now`: at most T - 1 frames, but always the newest one, for the reset rules. */
export function after(history, now, numFrames) {
  return [now, ...history].slice(0, Math.max(1, numFrames - 1));
}
