import assert from 'node:assert/strict';
import test from 'node:test';

import { mapProbabilities, selectDetections, sigmoid } from '../lib/detections.js';

const CLASSES = ['car', 'truck'];

function boxesOf(count) {
  return Float32Array.from({ length: count * 9 }, (_, index) => index);
}

test('pairs are sorted by score, and equal scores keep the order of queries and classes', () => {
  const logits = Float32Array.of(0, 2, 2, -1, 0, 0);
  const { boxes, droppedQueries } = selectDetections(logits, boxesOf(3), CLASSES);
  assert.deepEqual(
    boxes.map((box) => [box.query, box.class]),
    [
      [0, 'truck'],
      [1, 'car'],
      [0, 'car'],
      [2, 'car'],
      [2, 'truck'],
      [1, 'truck'],
    ],
  );
  assert.deepEqual(boxes[1].box, [9, 10, 11, 12, 13, 14, 15, 16, 17]);
  assert.equal(droppedQueries, 0);
});

test('logits that round to one float32 score are a tie', () => {
  // Float32 scores near 1 are 6e-8 apart: both logits have the score 1.
  const { boxes } = selectDetections(Float32Array.of(20, -9, 21, -9), boxesOf(2), CLASSES);
  assert.deepEqual(boxes.map((box) => box.query).slice(0, 2), [0, 1]);
});

test('a query with a number that is not finite is dropped with all its classes', () => {
  const boxes = boxesOf(3);
  boxes[9 + 4] = NaN;
  const { boxes: selected, droppedQueries } = selectDetections(
    Float32Array.of(1, 1, 5, 5, Infinity, 0),
    boxes,
    CLASSES,
  );
  assert.deepEqual(
    selected.map((box) => box.query),
    [0, 0],
  );
  assert.equal(droppedQueries, 2);
});

test('at most 500 pairs are kept', () => {
  const { boxes } = selectDetections(new Float32Array(600), boxesOf(300), CLASSES);
  assert.equal(boxes.length, 500);
  assert.equal(boxes.at(-1).query, 249);
});

test('the sigmoid does not overflow', () => {
  assert.deepEqual([0, 1000, -1000].map(sigmoid), [0.5, 1, 0]);
  assert.equal(sigmoid(1), Math.fround(0.7310585786300049));
});

test('a map cell that is not finite has probability 0', () => {
  const { probabilities, droppedCells } = mapProbabilities(Float32Array.of(0, NaN, Infinity));
  assert.deepEqual([...probabilities], [0.5, 0, 0]);
  assert.equal(droppedCells, 2);
});
