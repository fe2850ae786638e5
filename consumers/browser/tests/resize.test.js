import assert from 'node:assert/strict';
import test from 'node:test';

import { scaledSize, toNetworkImage } from '../lib/preprocessing.js';
import { halve, resizeArea, resizeLinear, roundHalfToEven } from '../lib/resize.js';
import { fixtureBytes, fixtureJson, needsFixtures } from './fixtures.js';

function grey(width, values) {
  return {
    width,
    height: values.length / width,
    data: Uint8Array.from(values.flatMap((value) => [value, value, value])),
  };
}

function firstChannel({ data }) {
  return [...data].filter((_, index) => index % 3 === 0);
}

test('halving rounds halves up', () => {
  assert.deepEqual(firstChannel(halve(grey(4, [0, 1, 4, 4, 0, 1, 4, 6]))), [1, 5]); // means 0.5 and 4.5
});

test('an area by a whole factor is the mean, halves rounded to even', () => {
  const columns = Array.from({ length: 16 }, (_, index) => (index < 8 ? 1 : 0));
  assert.deepEqual(firstChannel(resizeArea(grey(4, columns), 1, 1)), [0]); // the mean 0.5
  assert.deepEqual(firstChannel(resizeArea(grey(3, [0, 3, 9, 3, 3, 3, 6, 9, 9]), 1, 1)), [5]);
});

test('an area by another factor weighs the pixels by their covered shares', () => {
  // Three pixels become two: each covers one pixel and half of the middle one.
  assert.deepEqual(firstChannel(resizeArea(grey(3, [30, 90, 240]), 2, 1)), [50, 190]);
});

test('linear interpolation has pixel centres at halves', () => {
  assert.deepEqual(firstChannel(resizeLinear(grey(2, [0, 100]), 4, 1)), [0, 25, 75, 100]);
});

test('halves are rounded to even numbers', () => {
  assert.deepEqual([0.5, 1.5, 2.5, 2.4, 2.6, 200.5].map(roundHalfToEven), [0, 2, 2, 2, 3, 200]);
});

test('the scaled image covers the input, and is cropped at the top and equally on both sides', () => {
  const network = { width_px: 400, height_px: 160 };
  assert.deepEqual(scaledSize(1600, 900, network), { width: 400, height: 225, left: 0, top: 65 });
  assert.deepEqual(scaledSize(803, 320, network), { width: 402, height: 160, left: 1, top: 0 }); // 401.5 to even
  assert.throws(() => scaledSize(1, 100_000, network), /^SceneError: image size: expected proportions like those/);
});

test('preprocessed images have the pixels of OpenCV', needsFixtures, async () => {
  const { cases } = await fixtureJson('pixels', 'cases.json');
  assert.ok(cases.length >= 20);
  for (const [index, { width, height, preprocessing }] of cases.entries()) {
    const image = { width, height, data: await fixtureBytes('pixels', `${index}.in`) };
    const found = toNetworkImage(image, preprocessing).data;
    assert.deepEqual(
      found,
      await fixtureBytes('pixels', `${index}.out`),
      `${width}x${height} for ${JSON.stringify(preprocessing)}`,
    );
  }
});
