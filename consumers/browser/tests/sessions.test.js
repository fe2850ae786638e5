import assert from 'node:assert/strict';
import test from 'node:test';

import { CameraGroups } from '../lib/sessions.js';

class Tensor {
  constructor(dtype, data, dims) {
    Object.assign(this, { dtype, data, dims });
  }
}

/** A backbone of two cameras whose features are the first two pixels of each camera. */
function backbone(runs) {
  const spec = {
    inputs: [{ name: 'images', dtype: 'uint8', shape: [2, 1, 1, 3] }],
    outputs: [{ name: 'features', dtype: 'float32', shape: [2, 2] }],
  };
  const run = async ({ images }) => {
    runs.push([...images]);
    return { features: new Tensor('float32', Float32Array.of(images[0], images[1], images[3], images[4]), [2, 2]) };
  };
  return { ort: { Tensor }, spec, run };
}

test('a backbone of two cameras runs for each pair that has an image, and lost pairs are zeros', async () => {
  const runs = [];
  const groups = new CameraGroups(backbone(runs), 6);
  const images = Uint8Array.from({ length: 18 }, (_, index) => index + 1);
  const { features } = await groups.run({ images, camera_valid: Uint8Array.of(1, 0, 0, 0, 1, 1) });
  assert.deepEqual(runs, [
    [1, 2, 3, 4, 5, 6],
    [13, 14, 15, 16, 17, 18],
  ]);
  assert.deepEqual(features.dims, [6, 2]);
  assert.deepEqual([...features.data], [1, 2, 4, 5, 0, 0, 0, 0, 13, 14, 16, 17]);
});
