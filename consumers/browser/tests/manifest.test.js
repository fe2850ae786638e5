import assert from 'node:assert/strict';
import test from 'node:test';

import { readManifest } from '../lib/manifest.js';
import { bundleFixture, needsFixtures } from './fixtures.js';
import { sealed } from './sealed-manifest.js';

/** Read the manifest of the bundle after a change, which is sealed. */
async function readChanged(change) {
  const manifest = structuredClone((await bundleFixture()).manifest);
  change(manifest);
  return readManifest(sealed(manifest));
}

test('the manifest of a bundle is accepted', needsFixtures, async () => {
  const { manifest } = await bundleFixture();
  assert.equal(manifest.preset, 'tiny');
  assert.deepEqual(await readChanged(() => {}), { ...manifest, sha256: (await readChanged(() => {})).sha256 });
});

test('an edited manifest is refused by its seal', needsFixtures, async () => {
  const text = new TextDecoder().decode(sealed((await bundleFixture()).manifest));
  for (const edited of [
    text.replace('"preset": "tiny"', '"preset": "tony"'),
    `${text}\n`,
    text.replace(/"sha256": "[0-9a-f]+"\n\}/, '"x": 1\n}'),
  ]) {
    assert.throws(
      () => readManifest(new TextEncoder().encode(edited)),
      /manifest\.json, field sha256: expected .* The file is damaged or was edited/,
    );
  }
});

const FAULTS = {
  'a newer schema': [
    (m) => {
      m.schema_version = 99;
    },
    /field schema_version: expected at most \d+; found 99\. The bundle is newer/,
  ],
  'a schema that is not a number': [
    (m) => {
      m.schema_version = '5';
    },
    /field schema_version: expected an integer/,
  ],
  'schema 1 with later fields': [
    (m) => {
      m.schema_version = 1;
    },
    /found it in schema 1/,
  ],
  'no parity report': [
    (m) => {
      m.parity = null;
    },
    /field parity: expected a passed parity report; found no report/,
  ],
  'a failed parity report': [
    (m) => {
      m.parity.passed = false;
    },
    /field parity: .* found a failed one/,
  ],
  'another crop': [
    (m) => {
      m.preprocessing.crop = 'centre';
    },
    /field preprocessing\.crop: expected "centre columns, bottom rows"; found "centre"/,
  ],
  'another rule of the window': [
    (m) => {
      m.window.above_largest = 'refuse';
    },
    /field window\.above_largest: expected "reset"/,
  ],
  'another selection': [
    (m) => {
      m.selection.largest_count = 300;
    },
    /field selection\.largest_count: expected 500; found 300/,
  ],
  'another size': [
    (m) => {
      m.preprocessing.width_px += 1;
    },
    /field preprocessing\.width_px: expected 160, as in its graphs; found 161/,
  ],
  'a class too few': [
    (m) => {
      m.classes.pop();
    },
    /field classes: expected 10, as in its graphs; found 9/,
  ],
  'another window': [
    (m) => {
      m.window.num_frames = 3;
    },
    /field window\.num_frames: expected 4, as in its graphs; found 3/,
  ],
  'a path for a file': [
    (m) => {
      m.graphs.lifter.file = '../lifter.onnx';
    },
    /field graphs\.lifter\.file: expected "lifter\.onnx"/,
  ],
  'an unknown graph': [
    (m) => {
      m.graphs.other = m.graphs.lifter;
    },
    /field graphs\.other: expected one of/,
  ],
  'a graph too few': [
    (m) => {
      delete m.graphs.projector;
    },
    /field graphs\.projector: expected an entry/,
  ],
  'a huge tensor': [
    (m) => {
      m.graphs.lifter.inputs[0].shape = [65536, 65536];
    },
    /field graphs\.lifter\.inputs\.0\.shape/,
  ],
  'a cached value that no graph has': [
    (m) => {
      m.memory[0] = 'nothing';
    },
    /field memory: expected outputs/,
  ],
  'a name with a control character': [
    (m) => {
      m.classes[0] = 'c\u001bar';
    },
    /field classes: expected a list of names; found \["c\\u001bar"/,
  ],
};

for (const [name, [change, message]] of Object.entries(FAULTS)) {
  test(`${name} is refused`, needsFixtures, async () => {
    await assert.rejects(readChanged(change), (error) => {
      assert.equal(error.name, 'BundleError');
      assert.match(error.message, message);
      return true;
    });
  });
}
