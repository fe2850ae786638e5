import assert from 'node:assert/strict';
import test from 'node:test';

import { Pipeline } from '../lib/pipeline.js';
import { Replay } from '../lib/replay.js';
import { readImages, readScene } from '../lib/scene.js';
import { loadJpeg, loadOrt, openFolder } from '../node/engine.js';
import { bundleFixture, fixture, needsFixtures } from './fixtures.js';

let loaded; // the graphs are opened once

async function openDrive() {
  loaded ??= { pipeline: await Pipeline.load(loadOrt(1), await bundleFixture()), jpeg: await loadJpeg() };
  const scene = await readScene(await openFolder(fixture('drive')), loaded.pipeline.manifest.num_cameras);
  return { ...loaded, scene };
}

function withoutTimes({ timings_ms: _, ...result }) {
  return result;
}

test('frames in any order have the results of a run from the first to the last', needsFixtures, async () => {
  const { pipeline, scene, jpeg } = await openDrive();
  const stream = pipeline.stream({ maps: true });
  const inOrder = [];
  for (const frame of scene.frames)
    inOrder.push(withoutTimes(await stream.step(frame, await readImages(scene, frame, jpeg))));
  const replay = new Replay(pipeline, scene, jpeg);
  // Jumps back and ahead, over resets and skipped frames, the same frame twice, and the next frame.
  for (const index of [3, 0, 19, 15, 16, 13, 14, 14, 11, 4, 5, 6]) {
    const { result } = await replay.frame(index);
    assert.deepEqual(withoutTimes(result), inOrder[index], `frame ${index}`);
  }
});

test('after a damaged image, the other frames have the same results', needsFixtures, async () => {
  const { pipeline, scene, jpeg } = await openDrive();
  const replay = new Replay(pipeline, scene, jpeg);
  const expected = withoutTimes((await replay.frame(0)).result);
  const path = [...scene.frames[2].cameras.values()].find((camera) => camera.image !== null).image;
  scene.folder.files.set(path, { size: 3, read: async () => Uint8Array.of(1, 2, 3) });
  for (const index of [2, 3]) await assert.rejects(replay.frame(index), { name: 'SceneError' });
  assert.deepEqual(withoutTimes((await replay.frame(0)).result), expected);
  assert.equal((await replay.frame(7)).result.history.reset_reason, 'gap of 2.50 s, above 2 s');
});
