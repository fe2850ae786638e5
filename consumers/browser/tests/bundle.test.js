import assert from 'node:assert/strict';
import test from 'node:test';

import { readBundle } from '../lib/bundle.js';
import { readGolden } from '../lib/golden.js';
import { openGraphs } from '../lib/sessions.js';
import { loadOrt, openFolder } from '../node/engine.js';
import { bundleFixture, fixture, folderOf, needsFixtures } from './fixtures.js';
import { sealed } from './sealed-manifest.js';

/** The files of the bundle in memory, after a change. */
async function changed(change) {
  const folder = await openFolder(fixture('bundle'));
  const contents = Object.fromEntries(
    await Promise.all(folder.paths.map(async (path) => [path, await folder.read(path)])),
  );
  change(contents);
  return folderOf(contents, 'tiny');
}

test('a damaged, truncated or missing graph is refused, and the file is named', needsFixtures, async () => {
  const changes = {
    'a flipped bit': [
      (files) => {
        files['lifter.onnx'] = files['lifter.onnx'].with(1000, files['lifter.onnx'][1000] ^ 1);
      },
      /^lifter\.onnx: expected the SHA-256/,
    ],
    'the first half': [
      (files) => {
        files['decoder.onnx'] = files['decoder.onnx'].slice(0, 5000);
      },
      /^decoder\.onnx: expected the SHA-256 .* 5000 bytes\. The file is damaged/,
    ],
    'no file': [
      (files) => {
        delete files['backbone.onnx'];
      },
      /^backbone\.onnx: expected the bundle's backbone graph; found no such file/,
    ],
    'no manifest': [
      (files) => {
        delete files['manifest.json'];
      },
      /^tiny: expected a bundle, with manifest\.json in it/,
    ],
  };
  for (const [name, [change, message]] of Object.entries(changes)) {
    await assert.rejects(readBundle(await changed(change)), { name: 'BundleError', message }, name);
  }
});

test('a graph with other tensors than the manifest says is refused', needsFixtures, async () => {
  const bundle = await bundleFixture();
  const manifest = structuredClone(bundle.manifest);
  manifest.graphs.projector.outputs[0].name = 'another';
  const opened = openGraphs(loadOrt(1), { manifest, graphs: bundle.graphs });
  await assert.rejects(opened, /^BundleError: projector\.onnx, outputs: expected another float32/);
});

test('bytes that are no graph are refused', needsFixtures, async () => {
  const { manifest } = await bundleFixture();
  const opened = openGraphs(loadOrt(1), { manifest, graphs: new Map([['lifter', new Uint8Array(100)]]) });
  await assert.rejects(opened, /^BundleError: lifter\.onnx: expected a graph that onnxruntime-web can load/);
});

test('a changed golden example is refused', needsFixtures, async () => {
  const changes = {
    'an edited file': [
      (files) => {
        files['golden/results.jsonl'] = files['golden/results.jsonl'].slice(1);
      },
      /^golden\/results\.jsonl: expected the SHA-256/,
    ],
    'a further file': [
      (files) => {
        files['golden/x'] = new Uint8Array(1);
      },
      /^golden\/x: expected only files that manifest\.json lists/,
    ],
    'a missing file': [
      (files) => {
        delete files['golden/expected.json'];
      },
      /^golden\/expected\.json: expected a file/,
    ],
  };
  for (const [name, [change, message]] of Object.entries(changes)) {
    await assert.rejects(readGolden(await readBundle(await changed(change))), { name: 'BundleError', message }, name);
  }
});

test('a bundle without a golden example says so', needsFixtures, async () => {
  const folder = await changed((files) => {
    const manifest = JSON.parse(new TextDecoder().decode(files['manifest.json']));
    files['manifest.json'] = sealed({ ...manifest, golden: null });
  });
  await assert.rejects(readGolden(await readBundle(folder)), /field golden: expected a golden example; found nothing/);
});

test('graphs that were loaded are freed if a later one is refused', async () => {
  const spec = { name: 'values', dtype: 'float32', shape: [1] };
  const graph = { inputs: [spec], outputs: [spec] };
  const described = [{ name: 'values', type: 'float32', shape: [1] }];
  let numOpen = 0;
  const create = async (bytes) => {
    if (bytes.length === 0) throw new Error('damaged');
    numOpen += 1;
    const release = async () => {
      numOpen -= 1;
    };
    return { inputMetadata: described, outputMetadata: bytes.length === 1 ? described : [], release };
  };
  const open = (...lengths) => {
    const graphs = new Map(lengths.map((length, index) => [`graph${index}`, new Uint8Array(length)]));
    const specs = Object.fromEntries([...graphs.keys()].map((name) => [name, graph]));
    return openGraphs({ InferenceSession: { create } }, { manifest: { graphs: specs }, graphs });
  };
  await assert.rejects(open(1, 0), /damaged/);
  await assert.rejects(open(1, 2), /found no more/);
  assert.equal(numOpen, 0);
  assert.equal((await open(1, 1)).size, 2);
});
