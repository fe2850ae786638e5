// The golden example finds the usual mistakes of a consumer, which are put in here one at a time.

import assert from 'node:assert/strict';
import test from 'node:test';

import { readGolden, verify } from '../lib/golden.js';
import { Pipeline } from '../lib/pipeline.js';
import { loadOrt } from '../node/engine.js';
import { bundleFixture, needsFixtures } from './fixtures.js';

const NO_JPEG = {}; // golden images are PNG files

const loaded = new Map(); // graphs are opened once

async function load(name) {
  if (!loaded.has(name)) {
    const bundle = await bundleFixture(name);
    loaded.set(name, { golden: await readGolden(bundle), pipeline: await Pipeline.load(loadOrt(1), bundle) });
  }
  return loaded.get(name);
}

/** Run the golden example of a bundle with a mistake, and return the report. */
async function verifyWith(makeMistake, name) {
  const { golden, pipeline } = await load(name);
  const faulty = new Pipeline(structuredClone(pipeline.manifest), new Map(pipeline.graphs));
  makeMistake(faulty);
  return verify(faulty, golden, NO_JPEG);
}

/** Change the inputs of a graph. */
function changeInputs(pipeline, name, change) {
  const graph = pipeline.graphs.get(name);
  pipeline.graphs.set(name, { spec: graph.spec, run: (values) => graph.run(change({ ...values })) });
}

function redForBlue(images) {
  return images.map((_, index) => images[index % 3 === 0 ? index + 2 : index % 3 === 2 ? index - 2 : index]);
}

/** Exchange two columns of matrices of four columns. */
function exchangeColumns(matrices, one, other) {
  const exchanged = { [one]: other, [other]: one };
  return matrices.map((_, index) => matrices[index - (index % 4) + (exchanged[index % 4] ?? index % 4)]);
}

function transposed(matrices) {
  return matrices.map(
    (_, index) => matrices[16 * Math.floor(index / 16) + 4 * (index % 4) + Math.floor((index % 16) / 4)],
  );
}

const MISTAKES = {
  'RGB for BGR': (pipeline) =>
    changeInputs(pipeline, 'backbone', (values) => ({ ...values, images: redForBlue(values.images) })),
  'x and y exchanged in the projections': (pipeline) => {
    for (const name of ['projector', 'decoder']) {
      changeInputs(pipeline, name, (values) => ({ ...values, image_T_ego: exchangeColumns(values.image_T_ego, 0, 1) }));
    }
  },
  'transposed ego motion': (pipeline) =>
    changeInputs(pipeline, 'decoder', (values) => ({ ...values, past_T_now: transposed(values.past_T_now) })),
  'slots 1 and 2 exchanged': (pipeline) => {
    changeInputs(pipeline, 'decoder', (values) => {
      const renamed = Object.entries(values).map(([key, value]) => [
        key.replace(/^slot([12])\./, (_, slot) => `slot${3 - slot}.`),
        value,
      ]);
      return Object.fromEntries(renamed);
    });
  },
  'slot 0 for slot 1': (pipeline) => {
    changeInputs(pipeline, 'decoder', (values) => {
      const present = Object.entries(values).map(([key, value]) => [
        key,
        key.startsWith('slot1.') ? values[key.replace('slot1', 'slot0')] : value,
      ]);
      return Object.fromEntries(present);
    });
  },
  'a lost camera that counts': (pipeline) =>
    changeInputs(pipeline, 'decoder', (values) => ({ ...values, camera_valid: values.camera_valid.map(() => 1) })),
  'ages that are never told': (pipeline) =>
    changeInputs(pipeline, 'decoder', (values) => ({ ...values, time_delta_s: values.time_delta_s.map(() => 0) })),
  'classes in another order': (pipeline) => {
    pipeline.manifest.classes.reverse();
  },
};

for (const name of ['bundle', 'int8']) {
  test(`the golden example of the ${name} is verified`, needsFixtures, async () => {
    const report = await verifyWith(() => {}, name);
    assert.deepEqual(report.differences, []);
    assert.ok(report.passed);
    assert.equal(report.frames, 3);
    assert.ok(report.tensors > 60 && report.values > 9000, JSON.stringify(report));
  });
}

for (const [mistake, make] of Object.entries(MISTAKES)) {
  test(`found: ${mistake}`, needsFixtures, async () => {
    const report = await verifyWith(make, 'bundle');
    assert.ok(!report.passed && report.count > 0);
    const { frame, tensor, expected, found } = report.differences[0];
    assert.ok(frame && tensor && expected && found);
  });
}

// Rounding hides smaller mistakes, such as exchanged slots: prove a consumer with a float32 bundle first.
for (const mistake of ['RGB for BGR', 'x and y exchanged in the projections']) {
  test(`found in int8: ${mistake}`, needsFixtures, async () =>
    assert.ok(!(await verifyWith(MISTAKES[mistake], 'int8')).passed),
  );
}
