import assert from 'node:assert/strict';
import test from 'node:test';

import { decodeImage } from '../lib/image-files.js';
import { loadJpeg } from '../node/engine.js';
import { fixtureBytes, fixtureJson, needsFixtures } from './fixtures.js';

const CAMERA = { width_px: 45, height_px: 31 };

test('images of every kind have the pixels of OpenCV', needsFixtures, async () => {
  const [jpeg, { valid }] = [await loadJpeg(), await fixtureJson('images', 'list.json')];
  assert.ok(valid.length >= 12);
  for (const name of valid) {
    const image = decodeImage(await fixtureBytes('images', name), name, CAMERA, jpeg);
    assert.deepEqual(image.data, await fixtureBytes('images', `${name}.bgr`), name);
  }
});

test('damaged and other files are refused, and the file is named', needsFixtures, async () => {
  const [jpeg, { refused }] = [await loadJpeg(), await fixtureJson('images', 'list.json')];
  for (const [name, message] of Object.entries(refused)) {
    const bytes = await fixtureBytes('images', name);
    assert.throws(
      () => decodeImage(bytes, name, CAMERA, jpeg),
      (error) => {
        assert.match(error.message, new RegExp(`^${name}: expected .*${message}`));
        return true;
      },
      name,
    );
  }
});

test('a truncated image is refused at every length', needsFixtures, async () => {
  const jpeg = await loadJpeg();
  for (const name of ['colour.png', 'colour.jpg']) {
    const bytes = await fixtureBytes('images', name);
    for (let share = 0; share < 1; share += 0.05) {
      const part = bytes.slice(0, Math.floor(share * bytes.length));
      assert.throws(
        () => decodeImage(part, name, CAMERA, jpeg),
        { name: 'SceneError' },
        `${name}, ${part.length} bytes`,
      );
    }
  }
});

test('an image of another size is refused', needsFixtures, async () => {
  const bytes = await fixtureBytes('images', 'colour.png');
  const decode = () => decodeImage(bytes, 'colour.png', { width_px: 31, height_px: 45 }, undefined);
  assert.throws(decode, /colour\.png: expected 31x45 px, as the calibration says; found 45x31 px/);
});
