import assert from 'node:assert/strict';
import { createHash } from 'node:crypto';
import { appendFile, cp, mkdir, readFile, rm, truncate, writeFile } from 'node:fs/promises';
import path from 'node:path';
import test, { after } from 'node:test';

import { fixture, fixtureJson } from '../fixtures.js';
import { sealed } from '../sealed-manifest.js';
import { closeBrowser, drop, folderWith, needsPage, openPage, pickFolder, waitForFrame } from './browser.js';

after(closeBrowser);

test('a bundle and a drive that are picked together run, and every request goes to the host', needsPage, async (t) => {
  const { page, host, problems, requests } = await openPage(t);
  const folder = await folderWith({ bundle: fixture('bundle'), drive: fixture('drive') });
  t.after(() => rm(folder, { recursive: true }));
  await pickFolder(page, folder);
  await waitForFrame(page, 1);
  assert.match(
    await page.textContent('#summary'),
    /^tiny, float32(, random weights)? · 20 frames · onnxruntime-web [\d.]+, \d+ threads?$/,
  );
  assert.equal(await threads(page), await cores(page));
  const ticks = await page.evaluate(countTicks);
  await page.evaluate(() => document.getElementById('play').click());
  await waitForFrame(page, 20);
  assert.ok((await page.evaluate(() => window.ticks)) - ticks > 20, 'the page is not responsive while frames run');
  await writeResults(page);
  assert.deepEqual(problems, []);
  assert.deepEqual(
    requests.filter((url) => !url.startsWith(host.url) && !url.startsWith('blob:')),
    [],
  );

  await page.evaluate(() => {
    document.getElementById('scrub').value = '4';
    document.getElementById('scrub').dispatchEvent(new Event('input'));
  });
  await waitForFrame(page, 5);
  assert.match(await page.textContent('#frame-info'), /skipped: every camera is lost/);
  await page.keyboard.press('ArrowLeft');
  await waitForFrame(page, 4);
  assert.match(await page.textContent('#frame-info'), /history of 0\.5, 1\.0, 1\.5 s · 320 detections/);
  for (const stage of [
    'total',
    'images',
    'preprocess',
    'backbone',
    'projector',
    'lifter',
    'decoder',
    'segmenter',
    'postprocess',
  ]) {
    assert.match(await page.textContent('#stages'), new RegExp(`${stage} [\\d.]+ ms`));
  }
  await page.fill('#score', '1');
  assert.match(await page.textContent('#legend'), /No box reaches the minimum score/);
});

test(
  'dropped folders are opened, the golden scene is shown, and the golden example is verified',
  needsPage,
  async (t) => {
    const { page, problems } = await openPage(t);
    await drop(page, [fixture('bundle')]);
    assert.match(await page.textContent('#start-title'), /Now drop a scene folder/);
    await page.click('#start-golden');
    await waitForFrame(page, 1);
    await page.click('#verify');
    await page.waitForSelector('#verdict:not([hidden])');
    assert.match(
      await page.textContent('#verdict'),
      /^VerifiedThe golden example gives the expected values: 3 frames, \d+ tensors/,
    );
    await page.click('#verdict .close');
    await drop(page, [fixture('drive')]);
    await waitForFrame(page, 1);
    assert.match(await page.textContent('#summary'), /20 frames/);
    assert.deepEqual(problems, []);
  },
);

test('a frame that was wanted while another scene is opened is not looked for in that scene', needsPage, async (t) => {
  const { page, problems } = await openPage(t);
  await drop(page, [fixture('bundle')]);
  await drop(page, [fixture('drive')]);
  await waitForFrame(page, 1);
  await page.evaluate(() => {
    for (const index of ['18', '19']) {
      document.getElementById('scrub').value = index;
      document.getElementById('scrub').dispatchEvent(new Event('input'));
    }
    document.getElementById('start-golden').click(); // its scene has 3 frames
  });
  await waitForFrame(page, 1);
  assert.match(await page.textContent('#position'), /^1 \/ 3/);
  assert.equal(await page.isVisible('#problem'), false);
  assert.deepEqual(problems, []);
});

test('what cannot be used is refused with the reason and a remedy', needsPage, async (t) => {
  const { page } = await openPage(t);
  const folder = await folderWith({ bundle: fixture('bundle') });
  t.after(() => rm(folder, { recursive: true }));
  await pickFolder(page, folder); // what is refused later does not replace this bundle
  for (const [name, { make, expected, found }] of Object.entries(REFUSED)) {
    const broken = path.join(folder, 'refused');
    await mkdir(broken, { recursive: true });
    await make(broken);
    await drop(page, [broken]);
    await page.waitForSelector('#problem:not([hidden])');
    const text = await page.evaluate(() =>
      [...document.querySelectorAll('#problem dd')].map((part) => part.textContent),
    );
    assert.match(text[1], expected, name);
    assert.match(text[2], found, name);
    assert.ok(text[3]?.length > 10, name);
    assert.match(await page.textContent('#start-text'), /tiny \(float32\) is loaded/, name);
    await page.click('#problem .close');
    await rm(broken, { recursive: true });
  }
  // A refused scene does not replace an open one either.
  await page.click('#start-golden');
  await waitForFrame(page, 1);
  await mkdir(path.join(folder, 'refused'));
  await REFUSED['a scene with a missing image'].make(path.join(folder, 'refused'));
  await drop(page, [path.join(folder, 'refused')]);
  await page.waitForSelector('#problem:not([hidden])');
  await page.click('#forward');
  await waitForFrame(page, 2);
});

test('a wrong value of the golden example is reported with frame, tensor and index', needsPage, async (t) => {
  const { page } = await openPage(t);
  const folder = await folderWith({ bundle: fixture('bundle') });
  t.after(() => rm(folder, { recursive: true }));
  await changeGolden(path.join(folder, 'bundle'));
  await pickFolder(page, folder);
  await page.click('#verify');
  await page.waitForSelector('#verdict.failed:not([hidden])');
  assert.match(await page.textContent('#verdict'), /Not verified: 1 differences.*golden-1decoder\.boxes0, 2/);
});

for (const [name, options] of [
  ['without headers, a service worker isolates the page', {}],
  ['without headers and service workers, the graphs run in one thread', { serviceWorkers: 'block' }],
]) {
  test(name, needsPage, async (t) => {
    const { page } = await openPage(t, { isolated: false, options });
    await page.waitForFunction(
      (expected) => window.crossOriginIsolated === expected && document.documentElement.dataset.ready,
      options.serviceWorkers !== 'block',
    );
    await drop(page, [fixture('bundle')]);
    await page.click('#start-golden');
    await waitForFrame(page, 1);
    assert.equal(await threads(page), options.serviceWorkers === 'block' ? 1 : await cores(page));
  });
}

test('nothing overlaps in wide, usual and narrow windows', needsPage, async (t) => {
  const { page } = await openPage(t);
  await drop(page, [fixture('bundle')]);
  await page.click('#start-golden');
  await waitForFrame(page, 1);
  for (const [width, height] of [
    [1280, 800],
    [1920, 1080],
    [1024, 600],
    [420, 900],
  ]) {
    await page.setViewportSize({ width, height });
    await page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
    const name = `${width}x${height}`;
    assert.deepEqual(await page.evaluate(findOverlaps), [], name);
    assert.ok(
      await page.evaluate(() => document.documentElement.scrollWidth <= window.innerWidth),
      `too wide at ${name}`,
    );
    if (width > 960)
      assert.ok(
        await page.evaluate(() => document.documentElement.scrollHeight <= window.innerHeight),
        `too high at ${name}`,
      );
  }
});

const REFUSED = {
  'an archive': {
    make: (folder) => writeFile(path.join(folder, 'nano.zip'), 'PK\x03\x04'),
    expected: /^a folder$/,
    found: /^an archive$/,
  },
  'a folder of images': {
    make: (folder) => cp(fixture('drive', 'images'), folder, { recursive: true }),
    expected: /^manifest\.json or scene\.json$/,
    found: /files without them: refused\/CAM_/,
  },
  'an edited manifest': {
    make: async (folder) => {
      await cp(fixture('bundle'), folder, { recursive: true, dereference: true });
      await appendFile(path.join(folder, 'manifest.json'), ' ');
    },
    expected: /hash|hexadecimal/,
    found: /./,
  },
  'a truncated graph': {
    make: async (folder) => {
      await cp(fixture('bundle'), folder, { recursive: true, dereference: true });
      await truncate(path.join(folder, 'backbone.onnx'), 1000);
    },
    expected: /^the SHA-256 [0-9a-f]{12}… of the manifest$/,
    found: /, 1000 bytes$/,
  },
  'a scene with a missing image': {
    make: async (folder) => {
      await cp(fixture('drive'), folder, { recursive: true });
      const [first] = Object.values((await fixtureJson('drive', 'scene.json')).frames[0].cameras);
      await rm(path.join(folder, first.image));
    },
    expected: /^the image images\/.*\.png in the folder$/,
    found: /^no such file$/,
  },
  'two bundles': {
    make: async (folder) => {
      for (const name of ['bundle', 'int8'])
        await cp(fixture(name), path.join(folder, name), { recursive: true, dereference: true });
    },
    expected: /^one bundle$/,
    found: /^2: refused\/bundle, refused\/int8$/,
  },
};

/** Change one expected value of a bundle, with its hash and the seal. */
async function changeGolden(bundle) {
  const file = path.join(bundle, 'golden', 'expected.json');
  const expected = JSON.parse(await readFile(file, 'utf8'));
  expected.frames[1].tensors['decoder.boxes'].values[2] += 1;
  const text = JSON.stringify(expected);
  await writeFile(file, text);
  const manifest = JSON.parse(await readFile(path.join(bundle, 'manifest.json'), 'utf8'));
  manifest.golden.sha256['golden/expected.json'] = createHash('sha256').update(text).digest('hex');
  await writeFile(path.join(bundle, 'manifest.json'), sealed(manifest));
}

/** The number of threads that the page names. */
async function threads(page) {
  return Number(/, (\d+) threads?$/.exec(await page.textContent('#summary'))[1]);
}

async function cores(page) {
  return page.evaluate(() => Math.min(8, navigator.hardwareConcurrency));
}

/** Save the results with the button of the page, for a comparison with Python's. */
async function writeResults(page) {
  const download = page.waitForEvent('download');
  await page.click('#save');
  await (await download).saveAs(fixture('page_results.jsonl'));
}

/** In the page: count animation frames from now on. Returns the count, 0. */
function countTicks() {
  window.ticks = 0;
  const tick = () => {
    window.ticks += 1;
    requestAnimationFrame(tick);
  };
  tick();
  return 0;
}

/** In the page: pairs of visible parts that overlap. */
function findOverlaps() {
  const selectors = [
    '.bar h1',
    '#summary',
    '.bar .actions',
    '.camera',
    '.bird-eye',
    '#legend',
    '.time-line .buttons',
    '.scrub',
    '#position',
    '#frame-info',
    '.settings',
    '#stages',
  ];
  const parts = selectors.flatMap((selector) =>
    [...document.querySelectorAll(selector)].map((part) => ({ selector, box: part.getBoundingClientRect() })),
  );
  const overlaps = [];
  parts.forEach((one, index) => {
    for (const other of parts.slice(index + 1)) {
      const width = Math.min(one.box.right, other.box.right) - Math.max(one.box.left, other.box.left);
      const height = Math.min(one.box.bottom, other.box.bottom) - Math.max(one.box.top, other.box.top);
      if (width > 1 && height > 1) overlaps.push(`${one.selector} and ${other.selector}`);
    }
  });
  return overlaps;
}
