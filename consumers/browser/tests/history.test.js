import assert from 'node:assert/strict';
import test from 'node:test';

import { after, decoderInputs, pastFrame, resetReason } from '../lib/history.js';

const LIMITS = { num_frames: 4, largest_time_delta_s: 2, largest_speed_m_s: 70, largest_turn_rad_s: 3 };

function frame({ scene = 'a', time = 0, x = 0, yaw = 0 } = {}) {
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  return {
    scene,
    timestamp_s: time,
    global_T_ego: [
      [cos, -sin, 0, x],
      [sin, cos, 0, 0],
      [0, 0, 1, 0],
      [0, 0, 0, 1],
    ],
  };
}

test('reasons of a reset, in their order', () => {
  const last = pastFrame(frame({ time: 10, x: 5 }));
  const reason = (values) => resetReason(last, frame({ time: 10.5, x: 5, ...values }), LIMITS);
  assert.equal(resetReason(undefined, frame(), LIMITS), null);
  assert.equal(reason({}), null);
  assert.equal(reason({ scene: 'b', time: 1 }), "new scene 'b' after 'a'");
  assert.equal(reason({ time: 12 }), null);
  assert.equal(reason({ time: 12.01 }), 'gap of 2.01 s, above 2 s');
  assert.equal(reason({ x: 40 }), null);
  assert.equal(reason({ x: 40.01 }), 'ego jump of 35.0 m in 0.50 s');
  assert.equal(reason({ yaw: 1.49 }), null);
  assert.equal(reason({ yaw: -1.51 }), 'ego turn of 87 degrees in 0.50 s');
});

test('a time stamp that is not later is refused', () => {
  const last = pastFrame(frame({ time: 10 }));
  for (const time of [10, 9]) {
    assert.throws(
      () => resetReason(last, frame({ time }), LIMITS),
      /timestamp_s: expected later than 10 of the frame before/,
    );
  }
});

test('the history has at most T - 1 frames, and always the newest', () => {
  assert.deepEqual(after(['b', 'a', 'z'], 'c', 4), ['c', 'b', 'a']);
  assert.deepEqual(after(['b'], 'c', 1), ['c']);
});

test('inputs of the decoder: differences in float64, and empty slots', () => {
  const inputs = {
    image_T_ego: Float32Array.from({ length: 12 }, (_, index) => index + 1),
    camera_valid: Uint8Array.of(1),
  };
  const [now, past] = [frame({ time: 1.5e9 + 0.25, x: 5e6 + 3 }), frame({ time: 1.5e9, x: 5e6, yaw: Math.PI / 2 })];
  const window = [
    pastFrame(now, inputs),
    pastFrame(past, { image_T_ego: inputs.image_T_ego.map((value) => -value), camera_valid: Uint8Array.of(0) }),
  ];
  const found = decoderInputs(window, 3, 1);
  assert.deepEqual([...found.time_delta_s], [0, 0.25, 0]);
  assert.deepEqual([...found.frame_valid], [1, 1, 0]);
  assert.deepEqual([...found.camera_valid], [1, 0, 0]);
  assert.deepEqual([...found.image_T_ego.slice(11, 14)], [12, -1, -2]);
  assert.deepEqual([...found.image_T_ego.slice(24)], Array(12).fill(0));
  const identity = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
  assert.deepEqual([...found.past_T_now.slice(0, 16)], identity);
  assert.deepEqual([...found.past_T_now.slice(32)], identity);
  // The past ego heads along global y, so the 3 m along global x are to its right.
  const expected = [0, 1, 0, 0, -1, 0, 0, -3, 0, 0, 1, 0, 0, 0, 0, 1];
  found.past_T_now.slice(16, 32).forEach((value, index) => assert.ok(Math.abs(value - expected[index]) < 1e-6));
});
